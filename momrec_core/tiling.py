"""Layers of polygons joined into one closed surface (Fig. 6b of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from momrec_core.knots import Knots, cap, join_knots
from momrec_core.layers import Layers, Slabs, as_knots
from momrec_core.manifolds import double_shared_edges
from momrec_core.noding import find_contacts
from momrec_core.rings import Rings, counts_of, ends_of, runs
from momrec_core.walking import Bands, walk_bands

__all__ = ["tile"]


def tile(slabs: Slabs) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Join cross-sections into a closed surface.

    Between two layers, pieces that are each other's only overlap are joined contour by contour
    along the shortest diagonals; where pieces or holes split, join, appear or vanish the contours
    are joined as they lie over each other. What ends at a layer is capped there.

    Parameters
    ----------
    slabs : Slabs
        By increasing offset, each on the layer that the one before ends at; empty layers at both
        ends close the surface.

    Returns
    -------
    vertices : array, shape (n, 3)
        In the planes' frame, in the layers' units.
    triangles : array of int, shape (m, 3)
        Closed, edge-manifold, facing outward.
    """
    contours = _Contours.of_layers(
        slabs.layers.take(np.append(slabs.sides[:1, 0], slabs.sides[:, 1]))
    )
    bands, is_sound, joins, alone = _bands(contours, slabs)
    contours, links = contours.with_contacts(joins)
    joined, failed = join_knots(contours.points, contours.knots(joins, links))
    left = [joins[np.isin(joins.knots, failed)], alone] if len(failed) else [alone]
    others = np.concatenate([joined, *(_caps(contours, pieces) for pieces in left)])
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
    def of_layers(cls, layers: Layers) -> _Contours:
        regions = layers.pieces.take(runs(layers.first, layers.counts))
        rings, of_layers = regions.rings, ends_of(layers.counts)
        points = np.empty((len(rings.points), 3))
        points[:, :2] = rings.points
        vertices = counts_of(rings.first[regions.first[of_layers]])
        points[:, 2] = np.repeat(layers.offsets, vertices)
        return cls(
            Rings(points, rings.first),
            layers=of_layers,
            pieces=regions.first,
            points=points,
            owners=np.empty(0, dtype=np.int64),
            order=np.arange(len(points)),
            ends=np.arange(len(points) + 1),
        )

    def knotted(
        self,
        knots: NDArray[np.int64],
        slabs: NDArray[np.int64],
        sides: NDArray[np.int64],
        places: NDArray[np.int64],
    ) -> _Pieces:
        """Return pieces of knots, given their places in the layers below (0) or above (1)."""
        pieces = self.layers[slabs + sides] + places
        ends = self.pieces[np.column_stack([pieces, pieces + 1])]
        return _Pieces(knots, slabs, sides == 1, ends)

    def with_contacts(self, pieces: _Pieces) -> tuple[_Contours, NDArray[np.int64]]:
        """Put vertices where the pieces below and above touch or cross; there are none so far.

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
        ends[1:] += np.bincount(edges, minlength=count).cumsum()
        order = np.empty(count + len(new), dtype=np.int64)
        order[ends[:-1]] = self.order
        order[edges[places] + np.arange(1, len(new) + 1)] = count + places
        divided = replace(
            self,
            points=np.concatenate([self.points, added]),
            owners=slabs[contacts.groups[of_contacts]],
            order=order,
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


def _bands(contours: _Contours, slabs: Slabs) -> tuple[Bands, NDArray[np.bool_], _Pieces, _Pieces]:
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
    pairs = slabs.pairs
    owners, first = _grouped(*pairs[:, :2].T)
    layers = contours.layers[pairs[:, :1] + (0, 1)]
    bands = walk_bands(contours.corners, contours.pieces[layers] + pairs[:, 3:5])
    is_poor = np.zeros(len(first), dtype=bool)
    is_poor[owners[bands.is_poor]] = True
    knots = slabs.knots[np.lexsort([slabs.knots[:, 1], slabs.knots[:, 0]])]
    joins = np.concatenate([knots, as_knots(pairs[first[is_poor]])])
    numbers, _ = _grouped(*joins[:, :2].T)
    alone = contours.knotted(np.arange(len(slabs.alone)), *slabs.alone.T)
    return bands, ~is_poor[owners], contours.knotted(numbers, *joins[:, [0, 2, 3]].T), alone


def _grouped(
    slabs: NDArray[np.int64], numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Count equal ones that follow each other as one; return each one's, and where it begins."""
    begins = np.ones(len(slabs), dtype=bool)
    begins[1:] = (slabs[1:] != slabs[:-1]) | (numbers[1:] != numbers[:-1])
    return begins.cumsum() - 1, np.flatnonzero(begins)


def _caps(contours: _Contours, pieces: _Pieces) -> NDArray[np.int64]:
    """Close each piece by itself."""
    numbers, _ = pieces.contours()
    vertices, ends = contours.around(numbers)
    first = ends_of(np.diff(pieces.ends)[:, 0])
    return cap(contours.points, vertices, ends, first, ~pieces.is_above)
