"""Cross-sections as polygons, and which pieces of adjacent ones belong together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from momrec_core.regions import Footprints, Regions
from momrec_core.rings import Rings, number_within

__all__ = [
    "Layer",
    "Slab",
    "Slabs",
    "layers_of_sections",
    "without_flakes",
    "without_needless",
]

CLEANING = 1e-3  # units: vertices that stand out less are rounding, not shape; float32 keeps it
MIN_AREA_RATIO = 0.4  # of two matching pieces, below which one contour is no image of the other
MAX_AREA_RATIO = 1 / MIN_AREA_RATIO
LEAST_WIDTH = 0.5  # of a piece's box, in x or y, that the matching piece's box has too
STEEPEST = 20.0  # shift over height of a slanted body that is followed between layers: 87 degrees
FEW_PAIRS = 4096  # of pieces: above, a tree of boxes finds candidates faster than trying all
LEDGE = 0.1  # of the largest section: a change in area between adjacent layers worth locating


@dataclass(frozen=True, eq=False)
class Layer:
    """The cross-section at one offset.

    Attributes
    ----------
    offset : float
        Along the planes' normal, in units.
    pieces : Regions
        The pieces, in units; of each the shell, counter-clockwise, then the holes, clockwise.
    areas : array, shape (pieces,)
        Their areas, in squared units.
    """

    offset: float
    pieces: Regions
    areas: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.pieces)

    @property
    def rings(self) -> Rings:
        """The contours of all pieces, piece by piece."""
        return self.pieces.rings

    @cached_property
    def area(self) -> float:
        """Area of all pieces, in squared units."""
        return float(self.areas.sum())

    @cached_property
    def region(self) -> Regions:
        """All pieces as one region."""
        return Regions(self.rings, self.pieces.first[[0, -1]])

    def contours(self, piece: int) -> range:
        """Return the numbers of a piece's contours: its shell, then its holes."""
        return range(int(self.pieces.first[piece]), int(self.pieces.first[piece + 1]))

    def only(self, pieces: Sequence[int]) -> Layer:
        """Return a layer of some of the pieces."""
        chosen = np.array(pieces, dtype=np.int64)
        return Layer(self.offset, self.pieces.take(chosen), self.areas[chosen])


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
    spans = zip(offsets, ends[:-1].tolist(), ends[1:].tolist(), strict=True)
    areas = pieces.areas
    return [
        Layer(float(offset), pieces.part(low, high), areas[low:high])
        for offset, low, high in spans
    ]


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
    """

    below: Layer
    above: Layer
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = field(default_factory=dict)
    knots: list[tuple[list[int], list[int]]] = field(default_factory=list)

    @property
    def height(self) -> float:
        """Distance between the layers, in units."""
        return self.above.offset - self.below.offset

    def changes(self, largest: float) -> bool:
        """Tell whether pieces change, or the area by a ledge; see `doubt`."""
        return bool(self.knots) or self._ledge(largest) > 0

    def leaves_open(self, volume: float, largest: float) -> bool:
        """Tell whether the doubt exceeds a volume; see `doubt`."""
        low, high = self._knot_areas
        ledge = self._ledge(largest)
        if (low + high + ledge) * self.height <= volume:
            return False
        return (abs(low - high) + ledge) * self.height > volume or self.doubt(largest) > volume

    def doubt(self, largest: float) -> float:
        """Return the volume, in cubed units, that pieces which change and ledges leave open.

        Parameters
        ----------
        largest : float
            Area of the largest section, in squared units, that ledges are compared with.
        """
        return (sum(self._knot_areas) - 2 * self._common_area + self._ledge(largest)) * self.height

    def _ledge(self, largest: float) -> float:
        """Return the change in area from layer to layer where it is one worth locating."""
        step = abs(self.above.area - self.below.area)
        return step if step > LEDGE * largest else 0.0

    @cached_property
    def _knot_areas(self) -> tuple[float, float]:
        """Areas of the knots' pieces below and above."""
        if not self.knots:
            return 0.0, 0.0
        low, high = self._knot_pieces()
        below = sum(float(self.below.areas[piece]) for piece in low)
        above = sum(float(self.above.areas[piece]) for piece in high)
        return below, above

    @cached_property
    def _common_area(self) -> float:
        """Area of the knots' pieces that is on both sides."""
        low, high = self._knot_pieces()
        if not low or not high:
            return 0.0
        above = Footprints.as_they_are(self.above.only(high).region)
        return float(self.below.only(low).region.clipped([above]).areas[0])

    def _knot_pieces(self) -> tuple[list[int], list[int]]:
        low, high = ([piece for group in self.knots for piece in group[side]] for side in (0, 1))
        return low, high


class Slabs:
    """The slabs between pairs of layers, each matched once."""

    def __init__(self) -> None:
        self._known: dict[tuple[Layer, Layer], Slab] = {}

    def between(self, pairs: Iterable[tuple[Layer, Layer]]) -> list[Slab]:
        """Return the slab of each pair of layers, below and above."""
        pairs = list(pairs)
        new = [pair for pair in pairs if pair not in self._known]
        self._known.update(zip(new, _match_layers(new), strict=True))
        return [self._known[pair] for pair in pairs]


def _match_layers(pairs: Sequence[tuple[Layer, Layer]]) -> list[Slab]:
    """Group the pieces of adjacent layers, below and above, by overlap."""
    slabs = [Slab(below, above) for below, above in pairs]
    sides = [layer for pair in pairs for layer in pair]
    counts = np.array([len(layer) for layer in sides], dtype=np.int64)
    count = int(counts.sum())
    if count == 0:
        return slabs
    side_of, place = number_within(counts)
    pieces = Regions.joined([layer.pieces for layer in sides])
    areas = np.concatenate([layer.areas for layer in sides])
    lower, upper = _overlaps(pieces, counts)
    graph = coo_array((np.ones(len(lower)), (lower, upper)), shape=(count, count))
    _, labels = connected_components(graph, directed=False)
    is_pair = (np.bincount(labels) == 2)[labels[lower]]
    is_pair &= _are_similar(areas[lower], areas[upper])
    widths = pieces.boxes[:, 2:] - pieces.boxes[:, :2]
    least, most = (take(widths[lower], widths[upper]) for take in (np.minimum, np.maximum))
    is_pair &= (least > LEAST_WIDTH * most).all(axis=1)
    is_left = np.ones(count, dtype=bool)
    sides_of, places = side_of.tolist(), place.tolist()
    for low, high in zip(lower[is_pair].tolist(), upper[is_pair].tolist(), strict=True):
        slab, pair = slabs[sides_of[low] // 2], (places[low], places[high])
        contours = _contour_pairs(slab, *pair)
        if contours:
            slab.pairs[pair] = contours
            is_left[low] = is_left[high] = False
    groups: dict[int, tuple[list[int], list[int]]] = {}
    for piece in np.flatnonzero(is_left).tolist():
        index, side = divmod(sides_of[piece], 2)
        if labels[piece] not in groups:
            groups[labels[piece]] = ([], [])
            slabs[index].knots.append(groups[labels[piece]])
        groups[labels[piece]][side].append(places[piece])
    for slab in slabs:
        _bridge(slab)
    return slabs


def _overlaps(
    pieces: Regions, counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return which pieces have an area in common, of layers below and above slabs in turn.

    Parameters
    ----------
    pieces : Regions
        Those of all layers.
    counts : array of int
        How many each layer has.

    Returns
    -------
    lower, upper : array of int
        Pieces, counted on from layer to layer.
    """
    first = np.cumsum(counts) - counts
    tries = counts[0::2] * counts[1::2]
    many = np.flatnonzero(tries > FEW_PAIRS)
    slab, number = number_within(np.where(tries > FEW_PAIRS, 0, tries))
    below, above = np.divmod(number, counts[1::2][slab])
    found = [(first[0::2][slab] + below, first[1::2][slab] + above)]
    for index in (2 * many).tolist():
        low, high = (np.arange(counts[side]) + first[side] for side in (index, index + 1))
        tree = shapely.STRtree(shapely.box(*pieces.boxes[high].T))
        below, above = tree.query(shapely.box(*pieces.boxes[low].T))
        found.append((low[below], high[above]))
    lower, upper = np.concatenate(found, axis=1)
    low, high = pieces.boxes[lower], pieces.boxes[upper]
    meet = ((low[:, :2] < high[:, 2:]) & (high[:, :2] < low[:, 2:])).all(axis=1)
    return _meeting(pieces, lower[meet], upper[meet])


def _meeting(
    pieces: Regions, lower: NDArray[np.int64], upper: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs of pieces, of those given, that have an area in common."""
    middles = pieces.rings.centroids[pieces.first[lower]]
    meet = pieces.hold(lower, middles) & pieces.hold(upper, middles)
    others = np.flatnonzero(~meet)  # whose centroid does not tell
    above = Footprints.as_they_are(pieces.take(upper[others]))
    meet[others] = pieces.take(lower[others]).clipped([above]).areas > 0
    return lower[meet], upper[meet]


def _are_similar(areas: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
    ratios = areas / others
    return (ratios > MIN_AREA_RATIO) & (ratios < MAX_AREA_RATIO)


def _contour_pairs(slab: Slab, low: int, high: int) -> list[tuple[int, int]]:
    """Match the contours of two pieces, the holes by overlap; none where that isn't one to one."""
    below, above = slab.below.contours(low), slab.above.contours(high)
    if len(below) != len(above):
        return []
    shells, holes = (below[0], above[0]), (below[1:], above[1:])
    count = len(holes[0])
    if count == 0:
        return [shells]
    loops = [slab.below.rings.loop(hole) for hole in holes[0]]
    loops += [slab.above.rings.loop(hole) for hole in holes[1]]
    inside = Regions.of_rings([[loop[::-1]] for loop in loops])
    lower, upper = np.indices((count, count)).reshape(2, -1)
    lower, upper = _meeting(inside, lower, upper + count)
    if len(lower) != count or len(set(lower.tolist())) + len(set(upper.tolist())) != 2 * count:
        return []
    matched = zip(lower.tolist(), (upper - count).tolist(), strict=True)
    return [shells, *((holes[0][first], holes[1][second]) for first, second in matched)]


def _bridge(slab: Slab) -> None:
    """Pair pieces that overlap none but lie where a slanted body would have moved from the other.

    Each is the other's nearest, of similar size and without holes.
    """
    ends = [low[0] for low, high in slab.knots if not high]
    begins = [high[0] for low, high in slab.knots if not low]
    if not ends or not begins:
        return
    distances = cdist(
        slab.below.rings.centroids[slab.below.pieces.first[ends]],
        slab.above.rings.centroids[slab.above.pieces.first[begins]],
    )
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


def without_flakes(layers: Sequence[Layer], slabs: Slabs) -> list[Layer]:
    """Leave out the pieces that meet none of the layer below or above, and so have no volume."""
    between = slabs.between(pairwise(layers))
    ends_above = [{low[0] for low, high in slab.knots if not high} for slab in between]
    ends_below = [{high[0] for low, high in slab.knots if not low} for slab in between]
    kept = []
    for layer, above, below in zip(layers, [*ends_above, set()], [set(), *ends_below], strict=True):
        flakes = above & below
        pieces = [piece for piece in range(len(layer)) if piece not in flakes]
        kept.append(layer.only(pieces) if flakes else layer)
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
    kept = np.isin([layer.offset for layer in layers], list(wanted))
    for index, slab in enumerate(slabs.between(pairwise(layers))):
        kept[[index, index + 1]] |= slab.changes(largest)
    gaps = [(low, high) for low, high in pairwise(np.flatnonzero(kept).tolist()) if high > low + 1]
    bridges = slabs.between((layers[low], layers[high]) for low, high in gaps)
    for gap, slab in zip(gaps, bridges, strict=True):
        kept[slice(*gap)] |= slab.leaves_open(doubtful_volume, largest)
    return [layer for layer, is_kept in zip(layers, kept, strict=True) if is_kept]
