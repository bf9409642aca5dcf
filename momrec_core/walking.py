"""Triangles between two matching contours, by the shortest diagonal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

__all__ = ["Bands", "walk_bands"]

DOUBTFUL_AREA = 1.1  # times what the contours explain: bands above are worth the second look
POOR_AREA = 1.8  # times the same: bands above do not follow their contours' surface
MAX_GRID = 4_000_000  # cells: bands above keep the greedy walk, so that memory is bounded


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

    def path(self, band: int) -> NDArray[np.int64]:
        """Return the vertices along one contour, the first one again at the end."""
        return self.vertices[self.first[band] : self.first[band] + self.counts[band] + 1]

    def measures(
        self, plane: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the length of each contour and the signed area that it encloses."""
        start, end = plane[self.vertices[:-1]], plane[self.vertices[1:]]
        lengths = np.hypot(*(end - start).T)
        areas = (start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]) / 2
        running = np.concatenate([np.zeros((2, 1)), np.cumsum([lengths, areas], axis=1)], axis=1)
        length, area = running[:, self.first + self.counts] - running[:, self.first]
        return length, area


@dataclass(frozen=True, eq=False)
class Bands:
    """Triangles between pairs of contours.

    Attributes
    ----------
    triangles : array of int, shape (m, 3)
        Either an edge below and a vertex above, in this order, or a vertex below and an edge
        above that the triangle uses backward.
    bands : array of int, shape (m,)
        The pair of contours that each triangle is of.
    is_poor : array of bool, shape (pairs,)
        Where the best band is still much larger than its contours explain.
    """

    triangles: NDArray[np.int64]
    bands: NDArray[np.int64]
    is_poor: NDArray[np.bool_]


def walk_bands(
    points: NDArray[np.float64],
    below: list[NDArray[np.int64]],
    above: list[NDArray[np.int64]],
) -> Bands:
    """Join pairs of contours by bands of triangles.

    Parameters
    ----------
    points : array, shape (n, 3)
        Positions of all vertices in the planes' frame.
    below, above : list of array of int
        Vertex indices around each contour; both of a pair wound the same way.

    Returns
    -------
    bands : Bands
        Facing away from the inside (left) of the contours. Every edge of a contour is used once.

    Notes
    -----
    From the nearest pair of vertices, the walk takes the shorter of the two diagonals, all bands
    in step (Christiansen and Sederberg). Where the band comes out larger than its contours'
    lengths, distance and difference in area explain, the greedy walk has crossed a notch or a
    spike; there the band of the least area is found by dynamic programming (Fuchs et al.).

    References
    ----------
    H. N. Christiansen and T. W. Sederberg, Conversion of complex contour line definitions into
    polygonal element mosaics, 1978 (reference 18 of the paper). H. Fuchs, Z. M. Kedem and
    S. P. Uselton, Optimal surface reconstruction from planar contours, 1977.
    """
    if not below:
        none = np.empty(0, dtype=np.int64)
        return Bands(none.reshape(0, 3), none, none.astype(bool))
    starts = _nearest_starts(points, below, above)
    paths = _Paths.unroll(below, starts[:, 0]), _Paths.unroll(above, starts[:, 1])
    triangles, bands, rises = _walk(points[:, :2], *paths)
    expected = _least_areas(points, *paths)
    areas = np.bincount(bands, weights=_areas(*points[triangles].transpose(1, 0, 2)))
    large = paths[0].counts * paths[1].counts > MAX_GRID
    doubtful = (areas > DOUBTFUL_AREA * expected) | _pinched(bands, rises)
    redone = np.flatnonzero(doubtful & ~large)
    best = [_least_band(points, *(path.path(int(band)) for path in paths)) for band in redone]
    kept = ~np.isin(bands, redone)
    triangles = np.concatenate([triangles[kept], *best])
    bands = np.concatenate([bands[kept], np.repeat(redone, [len(band) for band in best])])
    areas = np.bincount(bands, weights=_areas(*points[triangles].transpose(1, 0, 2)))
    return Bands(triangles, bands, areas > POOR_AREA * expected)


def _nearest_starts(
    points: NDArray[np.float64], below: list[NDArray[np.int64]], above: list[NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Return where in each pair of contours the nearest vertices are; shape (bands, 2)."""
    nearest = [
        divmod(int(np.argmin(cdist(points[low, :2], points[high, :2], "sqeuclidean"))), len(high))
        for low, high in zip(below, above, strict=True)
    ]
    return np.array(nearest)


def _walk(
    plane: NDArray[np.float64], low: _Paths, high: _Paths
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return all bands' triangles by shortest diagonals, their bands, and which step below."""
    low_at, high_at = low.first.copy(), high.first.copy()
    low_end, high_end = low.first + low.counts, high.first + high.counts
    active = np.arange(len(low.counts))
    triangles, bands, rises = [], [], []
    while len(active):
        at1, at2 = low_at[active], high_at[active]
        here1, next1 = low.vertices[at1], low.vertices[at1 + 1]
        here2, next2 = high.vertices[at2], high.vertices[at2 + 1]
        diagonal1 = ((plane[next1] - plane[here2]) ** 2).sum(axis=1)
        diagonal2 = ((plane[here1] - plane[next2]) ** 2).sum(axis=1)
        ended1, ended2 = at1 == low_end[active], at2 == high_end[active]
        step_below = ended2 | (~ended1 & (diagonal1 <= diagonal2))
        triangles.append(np.column_stack([here1, np.where(step_below, next1, next2), here2]))
        bands.append(active)
        rises.append(step_below)
        low_at[active] += step_below
        high_at[active] += ~step_below
        active = active[(low_at[active] < low_end[active]) | (high_at[active] < high_end[active])]
    return np.concatenate(triangles), np.concatenate(bands), np.concatenate(rises)


def _pinched(bands: NDArray[np.int64], rises: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which bands run around one contour in one go, and so use an edge across twice."""
    order = np.argsort(bands, kind="stable")
    sorted_bands, sorted_rises = bands[order], rises[order]
    last = np.flatnonzero(np.diff(sorted_bands, append=-1))
    following = np.roll(sorted_rises, -1)
    following[last] = sorted_rises[np.concatenate([[0], last[:-1] + 1])]
    return np.asarray(np.bincount(sorted_bands, weights=sorted_rises & ~following) == 1)


def _areas(
    first: NDArray[np.float64], second: NDArray[np.float64], third: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the areas of triangles given by their corners, shape (..., 3) each."""
    return np.asarray(np.linalg.norm(np.cross(second - first, third - first), axis=-1) / 2)


def _least_areas(points: NDArray[np.float64], low: _Paths, high: _Paths) -> NDArray[np.float64]:
    """Estimate each band's area from its height and the contours' lengths and enclosed areas."""
    (length1, area1), (length2, area2) = (path.measures(points[:, :2]) for path in (low, high))
    heights = points[high.vertices[high.first], 2] - points[low.vertices[low.first], 2]
    return np.asarray(np.hypot(heights * (length1 + length2) / 2, area2 - area1))


def _least_band(
    points: NDArray[np.float64], below: NDArray[np.int64], above: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the band of the least area between two closed paths that start side by side.

    Row i, column j of the table is the least area up to step i below and j above. A row follows
    from the one before at once, as the least of all ways to step up and then along.
    """
    low, high = points[below], points[above]
    rises = _areas_over_edges(low, high)
    runs = _areas_over_edges(high, low).T
    along = np.concatenate([np.zeros((len(low), 1)), np.cumsum(runs, axis=1)], axis=1)
    least = along.copy()
    for row in range(1, len(low)):
        least[row] += np.minimum.accumulate(least[row - 1] + rises[row - 1] - along[row])
    steps = _unpinched(_backtrack(least, rises, runs))
    rows = np.concatenate([[0], np.cumsum(steps)])
    columns = np.arange(len(rows)) - rows
    third = np.where(steps, below[rows[1:]], above[columns[1:]])
    return np.column_stack([below[rows[:-1]], third, above[columns[:-1]]])


def _areas_over_edges(
    path: NDArray[np.float64], apexes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the areas of the triangles over each edge of a path to apexes of another plane."""
    edges = np.diff(path[:, :2], axis=0)
    across = np.column_stack([-edges[:, 1], edges[:, 0]])
    beside = across @ apexes[:, :2].T - (across * path[:-1, :2]).sum(axis=1)[:, None]
    upright = (apexes[0, 2] - path[0, 2]) * np.hypot(*edges.T)
    return np.asarray(np.hypot(beside, upright[:, None]) / 2)


def _backtrack(
    least: NDArray[np.float64], rises: NDArray[np.float64], runs: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the steps of the least way through the table, True for a step below."""
    row, column = np.array(least.shape) - 1
    steps = []
    while row or column:
        by_rise = least[row - 1, column] + rises[row - 1, column] if row else np.inf
        by_run = least[row, column - 1] + runs[row, column - 1] if column else np.inf
        steps.append(bool(by_rise <= by_run))
        row, column = (row - 1, column) if steps[-1] else (row, column - 1)
    return np.array(steps[::-1])


def _unpinched(steps: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Exchange two steps where one contour is run around in one go."""
    turns = np.flatnonzero(steps[1:] != steps[:-1])
    if len(turns) + (steps[0] != steps[-1]) > 2:
        return steps
    turn = turns[0]
    steps[[turn, turn + 1]] = steps[[turn + 1, turn]]
    return steps
