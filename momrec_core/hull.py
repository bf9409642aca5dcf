"""The visual hull: viewing volumes intersected slice by slice, view by view."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any, Self

import numpy as np
import trimesh
from numpy.typing import NDArray
from shapely import MultiPolygon

from momrec_core.errors import (
    DegenerateShapeError,
    EmptyHullError,
    InvalidContourError,
    NoCommonLineError,
)
from momrec_core.layers import (
    Slabs,
    layers_of_sections,
    match_layers,
    without_flakes,
    without_needless,
)
from momrec_core.regions import Regions
from momrec_core.rings import counts_of
from momrec_core.slicing import (
    Intersection,
    Levels,
    PlaneFamily,
    clip_levels,
    common_line,
    directions_to_slice,
    height_range,
    region_of_pairs,
    viewing_region,
)
from momrec_core.strips import surface_strips
from momrec_core.tiling import tile
from momrec_core.view import View

__all__ = ["VisualHull", "reconstruct"]

EMPTY_SHARE = 0.05  # of the planes at the ends without the hull, before the planes are laid anew
SPARSE_SHARE = 0.34  # of the planes that still meet the hull, below which that can't wait
SEARCH_ROUNDS, SEARCH_PLANES = 8, 4  # the hull's ends are found to a fifth of the gap each time
END_PRECISION = 5e-3  # of the spacing: how well the hull's ends are found
SEARCH_DENSITY = 32  # planes per spacing where a hull may hide between two planes
END_INSET = 1e-3  # of the spacing: how far inside its ends the hull is cut for its caps
DOUBTFUL_VOLUME = 1e-4  # of the hull's: what a slab with an event or a ledge may leave open
EVENT_DEPTH = 8  # halvings of such a slab at the most
MAX_LAYERS = 5  # times the slices: where everything changes everywhere, the worst comes first
MARGIN = 0.25  # of the sections' box: what the hull may stick out between two planes
END_MARGIN = 0.03  # of the extent along a new normal, beyond which the hull ends most likely
WIDENINGS = 8  # doublings of that, at most
TURN_SHARE = 0.3  # of how coarsely the planes cut the hull: when those along another line pay
REFIT_SHARE = 0.9  # the same where the planes have to be laid anew anyway
WEIGHED_PLANES = 9  # evenly chosen ones tell the hull's extents well enough
LEANING_POWER = 2  # of facets, beside the extent: measured, area errors follow it about like that
FEWEST_TO_TURN = 3  # views: two slice along their common line
SETTLED = ("_family", "_pair", "_levels", "_prepared", "_is_turned")  # what settling changes
MOST_AT_ONCE = 64  # views that sections are clipped with: bounds the memory for their outlines
SETTLED_AT = tuple(4**power for power in range(2, 16))  # views: seldom, as it costs like all
MAX_SPARE = 8  # silhouettes to spare: each costs as much as the hull itself


class VisualHull:
    """The intersection of viewing volumes, as cross-sections with parallel planes.

    The first two views whose viewing directions differ give the planes' normal, the common line
    of their image planes. The planes are equidistant and fill the extent that the views leave;
    when later views leave much less of it (pinhole cameras), the planes are laid anew. When the
    hull is asked for, the common lines of all views and their directions are weighed: planes lie
    the denser, the shorter the hull is along their normal, and cut its surface the better, the
    less of it leans towards them; they are turned where that pays. What comes of the views
    depends on them and their order alone, not on when it is asked for.

    Parameters
    ----------
    slices : int, default 64
        Number of slicing planes.
    spare : int, default 0
        The hull is what lies in at least all but so many of the viewing volumes, so that as many
        wrong silhouettes or poses cannot take anything away. At most 8.

    Attributes
    ----------
    views : list of View
        All views so far, in the order of their arrival.
    spare : int
        How many viewing volumes a point of the hull may be outside of.
    ready : bool
        Whether two views with different viewing directions have come, whichever are spared.
    emptied_by : int or None
        Index of the view that left nothing of the hull.

    References
    ----------
    Section 2 of the paper; W. N. Martin and J. K. Aggarwal, Volumetric descriptions of objects
    from multiple views, 1983.
    """

    def __init__(self, slices: int = 64, *, spare: int = 0) -> None:
        if not isinstance(slices, int | np.integer) or slices < 2:
            raise ValueError(f"Expected a whole number of at least 2 slices, got {slices!r}")
        if not isinstance(spare, int | np.integer) or not 0 <= spare <= MAX_SPARE:
            raise ValueError(f"Expected 0 to {MAX_SPARE} silhouettes to spare, got {spare!r}")
        self._count = int(slices)
        self.spare = int(spare)
        self.views: list[View] = []
        self.emptied_by: int | None = None
        self._pairs: tuple[tuple[int, int], ...] = ()
        self._pair: tuple[int, int] | None = None
        self._family: PlaneFamily | None = None
        self._prepared: Intersection | None = None
        self._levels: Levels = []
        self._is_turned = False
        self._gathering: dict[str, Any] | None = None  # the state to go on gathering with

    def __copy__(self) -> Self:
        duplicate = type(self)(self._count, spare=self.spare)
        duplicate.__dict__.update(self.__dict__)
        duplicate.views = self.views.copy()
        return duplicate

    def __getstate__(self) -> dict[str, object]:
        """Leave out what is made ready again at need: other processes take no functions."""
        unprepared = {"_prepared": None}
        gathering = None if self._gathering is None else self._gathering | unprepared
        return self.__dict__ | unprepared | {"_gathering": gathering}

    @property
    def ready(self) -> bool:
        """Whether two views with different viewing directions have come, whichever are spared."""
        return self._family is not None

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
        self.extend([view])

    def extend(self, views: Iterable[View]) -> None:
        """Intersect the hull with more viewing volumes: the same as `add` for each.

        All at once takes down to two thirds of the time of one by one.

        Parameters
        ----------
        views : iterable of View
            In the order of their arrival.

        Raises
        ------
        InvalidContourError
            If one is no `View`; the hull is as before.
        """
        waiting = deque(views)
        for view in waiting:
            if not isinstance(view, View):
                raise InvalidContourError(f"Expected a View, got {type(view).__name__}")
        if waiting:
            self._resume()
        while waiting:
            if self._family is None:
                self.views.append(waiting.popleft())
                self._begin()
            elif self.emptied_by is None:
                count = min(len(waiting), MOST_AT_ONCE, self._until_settled())
                self._clip([waiting.popleft() for _ in range(count)], self._family)
            else:
                self.views.append(waiting.popleft())

    def _until_settled(self) -> int:
        """Return how many views may come until the planes are to be settled."""
        until: int = SETTLED_AT[bisect_right(SETTLED_AT, len(self.views))]
        return until - len(self.views)

    def _clip(self, views: Sequence[View], family: PlaneFamily) -> None:
        """Clip with all views at once, unless the planes have to be looked at after each."""
        before = self._sections
        prepared = self._intersection(family).with_views(views)
        newest_last = prepared.volumes[: len(views)][::-1]
        levels = clip_levels(self._levels, newest_last, family.offsets, in_turn=True)
        if len(views) > 1 and self._is_sparse(levels[-1]):
            for view in views:
                self.extend([view])
            return
        self._prepared, self._levels = prepared, levels
        self.views.extend(views)
        self._after_clipping(before)
        if len(self.views) in SETTLED_AT:
            self._settle()

    @property
    def _sections(self) -> Regions:
        return self._levels[-1]

    def _begin(self) -> None:
        """Lay the planes if views with different directions are there, whichever are spared."""
        last = len(self.views) - 1
        lines = (common_line(earlier, self.views[last]) for earlier in self.views[:-1])
        found = [(index, line) for index, line in enumerate(lines) if line is not None]
        self._pairs += tuple((index, last) for index, _ in found)
        if not found or not _outlast(self._pairs, self.spare):
            return
        index, normal = found[0]
        self._family = self._first_region(index, normal)
        if self._family.high <= self._family.low:
            self.emptied_by = last
            self._levels = [Regions.of_rings([[]] * self._count)]
            return
        self._cut()
        self._after_clipping(None)

    def _first_region(self, index: int, normal: NDArray[np.float64]) -> PlaneFamily:
        """Lay planes through what the last view has in common with another, or what all have."""
        if self.spare:
            pairs = [(self.views[first], self.views[second]) for first, second in self._pairs]
            return region_of_pairs(pairs, normal, self._count)
        self._pair = index, len(self.views) - 1
        return viewing_region(self.views[index], self.views[-1], normal, self._count)

    def _cut(self) -> None:
        family = self._require_family()
        self._levels = self._intersection(family).levels(family.offsets)

    def _after_clipping(self, before: Regions | None) -> None:
        """Keep enough planes on a hull that has become small, and notice when it is gone.

        The hull was where the sections before met it; without them, it may be anywhere.
        """
        if not self._is_sparse(self._sections):
            return
        if not self._sections.is_met.any():
            planes = np.arange(self._count) if before is None else _occupied(before)
            if not self._search_between(planes):
                self.emptied_by = len(self.views) - 1
                return
        self._fit()

    def _is_sparse(self, sections: Regions) -> bool:
        return bool(np.count_nonzero(sections.is_met) < SPARSE_SHARE * self._count)

    def _search_between(self, previous: NDArray[np.int64]) -> bool:
        """Look between the planes for a hull thinner than their spacing."""
        family = self._require_family()
        low, high = self._bracket(previous)
        if not self.spare:
            lowest, highest = height_range(self.views[-1], family)
            low, high = max(low, lowest), min(high, highest)
        if low >= high:
            return False
        count = SEARCH_DENSITY * (min(len(previous), self._count) + 1)
        finer = PlaneFamily.spread(family.frame, family.unit, low, high, count)
        levels = self._intersection(finer).levels(finer.offsets)
        if len(_occupied(levels[-1])) == 0:
            return False
        self._family, self._levels = finer, levels
        return True

    def _bracket(self, occupied: NDArray[np.int64]) -> tuple[float, float]:
        """Return offsets between which the hull lies, given the planes that meet it."""
        family = self._require_family()
        offsets = np.concatenate([[family.low], family.offsets, [family.high]])
        return float(offsets[occupied[0]]), float(offsets[occupied[-1] + 2])

    def _intersection(self, family: PlaneFamily) -> Intersection:
        """Return the viewing volumes ready to be cut, prepared once for a family."""
        if self._prepared is None or self._prepared.family is not family:
            self._prepared = Intersection(self.views, self._pair, family, self.spare)
        return self._prepared

    def _fit(self) -> None:
        """Lay the planes anew between the ends of what is left of the hull."""
        family, before = self._require_family(), self._state()
        occupied = _occupied(self._sections)
        points = self._sections.rings.points
        corner_low, corner_high = points.min(axis=0), points.max(axis=0)
        ends = self._find_ends(self._bracket(occupied), family.offsets[occupied[[0, -1]]])
        self._lay(corner_low, corner_high, ends)
        self._go_back_if_missed(before)

    def _lay(
        self,
        corner_low: NDArray[np.float64],
        corner_high: NDArray[np.float64],
        ends: tuple[float, float],
    ) -> None:
        """Lay the planes between two ends, through a box around the sections."""
        margin = MARGIN * (corner_high - corner_low).max()
        low, high = ends
        self._family = self._require_family().recentred(
            np.array([*(corner_low - margin), low]),
            np.array([*(corner_high + margin), high]),
            self._count,
        )
        self._cut()

    def _find_ends(
        self, outside: tuple[float, float], inside: NDArray[np.float64]
    ) -> tuple[float, float]:
        """Narrow down where the hull ends, between offsets that it does not reach and does."""
        (low, high), (low_inside, high_inside) = outside, inside
        steps = np.arange(1, SEARCH_PLANES + 1) / (SEARCH_PLANES + 1)
        hull = self._intersection(self._require_family())
        precision = END_PRECISION * (high_inside - low_inside) / self._count
        for _ in range(SEARCH_ROUNDS):
            if max(low_inside - low, high - high_inside) <= precision:
                break
            from_low = low + steps * (low_inside - low)
            from_high = high + steps * (high_inside - high)
            found = hull.cut(np.concatenate([from_low, from_high])).is_met
            low, low_inside = _narrow(low, low_inside, from_low, found[:SEARCH_PLANES])
            high, high_inside = _narrow(high, high_inside, from_high, found[SEARCH_PLANES:])
        return low, high

    def _state(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in SETTLED}

    def _go_back_if_missed(self, before: dict[str, Any]) -> None:
        """Take the planes from before where those laid since pass between the hull's pieces."""
        if not self._sections.is_met.any():
            self.__dict__.update(before)

    def _settled(self) -> PlaneFamily:
        """Return the planes as they suit the hull best, until the next view comes."""
        self._require_family()
        if self._gathering is None:
            self._gathering = self._state()
            self._settle()
        return self._require_family()

    def _resume(self) -> None:
        """Go back to the planes that views are gathered with, asked for or not."""
        if self._gathering is not None:
            self.__dict__.update(self._gathering)
            self._gathering = None

    def _settle(self) -> None:
        """Turn the planes, or lay them anew, where that makes them denser on the hull."""
        if self.emptied_by is not None:
            return
        occupied = _occupied(self._sections)
        unused = self._count - (occupied[-1] - occupied[0] + 1)
        is_due = bool(unused > EMPTY_SHARE * self._count)
        share = REFIT_SHARE if is_due or self._is_turned else TURN_SHARE
        if not self._turn(share) and is_due:
            self._fit()

    def _turn(self, share: float) -> bool:
        """Turn the planes if those along another normal cut the hull less than a share as coarsely.

        How coarsely is the hull's extent along the normal, times how far its facets lean.
        """
        if len(self.views) < FEWEST_TO_TURN:
            return False
        points = self._outlines(WEIGHED_PLANES)
        lines, pairs = directions_to_slice(self.views)
        normals = np.vstack([lines, self._require_family().frame[:3, 2]])
        strips = surface_strips(self.views, points.mean(axis=0), self.spare)
        coarseness = np.ptp(points @ normals.T, axis=0) * strips.leaning(normals) ** LEANING_POWER
        best = int(np.argmin(coarseness[:-1]))
        if coarseness[best] > share * coarseness[-1]:
            return False
        self._turn_to(lines[best], None if self.spare else pairs[best])
        return True

    def _outlines(self, most: int) -> NDArray[np.float64]:
        """Return the vertices of so many sections in the world, shape (n, 3)."""
        family = self._require_family()
        occupied = _occupied(self._sections)
        chosen = occupied[np.linspace(0, len(occupied) - 1, min(most, len(occupied))).astype(int)]
        sections = self._sections.take(chosen)
        counts = counts_of(sections.rings.first[sections.first])
        heights = np.repeat(family.offsets[chosen], counts)
        return family.to_world(np.column_stack([sections.rings.points, heights]))

    def _turn_to(self, normal: NDArray[np.float64], pair: tuple[int, int] | None) -> None:
        """Lay the planes perpendicular to another normal, the common line of a pair or not."""
        points, before = self._outlines(self._count), self._state()
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        reach = (1 + MARGIN) * float(np.linalg.norm(points - middle, axis=1).max())
        self._family = PlaneFamily.through_sphere(middle, reach, normal, self._count)
        self._pair, self._is_turned = pair, True
        box = self._family.to_planes(points)
        low, high = box.min(axis=0), box.max(axis=0)
        inside = np.array([low[2], high[2]])
        self._lay(low[:2], high[:2], self._find_ends(self._outside(inside), inside))
        self._go_back_if_missed(before)

    def _outside(self, inside: NDArray[np.float64]) -> tuple[float, float]:
        """Return offsets that the hull does not reach, beyond two that it about reaches."""
        hull = self._intersection(self._require_family())
        margin = END_MARGIN * (inside[1] - inside[0]) * np.array([-1.0, 1.0])
        for _ in range(WIDENINGS):
            met = hull.cut(inside + margin).is_met
            if not met.any():
                break
            margin[met] *= 2
        low, high = inside + margin
        return float(low), float(high)

    def _require_family(self) -> PlaneFamily:
        if self._family is None:
            raise NoCommonLineError(
                "Expected two views with different viewing directions, got "
                f"{len(self.views)} from the same side"
                + (f" without {self.spare} of them" if self.spare else "")
            )
        return self._family

    @property
    def plane_frame(self) -> NDArray[np.float64]:
        """Pose of the planes' frame in the world, z along their normal, metres; shape (4, 4)."""
        return self._settled().frame.copy()

    @property
    def offsets(self) -> NDArray[np.float64]:
        """Positions of the planes along the normal, metres, increasing; shape (slices,).

        They are the centres of equal slabs that fill the hull's extent, so that the sum of the
        sections' areas times the spacing is the volume (midpoint rule). Where so few would all
        pass between the hull's pieces, they are others, which may be more and reach further.
        """
        family = self._settled()
        return family.offsets * family.unit

    @property
    def sections(self) -> list[MultiPolygon]:
        """Cross-section with each plane, in the planes' frame's x and y, metres."""
        unit = self._settled().unit
        return self._sections.polygons(unit)

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
        family = self._settled()
        if self.emptied_by is not None:
            raise EmptyHullError(
                "Expected viewing volumes with a point in common, but view "
                f"{self.emptied_by} (counting from 0) leaves nothing of the {self.emptied_by} "
                "before it"
            )
        slabs = self._slabs(family)
        if not slabs.layers.counts[slabs.sides].any():
            raise DegenerateShapeError(
                f"Expected a hull thick enough for {self._count} slices, got one so thin and "
                "slanted that no two of them overlap; more slices may help"
            )
        vertices, faces = tile(slabs)
        return trimesh.Trimesh(family.to_world(vertices), faces, process=False)

    def _slabs(self, family: PlaneFamily) -> Slabs:
        """Return what is between the sections and those that the surface needs besides.

        Where pieces or holes appear, vanish, split or join between two planes, where the section's
        area jumps, and at the ends, the slab is halved until what it leaves open is negligible.
        """
        inset = END_INSET * family.spacing
        ends = np.array([family.low + inset, family.high - inset])
        hull = self._intersection(family)
        offsets = np.concatenate([[family.low, family.high], ends, family.offsets])
        parts = [Regions.of_rings([[], []]), hull.cut(ends), self._sections]
        layers = layers_of_sections(offsets, Regions.joined(parts))
        largest = float(layers.areas.max())
        doubtful = DOUBTFUL_VOLUME * family.spacing * float(layers.areas.sum())
        rounds = [match_layers(layers, layers.adjacent)]
        for _ in range(EVENT_DEPTH):
            doubts = rounds[-1].doubts(largest)
            chosen = np.flatnonzero(doubts > doubtful)
            room = MAX_LAYERS * len(family.offsets) - len(rounds[-1].layers)
            if len(chosen) > room:
                chosen = np.sort(np.argsort(-doubts, kind="stable")[:room])
            if not len(chosen):
                break
            rounds.append(rounds[-1].halved(chosen, hull.cut))
        slabs = without_flakes(Slabs.joined(rounds))
        return without_needless(slabs, len(layers), doubtful)


def _outlast(pairs: Sequence[tuple[int, int]], spare: int) -> bool:
    """Tell whether a pair is left, whichever views are left out, so many of them."""
    if not pairs or spare == 0:
        return bool(pairs)
    return all(
        _outlast([pair for pair in pairs if view not in pair], spare - 1) for view in pairs[0]
    )


def _occupied(sections: Regions) -> NDArray[np.int64]:
    return np.flatnonzero(sections.is_met)


def _narrow(
    outside: float, inside: float, offsets: NDArray[np.float64], found: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return the last offset without the hull and the first with it, going inward."""
    if not found.any():
        return float(offsets[-1]), inside
    first = int(np.argmax(found))
    return (float(offsets[first - 1]) if first else outside), float(offsets[first])


def reconstruct(views: Iterable[View], slices: int = 64, *, spare: int = 0) -> VisualHull:
    """Return the visual hull of views.

    Parameters
    ----------
    views : iterable of View
        In any order; at least two with different viewing directions for a mesh.
    slices : int, default 64
        Number of slicing planes.
    spare : int, default 0
        How many viewing volumes a point of the hull may be outside of.

    Returns
    -------
    hull : VisualHull
    """
    hull = VisualHull(slices, spare=spare)
    hull.extend(views)
    return hull
