"""Cross-sections as polygons, and which pieces of adjacent ones belong together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from momrec_core.regions import Footprints, Regions
from momrec_core.rings import Rings, ends_of, number_within

__all__ = [
    "Layer",
    "Slab",
    "Slabs",
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


@dataclass(frozen=True, eq=False)
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
    """

    offset: float
    batch: Regions
    low: int
    high: int

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

    @cached_property
    def area(self) -> float:
        """Area of all pieces, in squared units."""
        return float(self.areas.sum())

    def contours(self, piece: int) -> range:
        """Return the numbers of a piece's contours: its shell, then its holes."""
        begins, at = self.batch.begins, self.low + piece
        return range(begins[at] - begins[self.low], begins[at + 1] - begins[self.low])

    def centroids(self, pieces: Sequence[int]) -> NDArray[np.float64]:
        """Return the centroids of some pieces' shells."""
        return np.asarray(self.batch.centroids[self.low + np.array(pieces)])

    def only(self, pieces: Sequence[int]) -> Layer:
        """Return a layer of some of the pieces."""
        chosen = self.pieces.take(np.array(pieces, dtype=np.int64))
        return Layer(self.offset, chosen, 0, len(chosen))


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
    return [Layer(float(offset), pieces, low, high) for offset, low, high in spans]


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
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = field(default_factory=dict)
    knots: list[tuple[list[int], list[int]]] = field(default_factory=list)
    knot_areas: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def height(self) -> float:
        """Distance between the layers, in units."""
        return self.above.offset - self.below.offset

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
        self._known.update(zip(new, _match_layers(new), strict=True))
        return [self._known[pair] for pair in pairs]


def _match_layers(pairs: Sequence[tuple[Layer, Layer]]) -> list[Slab]:
    """Group the pieces of adjacent layers, below and above, by overlap."""
    slabs = [Slab(below, above) for below, above in pairs]
    sides = [layer for pair in pairs for layer in pair]
    counts = np.array([len(layer) for layer in sides], dtype=np.int64)
    if not counts.any():
        return slabs
    pieces, starts = pieces_of_layers(sides)
    owners, places = _overlaps(pieces, starts, counts)
    members = starts.reshape(-1, 2)[owners] + places
    nodes = ends_of(counts)[:-1].reshape(-1, 2)[owners] + places
    degrees = np.bincount(nodes.ravel(), minlength=counts.sum())
    is_pair = (degrees[nodes] == 1).all(axis=1) & _are_images(pieces, members)
    for index in np.flatnonzero(is_pair).tolist():
        slab, pair = slabs[owners[index]], tuple(places[index].tolist())
        contours = _contour_pairs(slab, *pair)
        if contours:
            slab.pairs[pair] = contours
        else:
            is_pair[index] = False
    is_left = np.ones(len(degrees), dtype=bool)
    is_left[nodes[is_pair]] = False
    side_of, place = number_within(counts)
    for group in _connected(np.flatnonzero(is_left), nodes[~is_pair]):
        knot: tuple[list[int], list[int]] = ([], [])
        for node in group:
            knot[side_of[node] % 2].append(int(place[node]))
        slabs[side_of[group[0]] // 2].knots.append(knot)
    areas = np.bincount(side_of, is_left * pieces.areas[starts[side_of] + place], len(sides))
    lower, upper = members[~is_pair].T
    common = pieces.take(lower).clipped([Footprints.of(pieces, upper)]).areas
    shared = np.bincount(owners[~is_pair], common, len(slabs))
    for slab, *knot_areas in zip(slabs, *areas.reshape(-1, 2).T.tolist(), shared, strict=True):
        if slab.knots:
            slab.knot_areas = tuple(knot_areas)
            _bridge(slab)
    return slabs


def pieces_of_layers(layers: Sequence[Layer]) -> tuple[Regions, NDArray[np.int64]]:
    """Return the pieces that layers are of, and where among them each layer's begin.

    Pieces of other layers may be among them.
    """
    batches = {id(layer.batch): layer.batch for layer in layers}
    numbers = np.array([len(batch) for batch in batches.values()])
    starts = dict(zip(batches, ends_of(numbers).tolist(), strict=False))
    first = np.array([starts[id(layer.batch)] + layer.low for layer in layers])
    return Regions.joined(list(batches.values())), first


def _connected(nodes: NDArray[np.int64], edges: NDArray[np.int64]) -> list[list[int]]:
    """Group nodes that edges connect, each group and all of them in order."""
    parents = {node: node for node in nodes.tolist()}

    def root(node: int) -> int:
        while parents[node] != node:
            parents[node] = node = parents[parents[node]]
        return node

    for one, other in edges.tolist():
        first, second = sorted((root(one), root(other)))
        parents[second] = first
    groups: dict[int, list[int]] = {}
    for node in parents:
        groups.setdefault(root(node), []).append(node)
    return list(groups.values())


def _overlaps(
    pieces: Regions, starts: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return which pieces have an area in common, of layers below and above slabs in turn.

    Parameters
    ----------
    pieces : Regions
        Those of all layers.
    starts, counts : array of int, shape (2 slabs,)
        Where each layer's begin, and how many it has.

    Returns
    -------
    owners : array of int, shape (n,)
        Slabs.
    places : array of int, shape (n, 2)
        The pieces' numbers in the layers below and above.
    """
    tries = counts[0::2] * counts[1::2]
    owners, numbers = number_within(np.where(tries > FEW_PAIRS, 0, tries))
    places = np.column_stack(np.divmod(numbers, counts[1::2][owners]))
    for slab in np.flatnonzero(tries > FEW_PAIRS).tolist():
        low, high = (
            shapely.box(*pieces.boxes[start : start + count].T)
            for start, count in zip(starts[2 * slab :][:2], counts[2 * slab :][:2], strict=True)
        )
        found = shapely.STRtree(high).query(low).T
        owners = np.append(owners, np.full(len(found), slab))
        places = np.concatenate([places, found])
    lower, upper = (starts.reshape(-1, 2)[owners] + places).T
    meet = _boxes_meet(pieces.boxes[lower], pieces.boxes[upper])
    meet[meet] = _meet(pieces, lower[meet], upper[meet])
    return owners[meet], places[meet]


def _boxes_meet(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell whether boxes, shape (..., 4), have an area in common."""
    return np.asarray(
        ((low[..., :2] < high[..., 2:]) & (high[..., :2] < low[..., 2:])).all(axis=-1)
    )


def _meet(pieces: Regions, lower: NDArray[np.int64], upper: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell whether pairs of pieces have an area in common."""
    low, high = pieces.boxes[lower], pieces.boxes[upper]
    corners = np.maximum(low[:, :2], high[:, :2]), np.minimum(low[:, 2:], high[:, 2:])
    middles = (corners[0] + corners[1]) / 2
    meet = pieces.hold(lower, middles) & pieces.hold(upper, middles)
    others = np.flatnonzero(~meet)  # for which the middle of what their boxes share does not tell
    common = pieces.take(lower[others]).clipped([Footprints.of(pieces, upper[others])])
    meet[others] = common.areas > 0
    return meet


def _are_similar(areas: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
    ratios = areas / others
    return (ratios > MIN_AREA_RATIO) & (ratios < MAX_AREA_RATIO)


def _are_images(pieces: Regions, members: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell whether two pieces each, shape (n, 2), may be one and the same a little higher."""
    lower, upper = members.T
    widths = pieces.boxes[:, 2:] - pieces.boxes[:, :2]
    least, most = (take(widths[lower], widths[upper]) for take in (np.minimum, np.maximum))
    are_similar = _are_similar(pieces.areas[lower], pieces.areas[upper])
    return np.asarray(are_similar & (least > LEAST_WIDTH * most).all(axis=1))


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
    meet = _boxes_meet(inside.boxes[:count, None], inside.boxes[count:])
    lower, upper = np.divmod(np.flatnonzero(meet), count)
    meet = _meet(inside, lower, upper + count)
    lower, upper = lower[meet], upper[meet]
    if len(lower) != count or len(set(lower.tolist())) + len(set(upper.tolist())) != 2 * count:
        return []
    matched = zip(lower.tolist(), upper.tolist(), strict=True)
    return [shells, *((holes[0][first], holes[1][second]) for first, second in matched)]


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
    kept = np.array([layer.offset in wanted for layer in layers])
    changes = [slab.changes(largest) for slab in slabs.between(pairwise(layers))]
    kept[:-1] |= changes
    kept[1:] |= changes
    gaps = [(low, high) for low, high in pairwise(np.flatnonzero(kept).tolist()) if high > low + 1]
    bridges = slabs.between((layers[low], layers[high]) for low, high in gaps)
    for gap, slab in zip(gaps, bridges, strict=True):
        kept[slice(*gap)] |= slab.leaves_open(doubtful_volume, largest)
    return [layer for layer, is_kept in zip(layers, kept, strict=True) if is_kept]
