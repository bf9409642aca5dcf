"""Cross-sections as polygons, and which pieces of adjacent ones belong together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from manifold3d import CrossSection, FillRule
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist
from shapely import MultiPolygon, Polygon

from momrec_core.rings import Rings, number_within

__all__ = [
    "Layer",
    "Slab",
    "Slabs",
    "layers_of_sections",
    "region_of_section",
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
    rings : Rings
        The contours, in units, piece by piece: the shell, counter-clockwise, then the holes,
        clockwise.
    first : array of int, shape (pieces + 1,)
        The shell of each piece, and the number of contours.
    polygons : array of Polygon, shape (pieces,)
        The pieces, prepared for many tests.
    areas : array, shape (pieces,)
        Their areas, in squared units.
    bounds : array, shape (pieces, 4)
        Their boxes: least x and y, greatest x and y.
    """

    offset: float
    rings: Rings
    first: NDArray[np.int64]
    polygons: NDArray[np.object_]

    areas: NDArray[np.float64]
    bounds: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.polygons)

    @cached_property
    def area(self) -> float:
        """Area of all pieces, in squared units."""
        return float(self.areas.sum())

    def contours(self, piece: int) -> range:
        """Return the numbers of a piece's contours: its shell, then its holes."""
        return range(int(self.first[piece]), int(self.first[piece + 1]))

    def ring(self, contour: int) -> NDArray[np.float64]:
        """Return the vertices of a contour, shape (n, 2)."""
        return self.rings.points[self.rings.first[contour] : self.rings.first[contour + 1]]

    def region(self, pieces: Iterable[int]) -> CrossSection:
        """Return some of the pieces as a cross-section."""
        loops = [self.ring(contour) for piece in pieces for contour in self.contours(piece)]
        return CrossSection(loops, FillRule.EvenOdd)

    def only(self, pieces: Sequence[int]) -> Layer:
        """Return a layer of some of the pieces."""
        chosen = np.array(pieces, dtype=np.int64)
        counts = np.diff(self.first)[chosen]
        owners, positions = number_within(counts)
        contours = self.first[chosen][owners] + positions
        vertices, _ = self.rings.around(contours)
        starts = np.concatenate([[0], np.cumsum(self.rings.counts[contours])])
        rings = Rings(self.rings.points[vertices], starts)
        first = np.concatenate([[0], np.cumsum(counts)])
        polygons, areas, bounds = self.polygons[chosen], self.areas[chosen], self.bounds[chosen]
        return Layer(self.offset, rings, first, polygons, areas, bounds)


def layers_of_sections(
    offsets: Sequence[float] | NDArray[np.float64], sections: Sequence[CrossSection]
) -> list[Layer]:
    """Take the pieces of cross-sections, cleaned of rounding.

    Parameters
    ----------
    offsets : sequence of float
        Along the planes' normal, in units.
    sections : sequence of CrossSection
        As many.

    Returns
    -------
    layers : list of Layer
    """
    loops: list[NDArray[np.float64]] = []
    piece_of: list[int] = []
    layer_of: list[int] = []
    for index, section in enumerate(sections):
        for part in _parts(section.simplify(CLEANING)):
            kept = [ring for ring in part.to_polygons() if len(ring) > 2]
            piece_of.extend([len(layer_of)] * len(kept))
            loops.extend(kept)
            layer_of.extend([index] * bool(kept))
    if not loops:
        return [_empty_layer(offset) for offset in offsets]
    pieces = np.array(piece_of)
    rings = _shells_first(loops, pieces)
    _, vertex_rings = rings.around(np.arange(len(pieces)))
    polygons = shapely.polygons(
        shapely.linearrings(rings.points, indices=vertex_rings), indices=pieces
    )
    shapely.prepare(polygons)
    columns = (polygons, shapely.area(polygons), shapely.bounds(polygons))
    piece_ends = np.searchsorted(layer_of, np.arange(len(sections) + 1))
    ring_ends = np.searchsorted(pieces, piece_ends)
    first = np.searchsorted(pieces, np.arange(len(polygons) + 1))
    layers = []
    for offset, low, high, begin, end in zip(
        offsets, piece_ends, piece_ends[1:], ring_ends, ring_ends[1:], strict=False
    ):
        start, stop = rings.first[[begin, end]]
        own = Rings(rings.points[start:stop], rings.first[begin : end + 1] - start)
        pieces = first[low : high + 1] - begin
        layers.append(Layer(float(offset), own, pieces, *(it[low:high] for it in columns)))
    return layers


def _empty_layer(offset: float) -> Layer:
    none = np.zeros(1, dtype=np.int64)
    rings = Rings(np.empty((0, 2)), none)
    polygons = np.empty(0, dtype=object)
    return Layer(float(offset), rings, none, polygons, np.empty(0), np.empty((0, 4)))


def _parts(section: CrossSection) -> list[CrossSection]:
    return [section] if section.num_contour() == 1 else section.decompose()


def _shells_first(loops: list[NDArray[np.float64]], pieces: NDArray[np.int64]) -> Rings:
    """Join the contours of pieces, each one's shell before its holes."""
    first = np.concatenate([[0], np.cumsum([len(loop) for loop in loops])])
    rings = Rings(np.concatenate(loops), first)
    if pieces[-1] + 1 == len(loops):
        return rings
    order = np.lexsort([-rings.areas, pieces])
    vertices, _ = rings.around(order)
    first = np.concatenate([[0], np.cumsum(rings.counts[order])])
    return Rings(rings.points[vertices], first)


def region_of_section(section: CrossSection, unit: float) -> MultiPolygon:
    """Return a cross-section as a region in metres."""
    parts = [] if section.is_empty() else section.scale((unit, unit)).decompose()
    return MultiPolygon([_polygon(part.to_polygons()) for part in parts])


def _polygon(rings: Sequence[NDArray[np.float64]]) -> Polygon:
    """Make a polygon of one piece's rings, the largest of which is the shell."""
    shell, *holes = sorted(rings, key=lambda ring: float(np.prod(np.ptp(ring, axis=0))))[::-1]
    return Polygon(shell, holes)


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
        return (self.below.region(low) ^ self.above.region(high)).area() if low and high else 0.0

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
    lower, upper = _overlaps(sides, counts)
    graph = coo_array((np.ones(len(lower)), (lower, upper)), shape=(count, count))
    _, labels = connected_components(graph, directed=False)
    areas = np.concatenate([layer.areas for layer in sides])
    is_pair = (np.bincount(labels) == 2)[labels[lower]]
    is_pair &= _are_similar(areas[lower], areas[upper])
    boxes = np.concatenate([layer.bounds for layer in sides])
    widths = boxes[:, 2:] - boxes[:, :2]
    least, most = (take(widths[lower], widths[upper]) for take in (np.minimum, np.maximum))
    is_pair &= (least > LEAST_WIDTH * most).all(axis=1)
    is_left = np.ones(count, dtype=bool)
    sides_of, places = side_of.tolist(), place.tolist()
    for low, high in zip(lower[is_pair].tolist(), upper[is_pair].tolist(), strict=True):
        slab, pieces = slabs[sides_of[low] // 2], (places[low], places[high])
        contours = _contour_pairs(slab, *pieces)
        if contours:
            slab.pairs[pieces] = contours
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
    sides: Sequence[Layer], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return which pieces have an area in common, over all layers below and above slabs in turn.

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
    for index in many.tolist():
        tree = shapely.STRtree(sides[2 * index + 1].polygons)
        below, above = tree.query(sides[2 * index].polygons)
        found.append((first[2 * index] + below, first[2 * index + 1] + above))
    lower, upper = np.concatenate(found, axis=1)
    bounds = np.concatenate([layer.bounds for layer in sides])
    low, high = bounds[lower], bounds[upper]
    meet = ((low[:, :2] < high[:, 2:]) & (high[:, :2] < low[:, 2:])).all(axis=1)
    polygons = np.concatenate([layer.polygons for layer in sides])
    return _meeting(polygons, lower[meet], upper[meet])


def _meeting(
    polygons: NDArray[np.object_], lower: NDArray[np.int64], upper: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs, of those given, whose polygons have an area in common."""
    below, above = polygons[lower], polygons[upper]
    middles = shapely.get_coordinates(shapely.centroid(below)).T
    meet = shapely.contains_xy(below, *middles) & shapely.contains_xy(above, *middles)
    others = np.flatnonzero(~meet)  # whose centroid does not tell
    meet[others] = shapely.intersects(below[others], above[others])
    others = others[meet[others]]
    meet[others] = ~shapely.touches(below[others], above[others])
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
    polygons = shapely.polygons(
        [shapely.linearrings(slab.below.ring(hole)) for hole in holes[0]]
        + [shapely.linearrings(slab.above.ring(hole)) for hole in holes[1]]
    )
    lower, upper = np.indices((count, count)).reshape(2, -1)
    lower, upper = _meeting(polygons, lower, upper + count)
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
        shapely.get_coordinates(shapely.centroid(slab.below.polygons[ends])),
        shapely.get_coordinates(shapely.centroid(slab.above.polygons[begins])),
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
