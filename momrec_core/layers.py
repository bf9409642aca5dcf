"""Cross-sections as polygons, and which pieces of adjacent ones belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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
    "differing_slabs",
    "hole_pairs",
    "match_layers",
    "region_of_section",
]

CLEANING = 1e-8  # units: vertices that stand out less are Clipper2's rounding, not shape
MIN_AREA_RATIO = 0.4  # of two matching pieces, below which one contour is no image of the other


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


@dataclass(frozen=True)
class Slab:
    """How the pieces of two adjacent layers belong together.

    Attributes
    ----------
    pairs : list of (int, int)
        Pieces below and above that are each other's only overlap, with holes that are as well.
    knots : list of (list of int, list of int)
        The other groups of overlapping pieces, below and above; a piece that overlaps none is
        a group of its own.
    """

    pairs: list[tuple[int, int]]
    knots: list[tuple[list[int], list[int]]]


def match_layers(below: Layer, above: Layer) -> Slab:
    """Group the pieces of two adjacent layers by overlap."""
    lower, upper = _overlaps(below.prepared, above.prepared)
    count = len(below.pieces)
    total = count + len(above.pieces)
    graph = coo_array((np.ones(len(lower)), (lower, upper + count)), shape=(total, total))
    groups, labels = connected_components(graph, directed=False) if total else (0, np.empty(0))
    slab = Slab([], [])
    for group in range(groups):
        members = np.flatnonzero(labels == group)
        low, high = members[members < count], members[members >= count] - count
        if len(low) == len(high) == 1 and _alike(below.pieces[low[0]], above.pieces[high[0]]):
            slab.pairs.append((int(low[0]), int(high[0])))
        else:
            slab.knots.append((low.tolist(), high.tolist()))
    return slab


def _overlaps(
    below: NDArray[np.object_], above: NDArray[np.object_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the index pairs of polygons that meet."""
    lower, upper = (index.ravel() for index in np.indices((len(below), len(above))))
    meet = shapely.intersects(below[lower], above[upper])
    return lower[meet], upper[meet]


def _alike(below: Polygon, above: Polygon) -> bool:
    """Tell whether each ring of one piece is the image of one ring of the other."""
    ratio = below.area / above.area
    if not MIN_AREA_RATIO < ratio < 1 / MIN_AREA_RATIO:
        return False
    return hole_pairs(below, above) is not None


def hole_pairs(below: Polygon, above: Polygon) -> list[tuple[int, int]] | None:
    """Match the holes of two pieces by overlap; None where that is not one to one."""
    count = len(below.interiors)
    if count != len(above.interiors):
        return None
    if count == 0:
        return []
    holes = [
        np.array([Polygon(hole) for hole in piece.interiors], dtype=object)
        for piece in (below, above)
    ]
    lower, upper = _overlaps(*holes)
    if len(lower) != count or len(set(lower.tolist())) + len(set(upper.tolist())) != 2 * count:
        return None
    return list(zip(lower.tolist(), upper.tolist(), strict=True))


def differing_slabs(layers: Sequence[Layer]) -> list[int]:
    """Return the slabs, by the index of the layer below, whose pieces do not match in pairs."""
    return [
        index
        for index in range(len(layers) - 1)
        if match_layers(layers[index], layers[index + 1]).knots
    ]
