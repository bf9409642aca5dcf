"""Layers of polygons joined into one closed surface (Fig. 6b of the paper)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from momrec_core.knots import Knots, cap, join_knots
from momrec_core.layers import Layer, Slab, pieces_of_layers
from momrec_core.manifolds import double_shared_edges
from momrec_core.noding import Edges, find_contacts
from momrec_core.rings import Rings, number_within
from momrec_core.walking import walk_bands

__all__ = ["tile"]

CORNER = -1  # owner of the vertices that a contour has of itself


def tile(slabs: Sequence[Slab]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Join cross-sections into a closed surface.

    Between two layers, pieces that are each other's only overlap are joined contour by contour
    along the shortest diagonals; where pieces or holes split, join, appear or vanish the contours
    are joined as they lie over each other. What ends at a layer is capped there.

    Parameters
    ----------
    slabs : sequence of Slab
        By increasing offset, each on the layer that the one before ends at; empty layers at both
        ends close the surface.

    Returns
    -------
    vertices : array, shape (n, 3)
        In the planes' frame, in the layers' units.
    triangles : array of int, shape (m, 3)
        Closed, edge-manifold, facing outward.
    """
    contours = _Contours.of_layers([slabs[0].below, *(slab.above for slab in slabs)])
    bands, edges, groups = _bands(contours, slabs)
    joins = [group for group in groups if group.below and group.above]
    links = contours.insert_contacts(joins)
    contours.settle()
    joined, failed = join_knots(contours.points, contours.knots(joins, links))
    banded = _divided(contours, bands, edges)
    triangles = [banded, joined]
    alone = (group for group in groups if not (group.below and group.above))
    triangles.extend(_caps(contours, [*alone, *(joins[index] for index in failed)]))
    return double_shared_edges(contours.points, np.concatenate(triangles), sound=len(banded))


@dataclass(frozen=True)
class _Group:
    """Pieces of two adjacent layers that do not match one to one.

    Attributes
    ----------
    slab : int
        The slab between the layers.
    below, above : list of range
        The contours of each piece: shell, then holes.
    """

    slab: int
    below: list[range]
    above: list[range]


@dataclass(eq=False)
class _Contours:
    """The contours of all layers, with the vertices that their neighbours need on them.

    Attributes
    ----------
    corners : Rings
        The contours as they are cut, shape (n, 3).
    base : array of int, shape (layers,)
        The first contour of each layer.
    points : array, shape (m, 3)
        The corners, contour by contour, then the inserted vertices.
    edges : array of int, shape (m,)
        The edge that a vertex lies on, numbered as the corner that it starts from.
    along : array, shape (m,)
        Where on that edge, 0 to 1; 0 for corners.
    owners : array of int, shape (m,)
        The slab that a vertex was inserted for, or `CORNER`.
    order : array of int, shape (m,)
        The vertices contour by contour, in their order around it.
    ends : array of int, shape (n + 1,)
        Where in this order the vertices on each edge begin.
    """

    corners: Rings
    base: NDArray[np.int64]
    points: NDArray[np.float64]
    edges: NDArray[np.int64]
    along: NDArray[np.float64]
    owners: NDArray[np.int64]
    order: NDArray[np.int64]
    ends: NDArray[np.int64]

    @classmethod
    def of_layers(cls, layers: Sequence[Layer]) -> _Contours:
        pieces, starts = pieces_of_layers(layers)
        counts = np.array([len(layer) for layer in layers])
        owners, places = number_within(counts)
        sections = pieces.take(starts[owners] + places).merged(counts)
        rings = sections.rings
        offsets = np.array([layer.offset for layer in layers])
        heights = np.repeat(offsets, np.diff(rings.first[sections.first]))
        points = np.column_stack([rings.points, heights])
        corners, base = Rings(points, rings.first), sections.first
        count = len(points)
        numbers = np.arange(count)
        ends = np.arange(count + 1)
        owners = np.full(count, CORNER)
        return cls(corners, base, points, numbers, np.zeros(count), owners, numbers, ends)

    def group(
        self, slabs: Sequence[Slab], index: int, pieces: tuple[list[int], list[int]]
    ) -> _Group:
        """Return pieces below and above a slab as a group."""
        slab = slabs[index]
        sides = []
        for layer, base, chosen in zip(
            (slab.below, slab.above), self.base[index : index + 2].tolist(), pieces, strict=True
        ):
            own = [layer.contours(piece) for piece in chosen]
            sides.append([range(base + piece.start, base + piece.stop) for piece in own])
        return _Group(index, *sides)

    def insert_contacts(self, groups: Sequence[_Group]) -> NDArray[np.int64]:
        """Put vertices where the pieces below and above touch or cross.

        Returns
        -------
        links : array of int, shape (n, 2)
            The vertices below and above that lie upon each other.
        """
        low, below = self._edges_of([group.below for group in groups])
        high, above = self._edges_of([group.above for group in groups])
        contacts = find_contacts(below, above)
        slabs = np.array([group.slab for group in groups], dtype=np.int64)
        slabs = slabs[below.groups[contacts.below]]
        return np.column_stack(
            [
                self._insert(low[contacts.below], contacts.below_at, contacts.points, slabs),
                self._insert(high[contacts.above], contacts.above_at, contacts.points, slabs),
            ]
        )

    def _edges_of(self, groups: Sequence[list[range]]) -> tuple[NDArray[np.int64], Edges]:
        """Return the corners that the edges of groups of pieces start from, and these edges."""
        counts = [sum(map(len, pieces)) for pieces in groups]
        corners, places = self.corners.around(_flat(chain(*groups)))
        numbers = np.repeat(np.arange(len(counts)), counts)[places]
        starts = self.corners.points[corners, :2]
        ends = self.corners.points[self.corners.following[corners], :2]
        return corners, Edges(starts, ends, numbers)

    def knots(self, groups: Sequence[_Group], links: NDArray[np.int64]) -> Knots:
        """Return groups of pieces with the vertices inserted into their contours."""
        pieces = [
            piece for group in groups for side in (group.below, group.above) for piece in side
        ]
        counts = np.array([(len(group.below), len(group.above)) for group in groups], dtype=int)
        sides, _ = number_within(counts.ravel())
        contours = _flat(pieces)
        starts, stops = self.ends[self.corners.first[[contours, contours + 1]]]
        numbers, positions = number_within(stops - starts)
        vertices = self.order[starts[numbers] + positions]
        piece_of = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
        slabs = np.array([group.slab for group in groups])[sides[piece_of[numbers]] // 2]
        is_own = (self.owners[vertices] == CORNER) | (self.owners[vertices] == slabs)
        first = np.concatenate([[0], np.cumsum(stops - starts)])
        return Knots(vertices, is_own, first, piece_of, sides // 2, sides % 2 == 1, links)

    def _insert(
        self,
        edges: NDArray[np.int64],
        along: NDArray[np.float64],
        points: NDArray[np.float64],
        slabs: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Return the vertices at places on edges, new ones where there is no corner."""
        new = np.flatnonzero(along > 0)
        vertices = edges.copy()
        vertices[new] = len(self.points) + np.arange(len(new))
        added = np.column_stack([points[new], self.points[edges[new], 2]])
        self.points = np.concatenate([self.points, added])
        self.edges = np.concatenate([self.edges, edges[new]])
        self.along = np.concatenate([self.along, along[new]])
        self.owners = np.concatenate([self.owners, slabs[new]])
        return vertices

    def settle(self) -> None:
        """Put the inserted vertices in their places around the contours."""
        self.order = np.lexsort([self.along, self.edges])
        self.ends = np.searchsorted(self.edges[self.order], np.arange(len(self.ends)))

    def around(self, pieces: Sequence[range]) -> list[list[NDArray[np.int64]]]:
        """Return the vertices around the contours of pieces, the inserted ones in their places."""
        first = self.ends[self.corners.first]
        return [[self.order[first[ring] : first[ring + 1]] for ring in piece] for piece in pieces]


def _bands(
    contours: _Contours, slabs: Sequence[Slab]
) -> tuple[NDArray[np.int64], NDArray[np.int64], list[_Group]]:
    """Join the contours that match one to one.

    Returns
    -------
    triangles : array of int, shape (m, 3)
        As of `Bands`, between the contours' own corners.
    edges : array of int, shape (m,)
        The corner that the edge of each starts from.
    groups : list of _Group
        The pieces that are left: the knots, and pairs of pieces that are poorly joined so.
    """
    owners = [(index, *match) for index, slab in enumerate(slabs) for match in slab.pairs.items()]
    owner_of = np.repeat(np.arange(len(owners)), [len(pairs) for _, _, pairs in owners])
    local = chain.from_iterable(chain.from_iterable(pairs) for _, _, pairs in owners)
    slab_of = np.array([index for index, _, _ in owners], dtype=np.int64)[owner_of]
    pairs = np.fromiter(local, dtype=np.int64, count=2 * len(owner_of)).reshape(-1, 2)
    pairs += np.column_stack([contours.base[slab_of], contours.base[slab_of + 1]])
    bands = walk_bands(contours.corners, pairs)
    is_poor = np.bincount(owner_of[bands.is_poor], minlength=len(owners)) > 0
    groups = [(index, group) for index, slab in enumerate(slabs) for group in slab.knots]
    for poor in np.flatnonzero(is_poor):
        index, (low, high), _ = owners[poor]
        groups.append((index, ([low], [high])))
    triangles, edges = bands.triangles(np.flatnonzero(~is_poor[owner_of]))
    return triangles, edges, [contours.group(slabs, *it) for it in groups]


def _divided(
    contours: _Contours, triangles: NDArray[np.int64], edges: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Divide the triangles of bands along contours that have got vertices on their edges."""
    is_whole = (np.diff(contours.ends) == 1)[edges]
    low, end, high = triangles[~is_whole].T
    edges = edges[~is_whole]
    runs = edges == high
    apexes = np.where(runs, low, high)
    first = contours.ends[edges]
    owners, positions = number_within(contours.ends[edges + 1] - first)
    at = first[owners] + positions
    here = contours.order[at]
    is_last = at + 1 == contours.ends[edges + 1][owners]
    there = np.where(is_last, end[owners], contours.order[(at + 1) % len(contours.order)])
    is_run = runs[owners]
    parts = np.column_stack(
        [
            np.where(is_run, apexes[owners], here),
            there,
            np.where(is_run, here, apexes[owners]),
        ]
    )
    return np.concatenate([triangles[is_whole], parts])


def _caps(contours: _Contours, groups: Iterable[_Group]) -> Iterator[NDArray[np.int64]]:
    """Close each piece by itself."""
    for group in groups:
        for piece in contours.around(group.below):
            yield cap(contours.points, piece)
        for piece in contours.around(group.above):
            yield cap(contours.points, piece)[:, ::-1]


def _flat(ranges: Iterable[range]) -> NDArray[np.int64]:
    return np.fromiter(chain.from_iterable(ranges), dtype=np.int64)
