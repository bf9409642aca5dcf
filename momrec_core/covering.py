"""How well a mesh explains the views it was made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from momrec_core._covering import rims
from momrec_core.errors import DegenerateShapeError
from momrec_core.rings import number_within
from momrec_core.scanning import outline_edges
from momrec_core.silhouette import silhouette_of_mesh

if TYPE_CHECKING:
    import trimesh
    from shapely import MultiPolygon

    from momrec_core.camera import Camera
    from momrec_core.view import View

__all__ = ["Coverage", "coverage", "covered_shares"]

SCAN_LINES = 32  # of each silhouette: its covered share is known to about a thousandth


@dataclass(frozen=True)
class Coverage:
    """Agreement of a view's silhouette with the one a mesh would have there.

    Attributes
    ----------
    covered : float
        Share of the view's silhouette that the mesh's projection covers again, 0 to 1.
    iou : float
        Intersection over union of the two, 0 to 1.
    """

    covered: float
    iou: float

    @classmethod
    def of_regions(cls, seen: MultiPolygon, projected: MultiPolygon) -> Coverage:
        """Compare a silhouette with a mesh's projection, both in the same image coordinates."""
        common = shapely.intersection(seen, projected).area
        return cls(covered=common / seen.area, iou=common / (seen.area + projected.area - common))


def coverage(view: View, mesh: trimesh.Trimesh) -> Coverage:
    """Compare a view's silhouette with the projection of a mesh into the same camera.

    The visual hull of consistent views covers every silhouette; what is missing measures
    errors of the contours, the calibration and the slicing.

    Parameters
    ----------
    view : View
        The silhouette and its camera.
    mesh : Trimesh
        In the world, metres; the whole of it before a pinhole.

    Returns
    -------
    coverage : Coverage
        Shares of areas in the image plane.

    Raises
    ------
    InvalidCameraError
        If a vertex lies beside or behind a pinhole camera.
    DegenerateShapeError
        If the mesh has no face that projects to an area.

    See Also
    --------
    covered_shares : The covered shares of many views at once, by scan lines.
    silhouette_of_mesh : The projection that is compared.
    """
    projected = silhouette_of_mesh(mesh, view.camera).silhouette
    return Coverage.of_regions(view.silhouette, projected)


def covered_shares(views: Sequence[View], mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """Return the share of every silhouette that a mesh's projection covers again.

    Both are compared along scan lines in each image, exactly. The projection is bounded by the
    edges between faces that turn towards the camera and faces that turn away.

    Parameters
    ----------
    views : sequence of View
        The silhouettes and their cameras. What is outside a view's `frame` does not count.
    mesh : Trimesh
        In the world, metres; closed, edge-manifold, wound outward.

    Returns
    -------
    shares : array, shape (views,)
        0 to 1.

    Raises
    ------
    DegenerateShapeError
        If the mesh is not closed.

    See Also
    --------
    coverage : One view, exactly.
    """
    if not views:
        return np.empty(0)
    to_scans = np.array([_to_scan(view.visible) for view in views])
    rim = _rim_crossings(views, mesh, to_scans)
    outline = _outline_crossings(views, to_scans)
    lines, places = np.hstack([rim[:2], outline])
    turns = np.concatenate([rim[2], np.zeros(outline.shape[1])])
    places = np.clip(places, 0.0, 1.0)  # beyond a silhouette's bounds nothing counts
    order = np.argsort(lines + places / 2.0)
    is_outline = order >= rim.shape[1]
    lengths = np.diff(places[order], append=0.0)
    lengths[np.cumsum(is_outline) % 2 == 0] = 0.0
    is_covered = np.cumsum(turns[order]) != 0
    owners = lines[order].astype(np.int64) // SCAN_LINES
    covered, whole = (
        np.bincount(owners, weights, len(views)) for weights in (lengths * is_covered, lengths)
    )
    return np.asarray(covered / np.maximum(whole, np.finfo(np.float64).tiny))


def _to_scan(region: MultiPolygon) -> NDArray[np.float64]:
    """Return a scaling and shift (3, 3) of an image.

    The region reaches from 0 to 1 along its scan lines, and these are at 0, 1, 2 and so on.
    """
    left, low, right, high = region.bounds
    across, up = right - left, (high - low) / SCAN_LINES
    return np.array([[1 / across, 0, -left / across], [0, 1 / up, -low / up - 0.5], [0, 0, 1]])


def _rim_crossings(
    views: Sequence[View], mesh: trimesh.Trimesh, to_scans: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return where a surface's projections begin and end: lines, places, turns; shape (3, n).

    The lines of all images are counted together.
    """
    projections = to_scans @ np.array([view.camera.matrix for view in views])
    eyes = np.array([_eye(view.camera) for view in views])
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
    try:
        found = rims(vertices, faces, projections.reshape(-1, 12), eyes, SCAN_LINES)
    except ValueError as error:
        raise DegenerateShapeError(f"{error}, got {len(faces)} faces with other edges") from error
    images, rows, places, turns = np.frombuffer(found).reshape(-1, 4).T
    return np.stack([images * SCAN_LINES + rows, places, turns])


def _eye(camera: Camera) -> list[float]:
    """Return where a camera looks from, homogeneous: a point, or against its viewing direction."""
    if camera.is_pinhole:
        return [*camera.position, 1.0]
    return [*-camera.rotation[:, 2], 0.0]


def _outline_crossings(views: Sequence[View], to_scans: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where the outlines of silhouettes cross scan lines: lines, places; shape (2, n)."""
    starts, ends, owners = outline_edges([view.visible for view in views])
    scales, shifts = to_scans[owners][:, [0, 1], [0, 1]], to_scans[owners, :2, 2]
    starts, ends = starts * scales + shifts, ends * scales + shifts
    levels = np.clip(np.ceil([starts[:, 1], ends[:, 1]]), 0, SCAN_LINES).astype(np.int64)
    edges, numbers = number_within(np.abs(levels[1] - levels[0]))
    rows = levels.min(axis=0)[edges] + numbers
    (x, y), (end_x, end_y) = starts[edges].T, ends[edges].T
    places = x + (rows - y) / (end_y - y) * (end_x - x)
    return np.stack([owners[edges] * SCAN_LINES + rows, places])
