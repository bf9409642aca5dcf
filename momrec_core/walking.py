"""Triangles between two matching contours, by the shortest diagonal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, FillRule
from numpy.typing import NDArray

from momrec_core.rings import Rings, number_within

__all__ = ["Bands", "walk_bands"]

VOLUME_WEIGHT = 5.0  # of a band's error in volume against one in area
DOUBTFUL_MISFIT = 0.15  # bands above are worth the second look
UNEXPLAINED = 0.1  # misfit beyond the slant, above which agreement is no proof
AGREEMENT = 0.01  # in misfit, of two walks that found the same
POOR_MISFIT = 0.3  # bands above do not follow their contours' surface
WASTEFUL = 1.3  # times a stepped surface's area: a band above leads nowhere, a slanted one is below
MAX_GRID = 4_000_000  # cells: bands above keep the greedy walk, so that memory is bounded


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


def walk_bands(rings: Rings, pairs: NDArray[np.int64]) -> Bands:
    """Join pairs of contours by bands of triangles.

    Parameters
    ----------
    rings : Rings
        Contours in the planes' frame, shape (n, 3).
    pairs : array of int, shape (bands, 2)
        The contours below and above; both of a pair wound the same way.

    Returns
    -------
    bands : Bands
        Facing away from the inside (left) of the contours. Every edge of a contour is used once.

    Notes
    -----
    From a near pair of vertices, the walk takes the shorter of the two diagonals, all bands
    in step (Christiansen and Sederberg). Where a band's area or volume is far from what its
    contours suggest, the greedy walk has crossed a notch or a spike, or the contours slide
    against each other, or the body is slanted. There a second walk takes the contours with their
    centroids upon each other, and the one that fits better is kept. Where the two disagree, or
    the slant does not explain them, the band of the least area is found by dynamic programming
    (Fuchs et al.), again for the contours in both positions.

    References
    ----------
    H. N. Christiansen and T. W. Sederberg, Conversion of complex contour line definitions into
    polygonal element mosaics, 1978 (reference 18 of the paper). H. Fuchs, Z. M. Kedem and
    S. P. Uselton, Optimal surface reconstruction from planar contours, 1977.
    """
    if len(pairs) == 0:
        none = np.empty(0, dtype=np.int64)
        return Bands(none.reshape(0, 3), none, none.astype(bool))
    expected = _Expectations.of(rings, pairs)
    walks = _walk(rings, pairs, np.zeros_like(expected.shift))
    misfits = _misfits(rings, walks, expected)
    doubtful = np.flatnonzero(misfits > DOUBTFUL_MISFIT)
    if len(doubtful):
        best, owners, misfits[doubtful] = _best_bands(rings, pairs[doubtful], expected[doubtful])
        parts.append(best)
        numbers.append(doubtful[owners])
    triangles, bands = np.concatenate(parts), np.concatenate(numbers)
    is_poor = misfits > POOR_MISFIT + expected.slant
    slanted = np.flatnonzero((misfits > POOR_MISFIT) & ~is_poor)
    if len(slanted):
        areas = np.bincount(bands, weights=_areas(rings.points[triangles]))
        is_poor[slanted] = areas[slanted] > WASTEFUL * _stepped_areas(rings, pairs[slanted])
    return Bands(triangles, bands, is_poor)


def _areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the areas of triangles, shape (n, 3, 3)."""
    sides = corners[:, 1:] - corners[:, :1]
    return np.asarray(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2)


def _stepped_areas(rings: Rings, pairs: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the areas of surfaces that run level where contours differ, and upright elsewhere."""
    low, high = pairs.T
    height = rings.points[rings.first[high], 2] - rings.points[rings.first[low], 2]
    upright = height * (rings.lengths[low] + rings.lengths[high]) / 2
    steps = [(_region(rings, one) ^ _region(rings, other)).area() for one, other in pairs.tolist()]
    differing = np.abs(rings.areas[low]) + np.abs(rings.areas[high]) - 2 * np.array(steps)
    return np.asarray(upright + differing)


def _region(rings: Rings, ring: int) -> CrossSection:
    loop = rings.points[rings.first[ring] : rings.first[ring + 1], :2]
    return CrossSection([loop], FillRule.EvenOdd)


@dataclass(frozen=True, eq=False)
class _Walks:
    """Bands as walks around both their contours.

    Attributes
    ----------
    pairs : array of int, shape (bands, 2)
        The contours below and above.
    starts : array of int, shape (bands, 2)
        At which of their vertices the walks begin and end.
    steps : array of int, shape (bands,)
        How many steps each walk has: the number of edges of both contours.
    rises : array of bool, shape (sum of steps,)
        Walk by walk, True for a step below and False for one above.
    """

    pairs: NDArray[np.int64]
    starts: NDArray[np.int64]
    steps: NDArray[np.int64]
    rises: NDArray[np.bool_]

    def __getitem__(self, chosen: NDArray[np.int64]) -> _Walks:
        places = self._places(chosen)
        return _Walks(
            self.pairs[chosen], self.starts[chosen], self.steps[chosen], self.rises[places]
        )

    def replaced(self, chosen: NDArray[np.int64], others: _Walks) -> _Walks:
        """Return the walks with others along the same pairs in the places of some."""
        starts, rises = self.starts.copy(), self.rises.copy()
        starts[chosen] = others.starts
        rises[self._places(chosen)] = others.rises
        return _Walks(self.pairs, starts, self.steps, rises)

    def _places(self, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return where the steps of some walks are."""
        owners, positions = number_within(self.steps[chosen])
        first = np.cumsum(self.steps) - self.steps
        places: NDArray[np.int64] = first[chosen][owners] + positions
        return places

    def triangles(self, rings: Rings) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the triangles, as in `Bands`, and the band of each."""
        bands, positions = number_within(self.steps)
        before: NDArray[np.int64] = np.cumsum(self.rises) - self.rises
        taken: NDArray[np.int64] = before - before[np.cumsum(self.steps) - self.steps][bands]
        corners = []
        for side, passed in enumerate((taken, positions - taken)):
            ring = self.pairs[:, side]
            place = (self.starts[bands, side] + passed) % rings.counts[ring][bands]
            corners.append(rings.first[ring][bands] + place)
        third = rings.following[np.where(self.rises, *corners)]
        return np.column_stack([corners[0], third, corners[1]]), bands

    def are_pinched(self) -> NDArray[np.bool_]:
        """Tell which walks go around one contour in one go, and so use an edge across twice."""
        ends = np.cumsum(self.steps)
        following = np.roll(self.rises, -1)
        following[ends - 1] = self.rises[ends - self.steps]
        falls = np.add.reduceat(self.rises & ~following, ends - self.steps, dtype=np.int64)
        return np.asarray(falls == 1)


def _starts(
    rings: Rings, pairs: NDArray[np.int64], shifts: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return where walks along two contours begin, the one above shifted back.

    It is the nearest pair of a few vertices of the contour below and all above.

    Returns
    -------
    starts : array of int, shape (bands, 2)
        Places in the contours, from 0.
    """
    low, high = pairs.T
    places = rings.counts[low] * np.arange(CANDIDATES)[:, None] // CANDIDATES
    candidates = rings.points[rings.first[low] + places, :2] + shifts
    above, bands = rings.around(high)
    x, y = (candidates[:, bands] - rings.points[above, :2]).transpose(2, 0, 1)
    squares = x * x + y * y
    first = np.searchsorted(bands, np.arange(len(pairs)))
    best = np.minimum.reduceat(squares, first, axis=1).argmin(axis=0)
    of_best = squares[best[bands], np.arange(len(bands))]
    nearest = np.flatnonzero(of_best == np.minimum.reduceat(of_best, first)[bands])
    nearest = nearest[np.searchsorted(bands[nearest], np.arange(len(pairs)))]
    return np.column_stack([places[best, np.arange(len(pairs))], nearest - first])


def _in_step(steps: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Order walks so that, at each step, those not yet at their ends are the first ones.

    Returns
    -------
    order : array of int, shape (bands,)
        The longest walks first.
    active : array of int, shape (longest walk,)
        How many of them take each step.
    """
    order = np.argsort(-steps, kind="stable")
    return order, np.searchsorted(-steps[order], -np.arange(steps.max()))


def _walk(rings: Rings, pairs: NDArray[np.int64], shifts: NDArray[np.float64]) -> _Walks:
    """Walk along all bands in step, by shortest diagonals, the contours above shifted back."""
    starts = _starts(rings, pairs, shifts)
    steps = rings.counts[pairs].sum(axis=1)
    order, active = _in_step(steps)
    low, at_low = _unrolled(rings, pairs[order, 0], starts[order, 0], np.zeros_like(shifts))
    high, at_high = _unrolled(rings, pairs[order, 1], starts[order, 1], shifts[order])
    taken = np.empty((len(active), len(pairs)), dtype=bool)
    for step, count in enumerate(active):
        row, column = at_low[:count], at_high[:count]
        rises = np.less_equal(
            np.abs(low[row + 1] - high[column]),
            np.abs(low[row] - high[column + 1]),
            out=taken[step, :count],
        )
        row += rises
        column += ~rises
    bands, positions = number_within(steps)
    return _Walks(pairs, starts, steps, taken[positions, np.argsort(order)[bands]])


def _unrolled(
    rings: Rings,
    chosen: NDArray[np.int64],
    starts: NDArray[np.int64],
    shifts: NDArray[np.float64],
) -> tuple[NDArray[np.complex128], NDArray[np.int64]]:
    """Return paths around contours, shifted back, as complex numbers, one behind the other.

    Each ends where it starts, and is followed by a point at infinity, which no diagonal reaches.

    Returns
    -------
    paths : array of complex
    first : array of int, shape (contours,)
        Where each path begins.
    """
    counts = rings.counts[chosen] + 2
    owners, positions = number_within(counts)
    vertices = rings.first[chosen][owners] + (starts[owners] + positions) % (counts[owners] - 2)
    x, y = (rings.points[vertices, :2] - shifts[owners]).T
    paths = x + 1j * y
    ends = np.cumsum(counts)
    paths[ends - 1] = np.inf
    return paths, ends - counts


@dataclass(frozen=True, eq=False)
class _Expectations:
    """What pairs of contours and their distances suggest of the bands between them.

    Attributes
    ----------
    area : array, shape (bands,)
        Of the band, were one contour the other's image, scaled.
    slant : array, shape (bands,)
        What a shift from one centroid to the other would add to the area, relatively.
    volume : array, shape (bands,)
        Between the contours; negative for holes.
    base : array, shape (bands,)
        What the caps contribute to the volume, see `_misfits`.
    shift : array, shape (bands, 2)
        From the centroid below to the one above.
    """

    area: NDArray[np.float64]
    slant: NDArray[np.float64]
    volume: NDArray[np.float64]
    base: NDArray[np.float64]
    shift: NDArray[np.float64]

    @classmethod
    def of(cls, rings: Rings, pairs: NDArray[np.int64]) -> _Expectations:
        low, high = pairs.T
        bottom, top = rings.points[rings.first[low], 2], rings.points[rings.first[high], 2]
        area1, area2 = rings.areas[low], rings.areas[high]
        shift = rings.centroids[high] - rings.centroids[low]
        height = top - bottom
        upright = height * (rings.lengths[low] + rings.lengths[high]) / 2
        edges = np.concatenate([np.column_stack(rings.around(side)) for side in (low, high)])
        (x, y), (shift_x, shift_y) = rings.edges[edges[:, 0]].T, shift[edges[:, 1]].T
        sides = np.hypot(height[edges[:, 1]] * np.hypot(x, y), x * shift_y - y * shift_x)
        slanted = np.bincount(edges[:, 1], weights=sides) / 2
        area = np.hypot(upright, area2 - area1)
        mean = (area1 + area2 + np.sign(area1) * np.sqrt(area1 * area2)) / 3
        slant = np.hypot(slanted, area2 - area1) / area - 1
        return cls(area, slant, height * mean, top * area2 - bottom * area1, shift)

    def __getitem__(self, chosen: NDArray[np.int64]) -> _Expectations:
        return _Expectations(
            self.area[chosen],
            self.slant[chosen],
            self.volume[chosen],
            self.base[chosen],
            self.shift[chosen],
        )


def _misfits(rings: Rings, walks: _Walks, expected: _Expectations) -> NDArray[np.float64]:
    """Return, per band, how much area and volume exceed or miss what is expected, relatively.

    The volume is the flux of (0, 0, z) through the band and the caps at both ends. A pinched band
    fits nothing.
    """
    triangles, bands = walks.triangles(rings)
    corners = rings.points[triangles]
    (x1, y1, z1), (x2, y2, z2) = (corners[:, 1:] - corners[:, :1]).transpose(1, 2, 0)
    upward = (x1 * y2 - y1 * x2) / 2
    aside = np.hypot(y1 * z2 - z1 * y2, z1 * x2 - x1 * z2) / 2
    areas = np.bincount(bands, weights=np.hypot(upward, aside))
    fluxes = np.bincount(bands, weights=corners[:, :, 2].mean(axis=1) * upward)
    excess = np.maximum(areas / expected.area - 1, 0.0)
    lack = np.abs((fluxes + expected.base) / expected.volume - 1)
    return np.where(walks.are_pinched(), np.inf, excess + VOLUME_WEIGHT * lack)


def _second_look(
    rings: Rings, walks: _Walks, misfits: NDArray[np.float64], expected: _Expectations
) -> tuple[_Walks, NDArray[np.float64]]:
    """Return walks that fit better where there are some, and their misfits."""
    others = _walk(rings, walks.pairs, expected.shift)
    other_misfits = _misfits(rings, others, expected)
    with np.errstate(invalid="ignore"):  # two pinched bands do not agree
        is_agreed = np.abs(other_misfits - misfits) < AGREEMENT
    walks, misfits = _better(walks, misfits, others, other_misfits)
    is_small = rings.counts[walks.pairs].prod(axis=1) <= MAX_GRID
    is_explained = misfits < UNEXPLAINED + expected.slant
    contested = np.flatnonzero(is_small & ~(is_agreed & is_explained))
    if len(contested):
        pairs, shifts = walks.pairs[contested], expected.shift[contested]
        both = _least_walks(
            rings, np.tile(pairs, (2, 1)), np.concatenate([np.zeros_like(shifts), shifts])
        )
        least = np.arange(2 * len(pairs)).reshape(2, -1)
        judged = [(both[half], _misfits(rings, both[half], expected[contested])) for half in least]
        best, misfits[contested] = _better(*judged[0], *judged[1])
        walks = walks.replaced(contested, best)
    return walks, misfits


def _better(
    walks: _Walks,
    misfits: NDArray[np.float64],
    others: _Walks,
    other_misfits: NDArray[np.float64],
) -> tuple[_Walks, NDArray[np.float64]]:
    """Return the better of two walks along each pair, and its misfit."""
    chosen = np.flatnonzero(other_misfits < misfits)
    return walks.replaced(chosen, others[chosen]), np.minimum(misfits, other_misfits)


def _least_walks(rings: Rings, pairs: NDArray[np.int64], shifts: NDArray[np.float64]) -> _Walks:
    """Find the bands of the least area, with the contours above shifted back."""
    starts = _starts(rings, pairs, shifts)
    counts = rings.counts[pairs]
    steps = counts.sum(axis=1)
    first = np.cumsum(steps) - steps
    rises = np.empty(steps.sum(), dtype=bool)
    for batch in _batches(counts):
        low, high = (_padded(rings, pairs[batch, side], starts[batch, side]) for side in (0, 1))
        high[..., :2] -= shifts[batch]
        owners, positions = number_within(steps[batch])
        rises[first[batch][owners] + positions] = _least_rises(low, high, counts[batch])
    walks = _Walks(pairs, starts, steps, rises)
    for band in np.flatnonzero(walks.are_pinched()):
        _unpinch(rises[first[band] : first[band] + steps[band]])
    return walks


def _batches(counts: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Divide bands into batches of similar size that keep memory bounded."""
    octaves = np.ceil(np.log2(counts.max(axis=1))).astype(np.int64)
    for octave in np.unique(octaves):
        members = np.flatnonzero(octaves == octave)
        parts = -(-len(members) * 4 ** int(octave) // MAX_GRID)
        yield from np.array_split(members, min(parts, len(members)))


def _padded(
    rings: Rings, chosen: NDArray[np.int64], starts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return paths around contours from their starts and back, shape (longest, contours, 3)."""
    counts = rings.counts[chosen]
    places = (starts + np.arange(counts.max() + 1)[:, None]) % counts
    return np.asarray(rings.points[rings.first[chosen] + places])


def _least_rises(
    low: NDArray[np.float64], high: NDArray[np.float64], counts: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Find the bands of the least area between pairs of closed paths that start side by side.

    Row i, column j of a band's table is the least area up to step i below and j above. A row
    follows from the one before at once, as the least of all ways to step up and then along.

    Parameters
    ----------
    low, high : array, shape (longest path, bands, 3)
        The paths, ending where they start; what comes behind has no bearing.
    counts : array of int, shape (bands, 2)
        Number of edges of each path.

    Returns
    -------
    rises : array of bool, shape (sum of counts,)
        Band by band, True for a step along the path below and False for one above.
    """
    rises = _areas_over_edges(low, high)
    runs = _areas_over_edges(high, low).transpose(2, 1, 0)
    least = np.zeros((len(low), low.shape[1], len(high)))
    np.cumsum(runs, axis=2, out=least[:, :, 1:])
    for row in range(1, len(low)):
        step_up = least[row - 1] + rises[row - 1] - least[row]
        least[row] += np.minimum.accumulate(step_up, axis=1)
    is_rise = np.zeros(least.shape, dtype=bool)
    is_rise[1:, :, 0] = True
    is_rise[1:, :, 1:] = least[:-1, :, 1:] + rises[:, :, 1:] <= least[1:, :, :-1] + runs[1:]
    return _trace_back(is_rise, counts)


def _areas_over_edges(
    paths: NDArray[np.float64], apexes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the areas of triangles over each edge of paths to apexes of another plane.

    Returns
    -------
    areas : array, shape (edges, bands, apexes)
    """
    x, y, _ = np.diff(paths, axis=0).transpose(2, 0, 1)[..., None]
    apex_x, apex_y, top = apexes.transpose(2, 1, 0)
    beside = x * apex_y - y * apex_x - (x * paths[:-1, :, 1:2] - y * paths[:-1, :, :1])
    upright = (top[:, :1] - paths[0, :, 2:]) * np.hypot(x, y)
    return np.asarray(np.sqrt(beside**2 + upright**2) / 2)


def _trace_back(is_rise: NDArray[np.bool_], counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Follow the least ways back through their tables, shape (rows, bands, columns)."""
    _, bands, columns = is_rise.shape
    steps = counts.sum(axis=1)
    order, active = _in_step(steps)
    cells = ((counts[:, 0] * bands + np.arange(bands)) * columns + counts[:, 1])[order]
    taken = np.empty((len(active), bands), dtype=bool)
    for step, count in enumerate(active):
        cell = cells[:count]
        taken[step, :count] = is_rise.ravel()[cell]
        cell -= np.where(taken[step, :count], bands * columns, 1)
    owners, positions = number_within(steps)
    return np.asarray(taken[steps[owners] - 1 - positions, np.argsort(order)[owners]])


def _unpinch(rises: NDArray[np.bool_]) -> None:
    """Exchange two steps of a walk that goes around one contour in one go."""
    turn = np.flatnonzero(rises[1:] != rises[:-1])[0]
    rises[[turn, turn + 1]] = rises[[turn + 1, turn]]
