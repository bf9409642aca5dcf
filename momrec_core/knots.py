"""The surface between contours that do not match one to one: splits, holes, pieces that vanish.

Seen along the planes' normal, the contours of two layers divide the plane into regions. Where only
the layer below has material the surface faces up, where only the one above has it faces down;
each region is triangulated in the plane and its vertices are lifted to the layer that they are
of. Where a contour below and one above cross or part, the region's border jumps from one layer to
the other by a vertical edge; where they coincide, a vertical wall stands on them.

References
----------
G. Barequet and M. Sharir, Piecewise-linear interpolation between polygonal slices, 1996.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import manifold3d
import numpy as np
from numpy.typing import NDArray

from momrec_core._filling import fill
from momrec_core.regions import Regions
from momrec_core.rings import Rings, number_within

__all__ = ["Knots", "cap", "join_knots"]


@dataclass(frozen=True, eq=False)
class Knots:
    """Groups of contours below and above, each group with what its contours share.

    Attributes
    ----------
    vertices : array of int, shape (n,)
        The vertices around all contours, one contour behind the other.
    is_own : array of bool, shape (n,)
        Whether a vertex takes part in its knot's contacts; the others lie on straight edges and
        are there for the slab on the other side. The first of a contour does.
    first : array of int, shape (contours + 1,)
        Where each contour begins in `vertices`.
    pieces : array of int, shape (contours,)
        The piece that each contour is of: its shell, then its holes.
    knots : array of int, shape (pieces,)
        The knot that each piece is of.
    is_above : array of bool, shape (pieces,)
        Whether a piece is of the layer above.
    links : array of int, shape (m, 2)
        Vertices below and above that lie upon each other.
    """

    vertices: NDArray[np.int64]
    is_own: NDArray[np.bool_]
    first: NDArray[np.int64]
    pieces: NDArray[np.int64]
    knots: NDArray[np.int64]
    is_above: NDArray[np.bool_]
    links: NDArray[np.int64]


def cap(
    points: NDArray[np.float64],
    vertices: NDArray[np.int64],
    ends: NDArray[np.int64],
    pieces: NDArray[np.int64],
    faces_up: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Triangulate pieces of the plane between contours.

    Parameters
    ----------
    points : array, shape (n, 3)
        All vertices, in the planes' frame.
    vertices : array of int, shape (m,)
        Those around the contours, with the pieces on the left, one contour behind the other.
    ends : array of int, shape (contours + 1,)
        Where each contour begins, and where the last one ends.
    pieces : array of int, shape (pieces + 1,)
        The first contour of each piece, and the number of contours.
    faces_up : array of bool, shape (pieces,)
        Whether a piece faces up, or down.

    Returns
    -------
    triangles : array of int, shape (k, 3)
        Each edge of a contour is used once, in its direction where the piece faces up, and all
        others in pairs.
    """
    triangles = np.empty((len(vertices) + 2 * len(ends) - 2, 3), dtype=np.int64)
    counts = np.empty(len(faces_up), dtype=np.int64)
    fill(points, vertices, ends, pieces, faces_up, triangles, counts)
    parts = [triangles[: counts[counts > 0].sum()]]
    for piece in np.flatnonzero(counts < 0):
        bounds = ends[pieces[piece] : pieces[piece + 1] + 1].tolist()
        plane = [points[vertices[low:high], :2] for low, high in pairwise(bounds)]
        doubtful = vertices[bounds[0] + manifold3d.triangulate(plane)]
        parts.append(doubtful if faces_up[piece] else doubtful[:, ::-1])
    return np.concatenate(parts)


def join_knots(
    points: NDArray[np.float64], knots: Knots
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Join groups of contours.

    Parameters
    ----------
    points : array, shape (n, 3)
        All vertices, in the planes' frame.
    knots : Knots
        The contours.

    Returns
    -------
    triangles : array of int, shape (m, 3)
        Facing outward. Each edge of a contour is used once.
    failed : array of int
        The knots that are left out, as their contacts contradict each other, by rounding.
    """
    if len(knots.knots) == 0:
        return np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=np.int64)
    chains = _Chains.of(knots, len(points))
    partners, is_wall = _partners(chains)
    rest = chains[~is_wall]
    alone = np.flatnonzero(partners[~is_wall] < 0)
    is_inside = np.zeros(len(rest.knots), dtype=bool)
    runs = _runs(points, knots, rest[alone])
    is_inside[alone] = _inside(points, knots, rest[alone[runs.longest]])[runs.numbers]
    borders = rest.turned(is_inside)
    faces_up = rest.is_above == is_inside
    failed = np.unique(
        np.concatenate(
            [
                _linked_twice(knots, len(points)),
                chains.knots[_claimed_twice(partners)],
                _unbalanced(borders, faces_up),
            ]
        )
    )
    walls = _walls(chains, partners, is_wall & ~np.isin(chains.knots, failed))
    kept = ~np.isin(borders.knots, failed)
    return np.concatenate([walls, *_fill(points, borders[kept], faces_up[kept])]), failed


@dataclass(frozen=True, eq=False)
class _Chains:
    """Straight parts of contours between the vertices that take part in their knots' contacts.

    Attributes
    ----------
    path : array of int, shape (n, 2)
        The vertices that the edges of all contours lead from and to.
    begin, end : array of int, shape (chains,)
        The edges of each chain, as a range in `path`.
    knots : array of int, shape (chains,)
        The knot of each chain.
    is_above : array of bool, shape (chains,)
        Whether it is of the layer above.
    ends : array of int, shape (chains, 2)
        The places where it begins and ends, with one number for vertices that are linked.
    is_back : array of bool, shape (chains,)
        Whether it is passed from its end to its beginning.
    """

    path: NDArray[np.int64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    knots: NDArray[np.int64]
    is_above: NDArray[np.bool_]
    ends: NDArray[np.int64]
    is_back: NDArray[np.bool_]

    @classmethod
    def of(cls, knots: Knots, count: int) -> _Chains:
        """Cut the contours at their own vertices; `count` is the number of all vertices."""
        following = np.roll(knots.vertices, -1)
        following[knots.first[1:] - 1] = knots.vertices[knots.first[:-1]]
        begin = np.flatnonzero(knots.is_own)
        end = np.append(begin[1:], len(following))
        pieces = knots.pieces[np.searchsorted(knots.first, begin, side="right") - 1]
        is_above = knots.is_above[pieces]
        roots = np.arange(count)
        roots[knots.links[:, 1]] = knots.links[:, 0]
        vertices = np.column_stack([knots.vertices[begin], following[end - 1]])
        places = np.where(is_above[:, None], roots[vertices], vertices)
        _, ends = np.unique(places + count * knots.knots[pieces, None], return_inverse=True)
        path = np.column_stack([knots.vertices, following])
        forward = np.zeros(len(begin), dtype=bool)
        return cls(path, begin, end, knots.knots[pieces], is_above, ends.reshape(-1, 2), forward)

    def __getitem__(self, chosen: NDArray[Any]) -> _Chains:
        columns = (self.begin, self.end, self.knots, self.is_above, self.ends, self.is_back)
        return _Chains(self.path, *(column[chosen] for column in columns))

    def turned(self, is_back: NDArray[np.bool_]) -> _Chains:
        """Return the chains, some of them passed from their ends to their beginnings."""
        ends = np.where(is_back[:, None], self.ends[:, ::-1], self.ends)
        return replace(self, ends=ends, is_back=is_back)

    @cached_property
    def first_edges(self) -> NDArray[np.int64]:
        """The edge that each chain begins with, in the direction of its passing, shape (c, 2)."""
        return self._passed(np.where(self.is_back, self.end - 1, self.begin), self.is_back)

    @cached_property
    def last_edges(self) -> NDArray[np.int64]:
        """The edge that each chain ends with, in the direction of its passing, shape (c, 2)."""
        return self._passed(np.where(self.is_back, self.begin, self.end - 1), self.is_back)

    def edges(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the edges along all chains, shape (m, 2), and the chain of each."""
        owners, positions = number_within(self.end - self.begin)
        is_back = self.is_back[owners]
        at = np.where(is_back, self.end[owners] - 1 - positions, self.begin[owners] + positions)
        return self._passed(at, is_back), owners

    def _passed(self, at: NDArray[np.int64], is_back: NDArray[np.bool_]) -> NDArray[np.int64]:
        tails, heads = 2 * at + is_back, 2 * at + ~is_back
        return self.path.ravel()[np.stack([tails, heads], axis=1)]


def _partners(chains: _Chains) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Match chains below and above that lie upon each other.

    Returns
    -------
    partners : array of int, shape (chains,)
        The other chain, or -1.
    is_wall : array of bool, shape (chains,)
        Whether the two run the same way, so that a wall stands between them.
    """
    count = int(chains.ends.max(initial=0)) + 1
    keys, backward = chains.ends @ (count, 1), chains.ends @ (1, count)
    above = np.flatnonzero(chains.is_above)
    below = np.flatnonzero(~chains.is_above)
    below = below[np.argsort(keys[below], kind="stable")]
    partners = np.full(len(keys), -1)
    is_wall = np.zeros(len(keys), dtype=bool)
    for wanted, runs_along in ((backward[above], False), (keys[above], True)):
        at = np.searchsorted(keys[below], wanted) % len(below)
        found = keys[below[at]] == wanted
        high, low = above[found], below[at[found]]
        partners[high], partners[low] = low, high
        is_wall[high] = is_wall[low] = runs_along
    return partners, is_wall


def _claimed_twice(partners: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which chains are the partner of more than one."""
    return np.asarray(np.bincount(partners[partners >= 0], minlength=len(partners)) > 1)


def _linked_twice(knots: Knots, count: int) -> NDArray[np.int64]:
    """Return the knots in which a vertex touches two others."""
    pieces = np.repeat(knots.pieces, np.diff(knots.first))
    knot_of = np.zeros(count, dtype=np.int64)
    is_below = ~knots.is_above[pieces]
    knot_of[knots.vertices[is_below]] = knots.knots[pieces[is_below]]
    low, high = (np.bincount(side, minlength=count)[side] > 1 for side in knots.links.T)
    return np.asarray(knot_of[knots.links[low | high, 0]])


def _unbalanced(borders: _Chains, faces_up: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the knots in which the border of a region does not close."""
    leaving, arriving = (2 * borders.ends + faces_up[:, None]).T
    count = int(borders.ends.max(initial=0)) * 2 + 2
    open_places = np.bincount(leaving, minlength=count) != np.bincount(arriving, minlength=count)
    return np.asarray(borders.knots[open_places[leaving] | open_places[arriving]])


def _walls(
    chains: _Chains, partners: NDArray[np.int64], is_wall: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return the vertical walls between chains that lie upon each other."""
    foot, head = (np.flatnonzero(is_wall & side) for side in (~chains.is_above, chains.is_above))
    below, low = chains[foot].edges()
    above, high = chains[head].edges()
    apexes = chains.first_edges[partners[foot], 0][low]
    bases = chains.last_edges[partners[head], 1][high]
    return np.concatenate(
        [np.column_stack([below, apexes]), np.column_stack([bases, above[:, ::-1]])]
    )


@dataclass(frozen=True, eq=False)
class _Runs:
    """Chains one after the other, none of which meets a contour of the other layer in between.

    Attributes
    ----------
    numbers : array of int, shape (chains,)
        The run of each chain.
    longest : array of int, shape (runs,)
        The longest chain of each run.
    """

    numbers: NDArray[np.int64]
    longest: NDArray[np.int64]


def _runs(points: NDArray[np.float64], knots: Knots, chains: _Chains) -> _Runs:
    starts, stops = chains.first_edges[:, 0], chains.last_edges[:, 1]
    is_linked = np.zeros(len(points), dtype=bool)
    is_linked[knots.links] = True
    is_new = np.ones(len(starts), dtype=bool)
    contours = np.searchsorted(knots.first, chains.begin, side="right")
    follows = (chains.begin[1:] == chains.end[:-1]) & (contours[1:] == contours[:-1])
    is_new[1:] = is_linked[starts[1:]] | ~follows
    numbers = np.cumsum(is_new) - 1
    squares = ((points[stops] - points[starts]) ** 2).sum(axis=1)
    order = np.lexsort([squares, numbers])
    return _Runs(numbers, order[np.flatnonzero(np.diff(numbers, append=-1))])


def _inside(points: NDArray[np.float64], knots: Knots, chains: _Chains) -> NDArray[np.bool_]:
    """Tell which chains run inside the pieces of the other layer."""
    sides = (2 * knots.knots + knots.is_above)[knots.pieces]
    first = np.searchsorted(sides, np.arange(2 * knots.knots[-1] + 3))
    regions = Regions(Rings(points[knots.vertices, :2], knots.first), first)
    ends = np.column_stack([chains.first_edges[:, 0], chains.last_edges[:, 1]])
    return regions.hold(2 * chains.knots + ~chains.is_above, points[ends, :2].mean(axis=1))


def _fill(
    points: NDArray[np.float64], borders: _Chains, faces_up: NDArray[np.bool_]
) -> Iterator[NDArray[np.int64]]:
    """Triangulate the regions that chains bound on their left, facing up or down.

    The corner between two chains belongs to the layer of the one that leaves it; where the one
    that arrives is of the other layer, a vertical triangle leads over.
    """
    if len(faces_up) == 0:
        return
    following = _following(points, borders, 2 * borders.ends + faces_up[:, None])
    leads = np.column_stack([borders.last_edges, borders.first_edges[following, 0]])
    leads, is_up = leads[leads[:, 1] != leads[:, 2]], faces_up[leads[:, 1] != leads[:, 2]]
    yield np.where(is_up[:, None], leads, leads[:, ::-1])
    sequence, loops = _cycles(following, np.lexsort([faces_up, borders.knots]))
    edges, owners = borders[sequence].edges()
    ends = np.searchsorted(loops[owners], np.arange(loops[-1] + 2))
    leaders = sequence[np.searchsorted(loops, np.arange(loops[-1] + 1))]
    keys = 2 * borders.knots[leaders] + faces_up[leaders]
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    regions = np.append(first, len(keys))
    yield cap(points, edges[:, 0].copy(), ends, regions, faces_up[leaders[first]])


def _following(
    points: NDArray[np.float64], borders: _Chains, ends: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the chain after each one: where several leave, the one furthest to the left."""
    leaving, arriving = ends.T
    order = np.argsort(leaving, kind="stable")
    first = np.searchsorted(leaving[order], arriving)
    following: NDArray[np.int64] = order[first]
    meeting = np.bincount(leaving)[arriving]
    tails, heads = (
        np.diff(points[edges, :2], axis=1)[:, 0]
        for edges in (borders.last_edges, borders.first_edges)
    )
    choices: dict[int, list[int]] = {}
    for chain in np.flatnonzero(meeting > 1).tolist():
        start = int(first[chain])
        waiting = choices.setdefault(start, order[start : start + meeting[chain]].tolist())
        following[chain] = waiting.pop(_leftmost(tails[chain], heads[waiting]))
    return following


def _leftmost(heading: NDArray[np.float64], leads: NDArray[np.float64]) -> int:
    """Return which of several leads turns furthest to the left."""
    sines = heading[0] * leads[:, 1] - heading[1] * leads[:, 0]
    return int(np.argmax(np.arctan2(sines, leads @ heading)))


def _cycles(
    following: NDArray[np.int64], order: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Follow each chain to the next until it closes.

    Returns
    -------
    sequence : array of int, shape (chains,)
        The chains, cycle by cycle, the cycles by their first chains in the given order.
    cycles : array of int, shape (chains,)
        The cycle that each of these is of.
    """
    after: list[int] = following.tolist()
    is_left = [True] * len(after)
    sequence: list[int] = []
    counts: list[int] = []
    for start in order.tolist():
        begin, chain = len(sequence), start
        while is_left[chain]:
            is_left[chain] = False
            sequence.append(chain)
            chain = after[chain]
        if len(sequence) > begin:
            counts.append(len(sequence) - begin)
    return np.array(sequence), np.repeat(np.arange(len(counts)), counts)
