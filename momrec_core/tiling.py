"""Layers of polygons joined into one closed surface (Fig. 6b of the paper)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from momrec_core.knots import Knots, cap, join_knots
from momrec_core.layers import Layer, Slab, pieces_of_layers
from momrec_core.manifolds import double_shared_edges
from momrec_core.noding import Edges, find_contacts
from momrec_core.rings import Rings, ends_of, number_within
from momrec_core.walking import Bands, walk_bands

__all__ = ["tile"]

_Scalar = TypeVar("_Scalar", np.float64, np.int64)


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
    bands, is_sound, groups = _bands(contours, slabs)
    joins = [group for group in groups if group.below and group.above]
    contours, links = contours.with_contacts(joins)
    joined, failed = join_knots(contours.points, contours.knots(joins, links))
    alone = [group for group in groups if not (group.below and group.above)]
    caps = _caps(contours, alone + [joins[index] for index in failed.tolist()])
    others = np.concatenate([joined, caps])
    triangles = bands.triangles(is_sound, contours.order, contours.ends, others)
    return double_shared_edges(contours.points, triangles, sound=len(triangles) - len(others))


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


@dataclass(frozen=True, eq=False)
class _Contours:
    """The contours of all layers, with the vertices that their neighbours need on them.

    Attributes
    ----------
    corners : Rings
        The contours as they are cut, shape (n, 3).
    base : array of int, shape (layers + 1,)
        The first contour of each layer, and the number of contours.
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
    base: NDArray[np.int64]
    points: NDArray[np.float64]
    owners: NDArray[np.int64]
    order: NDArray[np.int64]
    ends: NDArray[np.int64]

    @classmethod
    def of_layers(cls, layers: Sequence[Layer]) -> _Contours:
        pieces, starts = pieces_of_layers(layers)
        numbers = np.array([len(layer) for layer in layers], dtype=np.int64)
        contours = pieces.first[np.column_stack([starts, starts + numbers])]
        vertices = pieces.rings.first[contours]
        heights = np.repeat([layer.offset for layer in layers], np.diff(vertices)[:, 0])
        points = np.column_stack([_spans(pieces.rings.points, vertices), heights])
        corners = Rings(points, ends_of(_spans(pieces.rings.counts, contours)))
        base, owners = ends_of(np.diff(contours)[:, 0]), np.empty(0, dtype=np.int64)
        return cls(
            corners, base, points, owners, np.arange(len(points)), np.arange(len(points) + 1)
        )

    def with_contacts(self, groups: Sequence[_Group]) -> tuple[_Contours, NDArray[np.int64]]:
        """Put vertices where the pieces below and above touch or cross.

        Returns
        -------
        contours : _Contours
            These corners, and vertices on their edges.
        links : array of int, shape (n, 2)
            The vertices below and above that lie upon each other.
        """
        low, below = self._edges_of([group.below for group in groups])
        high, above = self._edges_of([group.above for group in groups])
        contacts = find_contacts(below, above)
        vertices = np.concatenate([low[contacts.below], high[contacts.above]])
        along = np.concatenate([contacts.below_at, contacts.above_at])
        new = np.flatnonzero(along > 0)
        edges, count = vertices[new], len(self.points)
        vertices[new] = count + np.arange(len(new))
        of_contacts = new % max(len(contacts.points), 1)  # both sides have got all of them
        added = np.column_stack([contacts.points[of_contacts], self.points[edges, 2]])
        slabs = np.array([group.slab for group in groups], dtype=np.int64)
        places = np.lexsort([along[new], edges])
        divided = replace(
            self,
            points=np.concatenate([self.points, added]),
            owners=slabs[below.groups[contacts.below[of_contacts]]],
            order=np.insert(self.order, edges[places] + 1, count + places),
            ends=self.ends + np.searchsorted(edges[places], np.arange(count + 1)),
        )
        return divided, vertices.reshape(2, -1).T

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
        vertices, first = self.around(_flat(pieces))
        piece_of = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
        slabs = np.array([group.slab for group in groups])[sides[piece_of] // 2]
        slabs = np.repeat(slabs, np.diff(first))
        inserted = np.flatnonzero(vertices >= len(self.corners.points))
        is_own = np.ones(len(vertices), dtype=bool)
        is_own[inserted] = (
            self.owners[vertices[inserted] - len(self.corners.points)] == slabs[inserted]
        )
        return Knots(vertices, is_own, first, piece_of, sides // 2, sides % 2 == 1, links)

    def around(self, contours: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the vertices around contours, and where those of each begin and the last end."""
        starts, stops = self.ends[self.corners.first[[contours, contours + 1]]]
        numbers, positions = number_within(stops - starts)
        return self.order[starts[numbers] + positions], ends_of(stops - starts)


def _bands(
    contours: _Contours, slabs: Sequence[Slab]
) -> tuple[Bands, NDArray[np.bool_], list[_Group]]:
    """Join the contours that match one to one.

    Returns
    -------
    bands : Bands
        Between the contours.
    is_sound : array of bool
        Which of them are joined well, with all others of their pieces.
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
    base = contours.base.tolist()
    return bands, ~is_poor[owner_of], [_group(slabs, base, *it) for it in groups]


def _group(
    slabs: Sequence[Slab], base: list[int], index: int, pieces: tuple[list[int], list[int]]
) -> _Group:
    """Return pieces below and above a slab as a group."""
    layers = slabs[index].below, slabs[index].above
    below, above = (
        [range(first + own.start, first + own.stop) for own in map(layer.contours, chosen)]
        for layer, first, chosen in zip(layers, base[index : index + 2], pieces, strict=True)
    )
    return _Group(index, below, above)


def _caps(contours: _Contours, groups: Iterable[_Group]) -> NDArray[np.int64]:
    """Close each piece by itself."""
    pieces = [
        (piece, is_below)
        for group in groups
        for side, is_below in ((group.below, True), (group.above, False))
        for piece in side
    ]
    vertices, ends = contours.around(_flat(piece for piece, _ in pieces))
    first = ends_of(np.array([len(piece) for piece, _ in pieces], dtype=np.int64))
    faces_up = np.array([is_below for _, is_below in pieces], dtype=bool)
    return cap(contours.points, vertices, ends, first, faces_up)


def _flat(ranges: Iterable[range]) -> NDArray[np.int64]:
    return np.fromiter(chain.from_iterable(ranges), dtype=np.int64)


def _spans(values: NDArray[_Scalar], spans: NDArray[np.int64]) -> NDArray[_Scalar]:
    """Return parts of an array, from one place to another each, one behind the other."""
    return np.concatenate([values[low:high] for low, high in spans.tolist()])
