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


def _outline(
    points: NDArray[np.float64], faces: NDArray[np.int64]
) -> list[NDArray[np.float64]]:
    triangles = points[faces]
    sides = triangles[:, 1:] - triangles[:, :1]
    areas = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    triangles[areas < 0] = triangles[areas < 0, ::-1]
    triangles = triangles[np.abs(areas) > np.finfo(np.float64).eps]
    union = manifold3d.CrossSection(list(triangles), manifold3d.FillRule.Positive)
    return [np.asarray(ring) for ring in union.to_polygons()]
