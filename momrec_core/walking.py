"""Triangles between two matching contours, by the shortest diagonal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, FillRule
from numpy.typing import NDArray

from momrec_core._bands import expect, greedy, lay, least
from momrec_core.rings import Rings, counts_of

__all__ = ["Bands", "walk_bands"]

POOR_MISFIT = 0.3  # bands above do not follow their contours' surface
WASTEFUL = 1.3  # times a stepped surface's area: a band above leads nowhere, a slanted one is below

# Columns of what contours suggest of their band, and of how a band fits; see _bands.c.
EXPECTATIONS, SLANT, STEPPED, SHIFTS = 7, 1, 4, slice(5, 7)
FITS, AREA, MISFIT = 3, 0, 2


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
    is the best of all walks, in time linear in the vertices. Where that is still far off, another
    greedy walk is tried with the contours' centroids upon each other. A later walk replaces an
    earlier one if it fits clearly better.

    References
    ----------
    H. N. Christiansen and T. W. Sederberg, Conversion of complex contour line definitions into
    polygonal element mosaics, 1978 (reference 18 of the paper). H. Fuchs, Z. M. Kedem and
    S. P. Uselton, Optimal surface reconstruction from planar contours, 1977.
    """
    count = len(pairs)
    expected, fits = np.empty((count, EXPECTATIONS)), np.empty((count, FITS))
    starts = np.full((count, 2), -1)
    rises = np.empty(counts_of(rings.first)[pairs].sum(), dtype=bool)
    expect(rings.points, rings.first, pairs, expected)
    # Where there is no walk yet or a doubtful one, each way is tried, and kept if it fits better.
    walks = rings.points, rings.first, pairs, expected, starts, rises, fits
    greedy(*walks, np.zeros((count, 2)))
    least(*walks)
    greedy(*walks, expected[:, SHIFTS].copy())
    return Bands(rings, pairs, starts, rises, _are_poor(rings, pairs, expected, fits))


def _are_poor(
    rings: Rings,
    pairs: NDArray[np.int64],
    expected: NDArray[np.float64],
    fits: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Tell which bands do not follow their contours' surface.

    A slanted one does unless it leads nowhere: is larger than a stepped surface.
    """
    areas, misfits, stepped = fits[:, AREA], fits[:, MISFIT], expected[:, STEPPED]
    is_poor = misfits > POOR_MISFIT
    slanted = np.flatnonzero(is_poor & (misfits <= POOR_MISFIT + expected[:, SLANT]))
    is_poor[slanted] = False
    wasteful = slanted[areas[slanted] > WASTEFUL * stepped[slanted]]
    excess = [_excess(*(_region(rings, ring) for ring in pair)) for pair in pairs[wasteful]]
    is_poor[wasteful] = areas[wasteful] > WASTEFUL * (stepped[wasteful] + np.array(excess))
    return is_poor


def _excess(below: CrossSection, above: CrossSection) -> float:
    """Return by how much more regions differ than if one contained the other."""
    return float(2 * (min(below.area(), above.area()) - (below ^ above).area()))


def _region(rings: Rings, ring: int) -> CrossSection:
    return CrossSection([rings.loop(ring)[:, :2]], FillRule.EvenOdd)


@dataclass(frozen=True, eq=False)
class Bands:
    """Bands of triangles between pairs of contours.

    Attributes
    ----------
    rings : Rings
        The contours.
    pairs : array of int, shape (bands, 2)
        The contours below and above.
    starts : array of int, shape (bands, 2)
        At which of their vertices the bands begin and end.
    rises : array of bool, shape (n,)
        Band by band, True for each step below and False for each one above: as many as both
        contours have edges.
    is_poor : array of bool, shape (bands,)
        Where even the best band is far from what its contours suggest.
    """

    rings: Rings
    pairs: NDArray[np.int64]
    starts: NDArray[np.int64]
    rises: NDArray[np.bool_]
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
        count = counts_of(ends[self.rings.first])[self.pairs[is_chosen]].sum()
        triangles = np.empty((count + len(others), 3), dtype=np.int64)
        lay(
            *(self.rings.first, self.pairs, self.starts, self.rises),
            *(is_chosen, order, ends, triangles[:count]),
        )
        triangles[count:] = others
        return triangles
