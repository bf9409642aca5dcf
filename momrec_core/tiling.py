"""Layers of polygons joined into one closed surface (Fig. 6b of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from momrec_core.knots import Knots, cap, join_knots
from momrec_core.layers import Layer, Slab, pieces_of_layers
from momrec_core.manifolds import double_shared_edges
from momrec_core.noding import find_contacts
from momrec_core.rings import Rings, counts_of, ends_of, runs
from momrec_core.walking import Bands, walk_bands

__all__ = ["tile"]

_Knot = tuple[int, tuple[list[int], list[int]]]  # a slab; pieces of the layers below and above


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
    bands, is_sound, joins, alone = _bands(contours, slabs)
    contours, links = contours.with_contacts(joins)
    joined, failed = join_knots(contours.points, contours.knots(joins, links))
    left = joins[np.isin(joins.knots, failed)]
    others = np.concatenate([joined, _caps(contours, left), _caps(contours, alone)])
    triangles = bands.triangles(is_sound, contours.order, contours.ends, others)
    return double_shared_edges(contours.points, triangles, sound=len(triangles) - len(others))


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces that bands do not join, knot by knot.

    Attributes
    ----------
    knots : array of int, shape (n,)
        The group of pieces below and above a slab that each is of.
    slabs : array of int, shape (n,)
        This slab.
    is_above : array of bool, shape (n,)
        Whether a piece is of the layer above, not below.
    ends : array of int, shape (n, 2)
        The first contour of each, its shell, and the one after its last, a hole.
    """

    knots: NDArray[np.int64]
    slabs: NDArray[np.int64]
    is_above: NDArray[np.bool_]
    ends: NDArray[np.int64]

    def __getitem__(self, chosen: NDArray[np.bool_]) -> _Pieces:
        return _Pieces(
            self.knots[chosen], self.slabs[chosen], self.is_above[chosen], self.ends[chosen]
        )

    def contours(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the contours of all pieces, and the piece of each."""
        first, last = self.ends.T
        counts = last - first
        return runs(first, counts), np.repeat(np.arange(len(counts)), counts)


@dataclass(frozen=True, eq=False)
class _Contours:
    """The contours of all layers, with the vertices that their neighbours need on them.

    Attributes
    ----------
    corners : Rings
        The contours as they are cut, shape (n, 3).
    layers : array of int, shape (layers + 1,)
        The first piece of each layer, and the number of pieces.
    pieces : array of int, shape (pieces + 1,)
        The first contour of each piece, and the number of contours.
    points : array, shape (m, 3)
        The corners, contour by contour, then the inserted vertices.
    owners : array of int, shape (m - n,)
        The slab that each inserted vertex is there for.
    order : array of int, shape (m,)
        The vertices contour by contour, in their order around it.
    ends : array of int, shape (n + 1,)
        Where in this order the vertices on each edge begin, the corner that it starts from first.
    """

    corners: Rings
    layers: NDArray[np.int64]
    pieces: NDArray[np.int64]
    points: NDArray[np.float64]
    owners: NDArray[np.int64]
    order: NDArray[np.int64]
    ends: NDArray[np.int64]

    @classmethod
    def of_layers(cls, layers: Sequence[Layer]) -> _Contours:
        regions, starts = pieces_of_layers(layers)
        counts = np.array([len(layer) for layer in layers], dtype=np.int64)
        pieces = runs(starts, counts)
        contours = counts_of(regions.first)[pieces]
        rings = runs(regions.first[pieces], contours)
        vertices = regions.rings.counts[rings]
        of_layers, of_pieces, first = ends_of(counts), ends_of(contours), ends_of(vertices)
        points = np.empty((first[-1], 3))
        chosen = runs(regions.rings.first[rings], vertices)
        points[:, :2] = regions.rings.points.take(chosen, axis=0)
        heights = [layer.offset for layer in layers]
        points[:, 2] = np.repeat(heights, counts_of(first[of_pieces[of_layers]]))
        return cls(
            Rings(points, first),
            layers=of_layers,
            pieces=of_pieces,
            points=points,
            owners=np.empty(0, dtype=np.int64),
            order=np.arange(len(points)),
            ends=np.arange(len(points) + 1),
        )

    def knotted(self, knots: Sequence[_Knot]) -> _Pieces:
        """Return the pieces of knots."""
        counts = [len(pieces) for _, sides in knots for pieces in sides]
        numbers = chain.from_iterable(chain.from_iterable(sides) for _, sides in knots)
        places = np.repeat(np.arange(len(counts)), counts)
        slabs = np.array([slab for slab, _ in knots], dtype=np.int64)[places // 2]
        pieces = self.layers[slabs + places % 2]
        pieces += np.fromiter(numbers, dtype=np.int64, count=len(places))
        ends = self.pieces[np.column_stack([pieces, pieces + 1])]
        return _Pieces(places // 2, slabs, places % 2 == 1, ends)

    def with_contacts(self, pieces: _Pieces) -> tuple[_Contours, NDArray[np.int64]]:
        """Put vertices where the pieces below and above touch or cross.

        Returns
        -------
        contours : _Contours
            These corners, and vertices on their edges.
        links : array of int, shape (n, 2)
            The vertices below and above that lie upon each other.
        """
        contours, owners = pieces.contours()
        knots, is_above = pieces.knots[owners], pieces.is_above[owners]
        contacts = find_contacts(self.corners, contours, knots, is_above)
        vertices = np.concatenate([contacts.below, contacts.above])
        along = np.concatenate([contacts.below_at, contacts.above_at])
        new = np.flatnonzero(along > 0)
        edges, count = vertices[new], len(self.points)
        vertices[new] = count + np.arange(len(new))
        of_contacts = new % max(len(contacts.points), 1)  # both sides have got all of them
        added = np.column_stack([contacts.points[of_contacts], self.points[edges, 2]])
        places = np.lexsort([along[new], edges])
        slabs = np.empty(len(pieces.knots), dtype=np.int64)
        slabs[pieces.knots] = pieces.slabs
        ends = self.ends.copy()
        ends[1:] += np.cumsum(np.bincount(edges, minlength=count))
        divided = replace(
            self,
            points=np.concatenate([self.points, added]),
            owners=slabs[contacts.groups[of_contacts]],
            order=np.insert(self.order, edges[places] + 1, count + places),
            ends=ends,
        )
        return divided, vertices.reshape(2, -1).T

    def knots(self, pieces: _Pieces, links: NDArray[np.int64]) -> Knots:
        """Return pieces with the vertices inserted into their contours."""
        contours, owners = pieces.contours()
        vertices, first = self.around(contours)
        slabs = np.repeat(pieces.slabs[owners], counts_of(first))
        inserted = np.flatnonzero(vertices >= len(self.corners.points))
        is_own = np.ones(len(vertices), dtype=bool)
        is_own[inserted] = (
            self.owners[vertices[inserted] - len(self.corners.points)] == slabs[inserted]
        )
        return Knots(vertices, is_own, first, owners, pieces.knots, pieces.is_above, links)

    def around(self, contours: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the vertices around contours, and where those of each begin and the last end."""
        starts, stops = self.ends[self.corners.first[[contours, contours + 1]]]
        return self.order[runs(starts, stops - starts)], ends_of(stops - starts)


def _bands(
    contours: _Contours, slabs: Sequence[Slab]
) -> tuple[Bands, NDArray[np.bool_], _Pieces, _Pieces]:
    """Join the contours that match one to one.

    Returns
    -------
    bands : Bands
        Between the contours.
    is_sound : array of bool
        Which of them are joined well, with all others of their pieces.
    joins, alone : _Pieces
        The pieces that are left: knots, and pairs of pieces that are poorly joined so; and knots
        that end below or above their slab.
    """
    owners = [(index, *match) for index, slab in enumerate(slabs) for match in slab.pairs.items()]
    owner_of = np.repeat(np.arange(len(owners)), [len(pairs) for _, _, pairs in owners])
    local = chain.from_iterable(chain.from_iterable(pairs) for _, _, pairs in owners)
    slab_of = np.array([index for index, _, _ in owners], dtype=np.int64)[owner_of]
    pairs = np.fromiter(local, dtype=np.int64, count=2 * len(owner_of)).reshape(-1, 2)
    pairs += contours.pieces[contours.layers[np.column_stack([slab_of, slab_of + 1])]]
    bands = walk_bands(contours.corners, pairs)
    is_poor = np.bincount(owner_of[bands.is_poor], minlength=len(owners)) > 0
    knots = [(index, knot) for index, slab in enumerate(slabs) for knot in slab.knots]
    joins = [knot for knot in knots if all(knot[1])]
    for poor in np.flatnonzero(is_poor).tolist():
        index, (low, high), _ = owners[poor]
        joins.append((index, ([low], [high])))
    alone = [knot for knot in knots if not all(knot[1])]
    return bands, ~is_poor[owner_of], contours.knotted(joins), contours.knotted(alone)


def _caps(contours: _Contours, pieces: _Pieces) -> NDArray[np.int64]:
    """Close each piece by itself."""
    numbers, _ = pieces.contours()
    vertices, ends = contours.around(numbers)
    first = ends_of(np.diff(pieces.ends)[:, 0])
    return cap(contours.points, vertices, ends, first, ~pieces.is_above)
