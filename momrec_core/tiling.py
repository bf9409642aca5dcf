"""Layers of polygons joined into one closed surface (Fig. 6b of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from momrec_core.knots import Knot, KnotError, cap, join_knot
from momrec_core.layers import Layer, Slab, hole_pairs, match_layers
from momrec_core.manifolds import double_shared_edges
from momrec_core.noding import Edges, find_contacts
from momrec_core.rings import Rings
from momrec_core.walking import walk_bands

__all__ = ["tile"]

CORNER = -1  # owner of the vertices that a contour has of itself


def tile(layers: Sequence[Layer]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Join cross-sections into a closed surface.

    Between two layers, pieces that are each other's only overlap are joined contour by contour
    along the shortest diagonals; where pieces or holes split, join, appear or vanish the contours
    are joined as they lie over each other. What ends at a layer is capped there.

    Parameters
    ----------
    layers : sequence of Layer
        By increasing offset; empty ones at both ends close the surface.

    Returns
    -------
    vertices : array, shape (n, 3)
        In the planes' frame, in the layers' units.
    triangles : array of int, shape (m, 3)
        Closed, edge-manifold, facing outward.
    """
    contours = _Contours.of_layers(layers)
    slabs = match_layers(list(pairwise(layers)))
    bands = _bands(contours, layers, slabs)
    links = {
        (index, number): contours.insert_contacts(index, low, high)
        for index, slab in enumerate(slabs)
        for number, (low, high) in enumerate(slab.knots)
        if low and high
    }
    contours.settle()
    rings = contours.rings()
    triangles = [_divided(contours, bands)]
    for (index, number), linked in links.items():
        low, high = slabs[index].knots[number]
        knot = Knot(
            [[rings[ring] for ring in contours.pieces[index][piece]] for piece in low],
            [[rings[ring] for ring in contours.pieces[index + 1][piece]] for piece in high],
            linked,
        )
        triangles.append(_joined(contours, knot, index))
    triangles.extend(_caps(contours, rings, slabs))
    return double_shared_edges(contours.points, np.concatenate(triangles))


@dataclass(eq=False)
class _Contours:
    """The contours of all layers, with the vertices that their neighbours need on them.

    Attributes
    ----------
    points : array, shape (n, 3)
        The contours' own corners, contour by contour, then the inserted vertices.
    edges : array of int, shape (n,)
        The edge that a vertex lies on, numbered as the corner that it starts from.
    along : array, shape (n,)
        Where on that edge, 0 to 1; 0 for corners.
    owners : array of int, shape (n,)
        The slab that a vertex was inserted for, or `CORNER`.
    first : array of int, shape (number of contours + 1,)
        The first corner of each contour.
    pieces : list of list of list of int
        Per layer and piece the contours: shell, then holes.
    count : int
        Number of vertices, with those in `added`.
    order : array of int, shape (n,)
        The vertices contour by contour, in their order around it.
    added : list of (points, edges, along, owners)
        The vertices that `settle` has yet to take in.
    """

    points: NDArray[np.float64]
    edges: NDArray[np.int64]
    along: NDArray[np.float64]
    owners: NDArray[np.int64]
    first: NDArray[np.int64]
    pieces: list[list[list[int]]]
    count: int
    order: NDArray[np.int64]
    added: list[tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]]

    @classmethod
    def of_layers(cls, layers: Sequence[Layer]) -> _Contours:
        loops: list[NDArray[np.float64]] = []
        pieces: list[list[list[int]]] = []
        for layer in layers:
            pieces.append([])
            for piece in layer.pieces:
                rings = [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(piece)]
                pieces[-1].append(list(range(len(loops), len(loops) + len(rings))))
                loops.extend(np.c_[ring, np.full(len(ring), layer.offset)] for ring in rings)
        points = np.concatenate(loops)
        first = np.cumsum([0, *(len(loop) for loop in loops)])
        count = len(points)
        owners = np.full(count, CORNER)
        corners = np.arange(count)
        return cls(points, corners, np.zeros(count), owners, first, pieces, count, corners, [])

    def insert_contacts(self, slab: int, low: list[int], high: list[int]) -> NDArray[np.int64]:
        """Put vertices where pieces below and above a slab touch or cross.

        Returns
        -------
        links : array of int, shape (n, 2)
            The vertices below and above that lie upon each other.
        """
        below = self.corners([ring for piece in low for ring in self.pieces[slab][piece]])
        above = self.corners([ring for piece in high for ring in self.pieces[slab + 1][piece]])
        contacts = find_contacts(self._edges_of(below), self._edges_of(above))
        sides = (
            (np.concatenate(below)[contacts.below], contacts.below_at),
            (np.concatenate(above)[contacts.above], contacts.above_at),
        )
        return np.column_stack([self._insert(*side, contacts.points, slab) for side in sides])

    def corners(self, rings: list[int]) -> list[NDArray[np.int64]]:
        """Return the corners around contours."""
        return [np.arange(self.first[ring], self.first[ring + 1]) for ring in rings]

    def _edges_of(self, corners: list[NDArray[np.int64]]) -> Edges:
        return Edges.of_rings([self.points[ring, :2] for ring in corners])

    def _insert(
        self,
        edges: NDArray[np.int64],
        along: NDArray[np.float64],
        points: NDArray[np.float64],
        slab: int,
    ) -> NDArray[np.int64]:
        """Return the vertices at places on edges, new ones where there is no corner."""
        new = np.flatnonzero(along > 0)
        vertices = edges.copy()
        vertices[new] = self.count + np.arange(len(new))
        self.count += len(new)
        added = np.c_[points[new], self.points[edges[new], 2]]
        self.added.append((added, edges[new], along[new], np.full(len(new), slab)))
        return vertices

    def settle(self) -> None:
        """Take in the inserted vertices."""
        columns = (self.points, self.edges, self.along, self.owners)
        self.points, self.edges, self.along, self.owners = (
            np.concatenate(parts) for parts in zip(columns, *self.added, strict=True)
        )
        self.added.clear()
        self.order = np.lexsort([self.along, self.edges])

    def rings(self) -> list[NDArray[np.int64]]:
        """Return the vertices around each contour, the inserted ones in their places."""
        ends = np.searchsorted(self.edges[self.order], self.first)
        return [self.order[start:end] for start, end in pairwise(ends)]

    def on_edge(self, edge: int) -> NDArray[np.int64]:
        """Return the vertices on an edge in order, from its first corner."""
        start, end = np.searchsorted(self.edges[self.order], [edge, edge + 1])
        return self.order[start:end]


def _bands(
    contours: _Contours, layers: Sequence[Layer], slabs: Sequence[Slab]
) -> NDArray[np.int64]:
    """Join the contours that match one to one.

    Pairs of pieces that are poorly joined so are made knots of their slab.

    Returns
    -------
    triangles : array of int, shape (m, 3)
        As in `Bands`, between the contours' own corners.
    """
    owners: list[tuple[int, tuple[int, int]]] = []
    pairs: list[tuple[int, int]] = []
    for index, slab in enumerate(slabs):
        for low, high in slab.pairs:
            holes = hole_pairs(layers[index].pieces[low], layers[index + 1].pieces[high]) or []
            for first, second in [(0, 0), *((a + 1, b + 1) for a, b in holes)]:
                owners.append((index, (low, high)))
                below, above = contours.pieces[index][low], contours.pieces[index + 1][high]
                pairs.append((below[first], above[second]))
    rings = Rings(contours.points, contours.first)
    bands = walk_bands(rings, np.array(pairs, dtype=np.int64).reshape(-1, 2))
    poor = {owners[band] for band in np.flatnonzero(bands.is_poor)}
    for index, (low, high) in poor:
        slabs[index].pairs.remove((low, high))
        slabs[index].knots.append(([low], [high]))
    kept = np.array([owner not in poor for owner in owners], dtype=bool)
    return np.asarray(bands.triangles[kept[bands.bands]])


def _divided(contours: _Contours, triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Divide the triangles of bands along contours that have got vertices on their edges."""
    heights = contours.points[triangles, 2]
    runs = heights[:, 1] > heights[:, 0]
    edges = np.where(runs, triangles[:, 2], triangles[:, 0])
    inserted = np.unique(contours.edges[contours.owners != CORNER])
    touched = np.isin(edges, inserted)
    parts = [triangles[~touched]]
    for triangle, edge, is_run in zip(
        triangles[touched], edges[touched], runs[touched], strict=True
    ):
        end = triangle[1]
        chain = np.append(contours.on_edge(edge), end)
        apex = np.full(len(chain) - 1, triangle[0] if is_run else triangle[2])
        fan = (apex, chain[1:], chain[:-1]) if is_run else (chain[:-1], chain[1:], apex)
        parts.append(np.column_stack(fan))
    return np.concatenate(parts)


def _joined(contours: _Contours, knot: Knot, slab: int) -> NDArray[np.int64]:
    """Join a knot, or cap both its sides where its contacts are beyond repair."""
    is_own = (contours.owners == CORNER) | (contours.owners == slab)
    try:
        return join_knot(contours.points, knot, is_own)
    except KnotError:
        caps = [cap(contours.points, piece) for piece in knot.below]
        caps += [cap(contours.points, piece)[:, ::-1] for piece in knot.above]
        return np.concatenate(caps)


def _caps(
    contours: _Contours, rings: list[NDArray[np.int64]], slabs: Sequence[Slab]
) -> list[NDArray[np.int64]]:
    """Close the pieces that have nothing above or below them."""
    caps = []
    for index, slab in enumerate(slabs):
        for low, high in slab.knots:
            if not high:
                loops = [rings[ring] for ring in contours.pieces[index][low[0]]]
                caps.append(cap(contours.points, loops))
            elif not low:
                loops = [rings[ring] for ring in contours.pieces[index + 1][high[0]]]
                caps.append(cap(contours.points, loops)[:, ::-1])
    return caps
