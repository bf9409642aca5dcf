"""Pictures of meshes: a small z-buffer renderer in numpy, hidden surfaces exact to the pixel."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

__all__ = ["Rendering", "Viewpoint", "render"]

OVERSAMPLING = 2  # samples per pixel and direction, averaged: smooth edges
FRAGMENTS = 4_000_000  # samples that are worked on at a time; bounds the memory at about 300 MB
CREASE_ANGLE = np.deg2rad(30.0)  # faces that meet flatter than this are shaded as one surface
SMOOTHING_ROUNDS = 3  # evens out the strips between slices, keeps what is wider
LIGHT = np.array([-0.45, 0.60, 0.66])  # right, up, towards the viewer: over the left shoulder
AMBIENT, DIFFUSE, GLOSS = 0.30, 0.72, 0.10
STEP = 0.04  # of the picture's half width: a depth difference that is drawn as a line
LINE_STRENGTH = 0.45


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """Where a picture is taken from, by parallel projection.

    Attributes
    ----------
    axes : array, shape (3, 3)
        Rows are the directions right, up and towards the viewer, in the world.
    center : array, shape (3,)
        The world point in the middle of the picture.
    half_width : float
        Half the side of the square picture, in world units.
    """

    axes: NDArray[np.float64]
    center: NDArray[np.float64]
    half_width: float

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return right, up and towards the viewer, 1 at the picture's border; shape (n, 3)."""
        seen: NDArray[np.float64] = (points - self.center) @ self.axes.T / self.half_width
        return seen


@dataclass(frozen=True, eq=False)
class Rendering:
    """A shaded picture of a mesh.

    Attributes
    ----------
    image : array, shape (pixels, pixels, 4)
        RGBA, 0 to 1, first row on top; transparent beside the mesh.
    depth : array, shape (pixels, pixels)
        Towards the viewer in half widths of the picture, first row on top; -inf beside the mesh.
    """

    image: NDArray[np.float64]
    depth: NDArray[np.float64]

    def hides(self, seen: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points (as `Viewpoint.project` returns them, shape (n, 3)) lie behind."""
        pixels = len(self.depth)
        columns = np.clip(((seen[:, 0] + 1) / 2 * pixels).astype(int), 0, pixels - 1)
        rows = np.clip(((1 - seen[:, 1]) / 2 * pixels).astype(int), 0, pixels - 1)
        hidden: NDArray[np.bool_] = self.depth[rows, columns] > seen[:, 2]
        return hidden


def render(
    mesh: trimesh.Trimesh, viewpoint: Viewpoint, color: tuple[float, float, float], pixels: int
) -> Rendering:
    """Draw the front of a closed mesh.

    Parameters
    ----------
    mesh : Trimesh
        Wound outward.
    viewpoint : Viewpoint
        From where; what lies outside of its square is not drawn.
    color : tuple of 3 floats
        Of the surface in full light, RGB from 0 to 1.
    pixels : int
        Side of the picture.

    Returns
    -------
    rendering : Rendering
    """
    side = pixels * OVERSAMPLING
    seen = viewpoint.project(np.asarray(mesh.vertices, dtype=np.float64))
    faces = np.asarray(mesh.faces)
    depth, nearest = _rasterise(_on_grid(seen, side)[faces], side)
    shade = _shade(_smooth_normals(mesh) @ viewpoint.axes.T)
    brightness = shade[nearest] * (1 - LINE_STRENGTH * _steps(depth))
    covered = np.isfinite(depth).astype(np.float64)
    light, alpha = _shrunk(brightness * covered), _shrunk(covered)
    image = np.empty((pixels, pixels, 4))
    image[..., :3] = (light / np.maximum(alpha, np.finfo(np.float64).eps))[..., None] * color
    image[..., 3] = alpha
    return Rendering(np.clip(image, 0, 1), depth[::OVERSAMPLING, ::OVERSAMPLING])


def _shrunk(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Average the samples of each pixel."""
    return np.asarray(
        np.mean(
            [
                samples[row::OVERSAMPLING, column::OVERSAMPLING]
                for row in range(OVERSAMPLING)
                for column in range(OVERSAMPLING)
            ],
            axis=0,
        )
    )


def _on_grid(seen: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Bring projected points to sample columns and rows (samples at integers), depth kept."""
    columns = (seen[:, 0] + 1) / 2 * side - 0.5
    rows = (1 - seen[:, 1]) / 2 * side - 0.5
    return np.column_stack([columns, rows, seen[:, 2]])


def _rasterise(
    triangles: NDArray[np.float64], side: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return depth and face of what is nearest at each sample; face 0 where there is none."""
    gradients, facing = _depth_planes(triangles)
    faces = np.flatnonzero(facing)
    tops = np.clip(np.ceil(triangles[faces, :, 1].min(axis=1)), 0, side).astype(np.int64)
    bottoms = np.clip(np.floor(triangles[faces, :, 1].max(axis=1)), -1, side - 1).astype(np.int64)
    owners, rows = _expand(faces, tops, bottoms)
    lefts, rights = _spans(triangles[owners], rows, side)
    depth = np.full(side * side, -np.inf)
    nearest = np.zeros(side * side, dtype=np.int64)
    for part in _parts(rights - lefts + 1):
        spans, columns = _expand(np.arange(len(rows))[part], lefts[part], rights[part])
        owner, row = owners[spans], rows[spans]
        gradient = gradients[owner]
        height = gradient[:, 0] * columns + gradient[:, 1] * row + gradient[:, 2]
        sample = row * side + columns
        np.maximum.at(depth, sample, height)
        front = height == depth[sample]
        nearest[sample[front]] = owner[front]
    return depth.reshape(side, side), nearest.reshape(side, side)


def _depth_planes(
    triangles: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return depth = a column + b row + c of every face, and which faces look at the viewer."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # Rows run downwards, so that what faces the viewer has turned to negative orientation.
    facing = normals[:, 2] < 0
    slope = np.where(facing, normals[:, 2], -1.0)
    a, b = -normals[:, 0] / slope, -normals[:, 1] / slope
    first = triangles[:, 0]
    return np.column_stack([a, b, first[:, 2] - a * first[:, 0] - b * first[:, 1]]), facing


def _expand(
    owners: NDArray[np.int64], first: NDArray[np.int64], last: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return every integer from first to last, and its owner."""
    counts = np.maximum(last - first + 1, 0)
    starts = np.cumsum(counts) - counts
    values = np.arange(counts.sum()) - np.repeat(starts - first, counts)
    return np.repeat(owners, counts), values


def _spans(
    triangles: NDArray[np.float64], rows: NDArray[np.int64], side: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and the last column of a triangle in a row of samples."""
    start, end = triangles[:, :, :2], np.roll(triangles[:, :, :2], -1, axis=1)
    rise = end[:, :, 1] - start[:, :, 1]
    along = (rows[:, None] - start[:, :, 1]) / np.where(rise == 0, np.inf, rise)
    met = (rise != 0) & (along >= 0) & (along <= 1)
    columns = start[:, :, 0] + along * (end[:, :, 0] - start[:, :, 0])
    lefts = np.where(met, columns, np.inf).min(axis=1)
    rights = np.where(met, columns, -np.inf).max(axis=1)
    return (
        np.ceil(np.clip(lefts, 0, side)).astype(np.int64),
        np.floor(np.clip(rights, -1, side - 1)).astype(np.int64),
    )


def _parts(counts: NDArray[np.int64]) -> list[slice]:
    """Cut a run of spans into parts of about as many samples as are worked on at a time."""
    part = np.cumsum(np.maximum(counts, 0)) // FRAGMENTS
    edges = [0, *(np.flatnonzero(np.diff(part)) + 1).tolist(), len(counts)]
    return [slice(low, high) for low, high in itertools.pairwise(edges)]


def _smooth_normals(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """Return unit face normals, averaged with the neighbours' where there is no crease."""
    normals = np.asarray(mesh.face_normals, dtype=np.float64)
    weighted = normals * np.asarray(mesh.area_faces)[:, None]
    left, right = np.asarray(mesh.face_adjacency).reshape(-1, 2).T
    flat = np.einsum("ij,ij->i", normals[left], normals[right]) > np.cos(CREASE_ANGLE)
    left, right = left[flat], right[flat]
    for _ in range(SMOOTHING_ROUNDS):
        spread = weighted.copy()
        np.add.at(spread, left, weighted[right])
        np.add.at(spread, right, weighted[left])
        weighted = spread
    length = np.linalg.norm(weighted, axis=1, keepdims=True)
    length[length == 0] = 1.0
    smooth: NDArray[np.float64] = weighted / length
    return smooth


def _shade(normals_seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the brightness of faces by their normals (right, up, towards the viewer)."""
    light = LIGHT / np.linalg.norm(LIGHT)
    halfway = light + np.array([0.0, 0.0, 1.0])
    diffuse = 0.5 + 0.5 * normals_seen @ light  # half Lambert: also the side in shadow has form
    gloss = np.clip(normals_seen @ halfway / np.linalg.norm(halfway), 0, None) ** 20
    shade: NDArray[np.float64] = AMBIENT + DIFFUSE * diffuse + GLOSS * gloss
    return shade


def _steps(depth: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mark samples behind which the surface falls away: outlines, also inner ones."""
    padded = np.pad(depth, 1, constant_values=-np.inf)
    middle = padded[1:-1, 1:-1]
    around = [padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]]
    lowest = np.minimum.reduce(around)
    steps: NDArray[np.bool_] = np.isfinite(middle) & (lowest < middle - STEP)
    return steps
