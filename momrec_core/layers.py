"""Cross-sections as polygons, and which pieces of adjacent ones belong together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from momrec_core._matching import match
from momrec_core.regions import CLEARANCE, Footprints, Regions
from momrec_core.rings import counts_of, ends_of, runs

__all__ = [
    "Layers",
    "Slabs",
    "as_knots",
    "layers_of_sections",
    "match_layers",
    "without_flakes",
    "without_needless",
]

CLEANING = 0.1  # units: what stands out less is noise or rounding, and float32 keeps the rest
MIN_AREA_RATIO = 0.4  # of two matching pieces, below which one contour is no image of the other
LEAST_WIDTH = 0.5  # of a piece's box, in x or y, that the matching piece's box has too
STEEPEST = 20.0  # shift over height of a slanted body that is followed between layers: 87 degrees
FEW_PAIRS = 4096  # of pieces: above, a tree of boxes finds candidates faster than trying all
LEDGE = 0.1  # of the largest section: a change in area between adjacent layers worth locating


@dataclass(frozen=True, eq=False)
class Layers:
    """Cross-sections at several offsets.

    Attributes
    ----------
    offsets : array, shape (n,)
        Along the planes' normal, in units.
    areas : array, shape (n,)
        In squared units.
    spans : array of int, shape (n, 3)
        Where each one's pieces are: batch, number of the first, count.
    batches : tuple of Regions
        The pieces, in units, and maybe those of other layers; of each the shell,
        counter-clockwise, then the holes, clockwise.
    """

    offsets: NDArray[np.float64]
    areas: NDArray[np.float64]
    spans: NDArray[np.int64]
    batches: tuple[Regions, ...]

    @classmethod
    def of_pieces(
        cls, offsets: NDArray[np.float64], pieces: Regions, ends: NDArray[np.int64]
    ) -> Layers:
        """Return layers of pieces that stand one behind the other, and end so."""
        counts = counts_of(ends)
        owners = np.repeat(np.arange(len(counts)), counts)
        areas = np.bincount(owners, pieces.areas, len(counts)).astype(np.float64, copy=False)
        spans = np.zeros((len(counts), 3), dtype=np.int64)
        spans[:, 1], spans[:, 2] = ends[:-1], counts
        return cls(offsets, areas, spans, (pieces,))

    def __len__(self) -> int:
        return len(self.offsets)

    @property
    def counts(self) -> NDArray[np.int64]:
        """How many pieces each layer has."""
        return self.spans[:, 2]

    @cached_property
    def pieces(self) -> Regions:
        """The pieces of all batches."""
        return Regions.joined(self.batches)

    @cached_property
    def first(self) -> NDArray[np.int64]:
        """Where among all pieces each layer's begin."""
        starts = ends_of(np.array([len(batch) for batch in self.batches]))
        return np.asarray(starts[self.spans[:, 0]] + self.spans[:, 1])

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """The layers by increasing offset."""
        return np.argsort(self.offsets)

    @property
    def adjacent(self) -> NDArray[np.int64]:
        """The layers without any between them, below and above, in order; shape (n - 1, 2)."""
        return np.column_stack([self.order[:-1], self.order[1:]])

    def boxes(self, layer: int) -> NDArray[np.float64]:
        """Return the boxes of a layer's pieces, shape (n, 4); see `Regions`."""
        batch, first, count = self.spans[layer].tolist()
        return np.asarray(self.batches[batch].boxes[first : first + count])

    def take(self, chosen: NDArray[np.int64]) -> Layers:
        """Return some of the layers, in any order."""
        return Layers(self.offsets[chosen], self.areas[chosen], self.spans[chosen], self.batches)

    def joined(self, others: Layers) -> Layers:
        """Return these layers and then others."""
        return Layers(
            np.concatenate([self.offsets, others.offsets]),
            np.concatenate([self.areas, others.areas]),
            np.concatenate([self.spans, others.spans + np.array([len(self.batches), 0, 0])]),
            self.batches + others.batches,
        )


def layers_of_sections(offsets: Sequence[float] | NDArray[np.float64], sections: Regions) -> Layers:
    """Take the pieces of cross-sections, cleaned of rounding.

    Parameters
    ----------
    offsets : sequence of float
        Along the planes' normal, in units.
    sections : Regions
        As many.

    Returns
    -------
    layers : Layers
    """
    return Layers.of_pieces(np.asarray(offsets), *sections.cleaned(CLEANING).apart())


@dataclass(frozen=True, eq=False)
class Slabs:
    """How the pieces of pairs of layers belong together, numbered within their layers.

    Attributes
    ----------
    layers : Layers
        The layers.
    sides : array of int, shape (n, 2)
        The layer below each slab, and the one above.
    pairs : array of int, shape (p, 6)
        Contours, shells and holes, that belong together, of pieces below and above that are each
        other's only overlap, with holes that are as well: slab, piece below, piece above,
        contour below, contour above (shell first), and how many contours both pieces have.
    knots : array of int, shape (k, 4)
        The other pieces that overlap, among them those of very different size: slab, what is the
        same number for all that hang together, side (0 below, 1 above), piece.
    alone : array of int, shape (m, 3)
        The pieces that overlap none: slab, side, piece.
    areas : array, shape (n, 3)
        Areas of all these but the pairs below, above, and of what they have in common.
    """

    layers: Layers
    sides: NDArray[np.int64]
    pairs: NDArray[np.int64]
    knots: NDArray[np.int64]
    alone: NDArray[np.int64]
    areas: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.sides)

    @cached_property
    def undivided(self) -> NDArray[np.int64]:
        """The slabs without any layer amid them, by increasing offset."""
        ranks = np.argsort(self.layers.order)
        below, above = ranks[self.sides.T]
        found = np.flatnonzero(above == below + 1)
        return found[np.argsort(below[found])]

    @property
    def heights(self) -> NDArray[np.float64]:
        """Distance between the layers of each slab, in units."""
        low, high = self.layers.offsets[self.sides.T]
        heights: NDArray[np.float64] = high - low
        return heights

    def changes(self, largest: float) -> NDArray[np.bool_]:
        """Tell of each slab whether pieces change, or the area by a ledge; see `doubts`."""
        changes = self._ledges(largest) > 0
        changes[self.knots[:, 0]] = True
        changes[self.alone[:, 0]] = True
        return changes

    def doubts(self, largest: float) -> NDArray[np.float64]:
        """Return the volumes, in cubed units, that pieces which change and ledges leave open.

        Parameters
        ----------
        largest : float
            Area of the largest section, in squared units, that ledges are compared with.
        """
        below, above, common = self.areas.T
        doubts: NDArray[np.float64] = below + above - 2 * common + self._ledges(largest)
        return doubts * self.heights

    def _ledges(self, largest: float) -> NDArray[np.float64]:
        """Return the changes in area from layer to layer where they are worth locating."""
        low, high = self.layers.areas[self.sides.T]
        steps = np.abs(high - low)
        return np.where(steps > LEDGE * largest, steps, 0.0)

    def take(self, chosen: NDArray[np.int64]) -> Slabs:
        """Return some of the slabs, in any order."""
        places = np.full(len(self), -1)
        places[chosen] = np.arange(len(chosen))
        return replace(
            self,
            sides=self.sides[chosen],
            pairs=_of_slabs(self.pairs, places),
            knots=_of_slabs(self.knots, places),
            alone=_of_slabs(self.alone, places),
            areas=self.areas[chosen],
        )

    @classmethod
    def joined(cls, parts: Sequence[Slabs]) -> Slabs:
        """Put slabs one behind the other; the last ones' layers are those of all, or more."""
        starts = ends_of(np.array([len(part) for part in parts]))
        return cls(
            parts[-1].layers,
            np.concatenate([part.sides for part in parts]),
            _joined([part.pairs for part in parts], starts),
            _joined([part.knots for part in parts], starts),
            _joined([part.alone for part in parts], starts),
            np.concatenate([part.areas for part in parts]),
        )

    def halved(
        self, chosen: NDArray[np.int64], cut: Callable[[NDArray[np.float64]], Regions]
    ) -> Slabs:
        """Return both halves of some of the slabs, with a layer between them.

        Parameters
        ----------
        chosen : array of int
            The slabs.
        cut : function
            Returns the sections at some offsets.
        """
        below, above = self.sides[chosen].T
        middles = self.layers.offsets[below] + self.heights[chosen] / 2
        layers = self.layers.joined(layers_of_sections(middles, cut(middles)))
        new = np.arange(len(self.layers), len(layers))
        return match_layers(layers, np.stack([below, new, new, above], axis=1).reshape(-1, 2))


def _of_slabs(rows: NDArray[np.int64], places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows of slabs that have got a place, in the order of these."""
    slabs = places[rows[:, 0]]
    order = np.argsort(slabs, kind="stable")[np.count_nonzero(slabs < 0) :]
    chosen = rows[order]
    chosen[:, 0] = slabs[order]
    return chosen


def _joined(tables: Sequence[NDArray[np.int64]], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Put rows of slabs one behind the other, the slabs as well."""
    rows = np.concatenate(tables)
    rows[:, 0] += np.repeat(starts[:-1], [len(table) for table in tables])
    return rows


def match_layers(layers: Layers, sides: NDArray[np.int64]) -> Slabs:
    """Group the pieces of layers, below and above slabs, by overlap.

    Parameters
    ----------
    layers : Layers
        The layers.
    sides : array of int, shape (n, 2)
        The layer below each slab, and the one above.

    Returns
    -------
    slabs : Slabs
    """
    return _bridged(_with_holes(_matched(layers, sides, MIN_AREA_RATIO, LEAST_WIDTH)))


def _matched(
    layers: Layers, sides: NDArray[np.int64], area_ratio: float, width_ratio: float
) -> Slabs:
    """Match pieces by overlap, whatever holes they have.

    Parameters
    ----------
    layers : Layers
        The layers.
    sides : array of int, shape (n, 2)
        Those below and above the slabs.
    area_ratio, width_ratio : float
        How much smaller, or narrower in x or y, a piece may be than one that is its image.
    """
    below, above = layers.counts[sides.T]
    crowded = np.flatnonzero(below * above > FEW_PAIRS)

    def common_area(slab: int, low: int, high: int) -> float:
        both = layers.pieces.take(layers.first[sides[slab]] + (low, high))
        return float(Regions.of_sections([both.section(0) ^ both.section(1)]).areas[0])

    pairs, knots, alone, areas = match(
        layers.spans[sides].reshape(-1, 3),
        _candidates(layers, sides, crowded),
        tuple((*batch.arrays, batch.areas, batch.boxes) for batch in layers.batches),
        common_area,
        FEW_PAIRS,
        area_ratio,
        width_ratio,
        CLEARANCE,
    )
    return Slabs(
        layers,
        sides,
        np.frombuffer(pairs, dtype=np.int64).reshape(-1, 6),
        np.frombuffer(knots, dtype=np.int64).reshape(-1, 4),
        np.frombuffer(alone, dtype=np.int64).reshape(-1, 3),
        np.frombuffer(areas).reshape(-1, 3),
    )


def _candidates(
    layers: Layers, sides: NDArray[np.int64], chosen: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the pieces of some of the slabs whose boxes meet.

    Returns
    -------
    candidates : array of int, shape (n, 3)
        Slab, and the pieces' numbers in the layers below and above.
    """
    found = [np.empty((0, 3), dtype=np.int64)]
    for slab in chosen.tolist():
        low, high = (shapely.box(*layers.boxes(layer).T) for layer in sides[slab].tolist())
        places = shapely.STRtree(high).query(low).T
        found.append(np.column_stack([np.full(len(places), slab), places]))
    return np.concatenate(found)


def _with_holes(slabs: Slabs) -> Slabs:
    """Match the holes of pairs of pieces by overlap; make knots where that isn't one to one."""
    places = np.flatnonzero(slabs.pairs[:, 5] > 1)
    if not len(places):
        return slabs
    pairs, pieces = slabs.pairs[places], slabs.layers.pieces
    first = pieces.first[slabs.layers.first[slabs.sides[pairs[:, 0]]]] + pairs[:, 3:5]
    counts = np.repeat(pairs[:, 5] - 1, 2)
    rings = [[pieces.rings.loop(hole)[::-1]] for hole in runs(first.ravel() + 1, counts).tolist()]
    layers = Layers.of_pieces(np.zeros(len(counts)), Regions.of_rings(rings), ends_of(counts))
    matches = _matched(layers, np.arange(len(counts)).reshape(-1, 2), 0.0, 0.0)
    owners = matches.pairs[:, 0]
    holes = pairs[owners]
    holes[:, 3:5] += 1 + matches.pairs[:, 1:3]
    rows = np.concatenate([slabs.pairs, holes])
    ranks = np.concatenate([np.arange(len(slabs.pairs)), places[owners]])
    order = np.argsort(ranks, kind="stable")
    tied = np.union1d(matches.knots[:, 0], matches.alone[:, 0])
    order = order[~np.isin(ranks[order], places[tied])]
    return _tied(replace(slabs, pairs=rows[order]), pairs[tied])


def _tied(slabs: Slabs, pairs: NDArray[np.int64]) -> Slabs:
    """Make knots of pairs."""
    numbers = slabs.layers.first[slabs.sides[pairs[:, 0]]] + pairs[:, 1:3]
    below, above = (slabs.layers.pieces.take(side) for side in numbers.T)
    common = below.clipped([Footprints.as_they_are(above)])
    areas = slabs.areas.copy()
    np.add.at(areas, pairs[:, 0], np.column_stack([below.areas, above.areas, common.areas]))
    return replace(slabs, knots=np.concatenate([slabs.knots, as_knots(pairs)]), areas=areas)


def as_knots(pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return pairs of pieces, one row each, as knots; see `Slabs`."""
    slabs, low = pairs[:, :2].repeat(2, axis=0).T
    sides = np.arange(2 * len(pairs)) % 2
    return np.column_stack([slabs, low, sides, pairs[:, 1:3].ravel()])


def _bridged(slabs: Slabs) -> Slabs:
    """Pair pieces that overlap none but lie where a slanted body would have moved from the other.

    Each is the other's nearest, of similar size and without holes.
    """
    owners, sides, places = slabs.alone.T
    are_met = np.zeros((2, len(slabs)), dtype=bool)
    are_met[sides, owners] = True
    meeting = np.flatnonzero(are_met[0] & are_met[1])
    if not len(meeting):
        return slabs
    layers = slabs.layers
    of_layers = layers.first[slabs.sides[owners, sides]]
    pieces = layers.pieces.take(of_layers + places)
    reach = STEEPEST * slabs.heights
    found = []
    for slab in meeting.tolist():
        low, high = (np.flatnonzero((owners == slab) & (sides == side)) for side in (0, 1))
        found.append(_bridges(pieces, low, high, reach[slab]))
    low, high = np.concatenate(found, axis=1)
    contours = layers.pieces.first[of_layers + places] - layers.pieces.first[of_layers]
    columns = owners[low], places[low], places[high], contours[low], contours[high]
    pairs = np.column_stack([*columns, np.ones(len(low), dtype=np.int64)])
    areas = slabs.areas.copy()
    ends = np.concatenate([low, high])
    np.subtract.at(areas, (owners[ends], sides[ends]), pieces.areas[ends])
    return replace(
        slabs,
        pairs=np.concatenate([slabs.pairs, pairs]),
        alone=np.delete(slabs.alone, ends, axis=0),
        areas=areas,
    )


def _bridges(
    pieces: Regions, low: NDArray[np.int64], high: NDArray[np.int64], reach: float
) -> NDArray[np.int64]:
    """Return which of some pieces below belong to which above, shape (2, n); see `_bridged`."""
    distances = cdist(pieces.centroids[low], pieces.centroids[high])
    rows, columns = np.arange(len(low)), distances.argmin(axis=1)
    nearest = high[columns]
    ratios = pieces.areas[low] / pieces.areas[nearest]
    contours = counts_of(pieces.first)
    are_paired = (
        (distances.argmin(axis=0)[columns] == rows)
        & (distances[rows, columns] < reach)
        & (ratios > MIN_AREA_RATIO)
        & (ratios < 1 / MIN_AREA_RATIO)
        & (contours[low] == 1)
        & (contours[nearest] == 1)
    )
    return np.stack([low[are_paired], nearest[are_paired]])


def without_flakes(slabs: Slabs) -> Slabs:
    """Leave out the pieces that meet none of the layer below or above, and so have no volume.

    Parameters
    ----------
    slabs : Slabs
        Those undivided decide.

    Returns
    -------
    slabs : Slabs
        The same, but if there were such pieces, without those that are divided.
    """
    layers, chosen = slabs.layers, slabs.undivided
    is_undivided = np.zeros(len(slabs), dtype=bool)
    is_undivided[chosen] = True
    owners, sides, places = slabs.alone[is_undivided[slabs.alone[:, 0]]].T
    numbers = layers.first[slabs.sides[owners, sides]] + places
    flakes = np.flatnonzero(np.bincount(numbers) == 2)  # below a slab and above one
    if not len(flakes):
        return slabs
    pieces = runs(layers.first, layers.counts)
    is_kept = ~np.isin(pieces, flakes)
    ends = ends_of(is_kept.astype(np.int64))[ends_of(layers.counts)]
    layers = Layers.of_pieces(layers.offsets, layers.pieces.take(pieces[is_kept]), ends)
    sides, changed = slabs.sides[chosen], np.flatnonzero(layers.counts < slabs.layers.counts)
    has_changed = np.isin(sides, changed).any(axis=1)
    others = replace(slabs, layers=layers).take(chosen[~has_changed])
    return Slabs.joined([others, match_layers(layers, sides[has_changed])])


def without_needless(slabs: Slabs, wanted: int, doubtful_volume: float) -> Slabs:
    """Leave out layers that only served the search for places where pieces split or end.

    Parameters
    ----------
    slabs : Slabs
        Among them the undivided ones.
    wanted : int
        So many of the layers, the first ones, are kept in any case.
    doubtful_volume : float
        What a slab may leave open, in cubed units.

    Returns
    -------
    slabs : Slabs
        By increasing offset, between the layers wanted, those on both sides of an event or a
        ledge, and those without which there were more of them.
    """
    layers, chosen = slabs.layers.order, slabs.undivided
    largest = float(slabs.layers.areas.max())
    changes = slabs.changes(largest)[chosen]
    kept = layers < wanted
    kept[:-1] |= changes
    kept[1:] |= changes
    gaps = _gaps(np.flatnonzero(kept))
    bridges = match_layers(slabs.layers, layers[gaps])
    is_open = bridges.doubts(largest) > doubtful_volume
    for low, high in gaps[is_open].tolist():
        kept[low:high] = True
    places = np.flatnonzero(kept)
    chosen = chosen[places[:-1]]
    chosen[counts_of(places) > 1] = len(slabs) + np.flatnonzero(~is_open)
    return Slabs.joined([slabs, bridges]).take(chosen)


def _gaps(places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places before and after each gap between increasing places, shape (n, 2)."""
    return np.column_stack([places[:-1], places[1:]])[counts_of(places) > 1]
