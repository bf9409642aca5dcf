"""Where viewing volumes meet a family of parallel planes (section 2 of the paper).

Everything here is in the planes' frame, in thousandths of the region of interest
(`PlaneFamily.unit` metres), so that tolerances and Clipper2's grid, which is fixed at 2^-27, mean
the same for a coin and a car.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from momrec_core.camera import Camera
from momrec_core.lines import cross_products, nearest_point_equations
from momrec_core.regions import CLEARANCE, Footprints, Regions
from momrec_core.rings import Rings, ends_of, number_within
from momrec_core.scanning import scan_spans
from momrec_core.view import View, evenly_chosen

__all__ = [
    "Intersection",
    "Levels",
    "PlaneFamily",
    "clip_levels",
    "common_line",
    "directions_to_slice",
    "height_range",
    "region_of_pairs",
    "viewing_direction",
    "viewing_region",
    "viewing_volume",
]

MIN_ANGLE = np.radians(1.0)  # between viewing directions: below, depth is noise times 60 and more
LEAST_OF_CONE = 0.25  # of the angle of view: least angle between two pinholes' directions
STRIP_COSINE = 1e-5  # of direction and normal: below, the volume is one of strips to 1e-5
RADIUS = 1000.0  # units: of the region of interest
CENTRE_DISTANCE = 1e-4  # units: a plane nearer to a camera centre is taken as if this far from it
REGION_FACTOR = 3.0  # safety on the size that two views suggest, for cones that meet far outside
MAX_WEIGHED = 16  # views whose directions are weighed: 120 common lines are dense enough
SOUND_SINE = 0.2  # of the angle between two views whose common line is worth turning to


def viewing_direction(view: View) -> NDArray[np.float64]:
    """Return the unit vector in the world from the camera towards the silhouette's middle.

    For parallel projection that is the optical axis. A pinhole's optical axis says nothing about
    where the object is seen from when the object is off the image's middle, so the ray through
    the middle of the silhouette's bounding box stands for it.
    """
    camera = view.camera
    if not camera.is_pinhole:
        return camera.rotation[:, 2]
    left, low, right, high = view.silhouette.bounds
    ray = camera.rotation @ camera.rays_camera([[(left + right) / 2, (low + high) / 2]])[0]
    return np.asarray(ray / np.linalg.norm(ray))


def common_line(first: View, second: View) -> NDArray[np.float64] | None:
    """Return the unit direction of the line that two views' image planes share.

    Returns
    -------
    direction : array, shape (3,), or None
        In the world; None where the views see the object from the same or the opposite side, so
        that their image planes share no line to speak of: within one degree, or, for pinholes,
        a quarter of the angle under which they see the object, as their cones hardly close then.
    """
    normal = cross_products(viewing_direction(first), viewing_direction(second))
    sine = np.linalg.norm(normal)
    least = max(MIN_ANGLE, *(LEAST_OF_CONE * _apparent_angle(view) for view in (first, second)))
    return np.asarray(normal / sine) if sine > np.sin(least) else None


def _apparent_angle(view: View) -> float:
    """Return the angle, in radians, under which a pinhole sees the object; 0 for parallel rays."""
    if not view.camera.is_pinhole:
        return 0.0
    left, low, right, high = view.silhouette.bounds
    corners = view.camera.rays_camera([[left, low], [right, high]])
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    return float(np.arccos(np.clip(corners[0] @ corners[1], -1.0, 1.0)))


@dataclass(frozen=True, eq=False)
class PlaneFamily:
    """Parallel planes and the region of space in which they are of interest.

    Attributes
    ----------
    frame : array, shape (4, 4)
        Pose of the planes' frame in the world, ``world_from_planes``; z is the planes' normal,
        the origin the region's centre; metres.
    unit : float
        A thousandth of the radius of the region of interest, metres: lengths in `offsets` and
        sections count in it.
    low, high : float
        The hull lies between these offsets, in units.
    offsets : array, shape (n,)
        Positions of the planes along the normal, in units, increasing: the centres of n equal
        slabs between `low` and `high`.
    """

    frame: NDArray[np.float64]
    unit: float
    low: float
    high: float
    offsets: NDArray[np.float64]

    @classmethod
    def spread(
        cls, frame: NDArray[np.float64], unit: float, low: float, high: float, count: int
    ) -> PlaneFamily:
        """Place `count` planes at the centres of equal slabs between two offsets."""
        offsets = low + (high - low) * (np.arange(count) + 0.5) / count
        return cls(frame, unit, low, high, offsets)

    @property
    def spacing(self) -> float:
        """Distance between adjacent planes, in units."""
        return (self.high - self.low) / len(self.offsets)

    @classmethod
    def through_sphere(
        cls, centre: NDArray[np.float64], radius: float, normal: NDArray[np.float64], count: int
    ) -> PlaneFamily:
        """Make a sphere the region of interest, with planes perpendicular to a unit vector."""
        frame = np.eye(4)
        frame[:3, :3] = _axes_along(normal)
        frame[:3, 3] = centre
        return cls.spread(frame, radius / RADIUS, -RADIUS, RADIUS, count)

    def to_planes(self, points_world: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points in the planes' frame, in units; shape (..., 3)."""
        return (points_world - self.frame[:3, 3]) @ self.frame[:3, :3] / self.unit

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points of the planes' frame (units) in the world, metres; shape (..., 3)."""
        moved = points @ (self.unit * self.frame[:3, :3]).T.copy()
        for axis in range(3):  # numpy is slow at rows of three
            moved[..., axis] += self.frame[axis, 3]
        return moved

    def recentred(
        self, low: NDArray[np.float64], high: NDArray[np.float64], count: int
    ) -> PlaneFamily:
        """Lay planes through a smaller box of interest, given by two corners in units."""
        frame = self.frame.copy()
        frame[:3, 3] = self.to_world((low + high) / 2)
        factor = float(np.linalg.norm(high - low)) / 2 / RADIUS
        half = float(high[2] - low[2]) / 2 / factor
        return self.spread(frame, self.unit * factor, -half, half, count)


def _axes_along(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation matrix whose last column is a unit vector."""
    aside = np.eye(3)[np.argmin(np.abs(normal))]
    x = cross_products(aside, normal)
    x /= np.linalg.norm(x)
    return np.column_stack([x, cross_products(normal, x), normal])


def viewing_region(
    first: View, second: View, normal: NDArray[np.float64], count: int
) -> PlaneFamily:
    """Lay planes through the space that two views have in common.

    Parameters
    ----------
    first, second : View
        Two views with different viewing directions.
    normal : array, shape (3,)
        Their common line.
    count : int
        Number of planes.

    Returns
    -------
    family : PlaneFamily
        `low` and `high` are where the two silhouettes end along the common line: exact for
        parallel projection; for a pinhole the ends of its cone within the region. `high` is
        below `low` where the two have nothing in common.
    """
    centre, radius = _common_sphere(first, second)
    family = PlaneFamily.through_sphere(centre, radius, normal, count)
    ranges = np.array([height_range(view, family) for view in (first, second)])
    low, high = max(-RADIUS, float(ranges[:, 0].max())), min(RADIUS, float(ranges[:, 1].min()))
    return PlaneFamily.spread(family.frame, family.unit, low, high, count)


def region_of_pairs(
    pairs: Sequence[tuple[View, View]], normal: NDArray[np.float64], count: int
) -> PlaneFamily:
    """Lay planes through all the space that any of several pairs of views have in common.

    Parameters
    ----------
    pairs : sequence of (View, View)
        Views with different viewing directions.
    normal : array, shape (3,)
        The planes' normal.
    count : int
        Number of planes.

    Returns
    -------
    family : PlaneFamily
        Its planes fill the region of interest.
    """
    spheres = [_common_sphere(first, second) for first, second in pairs]
    centres = np.array([centre for centre, _ in spheres])
    radii = np.array([radius for _, radius in spheres])
    centre = np.average(centres, axis=0, weights=1 / radii)
    reach = np.linalg.norm(centres - centre, axis=1) + radii
    return PlaneFamily.through_sphere(centre, float(reach.max()), normal, count)


def _common_sphere(first: View, second: View) -> tuple[NDArray[np.float64], float]:
    """Return centre and radius of a sphere that what two views have in common lies in."""
    views = (first, second)
    directions = np.array([viewing_direction(view) for view in views])
    middles = np.array([_middle_point(view) for view in views])
    centre = np.asarray(np.linalg.solve(*nearest_point_equations(middles, directions)))
    sine = np.linalg.norm(cross_products(*directions))
    sizes = sum(_apparent_radius(view, centre) for view in views)
    return centre, float(REGION_FACTOR * sizes / sine)


def directions_to_slice(
    views: Sequence[View],
) -> tuple[NDArray[np.float64], list[tuple[int, int] | None]]:
    """Return directions that planes may be perpendicular to, for some views evenly chosen.

    Returns
    -------
    normals : array, shape (n, 3)
        The common lines of two views, and viewing directions, in the world.
    pairs : list of (int, int) or None
        The two views of each common line.
    """
    chosen = evenly_chosen(views, MAX_WEIGHED)
    directions = np.array([viewing_direction(views[index]) for index in chosen])
    first, second = np.triu_indices(len(chosen), 1)
    lines = cross_products(directions[first], directions[second])
    sines = np.linalg.norm(lines, axis=1)
    sound = np.flatnonzero(sines > SOUND_SINE)
    lines = lines[sound] / sines[sound, None]
    pairs = zip(chosen[first[sound]].tolist(), chosen[second[sound]].tolist(), strict=True)
    return np.concatenate([lines, directions]), [*pairs, *([None] * len(chosen))]


def _middle_point(view: View) -> NDArray[np.float64]:
    """Return a point in the world on the ray through the middle of the silhouette."""
    camera = view.camera
    if camera.is_pinhole:
        return camera.position
    left, low, right, high = view.silhouette.bounds
    middle = camera.rotation[:, :2] @ ((left + right) / 2, (low + high) / 2)
    return np.asarray(camera.position + middle)


def _apparent_radius(view: View, centre: NDArray[np.float64]) -> float:
    """Return half the diagonal of the silhouette's box, in metres at the centre's depth."""
    camera = view.camera
    left, low, right, high = view.silhouette.bounds
    if not camera.is_pinhole:
        return float(np.hypot(right - left, high - low)) / 2
    corners = camera.rays_camera([[left, low], [right, high]])
    depth = abs(float((centre - camera.position) @ camera.rotation[:, 2]))
    return float(np.linalg.norm(corners[1] - corners[0])) / 2 * depth


def height_range(view: View, family: PlaneFamily) -> tuple[float, float]:
    """Return the offsets, in units, between which a viewing volume lies within the region."""
    camera = view.camera
    points = view.outline.points
    if not camera.is_pinhole:
        if abs(camera.rotation[:, 2] @ family.frame[:3, 2]) >= STRIP_COSINE:
            return -RADIUS, RADIUS
        corners = camera.position + points @ camera.rotation[:, :2].T
        heights = family.to_planes(corners)[:, 2]
    else:
        rays, position = _rays(camera, points, family)
        near, far = _depth_range(camera, family)
        heights = position[2] + np.concatenate([near * rays[:, 2], far * rays[:, 2]])
    return float(heights.min()), float(heights.max())


def _rays(
    camera: Camera, points: NDArray[np.float64], family: PlaneFamily
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rays of unit depth and the camera's position in the planes' frame, in units."""
    rotation = family.frame[:3, :3].T @ camera.rotation
    return camera.rays_camera(points) @ rotation.T, family.to_planes(camera.position)


def _depth_range(camera: Camera, family: PlaneFamily) -> tuple[float, float]:
    """Return the depths, in units, between which the region of interest lies."""
    centre = (family.frame[:3, 3] - camera.position) @ camera.rotation[:, 2] / family.unit
    return max(float(centre) - RADIUS, 0.0), max(float(centre), 0.0) + RADIUS


class Intersection:
    """The intersection of viewing volumes, ready to be cut with planes at any offsets.

    Parameters
    ----------
    views : sequence of View
        The views.
    pair : (int, int) or None
        Two of them whose common line is the family's normal, if there are.
    family : PlaneFamily
        The planes' frame.
    spare : int, default 0
        How many viewing volumes a point may be outside of.

    Attributes
    ----------
    family : PlaneFamily
        As given.
    volumes : list of functions
        Those of the views besides the pair, see `viewing_volume`, the newest first.
    """

    def __init__(
        self,
        views: Sequence[View],
        pair: tuple[int, int] | None,
        family: PlaneFamily,
        spare: int = 0,
    ) -> None:
        self._start: Callable[[NDArray[np.float64]], Levels] = partial(_whole_region, 1 + spare)
        others = list(views)
        if pair is not None and not spare:
            first, second = (views[index] for index in pair)
            self._start = _intersected_pair(first, second, family)
            others = [view for index, view in enumerate(views) if index not in pair]
        self.family = family
        self.volumes = [viewing_volume(view, family) for view in reversed(others)]

    def with_views(self, views: Sequence[View]) -> Intersection:
        """Return the intersection with more viewing volumes."""
        joined = copy(self)
        newer = [viewing_volume(view, self.family) for view in reversed(views)]
        joined.volumes = [*newer, *self.volumes]
        return joined

    def cut(self, offsets: NDArray[np.float64]) -> Regions:
        """Return the cross-sections at offsets in units, as many."""
        return self.levels(offsets)[-1]

    def levels(self, offsets: NDArray[np.float64]) -> Levels:
        """Return the cross-sections at offsets for every number of views to spare.

        The newest views come first, as they leave the least.
        """
        return clip_levels(self._start(offsets), self.volumes, offsets)


def _whole_region(count: int, offsets: NDArray[np.float64]) -> Levels:
    corners = RADIUS * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    whole = _quadrangles(np.tile(corners, (len(offsets), 1, 1)), np.ones(len(offsets), np.int64))
    return [whole] * count


Levels = list[Regions]
ViewingVolume = Callable[[NDArray[np.float64]], Footprints]


def _intersected_pair(
    first: View, second: View, family: PlaneFamily
) -> Callable[[NDArray[np.float64]], Levels]:
    """Return a function that cuts the intersection of two viewing volumes, plane by plane.

    For parallel projection, each silhouette is rasterised into scan-line segments perpendicular
    to the common line, and the segments' strips meet in N1 x N2 parallelograms per plane (Figs. 3
    and 4 of the paper). A pinhole's cone meets the plane in the silhouette's homographic image.
    """
    if first.camera.is_pinhole or second.camera.is_pinhole:
        volumes = [viewing_volume(view, family) for view in (first, second)]

        def cut_cones(offsets: NDArray[np.float64]) -> Levels:
            return clip_levels(_whole_region(1, offsets), volumes, offsets)

        return cut_cones

    rasters = [_Raster.of(view, family) for view in (first, second)]
    from_spans = np.linalg.inv(np.array([raster.across for raster in rasters]))
    if np.linalg.det(from_spans) < 0:
        rasters, from_spans = rasters[::-1], from_spans[:, ::-1]

    def cut_prisms(offsets: NDArray[np.float64]) -> Levels:
        (spans1, counts1), (spans2, counts2) = (raster.spans(offsets) for raster in rasters)
        planes, numbers = number_within(counts1 * counts2)
        one, other = np.divmod(numbers, counts2[planes])
        low1, high1 = spans1[(np.cumsum(counts1) - counts1)[planes] + one].T
        low2, high2 = spans2[(np.cumsum(counts2) - counts2)[planes] + other].T
        corners = np.stack([low1, low2, high1, low2, high1, high2, low1, high2], axis=-1)
        return [_quadrangles(corners.reshape(-1, 4, 2) @ from_spans.T, counts1 * counts2)]

    return cut_prisms


def _quadrangles(corners: NDArray[np.float64], counts: NDArray[np.int64]) -> Regions:
    """Return regions, each of some of the quadrangles, shape (sum of counts, 4, 2)."""
    rings = Rings(corners.reshape(-1, 2), 4 * np.arange(len(corners) + 1))
    return Regions(rings, ends_of(counts))


@dataclass(frozen=True, eq=False)
class _Raster:
    """A silhouette whose viewing direction lies in the planes, ready to be rasterised.

    Attributes
    ----------
    across : array, shape (2,)
        The unit vector in the planes that the scan lines run along.
    outline : Rings
        Coordinates along `across` and along the planes' normal.
    """

    across: NDArray[np.float64]
    outline: Rings

    @classmethod
    def of(cls, view: View, family: PlaneFamily) -> _Raster:
        camera = view.camera
        axes = family.frame[:3, :3].T @ camera.rotation[:, :2]
        heading = axes[2] / np.linalg.norm(axes[2])
        across = axes[:2] @ (-heading[1], heading[0])
        corners = family.to_planes(camera.position + view.outline.points @ camera.rotation[:, :2].T)
        points = np.column_stack([corners[:, :2] @ across, corners[:, 2]])
        return cls(across, Rings(points, view.outline.first))

    def spans(self, offsets: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the segments of scan lines, as `scan_spans`, those that touch as one."""
        return scan_spans(self.outline, offsets, CLEARANCE)


def clip_levels(
    levels: Levels,
    volumes: Sequence[ViewingVolume],
    offsets: NDArray[np.float64],
    *,
    in_turn: bool = False,
) -> Levels:
    """Clip every cross-section with more viewing volumes, one after the other.

    Projecting a plane into an image, clipping there and projecting back is one affine map for
    parallel projection and one homography for a pinhole, so the silhouette is brought into the
    plane and the clip is done there. What is in all volumes but j is, with one more of them,
    either in that one, or was in all but j - 1.

    Parameters
    ----------
    levels : list of Regions
        What the views before have left, for every number of them that may be spared, from 0.
    volumes : sequence of functions
        The viewing volumes to clip with, see `viewing_volume`.
    offsets : array, shape (n,)
        Where the planes are, in units.
    in_turn : bool, default False
        Whether the result is to be that of one volume after the other to the last bit.

    Returns
    -------
    levels : list of Regions
    """
    met = np.flatnonzero(levels[-1].is_met)
    footprints = [volume(offsets[met]) for volume in volumes]
    clipped = [sections.take(met) for sections in levels]
    if len(levels) == 1:
        clipped = [clipped[0].clipped(footprints, in_turn=in_turn)]
    else:
        for footprint in footprints:
            clipped = _clipped_once(clipped, footprint)
    return [sections.replaced(met, cut) for sections, cut in zip(levels, clipped, strict=True)]


def _clipped_once(levels: Levels, footprints: Footprints) -> Levels:
    clipped = [sections.clipped([footprints]) for sections in levels]
    unions = (cut.united(less) for cut, less in zip(clipped[1:], levels, strict=False))
    return [clipped[0], *unions]


def viewing_volume(view: View, family: PlaneFamily) -> ViewingVolume:
    """Return a function from offsets to what the viewing volume covers of the planes there."""
    if view.camera.is_pinhole:
        return _cone(view, family)
    if abs(view.camera.rotation[:, 2] @ family.frame[:3, 2]) < STRIP_COSINE:
        return _strips(view, family)
    return _prism(view, family)


def _strips(view: View, family: PlaneFamily) -> ViewingVolume:
    raster = _Raster.of(view, family)
    along = 2 * RADIUS * np.array([-raster.across[1], raster.across[0]])  # beyond the region

    def volume(offsets: NDArray[np.float64]) -> Footprints:
        spans, counts = raster.spans(offsets)
        low, high = spans.T[:, :, None] * raster.across
        corners = np.stack([low - along, high - along, high + along, low + along], axis=1)
        return Footprints.as_they_are(_quadrangles(corners, counts))

    return volume


def _prism(view: View, family: PlaneFamily) -> ViewingVolume:
    camera = view.camera
    image_from_planes = camera.rotation[:, :2].T @ family.frame[:3, :3]
    origin = (family.frame[:3, 3] - camera.position) @ camera.rotation[:, :2] / family.unit
    planes_from_image = np.linalg.inv(image_from_planes[:, :2])
    shift = -planes_from_image @ image_from_planes[:, 2]
    rings = view.outline
    if camera.rotation[:, 2] @ family.frame[:3, 2] < 0:  # the plane is seen from its other side
        rings = rings.reversed
    points = (rings.points / family.unit - origin) @ planes_from_image.T
    outline = Regions(Rings(points, rings.first), np.array([0, len(rings.counts)]))

    def volume(offsets: NDArray[np.float64]) -> Footprints:
        count = len(offsets)
        chosen, scales = np.zeros(count, dtype=np.int64), np.ones(count)
        return Footprints(outline, chosen, scales, offsets[:, None] * shift)

    return volume


def _cone(view: View, family: PlaneFamily) -> ViewingVolume:
    """Cut a pinhole's cone; planes that meet all its rays see one another's cuts scaled."""
    rays, position = _rays(view.camera, view.outline.points, family)
    _, far = _depth_range(view.camera, family)
    foot = position[:2]
    lowest, highest = rays[:, 2].min(), rays[:, 2].max()
    deepest = far * (lowest if lowest > 0 else min(highest, 0.0))  # plane that meets all rays
    whole = Regions.of_rings([[]])
    if deepest:
        outline = Rings(deepest * rays[:, :2] / rays[:, 2:], view.outline.first)
        whole = Regions.facing_left(outline, np.array([0, len(outline.counts)]))

    def volume(offsets: NDArray[np.float64]) -> Footprints:
        heights = offsets - position[2]
        heights = np.where(np.abs(heights) < CENTRE_DISTANCE, CENTRE_DISTANCE, heights)
        is_whole = (heights * deepest > 0) & (np.abs(heights) <= abs(deepest))
        parts = _partial_cuts(rays, view.outline.counts, heights[~is_whole], far)
        scales = np.ones(len(heights))
        scales[is_whole] = heights[is_whole] / (deepest or 1.0)
        chosen = np.where(is_whole, 0, np.cumsum(~is_whole))
        shifts = np.tile(foot, (len(heights), 1))
        return Footprints(Regions.joined([whole, parts]), chosen, scales, shifts)

    return volume


def _partial_cuts(
    rays: NDArray[np.float64], counts: NDArray[np.int64], heights: NDArray[np.float64], far: float
) -> Regions:
    """Cut cones that the planes, at heights above their apex, do not meet in whole."""
    margins = np.sign(heights)[:, None] * rays[:, 2] - (np.abs(heights) / far)[:, None]
    planes, rings, cut = _cut_rings(rays, counts, margins)
    points = (heights[planes] / cut[:, 2])[:, None] * cut[:, :2]
    numbers = np.bincount(planes * len(counts) + rings, minlength=len(heights) * len(counts))
    kept = numbers > 2
    first = ends_of(kept.reshape(len(heights), len(counts)).sum(axis=1))
    contours = Rings(points[np.repeat(kept, numbers)], ends_of(numbers[kept]))
    return Regions.facing_left(contours, first)


def _cut_rings(
    rays: NDArray[np.float64], counts: NDArray[np.int64], margins: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Keep, for each plane, the parts of closed rings where a margin is not negative.

    Parts of a ring that the cut separates stay joined by edges along the cut, which bound no
    area (I. E. Sutherland and G. W. Hodgman, Reentrant polygon clipping, 1974).

    Parameters
    ----------
    rays : array, shape (n, 3)
        The rings' vertices, one ring behind the other.
    counts : array of int, shape (r,)
        Number of vertices of each ring.
    margins : array, shape (p, n)
        Per plane; linear along edges.

    Returns
    -------
    planes, rings : array of int, shape (m,)
        The plane and the ring of each vertex that is left, in order.
    points : array, shape (m, 3)
        These vertices.
    """
    first = np.cumsum(counts) - counts
    following = np.arange(1, len(rays) + 1)
    following[first + counts - 1] = first
    inside = margins >= 0
    kept = np.empty((len(margins), 2 * len(rays)), dtype=bool)
    kept[:, 0::2] = inside
    kept[:, 1::2] = inside != inside[:, following]
    planes, slots = np.nonzero(kept)
    starts, is_crossing = np.divmod(slots, 2)
    points = rays[starts]
    crossing = np.flatnonzero(is_crossing)
    start, plane = starts[crossing], planes[crossing]
    here, there = margins[plane, start], margins[plane, following[start]]
    points[crossing] += (here / (here - there))[:, None] * (rays[following[start]] - rays[start])
    return planes, np.repeat(np.arange(len(counts)), counts)[starts], points
