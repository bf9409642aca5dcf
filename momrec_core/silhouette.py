"""The silhouette of a mesh as a camera sees it: what `simulate` and the tests draw from."""

from __future__ import annotations

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray

from momrec_core.camera import Camera
from momrec_core.errors import DegenerateShapeError, InvalidCameraError
from momrec_core.view import View

__all__ = ["silhouette_of_mesh"]

ROUNDING_AREA = 1e-9  # of the squared extent: rings below are rounding, and may cross themselves


def silhouette_of_mesh(mesh: trimesh.Trimesh, camera: Camera) -> View:
    """Project a mesh and return the view of it.

    Parameters
    ----------
    mesh : Trimesh
        In the world, metres. Need not be closed; both sides of every face are opaque.
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
    """
    points, depths = camera.project(mesh.vertices)
    if camera.is_pinhole and (depths.size == 0 or depths.min() <= 0):
        raise InvalidCameraError(
            f"Expected the whole mesh before the camera, got {np.sum(depths <= 0)} of "
            f"{len(depths)} vertices at depth {depths.min(initial=0.0):.6g} or behind"
        )
    low = points.min(axis=0, initial=np.inf)
    extent = float(np.max(points.max(axis=0, initial=-np.inf) - low, initial=0.0))
    if not np.isfinite(extent) or extent <= 0:
        raise DegenerateShapeError(f"Expected a mesh with an area, got {len(mesh.faces)} faces")
    rings = _outline((points - low) / extent, mesh.faces)
    if not rings:
        raise DegenerateShapeError("Expected a mesh that projects to an area, got none")
    return View.from_rings(camera, [ring * extent + low for ring in rings])


def _outline(points: NDArray[np.float64], faces: NDArray[np.int64]) -> list[NDArray[np.float64]]:
    """Return the rings of the union of all faces, from the edges where their layers change."""
    triangles = points[faces]
    sides = triangles[:, 1:] - triangles[:, :1]
    areas = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    turned = np.where((areas < 0)[:, None], faces[:, ::-1], faces)
    turned = turned[np.abs(areas) > np.finfo(np.float64).eps]
    loops = [points[loop] for loop in _boundary_loops(turned)]
    union = manifold3d.CrossSection(loops, manifold3d.FillRule.Positive)
    rings = [np.asarray(ring) for ring in union.to_polygons()]
    return [ring for ring in rings if abs(_signed_area(ring)) > ROUNDING_AREA]


def _signed_area(ring: NDArray[np.float64]) -> float:
    x, y = (ring - ring[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _boundary_loops(faces: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return closed walks that go round as the sum of all faces' boundaries does.

    The winding number about a point is the number of faces that cover it; edges that two faces
    run through in opposite directions cancel out, which leaves few of a fine mesh.
    """
    if len(faces) == 0:
        return []
    tails, heads = _uncancelled(faces.ravel(), np.roll(faces, -1, axis=1).ravel())
    following = np.empty(len(tails), dtype=np.int64)
    following[np.argsort(heads, kind="stable")] = np.argsort(tails, kind="stable")
    walked = np.zeros(len(tails), dtype=np.bool_)
    loops = []
    for start in range(len(tails)):
        walk = []
        edge = start
        while not walked[edge]:
            walked[edge] = True
            walk.append(edge)
            edge = int(following[edge])
        if walk:
            loops.append(tails[walk])
    return loops


def _uncancelled(
    tails: NDArray[np.int64], heads: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return directed edges less those with an opposite, as often as one way outweighs."""
    count = int(max(tails.max(), heads.max())) + 1
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    edges, owners = np.unique(low * count + high, return_inverse=True)
    net = np.bincount(owners, weights=np.where(tails == low, 1.0, -1.0), minlength=len(edges))
    low, high = np.divmod(edges, count)
    times = np.abs(net).astype(np.int64)
    forward = net > 0
    return np.repeat(np.where(forward, low, high), times), np.repeat(
        np.where(forward, high, low), times
    )
