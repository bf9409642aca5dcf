"""Cross-sections as polygons, and which pieces of adjacent ones belong together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise, repeat
from operator import attrgetter

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from momrec_core._matching import match
from momrec_core.regions import CLEARANCE, Footprints, Regions
from momrec_core.rings import Rings, counts_of, ends_of

__all__ = [
    "Layer",
    "Slab",
    "Slabs",
    "in_order",
    "layers_of_sections",
    "pieces_of_layers",
    "without_flakes",
    "without_needless",
]

CLEANING = 0.1  # units: what stands out less is noise or rounding, and float32 keeps the rest
MIN_AREA_RATIO = 0.4  # of two matching pieces, below which one contour is no image of the other
MAX_AREA_RATIO = 1 / MIN_AREA_RATIO
LEAST_WIDTH = 0.5  # of a piece's box, in x or y, that the matching piece's box has too
STEEPEST = 20.0  # shift over height of a slanted body that is followed between layers: 87 degrees
FEW_PAIRS = 4096  # of pieces: above, a tree of boxes finds candidates faster than trying all
LEDGE = 0.1  # of the largest section: a change in area between adjacent layers worth locating


@dataclass(eq=False)  # not frozen: there are so many that it would be felt
class Layer:
    """The cross-section at one offset.

    Attributes
    ----------
    offset : float
        Along the planes' normal, in units.
    batch : Regions
        The pieces of several layers, in units; of each the shell, counter-clockwise, then the
        holes, clockwise.
    low, high : int
        Which of them are this layer's.
    area : float
        Area of these, in squared units.
    """

    offset: float
    batch: Regions
    low: int
    high: int
    area: float

    def __len__(self) -> int:
        return self.high - self.low

    @cached_property
    def pieces(self) -> Regions:
        """The layer's own pieces."""
        return self.batch.part(self.low, self.high)

    @property
    def rings(self) -> Rings:
        """The contours of all pieces, piece by piece."""
        return self.pieces.rings

    @property
    def areas(self) -> NDArray[np.float64]:
        """The pieces' areas, in squared units."""
        return self.batch.areas[self.low : self.high]

    @property
    def boxes(self) -> NDArray[np.float64]:
        """The pieces' boxes, shape (n, 4); see `Regions`."""
        return self.batch.boxes[self.low : self.high]

    def contours(self, piece: int) -> range:
        """Return the numbers of a piece's contours: its shell, then its holes."""
        begins, at = self.batch.begins, self.low + piece
        return range(begins[at] - begins[self.low], begins[at + 1] - begins[self.low])

    def centroids(self, pieces: Sequence[int]) -> NDArray[np.float64]:
        """Return the centroids of some pieces' shells."""
        return np.asarray(self.batch.centroids[self.low + np.array(pieces)])

    def alone(self, piece: int) -> Regions:
        """Return one of the pieces."""
        return self.batch.part(self.low + piece, self.low + piece + 1)

    def only(self, pieces: Sequence[int]) -> Layer:
        """Return a layer of some of the pieces."""
        chosen = self.pieces.take(np.array(pieces, dtype=np.int64))
        return Layer(self.offset, chosen, 0, len(chosen), float(chosen.areas.sum()))


def layers_of_sections(
    offsets: Sequence[float] | NDArray[np.float64], sections: Regions
) -> list[Layer]:
    """Take the pieces of cross-sections, cleaned of rounding.

    Parameters
    ----------
    offsets : sequence of float
        Along the planes' normal, in units.
    sections : Regions
        As many.

    Returns
    -------
    layers : list of Layer
    """
    pieces, ends = sections.cleaned(CLEANING).apart()
    return _layers_of(offsets, pieces, ends)


def _layers_of(
    offsets: Sequence[float] | NDArray[np.float64], pieces: Regions, ends: NDArray[np.int64]
) -> list[Layer]:
    """Return layers of pieces that stand one behind the other, and end so."""
    owners = np.repeat(np.arange(len(offsets)), counts_of(ends))
    areas = np.bincount(owners, pieces.areas, len(offsets))
    columns = np.asarray(offsets).tolist(), repeat(pieces), ends[:-1].tolist(), ends[1:].tolist()
    return list(map(Layer, *columns, areas.tolist()))


def in_order(layers: Iterable[Layer]) -> list[Layer]:
    """Return layers by increasing offset."""
    return sorted(layers, key=attrgetter("offset"))


@dataclass(eq=False)
class Slab:
    """How the pieces of two adjacent layers belong together.

    Attributes
    ----------
    below, above : Layer
        The layers.
    pairs : dict of (int, int) to list of (int, int)
        Pieces below and above that are each other's only overlap, with holes that are as well;
        and their contours, shells and holes, that belong together.
    knots : list of (list of int, list of int)
        The other groups of overlapping pieces, below and above; a piece that overlaps none is
        a group of its own. So are pieces that are each other's only overlap but of very
        different size.
    knot_areas : (float, float, float)
        Areas of the knots' pieces below, above, and of what they have in common.
    """

    below: Layer
    above: Layer
    pairs: dict[tuple[int, int], list[tuple[int, int]]]
    knots: list[tuple[list[int], list[int]]]
    knot_areas: tuple[float, float, float]

    @property
    def height(self) -> float:
        """Distance between the layers, in units."""
        return self.above.offset - self.below.offset

    @property
    def middle(self) -> float:
        """Offset halfway between the layers, in units."""
        return self.below.offset + self.height / 2

    def changes(self, largest: float) -> bool:
        """Tell whether pieces change, or the area by a ledge; see `doubt`."""
        return bool(self.knots) or self._ledge(largest) > 0

    def leaves_open(self, volume: float, largest: float) -> bool:
        """Tell whether the doubt exceeds a volume; see `doubt`."""
        return self.doubt(largest) > volume

    def doubt(self, largest: float) -> float:
        """Return the volume, in cubed units, that pieces which change and ledges leave open.

        Parameters
        ----------
        largest : float
            Area of the largest section, in squared units, that ledges are compared with.
        """
        below, above, common = self.knot_areas
        return (below + above - 2 * common + self._ledge(largest)) * self.height

    def _ledge(self, largest: float) -> float:
        """Return the change in area from layer to layer where it is one worth locating."""
        step = abs(self.above.area - self.below.area)
        return step if step > LEDGE * largest else 0.0


class Slabs:
    """The slabs between pairs of layers, each matched once."""

    def __init__(self) -> None:
        self._known: dict[tuple[Layer, Layer], Slab] = {}

    def between(self, pairs: Iterable[tuple[Layer, Layer]]) -> list[Slab]:
        """Return the slab of each pair of layers, below and above."""
        pairs = list(pairs)
        new = [pair for pair in pairs if pair not in self._known]
        if new:
            self._known.update(zip(new, _match_layers(new), strict=True))
        return [self._known[pair] for pair in pairs]


def _match_layers(pairs: Sequence[tuple[Layer, Layer]]) -> list[Slab]:
    """Group the pieces of adjacent layers, below and above, by overlap."""
    matches = _Matches.of(pairs, MIN_AREA_RATIO, LEAST_WIDTH)
    slabs = [
        Slab(below, above, {}, [], (low, high, common))
        for (below, above), (low, high, common) in zip(pairs, matches.areas.tolist(), strict=True)
    ]
    with_holes = []
    for index, low, high, contours, below, above in zip(*matches.pairs.T.tolist(), strict=True):
        slabs[index].pairs[low, high] = [(below, above)]
        if contours > 1:
            with_holes.append((slabs[index], low, high))
    for index, number, side, piece in zip(*matches.members.T.tolist(), strict=True):
        knots = slabs[index].knots
        if number == len(knots):
            knots.append(([], []))
        knots[number][side].append(piece)
    if with_holes:
        _match_holes(with_holes)
    for slab in slabs:
        if slab.knots:
            _bridge(slab)
    return slabs


@dataclass(frozen=True)
class _Matches:
    """How the pieces of adjacent layers belong together, numbered within these.

    Attributes
    ----------
    pairs : array of int, shape (n, 6)
        Pieces that overlap nothing else, are alike and have as many contours: slab, piece below,
        piece above, contours of each, and the number of the first in the layer below and above.
    members : array of int, shape (m, 4)
        All other pieces: slab, number of the knot in it, side (0 below, 1 above), piece.
    areas : array, shape (slabs, 3)
        Of these below, above, and of what they have in common.
    """

    pairs: NDArray[np.int64]
    members: NDArray[np.int64]
    areas: NDArray[np.float64]

    @classmethod
    def of(
        cls, slabs: Sequence[tuple[Layer, Layer]], area_ratio: float, width_ratio: float
    ) -> _Matches:
        """Match the layers below and above slabs.

        Parameters
        ----------
        slabs : sequence of (Layer, Layer)
            The layers.
        area_ratio, width_ratio : float
            How much smaller, or narrower in x or y, a piece may be than one that is alike.
        """
        sides = [layer for slab in slabs for layer in slab]
        batches: dict[Regions, int] = {}
        spans = [
            (batches.setdefault(layer.batch, len(batches)), layer.low, layer.high - layer.low)
            for layer in sides
        ]
        flat = np.fromiter(chain.from_iterable(spans), dtype=np.int64, count=3 * len(spans))
        layers = flat.reshape(-1, 3)
        counts = layers[:, 2].reshape(-1, 2)
        crowded = np.flatnonzero(counts[:, 0] * counts[:, 1] > FEW_PAIRS)

        def common_area(slab: int, low: int, high: int) -> float:
            below, above = slabs[slab]
            section = below.alone(low).section(0) ^ above.alone(high).section(0)
            return float(Regions.of_sections([section]).areas[0])

        pairs, members, areas = match(
            layers,
            _candidates(slabs, crowded),
            tuple((*batch.arrays, batch.areas, batch.boxes) for batch in batches),
            common_area,
            FEW_PAIRS,
            area_ratio,
            width_ratio,
            CLEARANCE,
        )
        return cls(
            np.frombuffer(pairs, dtype=np.int64).reshape(-1, 6),
            np.frombuffer(members, dtype=np.int64).reshape(-1, 4),
            np.frombuffer(areas).reshape(-1, 3),
        )


def _candidates(
    slabs: Sequence[tuple[Layer, Layer]], chosen: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the pieces of some of the slabs whose boxes meet.

    Returns
    -------
    candidates : array of int, shape (n, 3)
        Slab, and the pieces' numbers in the layers below and above.
    """
    found = [np.empty((0, 3), dtype=np.int64)]
    for slab in chosen.tolist():
        low, high = (shapely.box(*layer.boxes.T) for layer in slabs[slab])
        places = shapely.STRtree(high).query(low).T
        found.append(np.column_stack([np.full(len(places), slab), places]))
    return np.concatenate(found)


def _match_holes(pairs: Sequence[tuple[Slab, int, int]]) -> None:
    """Match the holes of pairs of pieces by overlap; make knots where that isn't one to one."""
    sides = [
        (layer, layer.contours(piece)[1:])
        for slab, *pieces in pairs
        for layer, piece in zip((slab.below, slab.above), pieces, strict=True)
    ]
    rings = [layer.rings.loop(hole)[::-1] for layer, holes in sides for hole in holes]
    inside = Regions.of_rings([[ring] for ring in rings])
    ends = ends_of(np.array([len(holes) for _, holes in sides]))
    layers = _layers_of([layer.offset for layer, _ in sides], inside, ends)
    slabs = list(zip(layers[::2], layers[1::2], strict=True))
    matches = _Matches.of(slabs, area_ratio=0.0, width_ratio=0.0)
    for index, low, high, *_ in matches.pairs.tolist():
        slab, *pieces = pairs[index]
        matched = sides[2 * index][1][low], sides[2 * index + 1][1][high]
        slab.pairs[pieces[0], pieces[1]].append(matched)
    for index in np.unique(matches.members[:, 0]).tolist():
        _tie(*pairs[index])


def _tie(slab: Slab, low: int, high: int) -> None:
    """Make a knot of a pair."""
    del slab.pairs[low, high]
    slab.knots.append(([low], [high]))
    slab.knots.sort(key=lambda knot: (knot[0] or [len(slab.below) + knot[1][0]])[0])
    one, other = slab.below.alone(low), slab.above.alone(high)
    common = one.clipped([Footprints.as_they_are(other)])
    shares = one.areas[0], other.areas[0], common.areas[0]
    below, above, shared = map(float, np.add(slab.knot_areas, shares))
    slab.knot_areas = below, above, shared


def pieces_of_layers(layers: Sequence[Layer]) -> tuple[Regions, NDArray[np.int64]]:
    """Return the pieces that layers are of, and where among them each layer's begin.

    Pieces of other layers may be among them.
    """
    batches = list(dict.fromkeys(layer.batch for layer in layers))
    numbers = np.array([len(batch) for batch in batches])
    starts = dict(zip(batches, ends_of(numbers).tolist(), strict=False))
    first = np.array([starts[layer.batch] + layer.low for layer in layers])
    return Regions.joined(batches), first


def _are_similar(areas: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
    ratios = areas / others
    return (ratios > MIN_AREA_RATIO) & (ratios < MAX_AREA_RATIO)


def _bridge(slab: Slab) -> None:
    """Pair pieces that overlap none but lie where a slanted body would have moved from the other.

    Each is the other's nearest, of similar size and without holes.
    """
    ends = [low[0] for low, high in slab.knots if not high]
    begins = [high[0] for low, high in slab.knots if not low]
    if not ends or not begins:
        return
    distances = cdist(slab.below.centroids(ends), slab.above.centroids(begins))
    similar = _are_similar(slab.below.areas[ends][:, None], slab.above.areas[begins])
    for row, column in enumerate(distances.argmin(axis=1)):
        contours = slab.below.contours(ends[row]), slab.above.contours(begins[column])
        if (
            distances[:, column].argmin() == row
            and distances[row, column] < STEEPEST * slab.height
            and similar[row, column]
            and len(contours[0]) == len(contours[1]) == 1
        ):
            slab.knots.remove(([ends[row]], []))
            slab.knots.remove(([], [begins[column]]))
            slab.pairs[ends[row], begins[column]] = [(contours[0][0], contours[1][0])]
            below, above, common = slab.knot_areas
            below -= float(slab.below.areas[ends[row]])
            above -= float(slab.above.areas[begins[column]])
            slab.knot_areas = below, above, common


def without_flakes(layers: Sequence[Layer], slabs: Slabs) -> list[Layer]:
    """Leave out the pieces that meet none of the layer below or above, and so have no volume."""
    kept = list(layers)
    between = slabs.between(pairwise(layers))
    for place, (below, above) in enumerate(pairwise(between), start=1):
        if below.knots and above.knots:
            flakes = {high[0] for low, high in below.knots if not low}
            flakes &= {low[0] for low, high in above.knots if not high}
            if flakes:
                pieces = [piece for piece in range(len(kept[place])) if piece not in flakes]
                kept[place] = kept[place].only(pieces)
    return kept


def without_needless(
    layers: Sequence[Layer], slabs: Slabs, wanted: set[float], doubtful_volume: float
) -> list[Layer]:
    """Leave out layers that only served the search for places where pieces split or end.

    Parameters
    ----------
    layers : sequence of Layer
        By increasing offset.
    slabs : Slabs
        Those between layers as far as they are known.
    wanted : set of float
        Offsets of the layers to keep in any case.
    doubtful_volume : float
        What a slab may leave open, in cubed units.

    Returns
    -------
    layers : list of Layer
        Those wanted, those on both sides of an event or a ledge, and those without which there
        were more of them.
    """
    largest = max(layer.area for layer in layers)
    kept = np.array([layer.offset in wanted for layer in layers])
    changes = [slab.changes(largest) for slab in slabs.between(pairwise(layers))]
    kept[:-1] |= changes
    kept[1:] |= changes
    gaps = [(low, high) for low, high in pairwise(np.flatnonzero(kept).tolist()) if high > low + 1]
    bridges = slabs.between((layers[low], layers[high]) for low, high in gaps)
    for gap, slab in zip(gaps, bridges, strict=True):
        kept[slice(*gap)] |= slab.leaves_open(doubtful_volume, largest)
    return [layer for layer, is_kept in zip(layers, kept, strict=True) if is_kept]
