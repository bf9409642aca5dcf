"""How well a mesh explains the views it was made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from momrec_core.errors import DegenerateShapeError
from momrec_core.moments import gathered_corners, normals_of
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
    surface = _Surface.of(mesh)
    seen = [_edges_in_image(view, surface) for view in views]
    owners = np.repeat(np.arange(len(views)), [edges.shape[1] for edges in seen])
    edges = np.concatenate(seen, axis=1)
    crossed, rows, places, ways = _crossings(edges[:2], edges[2:4])
    places = np.clip(places, 0.0, 1.0)  # beyond a silhouette's bounds nothing counts
    order = np.argsort(owners[crossed] * SCAN_LINES + rows + places / 2.0)
    crossed, is_rim = crossed[order], edges[4, crossed[order]] != 0
    lengths = np.diff(places[order], append=0.0)
    lengths[np.cumsum(~is_rim) % 2 == 0] = 0.0
    layers = np.cumsum(np.where(is_rim, ways[order], 0))
    covered, whole = (
        np.bincount(owners[crossed], weights, len(views))
        for weights in (np.where(layers != 0, lengths, 0.0), lengths)
    )
    return np.asarray(covered / np.maximum(whole, np.finfo(np.float64).tiny))


@dataclass(frozen=True, eq=False)
class _Surface:
    """A closed mesh.

    Attributes
    ----------
    points : array, shape (4, n)
        Its vertices, homogeneous.
    planes : array, shape (4, m)
        Of its faces: their products with points are positive on the outer side.
    tails, heads : array of int, shape (e,)
        The vertices of each edge, as one of its two faces runs through it.
    first, second : array of int, shape (e,)
        Its faces, that one first.
    """

    points: NDArray[np.float64]
    planes: NDArray[np.float64]
    tails: NDArray[np.int64]
    heads: NDArray[np.int64]
    first: NDArray[np.int64]
    second: NDArray[np.int64]

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> _Surface:
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        corners = gathered_corners(vertices, faces)
        normals = normals_of(corners)
        heights = (normals * corners[:, 0]).sum(axis=0)
        return cls(
            np.vstack([vertices.T, np.ones(len(vertices))]),
            np.vstack([normals, -heights]),
            *_shared_edges(faces),
        )

    def turned_to(self, camera: Camera) -> NDArray[np.bool_]:
        """Return which faces turn towards a camera, shape (m,)."""
        eye = [*camera.position, 1.0] if camera.is_pinhole else [*-camera.rotation[:, 2], 0.0]
        return np.asarray(np.array(eye) @ self.planes > 0)


def _edges_in_image(view: View, surface: _Surface) -> NDArray[np.float64]:
    """Return the edges of a silhouette's outline, and those that bound a surface's projection.

    Shape (5, e): where they start and end, and 1 for the surface's rims, 0 for the outline. The
    silhouette reaches from 0 to 1 along the scan lines, and these are at 0, 1, 2 and so on. Rims
    run between a face that turns towards the camera and one that turns away, and as the former
    does; most edges of a fine mesh cross no line, and are left out.
    """
    left, low, right, high = view.visible.bounds
    scale = np.array([[1.0 / (right - left)], [SCAN_LINES / (high - low)]])
    shift = np.array([[-left], [-low]]) * scale - [[0.0], [0.5]]
    image = _image(view.camera, surface.points) * scale + shift
    rows = _rows_above(image[1])
    across = np.flatnonzero(rows.take(surface.tails) != rows.take(surface.heads))
    front = surface.turned_to(view.camera)
    runs, comes_back = front[surface.first[across]], front[surface.second[across]]
    is_rim = runs != comes_back
    rims, runs = across[is_rim], runs[is_rim]
    ends = image[:, surface.tails[rims]], image[:, surface.heads[rims]]
    outline = outline_edges(view.visible)
    return np.hstack(
        [
            np.vstack(
                [*(points.T * scale + shift for points in outline), np.zeros(len(outline[0]))]
            ),
            np.vstack([np.where(runs, *ends), np.where(runs, *ends[::-1]), np.ones(len(rims))]),
        ]
    )


def _shared_edges(faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Return tails, heads, first and second faces of all edges, see `_Surface`."""
    tails, heads = np.ravel(faces), np.take(faces, [1, 2, 0], axis=1).ravel()
    keys = np.minimum(tails, heads) * (int(faces.max(initial=0)) + 1) + np.maximum(tails, heads)
    order = np.argsort(keys)
    keys = keys[order]
    if len(keys) % 2 or (keys[::2] != keys[1::2]).any():
        raise DegenerateShapeError(
            f"Expected a closed mesh whose edges have two faces each, got {len(faces)} faces with "
            "other edges"
        )
    owners = np.repeat(np.arange(len(faces)), 3)
    return tails[order[::2]], heads[order[::2]], owners[order[::2]], owners[order[1::2]]


def _image(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project homogeneous points (4, n); return image coordinates (2, n)."""
    seen = camera.matrix @ points
    if not camera.is_pinhole:
        return seen[:2]
    depths = np.maximum(seen[2], LEAST_DEPTH * np.abs(seen[2]).max(initial=0.0))
    return np.asarray(seen[:2] / depths)


def _rows_above(ordinates: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the first scan line at or above each ordinate."""
    return np.asarray(np.clip(np.ceil(ordinates), 0, SCAN_LINES).astype(np.uint8))


def _crossings(
    starts: NDArray[np.float64], ends: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Return where edges (2, n) cross scan lines: edge, line, place along it, and which way."""
    first, last = (_rows_above(points[1]).astype(np.int64) for points in (starts, ends))
    edges, numbers = number_within(np.abs(last - first))
    rows = np.minimum(first, last)[edges] + numbers
    (x, y), (end_x, end_y) = starts[:, edges], ends[:, edges]
    places = x + (rows - y) / (end_y - y) * (end_x - x)
    return edges, rows, places, np.sign(last - first)[edges]
