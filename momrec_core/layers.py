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

CLEANING = 1e-6  # units: vertices that stand out less are rounding, not shape
MIN_AREA_RATIO = 0.4  # of two matching pieces, below which one contour is no image of the other
MAX_AREA_RATIO = 1 / MIN_AREA_RATIO
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
    return [_polygon(part.to_polygons()) for part in parts]


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
        np.indices((below, above)).reshape(2, -1).T + first[[2 * slab, 2 * slab + 1]]
        for slab, (below, above) in enumerate(counts)
    ]
    lower, upper = _meeting(pieces, np.concatenate(candidates))
    graph = coo_array((np.ones(len(lower)), (lower, upper)), shape=(len(pieces), len(pieces)))
    _, labels = connected_components(graph, directed=False)
    order = np.argsort(labels, kind="stable")
    slab_of = np.repeat(np.arange(len(pairs)), counts.sum(axis=1))
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
            slabs[slab].doubt += _unshared_area(pieces[members], areas, len(low))
    return slabs


def _slab_of_ledge(below: Layer, above: Layer, largest: float) -> Slab:
    step = abs(above.area - below.area)
    return Slab(doubt=step if step > LEDGE * largest else 0.0)


def _unshared_area(pieces: NDArray[np.object_], areas: NDArray[np.float64], below: int) -> float:
    """Return the area that is in pieces below and not in those above, or the other way."""
    lower, upper = np.indices((below, len(pieces) - below)).reshape(2, -1)
    common = shapely.intersection(pieces[lower], pieces[below + upper], grid_size=CLEANING)
    return float(areas.sum() - 2 * shapely.area(common).sum())


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
