"""The visual hull: viewing volumes intersected slice by slice, view by view."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Self

import numpy as np
import trimesh
from manifold3d import CrossSection
from numpy.typing import NDArray
from shapely import MultiPolygon

from momrec_core.errors import (
    DegenerateShapeError,
    EmptyHullError,
    InvalidContourError,
    NoCommonLineError,
)
from momrec_core.layers import (
    Layer,
    Slabs,
    layers_of_sections,
    region_of_section,
    without_flakes,
    without_needless,
)
from momrec_core.slicing import (
    Intersection,
    PlaneFamily,
    clip_sections,
    common_line,
    height_range,
    viewing_region,
    viewing_volume,
)
from momrec_core.tiling import tile
from momrec_core.view import View

__all__ = ["VisualHull", "reconstruct"]

EMPTY_SHARE = 0.05  # of the planes at the ends without the hull, before the planes are laid anew
SPARSE_SHARE = 0.34  # of the planes that still meet the hull, below which that can't wait
SEARCH_ROUNDS, SEARCH_PLANES = 4, 4  # the hull's ends are found to 1 / 5^4 of a spacing
SEARCH_DENSITY = 32  # planes per spacing where a hull may hide between two planes
END_INSET = 1e-3  # of the spacing: how far inside its ends the hull is cut for its caps
DOUBTFUL_VOLUME = 2e-5  # of the hull's: what a slab with an event or a ledge may leave open
EVENT_DEPTH = 8  # halvings of such a slab at the most
MAX_LAYERS = 5  # times the slices: where everything changes everywhere, the worst comes first
MARGIN = 0.25  # of the sections' box: what the hull may stick out between two planes


class VisualHull:
    """The intersection of viewing volumes, as cross-sections with parallel planes.

    The first two views whose viewing directions differ give the planes' normal, the common line
    of their image planes. The planes are equidistant and fill the extent that the views leave;
    when later views leave much less of it (pinhole cameras), the planes are laid anew.

    Parameters
    ----------
    slices : int, default 64
        Number of slicing planes.

    Attributes
    ----------
    views : list of View
        All views so far, in the order of their arrival.
    ready : bool
        Whether two views with different viewing directions have come.
    emptied_by : int or None
        Index of the view that left nothing of the hull.

    References
    ----------
    Section 2 of the paper; W. N. Martin and J. K. Aggarwal, Volumetric descriptions of objects
    from multiple views, 1983.
    """

    def __init__(self, slices: int = 64) -> None:
        if not isinstance(slices, int | np.integer) or slices < 2:
            raise ValueError(f"Expected a whole number of at least 2 slices, got {slices!r}")
        self._count = int(slices)
        self.views: list[View] = []
        self.emptied_by: int | None = None
        self._pair: tuple[int, int] | None = None
        self._family: PlaneFamily | None = None
        self._sections: list[CrossSection] = []

    def __copy__(self) -> Self:
        duplicate = type(self)(self._count)
        duplicate.__dict__.update(self.__dict__)
        duplicate.views = self.views.copy()
        return duplicate

    @property
    def ready(self) -> bool:
        """Whether two views with different viewing directions have come."""
        return self._pair is not None

    def add(self, view: View) -> None:
        """Intersect the hull with one more viewing volume.

        Views from the same or the opposite side wait until one comes from another side; then
        all of them take part. A view that leaves nothing is told by `emptied_by`.

        Parameters
        ----------
        view : View
            Any camera, anywhere.

        Raises
        ------
        InvalidContourError
            If it is no `View`; the hull is as before.
        """
        if not isinstance(view, View):
            raise InvalidContourError(f"Expected a View, got {type(view).__name__}")
        self.views.append(view)
        if self._family is None:
            self._begin()
        elif self.emptied_by is None:
            before = self._sections
            self._sections = clip_sections(
                before, viewing_volume(view, self._family), self._family.offsets
            )
            self._after_clipping(before)

    def _begin(self) -> None:
        """Lay the planes if the last view makes a pair with an earlier one."""
        last = len(self.views) - 1
        for index, earlier in enumerate(self.views[:-1]):
            normal = common_line(earlier, self.views[last])
            if normal is None:
                continue
            self._pair = index, last
            self._family = viewing_region(earlier, self.views[last], normal, self._count)
            if self._family.high <= self._family.low:
                self.emptied_by = last
                self._sections = [CrossSection()] * self._count
                return
            self._sections = self._intersection(self._family).cut(self._family.offsets)
            self._after_clipping(None)
            return

    def _after_clipping(self, before: list[CrossSection] | None) -> None:
        """Keep enough planes on a hull that has become small, and notice when it is gone.

        The hull was where the sections before met it; without them, it may be anywhere.
        """
        occupied = _occupied(self._sections)
        if len(occupied) >= SPARSE_SHARE * self._count:
            return
        if len(occupied) == 0:
            planes = np.arange(self._count) if before is None else _occupied(before)
            if not self._search_between(planes):
                self.emptied_by = len(self.views) - 1
                return
        self._fit()

    def _search_between(self, previous: NDArray[np.int64]) -> bool:
        """Look between the planes for a hull thinner than their spacing."""
        family = self._require_family()
        ranges = np.array([self._bracket(previous), height_range(self.views[-1], family)])
        low, high = float(ranges[:, 0].max()), float(ranges[:, 1].min())
        if low >= high:
            return False
        count = SEARCH_DENSITY * (len(previous) + 1)
        finer = PlaneFamily.spread(family.frame, family.unit, low, high, count)
        sections = self._intersection(finer).cut(finer.offsets)
        if len(_occupied(sections)) == 0:
            return False
        self._family, self._sections = finer, sections
        return True

    def _bracket(self, occupied: NDArray[np.int64]) -> tuple[float, float]:
        """Return offsets between which the hull lies, given the planes that meet it."""
        family = self._require_family()
        offsets = np.concatenate([[family.low], family.offsets, [family.high]])
        return float(offsets[occupied[0]]), float(offsets[occupied[-1] + 2])

    def _intersection(self, family: PlaneFamily) -> Intersection:
        return Intersection(self.views, self._require_pair(), family)

    def _fit(self) -> None:
        """Lay the planes anew between the ends of what is left of the hull."""
        family = self._require_family()
        occupied = _occupied(self._sections)
        low, high = self._find_ends(*self._bracket(occupied), occupied)
        bounds = np.array([self._sections[index].bounds() for index in occupied])
        corner_low, corner_high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
        margin = MARGIN * (corner_high - corner_low).max()
        self._family = family.recentred(
            np.array([*(corner_low - margin), low]),
            np.array([*(corner_high + margin), high]),
            self._count,
        )
        self._sections = self._intersection(self._family).cut(self._family.offsets)

    def _find_ends(
        self, low: float, high: float, occupied: NDArray[np.int64]
    ) -> tuple[float, float]:
        """Narrow down where the hull ends, between an empty plane and one that meets it."""
        family = self._require_family()
        low_inside, high_inside = family.offsets[occupied[[0, -1]]]
        steps = np.arange(1, SEARCH_PLANES + 1) / (SEARCH_PLANES + 1)
        hull = self._intersection(family)
        for _ in range(SEARCH_ROUNDS):
            from_low = low + steps * (low_inside - low)
            from_high = high + steps * (high_inside - high)
            found = _meets(hull.cut(np.concatenate([from_low, from_high])))
            low, low_inside = _narrow(low, low_inside, from_low, found[:SEARCH_PLANES])
            high, high_inside = _narrow(high, high_inside, from_high, found[SEARCH_PLANES:])
        return low, high

    def _settle(self) -> PlaneFamily:
        """Return the planes, laid anew if too many at the ends do not meet the hull."""
        self._require_family()
        if self.emptied_by is None:
            occupied = _occupied(self._sections)
            unused = self._count - (occupied[-1] - occupied[0] + 1)
            if unused > EMPTY_SHARE * self._count:
                self._fit()
        return self._require_family()

    def _require_family(self) -> PlaneFamily:
        if self._family is None:
            raise NoCommonLineError(
                "Expected two views with different viewing directions, got "
                f"{len(self.views)} from the same side"
            )
        return self._family

    def _require_pair(self) -> tuple[int, int]:
        if self._pair is None:
            raise NoCommonLineError("Expected two views with different viewing directions")
        return self._pair

    @property
    def plane_frame(self) -> NDArray[np.float64]:
        """Pose of the planes' frame in the world, z along their normal, metres; shape (4, 4)."""
        return self._settle().frame.copy()

    @property
    def offsets(self) -> NDArray[np.float64]:
        """Positions of the planes along the normal, metres, increasing; shape (slices,).

        They are the centres of equal slabs that fill the hull's extent, so that the sum of the
        sections' areas times the spacing is the volume (midpoint rule).
        """
        family = self._settle()
        return family.offsets * family.unit

    @property
    def sections(self) -> list[MultiPolygon]:
        """Cross-section with each plane, in the planes' frame's x and y, metres."""
        family = self._settle()
        return [region_of_section(section, family.unit) for section in self._sections]

    def mesh(self) -> trimesh.Trimesh:
        """Join the slices into a closed surface.

        Returns
        -------
        mesh : Trimesh
            In the world, metres; closed, edge-manifold, wound outward.

        Raises
        ------
        NoCommonLineError
            If all views so far are from the same or the opposite side.
        EmptyHullError
            If the viewing volumes have no point in common; names the view that emptied it.
        DegenerateShapeError
            If the hull is too thin and slanted for its number of slices.
        """
        family = self._settle()
        if self.emptied_by is not None:
            raise EmptyHullError(
                "Expected viewing volumes with a point in common, but view "
                f"{self.emptied_by} (counting from 0) leaves nothing of the {self.emptied_by} "
                "before it"
            )
        slabs = Slabs()
        layers = self._layers(family, slabs)
        if not any(len(layer) for layer in layers):
            raise DegenerateShapeError(
                f"Expected a hull thick enough for {self._count} slices, got one so thin and "
                "slanted that no two of them overlap; more slices may help"
            )
        vertices, faces = tile(slabs.between(pairwise(layers)))
        return trimesh.Trimesh(family.to_world(vertices), faces, process=False)

    def _layers(self, family: PlaneFamily, slabs: Slabs) -> list[Layer]:
        """Return the sections and those between them that the surface needs besides.

        Where pieces or holes appear, vanish, split or join between two planes, where the section's
        area jumps, and at the ends, the slab is halved until what it leaves open is negligible.
        """
        inset = END_INSET * family.spacing
        ends = np.array([family.low + inset, family.high - inset])
        hull = self._intersection(family)
        bottom, top = hull.cut(ends)
        offsets = [family.low, ends[0], *family.offsets, ends[1], family.high]
        sections = [CrossSection(), bottom, *self._sections, top, CrossSection()]
        layers = layers_of_sections(offsets, sections)
        largest = max(layer.area for layer in layers)
        doubtful = DOUBTFUL_VOLUME * family.spacing * sum(layer.area for layer in layers)
        open_slabs = slabs.between(pairwise(layers))
        for _ in range(EVENT_DEPTH):
            open_slabs = [slab for slab in open_slabs if slab.leaves_open(doubtful, largest)]
            room = MAX_LAYERS * self._count - len(layers)
            if len(open_slabs) > room:
                open_slabs.sort(key=lambda slab: -slab.doubt(largest))
            open_slabs = open_slabs[:room]
            if not open_slabs:
                break
            middles = np.array([slab.below.offset + slab.height / 2 for slab in open_slabs])
            new = layers_of_sections(middles, hull.cut(middles))
            layers.extend(new)
            open_slabs = slabs.between(
                half
                for slab, middle in zip(open_slabs, new, strict=True)
                for half in ((slab.below, middle), (middle, slab.above))
            )
        layers = without_flakes(sorted(layers, key=lambda layer: layer.offset), slabs)
        return without_needless(layers, slabs, set(offsets), doubtful)


def _meets(sections: list[CrossSection]) -> NDArray[np.bool_]:
    return np.array([not section.is_empty() for section in sections])


def _occupied(sections: list[CrossSection]) -> NDArray[np.int64]:
    return np.flatnonzero(_meets(sections))


def _narrow(
    outside: float, inside: float, offsets: NDArray[np.float64], found: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return the last offset without the hull and the first with it, going inward."""
    if not found.any():
        return float(offsets[-1]), inside
    first = int(np.argmax(found))
    return (float(offsets[first - 1]) if first else outside), float(offsets[first])


def reconstruct(views: Iterable[View], slices: int = 64) -> VisualHull:
    """Return the visual hull of views.

    Parameters
    ----------
    views : iterable of View
        In any order; at least two with different viewing directions for a mesh.
    slices : int, default 64
        Number of slicing planes.

    Returns
    -------
    hull : VisualHull
    """
    hull = VisualHull(slices)
    for view in views:
        hull.add(view)
    return hull
