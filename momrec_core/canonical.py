"""Canonical position, orientation and size of a shape: section 4 of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from momrec_core.errors import DegenerateShapeError
from momrec_core.moments import surface_moments, triangles_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CANONICAL_AREA", "CanonicalShape", "normalize"]

CANONICAL_AREA = 100.0  # C of eq. 5, as in the paper's section 5
NO_AREA = 1e-14  # of the squared extent: what rounding leaves of a surface squeezed to a line
HIT_TOLERANCE = 1e-9  # of the extent: how near an axis line passes to an edge that it meets
LARGEST_EXTENT = 1e60  # metres, and one over it the smallest: eigenvalues go with its 4th power
TIE_TOLERANCE = 1e-7  # relative: below it, the two ends of an axis differ by rounding only


@dataclass(frozen=True, eq=False)
class CanonicalShape:
    """A shape in canonical position, orientation and size, made with `normalize`.

    Attributes
    ----------
    mesh : Trimesh
        The canonical mesh, unitless: centroid at the origin, v1 along z, v2 along x, v3 along y.
        Vertices and faces are those of the shape, in their order.
    matrix : array, shape (4, 4)
        Homogeneous similarity that takes the world (metres) to the canonical frame.
    principal_frame : array, shape (4, 4)
        Pose of the principal frame in the world (metres): origin the centroid, columns
        x, y, z = v2, v3, v1; right-handed.
    scale : float
        alpha of eq. 13, canonical units per metre.
    moments : array, shape (6, 6, 6)
        Normalised moments eta_ijk up to order 5 at [i, j, k].
    eigenvalues : array, shape (3,)
        Of the inertia matrix (eq. 9) in the world, increasing, metres to the power 4.
    eigenvalue_gaps : array, shape (2,)
        Second less first and third less second eigenvalue, relative to the third.
    sign_margins : array, shape (2,)
        For v1 and v2: how much farther the surface reaches on the axis' positive side than on
        its negative side, relative to the farther one, 0 to 1; NaN where the axis line misses the
        surface.
    is_unique : bool
        Whether all gaps and margins are above the tolerances.
    alternatives : tuple of arrays, shape (4, 4)
        World poses of the further right-handed principal frames that are as good within the
        tolerances, at most 23.
    """

    mesh: trimesh.Trimesh
    matrix: NDArray[np.float64]
    principal_frame: NDArray[np.float64]
    scale: float
    moments: NDArray[np.float64]
    eigenvalues: NDArray[np.float64]
    eigenvalue_gaps: NDArray[np.float64]
    sign_margins: NDArray[np.float64]
    is_unique: bool
    alternatives: tuple[NDArray[np.float64], ...]


def normalize(
    mesh: trimesh.Trimesh,
    area: float = CANONICAL_AREA,
    gap_tolerance: float = 0.02,
    sign_tolerance: float = 0.01,
) -> CanonicalShape:
    """Bring a shape into its canonical position, orientation and size.

    Parameters
    ----------
    mesh : Trimesh
        A triangle mesh in the world, metres; any size, place and winding, closed or not.
    area : float
        C of eq. 5, the area of the canonical surface.
    gap_tolerance : float
        Axes whose eigenvalues differ by less, relative to the largest, are interchangeable.
    sign_tolerance : float
        An axis whose two ends differ by less, relative to the farther, has no sure sign.

    Returns
    -------
    shape : CanonicalShape

    Raises
    ------
    DegenerateShapeError
        If the mesh has no face, a vertex that is not finite, or no area.
    ValueError
        If the area or a tolerance is out of its range.

    Notes
    -----
    Equations 6 to 13 with the rules A.1 to A.3 for the signs. Beyond the paper: where an axis line
    misses the surface, or meets it equally far on both sides, the axis points to where its
    third-order moment is positive, or, if that vanishes too, to the side of the first vertex that
    is off the centroid's plane. Every rule moves along with a similarity.
    """
    if not (np.isfinite(area) and area > 0):
        raise ValueError(f"Expected a positive area, got {area}")
    if not (0 <= gap_tolerance < 1 and 0 <= sign_tolerance < 1):
        raise ValueError(
            f"Expected tolerances from 0 to below 1, got {gap_tolerance} and {sign_tolerance}"
        )
    centred, centroid, extent = _centred(mesh)
    eigenvalues, axes = _principal_axes(surface_moments(centred, order=2))
    aligned = trimesh.Trimesh(centred.vertices @ axes, centred.faces, process=False)
    signs, margins = _directions(aligned)
    gaps = np.diff(eigenvalues) / eigenvalues[2]
    principal, *alternatives = _admissible_frames(
        axes * signs, exchangeable=gaps < gap_tolerance, signed=margins >= sign_tolerance
    )
    metric_area = centred.area * extent**2
    scale = float(np.sqrt(area / metric_area))
    canonical = trimesh.Trimesh(
        centred.vertices @ principal * (scale * extent), centred.faces, process=False
    )
    return CanonicalShape(
        mesh=canonical,
        matrix=_similarity(principal, centroid, scale),
        principal_frame=_pose(principal, centroid),
        scale=scale,
        moments=surface_moments(canonical, order=5),
        eigenvalues=eigenvalues * extent**4,
        eigenvalue_gaps=gaps,
        sign_margins=margins[:2],
        is_unique=not alternatives,
        alternatives=tuple(_pose(frame, centroid) for frame in alternatives),
    )


def _centred(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, NDArray[np.float64], float]:
    """Return the mesh about its centroid in units of its extent, the centroid and the extent."""
    corners = triangles_of(mesh).reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = float(2.0 * np.max(high / 2.0 - low / 2.0))
    if not 1.0 / LARGEST_EXTENT <= extent <= LARGEST_EXTENT:
        raise DegenerateShapeError(f"Expected a mesh with an area, got an extent of {extent:.6g}")
    middle = (low + high) / 2.0
    vertices = (np.asarray(mesh.vertices, dtype=np.float64) - middle) / extent
    faces = np.asarray(mesh.faces)
    moments = surface_moments(trimesh.Trimesh(vertices, faces, process=False), order=1)
    if moments[0, 0, 0] <= NO_AREA:
        raise DegenerateShapeError(
            f"Expected a mesh with an area, got {moments[0, 0, 0]:.3g} of its squared extent"
        )
    shift = np.array([moments[1, 0, 0], moments[0, 1, 0], moments[0, 0, 1]]) / moments[0, 0, 0]
    centred = trimesh.Trimesh(vertices - shift, faces, process=False)
    return centred, middle + shift * extent, extent


def _principal_axes(
    moments: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return eigenvalues, increasing, and eigenvectors (columns) of the inertia matrix, eq. 9."""
    second = np.diag([moments[2, 0, 0], moments[0, 2, 0], moments[0, 0, 2]])
    second[[0, 1], [1, 0]] = moments[1, 1, 0]
    second[[0, 2], [2, 0]] = moments[1, 0, 1]
    second[[1, 2], [2, 1]] = moments[0, 1, 1]
    eigenvalues, axes = np.linalg.eigh(np.trace(second) * np.eye(3) - second)
    return eigenvalues, axes


def _directions(aligned: trimesh.Trimesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return signs and sign margins (3,) of the coordinate axes of a centred mesh: A.1, A.2."""
    moments = surface_moments(aligned, order=3)
    third = np.array([moments[3, 0, 0], moments[0, 3, 0], moments[0, 0, 3]])
    spread = np.array([moments[2, 0, 0], moments[0, 2, 0], moments[0, 0, 2]]) / moments[0, 0, 0]
    skewness = third / (moments[0, 0, 0] * np.maximum(spread, TIE_TOLERANCE**2) ** 1.5)
    signs, margins = np.ones(3), np.full(3, np.nan)
    for axis in range(3):
        heights = _axis_hits(aligned, axis)
        upper, lower = np.max(heights, initial=0.0), np.max(-heights, initial=0.0)
        farther = max(upper, lower)
        if len(heights):
            margins[axis] = abs(upper - lower) / farther if farther > HIT_TOLERANCE else 0.0
        if margins[axis] > TIE_TOLERANCE:
            signs[axis] = np.sign(upper - lower)
        elif abs(skewness[axis]) > TIE_TOLERANCE:
            signs[axis] = np.sign(skewness[axis])
        else:
            signs[axis] = _side_of_first_vertex(aligned.vertices[:, axis])
    return signs, margins


def _side_of_first_vertex(heights: NDArray[np.float64]) -> float:
    off_plane = heights[np.abs(heights) >= np.abs(heights).max() / 2.0]
    return float(np.copysign(1.0, off_plane[0]))


def _axis_hits(aligned: trimesh.Trimesh, axis: int) -> NDArray[np.float64]:
    """Return the coordinates at which a coordinate axis meets the surface, in no order.

    Faces are seen along the axis: one that has the origin inside is hit; edges and vertices are
    hit if the axis passes within `HIT_TOLERANCE`, so that no hit is lost between two faces or on
    a face seen edge on.
    """
    vertices = np.asarray(aligned.vertices)
    heights = vertices[:, axis]
    flat = np.delete(vertices, axis, axis=1)
    starts, ends = aligned.faces, np.roll(aligned.faces, -1, axis=1)
    turns = flat[starts, 0] * flat[ends, 1] - flat[starts, 1] * flat[ends, 0]
    total = turns.sum(axis=1)
    inside = ((turns >= 0).all(axis=1) | (turns <= 0).all(axis=1)) & (total != 0)
    opposite = np.roll(aligned.faces, 1, axis=1)[inside]  # an edge's turn weighs its third corner
    in_faces = np.einsum("ij,ij->i", turns[inside], heights[opposite]) / total[inside]

    sides = flat[ends] - flat[starts]
    squared = np.einsum("ijk,ijk->ij", sides, sides)
    along = -np.einsum("ijk,ijk->ij", flat[starts], sides)
    fraction = np.clip(along / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
    nearest = np.linalg.norm(flat[starts] + fraction[..., None] * sides, axis=2)
    on_edges = (heights[starts] + fraction * (heights[ends] - heights[starts]))[
        nearest <= HIT_TOLERANCE
    ]
    corners = np.unique(aligned.faces)
    at_corners = heights[corners][np.linalg.norm(flat[corners], axis=1) <= HIT_TOLERANCE]
    return np.concatenate([in_faces, on_edges, at_corners])


def _admissible_frames(
    axes: NDArray[np.float64], exchangeable: NDArray[np.bool_], signed: NDArray[np.bool_]
) -> list[NDArray[np.float64]]:
    """Return the right-handed frames, columns v2, v3, v1, the one by A.1 to A.3 first.

    Parameters
    ----------
    axes : array, shape (3, 3)
        Principal axes as columns, by increasing eigenvalue, with their likely signs.
    exchangeable : array of bool, shape (2,)
        Whether the first two, the last two axes cannot be told apart.
    signed : array of bool, shape (3,)
        Whether the sign of an axis is sure.
    """
    rank = np.concatenate([[0], np.cumsum(~exchangeable)])  # equal for axes that are alike
    frames = []
    for order in permutations(range(3)):
        if (rank[list(order)] != rank).any():
            continue
        choices = [(1.0,) if signed[axis] else (1.0, -1.0) for axis in order[:2]]
        for first, second in product(*choices):
            v1, v2 = first * axes[:, order[0]], second * axes[:, order[1]]
            frames.append(np.column_stack([v2, np.cross(v1, v2), v1]))
    return frames


def _pose(rotation: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def _similarity(
    principal: NDArray[np.float64], centroid: NDArray[np.float64], scale: float
) -> NDArray[np.float64]:
    """Return A R T of eqs. 4a to 4c as one matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * principal.T
    matrix[:3, 3] = -matrix[:3, :3] @ centroid
    return matrix
