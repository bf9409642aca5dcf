"""Triangles between two matching contours, by the shortest diagonal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

__all__ = ["Bands", "walk_bands"]

VOLUME_WEIGHT = 5.0  # of a band's error in volume against one in area
DOUBTFUL_MISFIT = 0.15  # bands above are worth the second look
POOR_MISFIT = 0.3  # bands above do not follow their contours' surface
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
        Where even the best band is far from what its contours suggest.
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
    in step (Christiansen and Sederberg). Where a band's area or volume is far from what its
    contours suggest, the greedy walk has crossed a notch or a spike, or the contours slide
    against each other; there the band of the least area is found by dynamic programming (Fuchs
    et al.), for the contours as they lie and with their centroids upon each other, and the one
    that fits best is kept.

    References
    ----------
    H. N. Christiansen and T. W. Sederberg, Conversion of complex contour line definitions into
    polygonal element mosaics, 1978 (reference 18 of the paper). H. Fuchs, Z. M. Kedem and
    S. P. Uselton, Optimal surface reconstruction from planar contours, 1977.
    """
    if not below:
        none = np.empty(0, dtype=np.int64)
        return Bands(none.reshape(0, 3), none, none.astype(bool))
    starts = np.array(
        [_nearest(points[low], points[high]) for low, high in zip(below, above, strict=True)]
    )
    paths = _Paths.unroll(below, starts[:, 0]), _Paths.unroll(above, starts[:, 1])
    triangles, bands, rises = _walk(points[:, :2], *paths)
    expected = _expectations(points, below, above)
    misfits = _misfits(points[triangles], bands, expected)
    large = paths[0].counts * paths[1].counts > MAX_GRID
    doubtful = (misfits > DOUBTFUL_MISFIT) | _pinched(bands, rises)
    parts, numbers = [], []
    for band in np.flatnonzero(doubtful & ~large):
        best, misfits[band] = _best_band(points, below[band], above[band], expected[band])
        parts.append(best)
        numbers.append(np.full(len(best), band))
    kept = ~np.isin(bands, np.flatnonzero(doubtful & ~large))
    return Bands(
        np.concatenate([triangles[kept], *parts]),
        np.concatenate([bands[kept], *numbers]),
        misfits > POOR_MISFIT + np.array([it.slant for it in expected]),
    )


@dataclass(frozen=True)
class _Expectation:
    """What two contours and their distance suggest of the band between them.

    Attributes
    ----------
    area : float
        Of the band, were one contour the other's image, scaled.
    slant : float
        What a shift from one centroid to the other would add to the area, relatively.
    volume : float
        Between the contours; negative for holes.
    base : float
        What the caps contribute to the volume, see `_misfits`.
    shift : array, shape (2,)
        From the centroid below to the one above.
    """

    area: float
    slant: float
    volume: float
    base: float
    shift: NDArray[np.float64]


def _expectations(
    points: NDArray[np.float64], below: list[NDArray[np.int64]], above: list[NDArray[np.int64]]
) -> list[_Expectation]:
    measures = {}
    for contour in (*below, *above):
        if id(contour) not in measures:
            measures[id(contour)] = _measure(points[contour, :2])
    expected = []
    for low, high in zip(below, above, strict=True):
        (edges1, area1, centroid1), (edges2, area2, centroid2) = (
            measures[id(contour)] for contour in (low, high)
        )
        bottom, top = points[low[0], 2], points[high[0], 2]
        shift = centroid2 - centroid1
        upright = (top - bottom) * np.hypot(*np.concatenate([edges1, edges2]).T)
        aside = np.concatenate([edges1, edges2]) @ (-shift[1], shift[0])
        volume = (top - bottom) * (area1 + area2 + np.sign(area1) * np.sqrt(area1 * area2)) / 3
        area, slanted = (
            float(np.hypot(sides.sum() / 2, area2 - area1))
            for sides in (upright, np.hypot(upright, aside))
        )
        base = top * area2 - bottom * area1
        expected.append(_Expectation(area, slanted / area - 1, volume, base, shift))
    return expected


def _measure(
    contour: NDArray[np.float64],
) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """Return the edges of a contour, its signed area and its centroid."""
    middle = contour.mean(axis=0)
    starts = contour - middle
    ends = np.roll(starts, -1, axis=0)
    crosses = starts[:, 0] * ends[:, 1] - starts[:, 1] * ends[:, 0]
    area = crosses.sum() / 2
    return ends - starts, area, middle + crosses @ (starts + ends) / (6 * area)


def _misfits(
    corners: NDArray[np.float64], bands: NDArray[np.int64], expected: list[_Expectation]
) -> NDArray[np.float64]:
    """Return, per band, how much area and volume exceed or miss what is expected, relatively.

    The volume is the flux of (0, 0, z) through the band and the caps at both ends.
    """
    first, second, third = corners.transpose(1, 0, 2)
    normals = np.cross(second - first, third - first) / 2
    areas = np.bincount(bands, weights=np.linalg.norm(normals, axis=1))
    fluxes = np.bincount(bands, weights=corners[:, :, 2].mean(axis=1) * normals[:, 2])
    area, volume, base = np.array([(it.area, it.volume, it.base) for it in expected]).T
    excess = np.maximum(areas / area - 1, 0.0)
    return np.asarray(excess + VOLUME_WEIGHT * np.abs((fluxes + base) / volume - 1))


def _best_band(
    points: NDArray[np.float64],
    below: NDArray[np.int64],
    above: NDArray[np.int64],
    expected: _Expectation,
) -> tuple[NDArray[np.int64], float]:
    """Return the best of the least bands between two contours, and its misfit."""
    candidates = []
    for shift in (np.zeros(2), expected.shift):
        back = np.append(shift, 0.0)
        row, column = _nearest(points[below], points[above] - back)
        low, high = (np.roll(below, -row), np.roll(above, -column))
        low, high = np.append(low, low[0]), np.append(high, high[0])
        steps = _least_steps(points[low], points[high] - back)
        rows = np.concatenate([[0], np.cumsum(steps)])
        columns = np.arange(len(rows)) - rows
        third = np.where(steps, low[rows[1:]], high[columns[1:]])
        candidates.append(np.column_stack([low[rows[:-1]], third, high[columns[:-1]]]))
    single = np.zeros(len(below) + len(above), dtype=np.int64)
    misfits = [_misfits(points[it], single, [expected])[0] for it in candidates]
    best = int(np.argmin(misfits))
    return candidates[best], float(misfits[best])


def _nearest(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[int, int]:
    """Return where in two contours the vertices are that lie nearest to each other."""
    if len(low) * len(high) > MAX_GRID:
        distances, partners = KDTree(high[:, :2]).query(low[:, :2])
        row = int(np.argmin(distances))
        return row, int(partners[row])
    squares = cdist(low[:, :2], high[:, :2], "sqeuclidean")
    row, column = divmod(int(np.argmin(squares)), len(high))
    return row, column


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


def _least_steps(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find the band of the least area between two closed paths that start side by side.

    Row i, column j of the table is the least area up to step i below and j above. A row follows
    from the one before at once, as the least of all ways to step up and then along.

    Returns
    -------
    steps : array of bool, shape (m,)
        True for a step along the path below, False for one above.
    """
    rises = _areas_over_edges(low, high)
    runs = _areas_over_edges(high, low).T
    along = np.concatenate([np.zeros((len(low), 1)), np.cumsum(runs, axis=1)], axis=1)
    least = along.copy()
    for row in range(1, len(low)):
        least[row] += np.minimum.accumulate(least[row - 1] + rises[row - 1] - along[row])
    return _unpinched(_backtrack(least, rises, runs))


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
