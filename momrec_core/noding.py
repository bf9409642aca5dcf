"""Where the contours of two adjacent layers touch or cross, seen along the planes' normal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from momrec_core.rings import number_within

__all__ = ["Contacts", "Edges", "find_contacts"]

# Units: above Clipper2's grid, and below the layers' cleaning, so that no two vertices touch one.
TOUCH = 1e-4


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of closed rings, in the plane.

    Attributes
    ----------
    starts, ends : array, shape (n, 2)
        Edge k runs from ``starts[k]`` to ``ends[k]``; each vertex is the start of one edge.
    groups : array of int, shape (n,)
        Edges of different groups do not meet.
    """

    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    groups: NDArray[np.int64]

    @cached_property
    def lengths(self) -> NDArray[np.float64]:
        """Length of each edge, shape (n,); never 0."""
        x, y = (self.ends - self.starts).T
        return np.asarray(np.maximum(np.sqrt(x * x + y * y), np.finfo(np.float64).tiny))

    @cached_property
    def tangents(self) -> NDArray[np.float64]:
        """Direction of each edge, shape (n, 2)."""
        return np.asarray((self.ends - self.starts) / self.lengths[:, None])


@dataclass(frozen=True, eq=False)
class Contacts:
    """Points that two sets of edges have in common.

    Attributes
    ----------
    below, above : array of int, shape (n,)
        The edges that meet.
    below_at, above_at : array, shape (n,)
        Where on the edge, 0 to 1; exactly 0 where the contact is the edge's first vertex.
    points : array, shape (n, 2)
    """

    below: NDArray[np.int64]
    above: NDArray[np.int64]
    below_at: NDArray[np.float64]
    above_at: NDArray[np.float64]
    points: NDArray[np.float64]


def find_contacts(below: Edges, above: Edges) -> Contacts:
    """Find where two sets of edges share a vertex, touch, or cross.

    Vertices within `TOUCH` of each other or of an edge count as on it, so that edges that
    coincide but for rounding are found to share their ends.
    """
    empty = np.empty(0, dtype=np.int64)
    if not len(below.starts) or not len(above.starts):
        return Contacts(empty, empty, np.empty(0), np.empty(0), np.empty((0, 2)))
    lower, upper = _near(below, above)
    parts = [
        _shared_vertices(below, above, lower, upper),
        _vertices_on_edges(below, above, lower, upper),
        _swapped(_vertices_on_edges(above, below, upper, lower)),
        _crossings(below, above, lower, upper),
    ]
    first, second, first_at, second_at = (np.concatenate(part) for part in zip(*parts, strict=True))
    points = below.starts[first] + first_at[:, None] * (below.ends - below.starts)[first]
    on_upper = (second_at == 0) & (first_at > 0)
    points[on_upper] = above.starts[second[on_upper]]
    return Contacts(first, second, first_at, second_at, points)


_EdgePairs = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]


def _swapped(contacts: _EdgePairs) -> _EdgePairs:
    first, second, first_at, second_at = contacts
    return second, first, second_at, first_at


def _near(below: Edges, above: Edges) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs of edges of a group whose boxes meet.

    The groups are laid one beside the other along x or y, whichever has the narrower boxes; of
    two edges that meet there, one begins within the other.
    """
    low, high = _boxes(below)
    other_low, other_high = _boxes(above)
    extent = np.maximum(high.max(axis=0), other_high.max(axis=0))
    extent -= np.minimum(low.min(axis=0), other_low.min(axis=0))
    axis = int(
        np.argmin(((high - low).sum(axis=0) + (other_high - other_low).sum(axis=0)) / extent)
    )
    aside, other_aside = (2 * extent[axis] * edges.groups for edges in (below, above))
    begin, end = low[:, axis] + aside, high[:, axis] + aside
    other_begin, other_end = other_low[:, axis] + other_aside, other_high[:, axis] + other_aside
    lower, upper = _beginning_within(begin, end, other_begin, "left")
    later_upper, later_lower = _beginning_within(other_begin, other_end, begin, "right")
    lower, upper = np.concatenate([lower, later_lower]), np.concatenate([upper, later_upper])
    across = 1 - axis
    meet = low[lower, across] <= other_high[upper, across]
    meet &= other_low[upper, across] <= high[lower, across]
    return lower[meet], upper[meet]


def _boxes(edges: Edges) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of the edges' boxes, as much larger as touching edges may be apart."""
    low, high = np.minimum(edges.starts, edges.ends), np.maximum(edges.starts, edges.ends)
    return low - TOUCH, high + TOUCH


def _beginning_within(
    begin: NDArray[np.float64],
    end: NDArray[np.float64],
    points: NDArray[np.float64],
    side: Literal["left", "right"],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return intervals and points in them: those at its beginning ("left") or not ("right")."""
    order = np.argsort(points)
    first = np.searchsorted(points[order], begin, side)
    last = np.searchsorted(points[order], end, "right")
    intervals, positions = number_within(last - first)
    return intervals, order[first[intervals] + positions]


def _shared_vertices(
    below: Edges, above: Edges, lower: NDArray[np.int64], upper: NDArray[np.int64]
) -> _EdgePairs:
    """Find the pairs of edges whose first vertices lie upon each other."""
    apart = below.starts[lower] - above.starts[upper]
    shared = (apart**2).sum(axis=1) <= TOUCH**2
    ends = np.zeros(np.count_nonzero(shared))
    return lower[shared], upper[shared], ends, ends


def _along(points: NDArray[np.float64], edges: Edges, on: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return positions along edges, in lengths."""
    return np.asarray(((points - edges.starts[on]) * edges.tangents[on]).sum(axis=1))


def _beside(
    points: NDArray[np.float64], edges: Edges, on: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return signed distances from the lines of edges, positive on their left."""
    (x, y), (along_x, along_y) = (points - edges.starts[on]).T, edges.tangents[on].T
    return np.asarray(along_x * y - along_y * x)


def _vertices_on_edges(
    vertices: Edges, edges: Edges, which: NDArray[np.int64], on: NDArray[np.int64]
) -> _EdgePairs:
    """Find the first vertices of edges of one set that lie inside edges of the other."""
    near = np.abs(_beside(vertices.starts[which], edges, on)) <= TOUCH
    which, on = which[near], on[near]
    along, lengths = _along(vertices.starts[which], edges, on), edges.lengths[on]
    inside = (along > TOUCH) & (along < lengths - TOUCH)
    position = along[inside] / lengths[inside]
    return which[inside], on[inside], np.zeros(len(position)), position


def _crossings(
    below: Edges, above: Edges, lower: NDArray[np.int64], upper: NDArray[np.int64]
) -> _EdgePairs:
    """Find the pairs of edges that cross away from their ends."""
    start, end = (_beside(points[lower], above, upper) for points in (below.starts, below.ends))
    cross = _are_opposite(start, end)
    lower, upper, start, end = lower[cross], upper[cross], start[cross], end[cross]
    begin, stop = (_beside(points[upper], below, lower) for points in (above.starts, above.ends))
    cross = _are_opposite(begin, stop)
    at = start[cross] / (start[cross] - end[cross])
    other_at = begin[cross] / (begin[cross] - stop[cross])
    return lower[cross], upper[cross], at, other_at


def _are_opposite(ones: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which signed distances from a line are clearly on either side of it."""
    clear = np.minimum(np.abs(ones), np.abs(others)) > TOUCH
    return np.asarray(clear & ((ones > 0) != (others > 0)))
