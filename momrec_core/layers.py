"""Cross-sections as polygons, and which pieces of adjacent ones belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from manifold3d import CrossSection
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist
from shapely import MultiPolygon, Polygon

__all__ = [
    "Layer",
    "Slab",
    "hole_pairs",
    "match_layers",
    "region_of_section",
    "without_flakes",
    "without_needless",
]

CLEANING = 1e-3  # units: vertices that stand out less are rounding, not shape; float32 keeps it
MIN_AREA_RATIO = 0.4  # of two matching pieces, below which one contour is no image of the other
MAX_AREA_RATIO = 1 / MIN_AREA_RATIO
STEEPEST = 20.0  # shift over height of a slanted body that is followed between layers: 87 degrees
FEW_PAIRS = 64  # of pieces: above, a tree of boxes finds candidates faster than trying all
LEDGE = 0.1  # of the largest section: a change in area between adjacent layers worth locating


@dataclass(frozen=True, eq=False)
class Layer:
    """The cross-section at one offset.

    Attributes
    ----------
    offset : float
        Along the planes' normal, in units.
    pieces : list of Polygon
        In units; shells counter-clockwise, holes clockwise.
    """

    offset: float
    pieces: list[Polygon]

    @classmethod
    def of(cls, offset: float, section: CrossSection) -> Layer:
        """Take the pieces of a cross-section, cleaned of rounding."""
        return cls(float(offset), _pieces(section.simplify(CLEANING)))

    @cached_property
    def area(self) -> float:
        """Area of all pieces, in squared units."""
        return float(sum(piece.area for piece in self.pieces))

    @cached_property
    def prepared(self) -> NDArray[np.object_]:
        """The pieces, ready for many tests."""
        pieces = np.array(self.pieces, dtype=object)
        shapely.prepare(pieces)
        return pieces


def _pieces(section: CrossSection) -> list[Polygon]:
    if section.is_empty():
        return []
    parts = [section] if section.num_contour() == 1 else section.decompose()
    rings = [[ring for ring in part.to_polygons() if len(ring) > 2] for part in parts]
    return [_polygon(part) for part in rings if part]


def _polygon(rings: Sequence[NDArray[np.float64]]) -> Polygon:
    """Make a polygon of one piece's rings, the largest of which is the shell."""
    shell, *holes = sorted(rings, key=lambda ring: float(np.prod(np.ptp(ring, axis=0))))[::-1]
    return Polygon(shell, holes)


def region_of_section(section: CrossSection, unit: float) -> MultiPolygon:
    """Return a cross-section as a region in metres."""
    pieces = [] if section.is_empty() else section.scale((unit, unit)).decompose()
    return MultiPolygon([_polygon(piece.to_polygons()) for piece in pieces])


@dataclass
class Slab:
    """How the pieces of two adjacent layers belong together.

    Attributes
    ----------
    pairs : list of (int, int)
        Pieces below and above that are each other's only overlap, with holes that are as well.
    knots : list of (list of int, list of int)
        The other groups of overlapping pieces, below and above; a piece that overlaps none is
        a group of its own. So are pieces that are each other's only overlap but of very
        different size.
    doubt : float
        Area, in squared units, that is on the one side of the slab and not on the other where
        pieces or holes appear, vanish, split or join, or a section changes by a ledge.
    """

    pairs: list[tuple[int, int]] = field(default_factory=list)
    knots: list[tuple[list[int], list[int]]] = field(default_factory=list)
    doubt: float = 0.0


def match_layers(pairs: Sequence[tuple[Layer, Layer]], largest: float = np.inf) -> list[Slab]:
    """Group the pieces of adjacent layers, below and above, by overlap.

    Parameters
    ----------
    pairs : sequence of (Layer, Layer)
        The layers below and above each slab.
    largest : float
        Area of the largest section, in squared units, that ledges are compared with.

    Returns
    -------
    slabs : list of Slab
        One a pair.
    """
    slabs = [_slab_of_ledge(below, above, largest) for below, above in pairs]
    counts = np.array([[len(below.pieces), len(above.pieces)] for below, above in pairs])
    if counts.sum() == 0:
        return slabs
    pieces = np.concatenate([layer.prepared for pair in pairs for layer in pair])
    first = np.concatenate([[0], np.cumsum(counts)])
    candidates = [
        _boxes_that_meet(*(layer.prepared for layer in pair)) + first[[2 * slab, 2 * slab + 1]]
        for slab, pair in enumerate(pairs)
    ]
    lower, upper = _meeting(pieces, np.concatenate(candidates))
    graph = coo_array((np.ones(len(lower)), (lower, upper)), shape=(len(pieces), len(pieces)))
    _, labels = connected_components(graph, directed=False)
    order = np.argsort(labels, kind="stable")
    slab_of = np.repeat(np.arange(len(pairs)), counts.sum(axis=1))
    groups = []
    for members in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1):
        slab = int(slab_of[members[0]])
        begin, middle = first[2 * slab], first[2 * slab + 1]
        low, high = members[members < middle] - begin, members[members >= middle] - middle
        matched = len(low) == len(high) == 1 and hole_pairs(*pieces[members]) is not None
        areas = shapely.area(pieces[members])
        if matched and MIN_AREA_RATIO < areas[0] / areas[1] < MAX_AREA_RATIO:
            slabs[slab].pairs.append((int(low[0]), int(high[0])))
        else:
            slabs[slab].knots.append((low.tolist(), high.tolist()))
            groups.append((slab, begin + low, middle + high))
    _doubt_groups(slabs, pieces, groups)
    for matched_slab, (below, above) in zip(slabs, pairs, strict=True):
        _bridge(matched_slab, below, above)
    return slabs


def _boxes_that_meet(below: NDArray[np.object_], above: NDArray[np.object_]) -> NDArray[np.int64]:
    """Return candidates for an overlap, as index pairs, shape (n, 2)."""
    if len(below) * len(above) <= FEW_PAIRS:
        return np.indices((len(below), len(above))).reshape(2, -1).T
    return np.asarray(shapely.STRtree(above).query(below)).T


def _bridge(slab: Slab, below: Layer, above: Layer) -> None:
    """Pair pieces that overlap none but lie where a slanted body would have moved from the other.

    Each is the other's nearest, of similar size and without holes.
    """
    ends = [low[0] for low, high in slab.knots if not high]
    begins = [high[0] for low, high in slab.knots if not low]
    if not ends or not begins:
        return
    lows = [below.pieces[index] for index in ends]
    highs = [above.pieces[index] for index in begins]
    distances = cdist(
        shapely.get_coordinates(shapely.centroid(lows)),
        shapely.get_coordinates(shapely.centroid(highs)),
    )
    reach = STEEPEST * (above.offset - below.offset)
    for row, column in enumerate(distances.argmin(axis=1)):
        ratio = lows[row].area / highs[column].area
        if (
            distances[:, column].argmin() == row
            and distances[row, column] < reach
            and MIN_AREA_RATIO < ratio < MAX_AREA_RATIO
            and not (lows[row].interiors or highs[column].interiors)
        ):
            slab.knots.remove(([ends[row]], []))
            slab.knots.remove(([], [begins[column]]))
            slab.pairs.append((ends[row], begins[column]))


def _slab_of_ledge(below: Layer, above: Layer, largest: float) -> Slab:
    step = abs(above.area - below.area)
    return Slab(doubt=step if step > LEDGE * largest else 0.0)


def _doubt_groups(
    slabs: list[Slab],
    pieces: NDArray[np.object_],
    groups: Sequence[tuple[int, NDArray[np.int64], NDArray[np.int64]]],
) -> None:
    """Add to each slab the area that is in its knots' pieces on one side and not on the other.

    A group is the index of a slab and those of its pieces below and above.
    """
    if not groups:
        return
    overlaps = [np.array(np.meshgrid(low, high)).reshape(2, -1) for _, low, high in groups]
    lower, upper = np.concatenate(overlaps, axis=1)
    common = shapely.area(shapely.intersection(pieces[lower], pieces[upper], grid_size=CLEANING))
    first = np.cumsum([0, *(overlap.shape[1] for overlap in overlaps)])
    for (slab, low, high), (start, end) in zip(groups, pairwise(first), strict=True):
        area = shapely.area(pieces[np.concatenate([low, high])]).sum()
        slabs[slab].doubt += float(area - 2 * common[start:end].sum())


def _meeting(
    polygons: NDArray[np.object_], pairs: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the index pairs, of those given, whose polygons have an area in common."""
    lower, upper = pairs.T
    below, above = polygons[lower], polygons[upper]
    meet = shapely.intersects(below, above) & ~shapely.touches(below, above)
    return lower[meet], upper[meet]


def hole_pairs(below: Polygon, above: Polygon) -> list[tuple[int, int]] | None:
    """Match the holes of two pieces by overlap; None where that is not one to one."""
    count = len(below.interiors)
    if count != len(above.interiors):
        return None
    if count == 0:
        return []
    holes = np.array([Polygon(hole) for piece in (below, above) for hole in piece.interiors])
    pairs = np.indices((count, count)).reshape(2, -1).T + np.array([0, count])
    lower, upper = _meeting(holes, pairs)
    if len(lower) != count or len(set(lower.tolist())) + len(set(upper.tolist())) != 2 * count:
        return None
    return list(zip(lower.tolist(), (upper - count).tolist(), strict=True))


def without_flakes(layers: Sequence[Layer]) -> list[Layer]:
    """Leave out the pieces that meet none of the layer below or above, and so have no volume."""
    slabs = match_layers(list(pairwise(layers)))
    ends_above = [{low[0] for low, high in slab.knots if not high} for slab in slabs]
    ends_below = [{high[0] for low, high in slab.knots if not low} for slab in slabs]
    kept = []
    for layer, above, below in zip(layers, [*ends_above, set()], [set(), *ends_below], strict=True):
        flakes = above & below
        pieces = [piece for index, piece in enumerate(layer.pieces) if index not in flakes]
        kept.append(Layer(layer.offset, pieces) if flakes else layer)
    return kept


def without_needless(
    layers: Sequence[Layer], wanted: set[float], doubtful_volume: float
) -> list[Layer]:
    """Leave out layers that only served the search for places where pieces split or end.

    Parameters
    ----------
    layers : sequence of Layer
        By increasing offset.
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
    for index, slab in enumerate(match_layers(list(pairwise(layers)), largest)):
        kept[[index, index + 1]] |= slab.doubt > 0
    gaps = [(low, high) for low, high in pairwise(np.flatnonzero(kept).tolist()) if high > low + 1]
    bridges = [(layers[low], layers[high]) for low, high in gaps]
    for gap, (below, above), slab in zip(
        gaps, bridges, match_layers(bridges, largest), strict=True
    ):
        kept[slice(*gap)] |= slab.doubt * (above.offset - below.offset) > doubtful_volume
    return [layer for layer, is_kept in zip(layers, kept, strict=True) if is_kept]
