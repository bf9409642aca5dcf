"""Regions of many parallel planes, kept one behind the other, and their intersection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from manifold3d import CrossSection, FillRule
from numpy.typing import NDArray
from shapely import MultiPolygon

from momrec_core._clipping import apart, clip, measure, simplify, take
from momrec_core.rings import Rings, counts_of, ends_of, number_within

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
        counts = np.array([len(rings) for rings in loops], dtype=np.int64)
        return cls(Rings.of_loops([ring for rings in loops for ring in rings]), ends_of(counts))

    @classmethod
    def facing_left(cls, rings: Rings, first: NDArray[np.int64]) -> Regions:
        """Turn the contours of regions whose shells are wound clockwise."""
        regions = cls(rings, first)
        is_right = np.repeat(regions.areas < 0, counts_of(first))
        if not is_right.any():
            return regions
        numbers, positions = number_within(rings.counts)
        turned = rings.counts[numbers] - 1 - positions
        vertices = rings.first[numbers] + np.where(is_right[numbers], turned, positions)
        return cls(Rings(rings.points[vertices], rings.first), first)

    @classmethod
    def of_sections(cls, sections: Iterable[CrossSection]) -> Regions:
        """Take over the contours of cross-sections of Clipper2."""
        return cls.of_rings([section.to_polygons() for section in sections])

    @classmethod
    def joined(cls, parts: Sequence[Regions]) -> Regions:
        """Put regions one behind the other."""
        if len(parts) == 1:
            return parts[0]
        points = np.concatenate([part.rings.points for part in parts])
        counts = np.concatenate([part.rings.counts for part in parts])
        numbers = np.concatenate([counts_of(part.first) for part in parts])
        return cls(Rings(points, ends_of(counts)), ends_of(numbers))

    def __len__(self) -> int:
        return len(self.first) - 1

    @cached_property
    def is_met(self) -> NDArray[np.bool_]:
        """Whether each region has any contour."""
        return counts_of(self.first) > 0

    @cached_property
    def begins(self) -> list[int]:
        """The same as `first`, for access one by one."""
        begins: list[int] = self.first.tolist()
        return begins

    @property
    def areas(self) -> NDArray[np.float64]:
        """Area of each region."""
        return self._measures[0]

    @property
    def boxes(self) -> NDArray[np.float64]:
        """Least x and y, greatest x and y of each region; infinite where it is empty."""
        return self._measures[1]

    @cached_property
    def _measures(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        areas, boxes = np.empty(len(self)), np.empty((len(self), 4))
        measure(*self.arrays, areas, boxes)
        return areas, boxes

    @cached_property
    def centroids(self) -> NDArray[np.float64]:
        """Centroid of what the first contour of each region encloses; none may be empty."""
        return self.rings.centroids[self.first[:-1]]

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """The region of each contour."""
        return np.repeat(np.arange(len(self)), counts_of(self.first))

    def cleaned(self, tolerance: float) -> Regions:
        """Leave out vertices that stand out by no more than a tolerance, and what is thinner."""
        return _regions(*simplify(*self.arrays, tolerance))

    def part(self, low: int, high: int) -> Regions:
        """Return the regions from one to another."""
        rings = self.rings.first[self.first[low] : self.first[high] + 1]
        points = self.rings.points[rings[0] : rings[-1]]
        return Regions(
            Rings(points, rings - rings[0]), self.first[low : high + 1] - self.first[low]
        )

    def apart(self) -> tuple[Regions, NDArray[np.int64]]:
        """Take regions apart into pieces that are connected; holes of no shell are left out.

        Returns
        -------
        pieces : Regions
            Region by region; of each the shell, then the holes.
        ends : array of int, shape (regions + 1,)
            The first piece of each region, and the number of pieces.
        """
        ends = np.empty(len(self) + 1, dtype=np.int64)
        return _regions(*apart(*self.arrays, ends)), ends

    def polygons(self, unit: float) -> list[MultiPolygon]:
        """Return the regions in other units, ``unit`` of which are one of these."""
        pieces, ends = self.apart()
        rings = pieces.rings
        owners = np.repeat(np.arange(len(rings.counts)), rings.counts)
        loops = shapely.linearrings(unit * rings.points, indices=owners)
        polygons = shapely.polygons(loops, indices=pieces.owners)
        return [MultiPolygon(list(polygons[low:high])) for low, high in pairwise(ends.tolist())]

    def take(self, chosen: NDArray[np.int64]) -> Regions:
        """Return some of the regions, in any order."""
        if len(chosen) == len(self) and (chosen == np.arange(len(self))).all():
            return self
        return _regions(*take(*self.arrays, np.ascontiguousarray(chosen)))

    def loops(self, region: int) -> list[NDArray[np.float64]]:
        """Return the contours of a region, each shape (n_i, 2)."""
        ends = self.rings.first[self.begins[region] : self.begins[region + 1] + 1].tolist()
        return [self.rings.points[low:high] for low, high in pairwise(ends)]

    def section(self, region: int) -> CrossSection:
        """Return a region as a cross-section of Clipper2."""
        return CrossSection(self.loops(region), FillRule.Positive)

    def replaced(self, places: NDArray[np.int64], others: Regions) -> Regions:
        """Return these regions with others in some places, which increase."""
        if len(places) == len(self):
            return others
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

    def clipped(self, footprints: Sequence[Footprints], *, in_turn: bool = False) -> Regions:
        """Return what these regions have in common with all of some footprints, plane by plane.

        Notes
        -----
        Boundaries that cross clearly, each crossing and each vertex apart from everything else by
        more than `CLEARANCE`, are joined at their crossings (Weiler and Atherton). From where
        that is not so, a plane is left to Clipper2; if footprints are taken in turn, for one of
        them, so that the result is the same as if it were asked for after each.

        References
        ----------
        K. Weiler and P. Atherton, Hidden surface removal using polygon area sorting, 1977.
        """
        if not footprints or len(self) == 0:
            return self
        steps = tuple(footprint.arrays for footprint in footprints)
        planes, done = np.arange(len(self)), np.zeros(len(self), dtype=np.int64)
        regions = left = self
        while True:
            cut = _regions(*clip(*left.arrays, done, steps, CLEARANCE))
            regions = regions.replaced(planes, cut)
            doubtful = np.flatnonzero(done < len(footprints))
            if len(doubtful) == 0:
                return regions
            sections = []
            for place in doubtful.tolist():
                section = cut.section(place)
                end = done[place] + 1 if in_turn else len(footprints)
                for footprint in footprints[done[place] : end]:
                    section ^= footprint.section(planes[place])
                sections.append(section)
                done[place] = end
            left, planes, done = Regions.of_sections(sections), planes[doubtful], done[doubtful]
            steps = tuple(footprint.take(planes).arrays for footprint in footprints)

    @cached_property
    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Points, and where contours and regions begin, contiguous."""
        points = np.ascontiguousarray(self.rings.points)
        return points, np.ascontiguousarray(self.rings.first), np.ascontiguousarray(self.first)


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

    @classmethod
    def as_they_are(cls, outlines: Regions) -> Footprints:
        """Return one outline for each plane, where it is."""
        count = len(outlines)
        return cls(outlines, np.arange(count), np.ones(count), np.zeros((count, 2)))

    def take(self, chosen: NDArray[np.int64]) -> Footprints:
        """Return the footprints of some of the planes."""
        return Footprints(
            self.outlines, self.chosen[chosen], self.scales[chosen], self.shifts[chosen]
        )

    @property
    def arrays(
        self,
    ) -> tuple[
        NDArray[np.float64],
        NDArray[np.int64],
        NDArray[np.int64],
        NDArray[np.int64],
        NDArray[np.float64],
        NDArray[np.float64],
    ]:
        """The outlines' arrays, and what becomes of these in the planes, contiguous."""
        return (
            *self.outlines.arrays,
            np.ascontiguousarray(self.chosen),
            np.ascontiguousarray(self.scales),
            np.ascontiguousarray(self.shifts),
        )

    def section(self, plane: int) -> CrossSection:
        """Return the footprint in a plane as a cross-section of Clipper2."""
        which, scale = int(self.chosen[plane]), float(self.scales[plane])
        if which not in self._sections:
            self._sections[which] = self.outlines.section(which)
        outline = self._sections[which]
        if scale != 1.0:
            outline = outline.scale((scale, scale))
        return outline.translate(self.shifts[plane])

    @cached_property
    def _sections(self) -> dict[int, CrossSection]:
        """Outlines as cross-sections, as far as they have been asked for."""
        return {}


def _regions(points: bytes, rings: bytes, first: bytes) -> Regions:
    contours = Rings(np.frombuffer(points).reshape(-1, 2), np.frombuffer(rings, dtype=np.int64))
    return Regions(contours, np.frombuffer(first, dtype=np.int64))
