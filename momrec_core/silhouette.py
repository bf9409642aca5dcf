"""The silhouette of a mesh as a camera sees it: what `simulate` and the tests draw from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from momrec_core.camera import Camera
from momrec_core.errors import DegenerateShapeError, InvalidCameraError
from momrec_core.rings import signed_area
from momrec_core.view import View

__all__ = ["silhouette_of_mesh", "silhouettes_of_mesh"]

# Of the extent: rings of less area, or narrower, are rounding, and may cross themselves.
ROUNDING_AREA, ROUNDING_WIDTH = 1e-9, 1e-6


@dataclass(frozen=True, eq=False)
class _Surface:
    """The faces of a mesh and their edges.

    Attributes
    ----------
    vertices : array, shape (n, 3)
        Those that faces have, all finite.
    faces : array, shape (m, 3)
    edges : array, shape (e, 2)
        Ends of the undirected edges.
    sides : array, shape (m, 3)
        The edge of each face's three sides.
    along : array, shape (m, 3)
        1 where a face's side runs from the edge's first end to its second, else -1.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    edges: NDArray[np.int64]
    sides: NDArray[np.int64]
    along: NDArray[np.float64]


def silhouette_of_mesh(mesh: trimesh.Trimesh, camera: Camera) -> View:
    """Project a mesh and return the view of it.

    Parameters
    ----------
    mesh : Trimesh
        In the world, metres. Need not be closed, nor wound alike; both sides of every face are
        opaque. Vertices that no face has do not count, nor do faces that are not finite.
    camera : Camera
        Any; the whole mesh must lie before a pinhole.

    Returns
    -------
    view : View
        Exact up to 1e-12 of the silhouette's size: the union of all projected faces.

    Raises
    ------
    InvalidCameraError
        If a vertex lies beside or behind a pinhole camera.
    DegenerateShapeError
        If the mesh has no face that projects to an area.

    See Also
    --------
    silhouettes_of_mesh : For several cameras, in less time.
    """
    return next(silhouettes_of_mesh(mesh, [camera]))


def silhouettes_of_mesh(mesh: trimesh.Trimesh, cameras: Iterable[Camera]) -> Iterator[View]:
    """Project a mesh for several cameras.

    Parameters
    ----------
    mesh : Trimesh
        As for `silhouette_of_mesh`.
    cameras : iterable of Camera
        Asked for one by one.

    Yields
    ------
    view : View
        As of `silhouette_of_mesh`, for each camera in turn.

    Raises
    ------
    InvalidCameraError, DegenerateShapeError
        As for `silhouette_of_mesh`.
    """
    surface = _surface(mesh)
    for camera in cameras:
        yield _seen(surface, camera)


def _surface(mesh: trimesh.Trimesh) -> _Surface:
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    faces = faces[np.asarray(np.isfinite(vertices[faces]).all(axis=(1, 2)))]
    used, corners = np.unique(faces, return_inverse=True)
    faces = corners.reshape(-1, 3)
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    count = max(len(used), 1)
    edges, sides = np.unique(low * count + high, return_inverse=True)
    return _Surface(
        vertices=vertices[used],
        faces=faces,
        edges=np.column_stack(np.divmod(edges, count)),
        sides=sides.reshape(-1, 3),
        along=np.where(tails == low, 1.0, -1.0).reshape(-1, 3),
    )


def _seen(surface: _Surface, camera: Camera) -> View:
    points, depths = camera.project(surface.vertices)
    if camera.is_pinhole and (depths.size == 0 or depths.min() <= 0):
        raise InvalidCameraError(
            f"Expected the whole mesh before the camera, got {np.sum(depths <= 0)} of "
            f"{len(depths)} vertices at depth {depths.min(initial=0.0):.6g} or behind"
        )
    low = points.min(axis=0, initial=np.inf)
    extent = float(np.max(points.max(axis=0, initial=-np.inf) - low, initial=0.0))
    if not np.isfinite(extent) or extent <= 0:
        raise DegenerateShapeError(
            f"Expected a mesh with an area, got {len(surface.faces)} faces of finite vertices"
        )
    rings = _outline(surface, (points - low) / extent)
    if not rings:
        raise DegenerateShapeError("Expected a mesh that projects to an area, got none")
    return View.from_rings(camera, [ring * extent + low for ring in rings])


def _outline(surface: _Surface, points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the rings of the union of all faces, from the edges where their layers change.

    The winding number about a point is the number of faces that cover it, each turned to the
    positive side. Edges that two faces run through in opposite directions cancel out, which
    leaves few of a fine mesh.
    """
    triangles = points[surface.faces]
    sides = triangles[:, 1:] - triangles[:, :1]
    areas = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    turns = np.where(np.abs(areas) > np.finfo(np.float64).eps, np.sign(areas), 0.0)
    weights = (surface.along * turns[:, None]).ravel()
    net = np.bincount(surface.sides.ravel(), weights=weights, minlength=len(surface.edges))
    left = np.flatnonzero(net)
    ends = np.where((net[left] > 0)[:, None], surface.edges[left], surface.edges[left, ::-1])
    times = np.abs(net[left]).astype(np.int64)
    loops = [points[loop] for loop in _closed_walks(*np.repeat(ends, times, axis=0).T)]
    union = manifold3d.CrossSection(loops, manifold3d.FillRule.Positive)
    rings = [np.asarray(ring) for ring in union.to_polygons()]
    return [ring for ring in rings if not _is_rounding(ring)]


def _is_rounding(ring: NDArray[np.float64]) -> bool:
    length = float(np.hypot(*(ring - np.roll(ring, 1, axis=0)).T).sum())
    return abs(signed_area(ring)) < max(ROUNDING_AREA, ROUNDING_WIDTH * length / 2)


def _closed_walks(tails: NDArray[np.int64], heads: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return closed walks that together run through directed edges, each once.

    As many edges start at each vertex as end there.
    """
    next_edges = np.empty(len(tails), dtype=np.int64)
    next_edges[np.argsort(heads, kind="stable")] = np.argsort(tails, kind="stable")
    following = next_edges.tolist()
    walked = [False] * len(following)
    walks = []
    for start in range(len(following)):
        walk = []
        edge = start
        while not walked[edge]:
            walked[edge] = True
            walk.append(edge)
            edge = following[edge]
        if walk:
            walks.append(tails[walk])
    return walks
