"""How well a mesh explains the views it was made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from momrec_core.errors import DegenerateShapeError
from momrec_core.rings import number_within
from momrec_core.scanning import outline_edges, scan_lines, scan_spans
from momrec_core.silhouette import silhouette_of_mesh

if TYPE_CHECKING:
    import trimesh
    from shapely import MultiPolygon

    from momrec_core.camera import Camera
    from momrec_core.view import View

__all__ = ["Coverage", "coverage", "covered_shares"]

SCAN_LINES = 32  # of each silhouette: its covered share is known to about a thousandth
LEAST_DEPTH = 1e-9  # of the largest: what is beside or behind a pinhole counts as far off


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
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    edges, neighbours = _shared_edges(faces)
    fronts = _turned_to(views, vertices[faces])
    are_rims = fronts[:, neighbours[:, 0]] != fronts[:, neighbours[:, 1]]
    crossings = []
    for number, (view, front, is_rim) in enumerate(zip(views, fronts, are_rims, strict=True)):
        rim = edges[is_rim]
        backwards = ~front[neighbours[is_rim, 0]]
        rim[backwards] = rim[backwards, ::-1]
        lines = scan_lines(view.visible, SCAN_LINES)
        spans, counts = scan_spans(*outline_edges(view.visible), lines)
        ends = _image(view.camera, vertices[rim.ravel()]).reshape(-1, 2, 2)
        for crossing in (_span_ends(spans, counts), _line_crossings(ends, lines)):
            crossing[0] += number * SCAN_LINES
            crossings.append(crossing)
    lines, places, toggles, turns = np.concatenate(crossings, axis=1)
    order = np.lexsort([places, lines])
    lengths = np.diff(places[order], append=0.0)
    seen = np.where(np.cumsum(toggles[order]) % 2 == 1, lengths, 0.0)
    common = np.where(np.cumsum(turns[order]) != 0, seen, 0.0)
    owners = lines[order].astype(np.int64) // SCAN_LINES
    covered, whole = (np.bincount(owners, weights, len(views)) for weights in (common, seen))
    return np.asarray(covered / np.maximum(whole, np.finfo(np.float64).tiny))


def _shared_edges(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return each edge as one of its two faces runs through it, and both, that one first."""
    tails, heads = np.ravel(faces), np.roll(faces, -1, axis=1).ravel()
    keys = np.minimum(tails, heads) * (int(faces.max(initial=0)) + 1) + np.maximum(tails, heads)
    order = np.argsort(keys)
    if len(keys) % 2 or (keys[order[::2]] != keys[order[1::2]]).any():
        raise DegenerateShapeError(
            f"Expected a closed mesh whose edges have two faces each, got {len(faces)} faces with "
            "other edges"
        )
    first = order[::2]
    return np.column_stack([tails[first], heads[first]]), order.reshape(-1, 2) // 3


def _turned_to(views: Sequence[View], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which faces turn towards which cameras, shape (views, faces)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    heights = np.einsum("ij,ij->i", normals, corners[:, 0])
    eyes = np.array(
        [
            [*view.camera.position, -1.0]
            if view.camera.is_pinhole
            else [*-view.camera.rotation[:, 2], 0.0]
            for view in views
        ]
    )
    return np.asarray(eyes @ np.vstack([normals.T, heights]) > 0)


def _image(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    seen = (points - camera.position) @ camera.rotation
    if camera.K is None:
        return seen[:, :2]
    depths = np.maximum(seen[:, 2], LEAST_DEPTH * np.abs(seen[:, 2]).max(initial=0.0))
    return np.asarray((seen / depths[:, None] @ camera.K.T)[:, :2])


def _span_ends(spans: NDArray[np.float64], counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return lines, places, ones and zeros: where silhouettes begin and end; shape (4, n)."""
    lines = np.repeat(np.arange(len(counts)), 2 * counts)
    return np.stack([lines, spans.ravel(), np.ones(len(lines)), np.zeros(len(lines))])


def _line_crossings(ends: NDArray[np.float64], lines: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return lines, places, zeros and which way edges cross equidistant lines; shape (4, n)."""
    levels = np.ceil((ends[:, :, 1] - lines[0]) / (lines[1] - lines[0]))
    first, last = np.clip(levels, 0, len(lines)).astype(np.int64).T
    edges, numbers = number_within(np.abs(last - first))
    rows = np.minimum(first, last)[edges] + numbers
    start, stop = ends[edges, 0], ends[edges, 1]
    fraction = (lines[rows] - start[:, 1]) / (stop[:, 1] - start[:, 1])
    places = start[:, 0] + fraction * (stop[:, 0] - start[:, 0])
    return np.stack([rows, places, np.zeros(len(rows)), np.sign(last - first)[edges]])
