"""Triangles between two matching contours, by the shortest diagonal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, FillRule
from numpy.typing import NDArray

from momrec_core._bands import expect, greedy, lay, least
from momrec_core.rings import Rings, counts_of

__all__ = ["Bands", "walk_bands"]

VOLUME_WEIGHT = 5.0  # of a band's error in volume against one in area
DOUBTFUL_MISFIT = 0.05  # bands above are worth the second look
POOR_MISFIT = 0.3  # bands above do not follow their contours' surface
WASTEFUL = 1.3  # times a stepped surface's area: a band above leads nowhere, a slanted one is below
WORTHWHILE = 0.8  # of a misfit: least area that gains less smooths rough contours, no more
TIE = 1e-6  # of a misfit: walks that fit better by less do so by rounding


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
    From a near pair of vertices, the walk takes the shorter of the two diagonals (Christiansen
    and Sederberg). Where a band's area or volume is far from what its contours suggest, the greedy
    walk has crossed a notch or a spike, or the contours slide against each other. There the walk
    is improved to one of least area by dynamic programming (Fuchs et al.), in a window around it
    that follows it as long as the best in it is at its border: but for the wildest contours, that
    is the best of all walks, in time linear in the vertices. Another greedy walk is tried with
    the contours' centroids upon each other, and the one that fits best is kept.

    References
    ----------
    H. N. Christiansen and T. W. Sederberg, Conversion of complex contour line definitions into
    polygonal element mosaics, 1978 (reference 18 of the paper). H. Fuchs, Z. M. Kedem and
    S. P. Uselton, Optimal surface reconstruction from planar contours, 1977.
    """
    expected = _Expectations.of(rings, pairs)
    walks = _walk(rings, pairs, np.zeros_like(expected.shift))
    misfits = _misfits(walks, expected)
    doubtful = misfits > DOUBTFUL_MISFIT
    better, misfits[doubtful] = _second_look(
        rings, walks[doubtful], misfits[doubtful], expected[doubtful]
    )
    walks = walks.replaced(doubtful, better)
    is_poor = misfits > POOR_MISFIT + expected.slant
    slanted = (misfits > POOR_MISFIT) & ~is_poor
    is_poor[slanted] = _are_wasteful(rings, walks[slanted], expected.stepped[slanted])
    return Bands(rings, walks, is_poor)


def _are_wasteful(rings: Rings, walks: _Walks, stepped: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which bands lead nowhere: larger than stepped surfaces, whose least areas are given."""
    areas = walks.measures[:, 0]
    wasteful = np.flatnonzero(areas > WASTEFUL * stepped)
    excess = [_excess(*(_region(rings, ring) for ring in pair)) for pair in walks.pairs[wasteful]]
    is_wasteful = np.zeros(len(areas), dtype=bool)
    is_wasteful[wasteful] = areas[wasteful] > WASTEFUL * (stepped[wasteful] + np.array(excess))
    return is_wasteful


def _excess(below: CrossSection, above: CrossSection) -> float:
    """Return by how much more regions differ than if one contained the other."""
    return float(2 * (min(below.area(), above.area()) - (below ^ above).area()))


def _region(rings: Rings, ring: int) -> CrossSection:
    return CrossSection([rings.loop(ring)[:, :2]], FillRule.EvenOdd)


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
    measures : array, shape (bands, 2)
        Each band's area, infinite for one that is pinched (it goes around one contour in one go,
        and so uses an edge across twice), and the flux of (0, 0, z) upward through it.
    """

    pairs: NDArray[np.int64]
    starts: NDArray[np.int64]
    steps: NDArray[np.int64]
    rises: NDArray[np.bool_]
    measures: NDArray[np.float64]

    def __getitem__(self, chosen: NDArray[np.bool_]) -> _Walks:
        return _Walks(
            self.pairs[chosen],
            self.starts[chosen],
            self.steps[chosen],
            self.rises[np.repeat(chosen, self.steps)],
            self.measures[chosen],
        )

    def replaced(self, chosen: NDArray[np.bool_], others: _Walks) -> _Walks:
        """Return the walks with others along the same pairs in the places of some."""
        starts, rises, measures = self.starts.copy(), self.rises.copy(), self.measures.copy()
        starts[chosen] = others.starts
        rises[np.repeat(chosen, self.steps)] = others.rises
        measures[chosen] = others.measures
        return _Walks(self.pairs, starts, self.steps, rises, measures)


@dataclass(frozen=True, eq=False)
class Bands:
    """Bands of triangles between pairs of contours.

    Attributes
    ----------
    rings : Rings
        The contours.
    walks : _Walks
        How the bands go around them.
    is_poor : array of bool, shape (bands,)
        Where even the best band is far from what its contours suggest.
    """

    rings: Rings
    walks: _Walks
    is_poor: NDArray[np.bool_]

    def triangles(
        self,
        is_chosen: NDArray[np.bool_],
        order: NDArray[np.int64],
        ends: NDArray[np.int64],
        others: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Return the triangles of some of the bands, along contours with vertices on their edges.

        Parameters
        ----------
        is_chosen : array of bool, shape (bands,)
        order : array of int, shape (m,)
            The vertices around the contours, their own n and others, contour by contour.
        ends : array of int, shape (n + 1,)
            Where in this order each of their own is, and where the last of all ends.
        others : array of int, shape (j, 3)
            Triangles to put behind them.

        Returns
        -------
        triangles : array of int, shape (k + j, 3)
        """
        walks = self.walks
        count = counts_of(ends[self.rings.first])[walks.pairs[is_chosen]].sum()
        triangles = np.empty((count + len(others), 3), dtype=np.int64)
        lay(
            *(self.rings.first, walks.pairs, walks.starts, walks.rises),
            *(is_chosen, order, ends, triangles[:count]),
        )
        triangles[count:] = others
        return triangles


def _walk(rings: Rings, pairs: NDArray[np.int64], shifts: NDArray[np.float64]) -> _Walks:
    """Walk along all pairs of contours, those above shifted back, by the shorter diagonals."""
    steps = rings.counts[pairs].sum(axis=1)
    starts = np.empty_like(pairs)
    rises = np.empty(steps.sum(), dtype=bool)
    measures = np.empty((len(pairs), 2))
    greedy(rings.points, rings.first, pairs, shifts, starts, rises, measures)
    return _Walks(pairs, starts, steps, rises, measures)


def _of_least_area(rings: Rings, walks: _Walks) -> _Walks:
    """Improve walks, those along the contours as they lie."""
    starts, rises, measures = walks.starts.copy(), walks.rises.copy(), walks.measures.copy()
    unshifted = np.zeros(measures.shape)
    least(rings.points, rings.first, walks.pairs, unshifted, starts, rises, measures)
    return _Walks(walks.pairs, starts, walks.steps, rises, measures)


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
    stepped : array, shape (bands,)
        Area of a surface that is level where the contours differ and upright elsewhere, did one
        contain the other; it is larger else.
    shift : array, shape (bands, 2)
        From the centroid below to the one above.
    """

    area: NDArray[np.float64]
    slant: NDArray[np.float64]
    volume: NDArray[np.float64]
    base: NDArray[np.float64]
    stepped: NDArray[np.float64]
    shift: NDArray[np.float64]

    @classmethod
    def of(cls, rings: Rings, pairs: NDArray[np.int64]) -> _Expectations:
        columns = np.empty((len(pairs), 7))
        expect(rings.points, rings.first, pairs, columns)
        area, slant, volume, base, stepped = columns[:, :5].T
        return cls(area, slant, volume, base, stepped, np.ascontiguousarray(columns[:, 5:]))

    def __getitem__(self, chosen: NDArray[np.bool_]) -> _Expectations:
        return _Expectations(
            self.area[chosen],
            self.slant[chosen],
            self.volume[chosen],
            self.base[chosen],
            self.stepped[chosen],
            self.shift[chosen],
        )


def _misfits(walks: _Walks, expected: _Expectations) -> NDArray[np.float64]:
    """Return, per band, how much area and volume exceed or miss what is expected, relatively.

    The volume is the flux of (0, 0, z) through the band and the caps at both ends. A pinched band
    fits nothing.
    """
    areas, fluxes = walks.measures.T
    excess = np.maximum(areas / expected.area - 1, 0.0)
    lack = np.abs((fluxes + expected.base) / expected.volume - 1)
    return np.asarray(excess + VOLUME_WEIGHT * lack)


def _second_look(
    rings: Rings, walks: _Walks, misfits: NDArray[np.float64], expected: _Expectations
) -> tuple[_Walks, NDArray[np.float64]]:
    """Return walks that fit better where there are some, and their misfits."""
    for others in (_of_least_area(rings, walks), _walk(rings, walks.pairs, expected.shift)):
        walks, misfits = _better(walks, misfits, others, _misfits(others, expected))
    return walks, misfits


def _better(
    walks: _Walks,
    misfits: NDArray[np.float64],
    others: _Walks,
    other_misfits: NDArray[np.float64],
) -> tuple[_Walks, NDArray[np.float64]]:
    """Return the clearly better of two walks along each pair, else the first, and its misfit."""
    is_better = other_misfits < WORTHWHILE * misfits - TIE
    better = walks.replaced(is_better, others[is_better])
    return better, np.where(is_better, other_misfits, misfits)
