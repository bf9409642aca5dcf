"""Triangles between two matching contours, by the shortest diagonal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

__all__ = ["walk_bands"]


@dataclass(frozen=True, eq=False)
class _Paths:
    """Closed contours, unrolled from their starts, one behind the other.

    Attributes
    ----------
    vertices : array of int
        Vertex indices; each contour is followed by its first vertex twice, so that the walk may
        look one step past its end.
    first, counts : array of int, shape (bands,)
        Where each contour begins, and its number of edges.
    """

    vertices: NDArray[np.int64]
    first: NDArray[np.int64]
    counts: NDArray[np.int64]

    @classmethod
    def unroll(cls, contours: list[NDArray[np.int64]], starts: NDArray[np.int64]) -> _Paths:
        pieces = []
        for contour, start in zip(contours, starts, strict=True):
            rolled = np.roll(contour, -start)
            pieces.append(np.concatenate([rolled, rolled[[0, 0]]]))
        counts = np.array([len(contour) for contour in contours])
        first = np.concatenate([[0], np.cumsum(counts + 2)[:-1]])
        return cls(np.concatenate(pieces), first, counts)


def walk_bands(
    points: NDArray[np.float64],
    below: list[NDArray[np.int64]],
    above: list[NDArray[np.int64]],
) -> NDArray[np.int64]:
    """Join pairs of contours by bands of triangles.

    Parameters
    ----------
    points : array, shape (n, 3)
        Positions of all vertices in the planes' frame.
    below, above : list of array of int
        Vertex indices around each contour; both of a pair wound the same way.

    Returns
    -------
    triangles : array of int, shape (m, 3)
        Facing away from the inside (left) of the contours. Every edge of a contour is used once.

    Notes
    -----
    From the nearest pair of vertices, the walk takes the shorter of the two diagonals. It is done
    twice, with the contours as they lie and scaled to the same box; of the two the band of the
    smaller area is kept. All bands advance in step.

    References
    ----------
    H. N. Christiansen and T. W. Sederberg, Conversion of complex contour line definitions into
    polygonal element mosaics, 1978 (reference 18 of the paper).
    """
    if not below:
        return np.empty((0, 3), dtype=np.int64)
    plane = points[:, :2]
    walks = [_walk(plane, below, above), _walk(_in_unit_boxes(plane, below + above), below, above)]
    areas = [_band_areas(points, *walk, len(below)) for walk in walks]
    scaled_is_better = areas[1] < areas[0]
    return np.concatenate(
        [
            triangles[chosen[bands]]
            for (triangles, bands), chosen in zip(
                walks, (~scaled_is_better, scaled_is_better), strict=True
            )
        ]
    )


def _in_unit_boxes(
    points: NDArray[np.float64], contours: list[NDArray[np.int64]]
) -> NDArray[np.float64]:
    """Scale and shift the points of each contour so that its box is the unit square."""
    scaled = points.copy()
    for contour in contours:
        low, high = points[contour].min(axis=0), points[contour].max(axis=0)
        scaled[contour] = (points[contour] - low) / np.maximum(high - low, np.finfo(float).tiny)
    return scaled


def _nearest_starts(
    points: NDArray[np.float64],
    below: list[NDArray[np.int64]],
    above: list[NDArray[np.int64]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where the nearest vertices of each pair of contours are in them."""
    nearest = [
        divmod(int(np.argmin(cdist(points[low], points[high]))), len(high))
        for low, high in zip(below, above, strict=True)
    ]
    starts = np.array(nearest)
    return starts[:, 0], starts[:, 1]


def _walk(
    points: NDArray[np.float64],
    below: list[NDArray[np.int64]],
    above: list[NDArray[np.int64]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the triangles of all bands and the band of each."""
    starts = _nearest_starts(points, below, above)
    low, high = _Paths.unroll(below, starts[0]), _Paths.unroll(above, starts[1])
    low_at, high_at = low.first.copy(), high.first.copy()
    low_end, high_end = low.first + low.counts, high.first + high.counts
    active = np.arange(len(below))
    triangles, bands = [], []
    while len(active):
        at1, at2 = low_at[active], high_at[active]
        here1, next1 = low.vertices[at1], low.vertices[at1 + 1]
        here2, next2 = high.vertices[at2], high.vertices[at2 + 1]
        diagonal1 = ((points[next1] - points[here2]) ** 2).sum(axis=1)
        diagonal2 = ((points[here1] - points[next2]) ** 2).sum(axis=1)
        ended1, ended2 = at1 == low_end[active], at2 == high_end[active]
        step_below = ended2 | (~ended1 & (diagonal1 <= diagonal2))
        triangles.append(np.column_stack([here1, np.where(step_below, next1, next2), here2]))
        bands.append(active)
        low_at[active] += step_below
        high_at[active] += ~step_below
        active = active[(low_at[active] < low_end[active]) | (high_at[active] < high_end[active])]
    return np.concatenate(triangles), np.concatenate(bands)


def _band_areas(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    bands: NDArray[np.int64],
    count: int,
) -> NDArray[np.float64]:
    first, second, third = points[triangles].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(second - first, third - first), axis=1) / 2
    return np.bincount(bands, weights=areas, minlength=count)
