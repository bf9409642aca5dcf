"""Regions of many parallel planes, kept one behind the other, and their intersection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from manifold3d import CrossSection, FillRule
from numpy.typing import NDArray

from momrec_core._clipping import intersect
from momrec_core.rings import Rings, number_within

__all__ = ["Footprints", "Regions"]

CLEARANCE = 1e-6  # units: boundaries that come nearer to each other's vertices are degenerate


@dataclass(frozen=True, eq=False)
class Regions:
    """One region for each of several planes.

    Attributes
    ----------
    rings : Rings
        Their contours, region by region, shape (n, 2), with the inside on the left: shells
        counter-clockwise, holes clockwise. They do not cross.
    first : array of int, shape (regions + 1,)
        The first contour of each region, and the number of contours.
    """

    rings: Rings
    first: NDArray[np.int64]

    @classmethod
    def of_rings(cls, loops: Sequence[Sequence[NDArray[np.float64]]]) -> Regions:
        """Join the contours of regions, which have the inside on their left already."""
        first = np.cumsum([0, *(len(rings) for rings in loops)])
        flat = [ring for rings in loops for ring in rings]
        points = np.concatenate([np.empty((0, 2)), *flat])
        return cls(Rings(points, np.cumsum([0, *(len(ring) for ring in flat)])), first)

    @classmethod
    def of_sections(cls, sections: Iterable[CrossSection]) -> Regions:
        """Take over the contours of cross-sections of Clipper2."""
        return cls.of_rings([section.to_polygons() for section in sections])

    @classmethod
    def joined(cls, parts: Sequence[Regions]) -> Regions:
        """Put regions one behind the other."""
        points = np.concatenate([part.rings.points for part in parts])
        counts = np.concatenate([part.rings.counts for part in parts])
        numbers = np.concatenate([np.diff(part.first) for part in parts])
        return cls(Rings(points, _ends(counts)), _ends(numbers))

    def __len__(self) -> int:
        return len(self.first) - 1

    @cached_property
    def is_met(self) -> NDArray[np.bool_]:
        """Whether each region has any contour."""
        return np.diff(self.first) > 0

    @cached_property
    def boxes(self) -> NDArray[np.float64]:
        """Least x and y, greatest x and y of each region that is met, shape (met, 4)."""
        starts = self.rings.first[self.first[:-1][self.is_met]]
        points = self.rings.points
        least, most = (take.reduceat(points, starts) for take in (np.minimum, np.maximum))
        return np.hstack([least, most])

    def take(self, chosen: NDArray[np.int64]) -> Regions:
        """Return some of the regions, in any order."""
        counts = np.diff(self.first)[chosen]
        owners, positions = number_within(counts)
        contours = self.first[chosen][owners] + positions
        vertices, _ = self.rings.around(contours)
        rings = Rings(self.rings.points[vertices], _ends(self.rings.counts[contours]))
        return Regions(rings, _ends(counts))

    def loops(self, region: int) -> list[NDArray[np.float64]]:
        """Return the contours of a region, each shape (n_i, 2)."""
        ends = self.rings.first[self.first[region] : self.first[region + 1] + 1]
        return [self.rings.points[low:high] for low, high in pairwise(ends.tolist())]

    def section(self, region: int) -> CrossSection:
        """Return a region as a cross-section of Clipper2."""
        return CrossSection(self.loops(region), FillRule.Positive)

    def replaced(self, places: NDArray[np.int64], others: Regions) -> Regions:
        """Return these regions with others in the places of some."""
        order = np.arange(len(self))
        order[places] = len(self) + np.arange(len(places))
        return Regions.joined([self, others]).take(order)

    def united(self, others: Regions) -> Regions:
        """Return the unions of these regions and others, plane by plane."""
        both = np.flatnonzero(self.is_met & others.is_met)
        order = np.arange(len(self)) + np.where(self.is_met, 0, len(self))
        joined = Regions.joined([self, others]).take(order)
        sections = [self.section(place) + others.section(place) for place in both.tolist()]
        return joined.replaced(both, Regions.of_sections(sections))

    def clipped(self, footprints: Footprints) -> Regions:
        """Return what these regions have in common with footprints, plane by plane.

        Notes
        -----
        Boundaries that cross clearly, each crossing and each vertex apart from everything else by
        more than `CLEARANCE`, are joined at their crossings (Weiler and Atherton). The other
        planes are left to Clipper2.

        References
        ----------
        K. Weiler and P. Atherton, Hidden surface removal using polygon area sorting, 1977.
        """
        outlines, is_doubtful = footprints.outlines, np.zeros(len(self), dtype=bool)
        points, rings, first = intersect(
            *self._arrays(),
            *outlines._arrays(),  # noqa: SLF001
            footprints.chosen,
            footprints.scales,
            footprints.shifts,
            is_doubtful,
            CLEARANCE,
        )
        clear = Regions(
            Rings(np.frombuffer(points).reshape(-1, 2), np.frombuffer(rings, dtype=np.int64)),
            np.frombuffer(first, dtype=np.int64),
        )
        doubtful = np.flatnonzero(is_doubtful)
        if len(doubtful) == 0:
            return clear
        sections = [self.section(plane) ^ footprints.section(plane) for plane in doubtful.tolist()]
        return clear.replaced(doubtful, Regions.of_sections(sections))

    def _arrays(self) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        return self.rings.points, self.rings.first, self.first


@dataclass(frozen=True, eq=False)
class Footprints:
    """What a viewing volume covers of each of several planes: outlines, scaled and shifted.

    Attributes
    ----------
    outlines : Regions
        The outlines.
    chosen : array of int, shape (planes,)
        The outline of each plane.
    scales : array, shape (planes,)
        What it is scaled by, about the origin.
    shifts : array, shape (planes, 2)
        By how much it is moved then.
    """

    outlines: Regions
    chosen: NDArray[np.int64]
    scales: NDArray[np.float64]
    shifts: NDArray[np.float64]

    def section(self, plane: int) -> CrossSection:
        """Return the footprint in a plane as a cross-section of Clipper2."""
        outline = self.outlines.section(int(self.chosen[plane]))
        return outline.scale(2 * (self.scales[plane],)).translate(self.shifts[plane])


def _ends(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(counts)])
