"""Closed contours kept one behind the other in one array, so that all are measured at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

__all__ = ["Rings", "counts_of", "ends_of", "number_within", "runs", "signed_area"]


def ends_of(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where groups that stand one behind the other begin, and where the last ends."""
    ends = np.zeros(len(counts) + 1, dtype=np.int64)
    counts.cumsum(out=ends[1:])
    return ends


def counts_of(ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many members groups have that stand one behind the other; see `ends_of`."""
    return ends[1:] - ends[:-1]


def number_within(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Count off the members of groups that stand one behind the other.

    Parameters
    ----------
    counts : array of int, shape (g,)
        Size of each group.

    Returns
    -------
    groups, positions : array of int, shape (sum of counts,)
        The group of each member and its place in it, from 0.
    """
    groups = np.repeat(np.arange(len(counts)), counts)
    return groups, np.arange(len(groups)) - np.repeat(np.cumsum(counts) - counts, counts)


def runs(starts: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count on from several numbers, so many each, one run behind the other."""
    ends = ends_of(counts)
    numbers = np.repeat(starts - ends[:-1], counts)
    numbers += np.arange(len(numbers))
    return numbers


def signed_area(ring: NDArray[np.float64]) -> float:
    """Return the area that a ring (n, 2) encloses, positive where it runs counter-clockwise."""
    x, y = (ring[1:] - ring[0]).T
    return 0.5 * float(x[:-1] @ y[1:] - y[:-1] @ x[1:])


@dataclass(frozen=True, eq=False)
class Rings:
    """Closed contours, one behind the other.

    Attributes
    ----------
    points : array, shape (n, d)
        Their vertices; the first is not repeated at the end.
    first : array of int, shape (rings + 1,)
        Where each contour begins, and where the last one ends; none is without vertices.
    """

    points: NDArray[np.float64]
    first: NDArray[np.int64]

    @classmethod
    def of_loops(cls, loops: Sequence[NDArray[np.float64]]) -> Rings:
        """Put contours, each shape (n_i, 2), one behind the other; there may be none."""
        counts = np.array([len(loop) for loop in loops], dtype=np.int64)
        return cls(np.concatenate([np.empty((0, 2)), *loops]), ends_of(counts))

    @cached_property
    def counts(self) -> NDArray[np.int64]:
        """Number of vertices of each contour."""
        return counts_of(self.first)

    @cached_property
    def following(self) -> NDArray[np.int64]:
        """The vertex after each one."""
        following = np.arange(1, len(self.points) + 1)
        following[self.first[1:] - 1] = self.first[:-1]
        return following

    @cached_property
    def reversed(self) -> Rings:
        """The same contours, the last one first, each the other way around."""
        return Rings(self.points[::-1], self.first[-1] - self.first[::-1])

    @cached_property
    def edges(self) -> NDArray[np.float64]:
        """Vectors in the plane from each vertex to the one after it, shape (n, 2)."""
        plane = self.points[:, :2]
        return plane[self.following] - plane

    @cached_property
    def areas(self) -> NDArray[np.float64]:
        """Signed area of each contour, positive where it runs counter-clockwise."""
        _, crosses, _ = self._sectors
        return self.total(crosses) / 2

    @cached_property
    def centroids(self) -> NDArray[np.float64]:
        """Centroid of what each contour encloses, shape (rings, 2)."""
        middles, crosses, doubled = self._sectors
        return middles + self.total(crosses[:, None] * doubled) / (6 * self.areas[:, None])

    @cached_property
    def _sectors(self) -> tuple[NDArray[np.float64], ...]:
        """Each contour's mean vertex; each edge's cross product and sum of ends as seen from it."""
        middles = self.total(self.points[:, :2]) / self.counts[:, None]
        starts = self.points[:, :2] - np.repeat(middles, self.counts, axis=0)
        ends = starts[self.following]
        return middles, starts[:, 0] * ends[:, 1] - starts[:, 1] * ends[:, 0], starts + ends

    def loop(self, ring: int) -> NDArray[np.float64]:
        """Return the vertices of one contour."""
        return self.points[self.first[ring] : self.first[ring + 1]]

    def total(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Add up, for each contour, one value per vertex."""
        return np.asarray(np.add.reduceat(values, self.first[:-1], axis=0))
