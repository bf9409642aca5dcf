"""Rays of silhouettes, and where along them the viewing volumes of other views are.

W. Matusik et al., Image-based visual hulls, 2000: a ray is cut in each image, exactly and
without a grid in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from momrec_core.camera import Camera
from momrec_core.scanning import outline_points
from momrec_core.view import View

__all__ = ["Sightlines"]

SIMPLIFICATION = 0.25  # of the tolerance: what may be given up for outlines of few edges
PARALLEL = 1e-9  # sine: a ray that a camera sees as a point


class Sightlines:
    """Rays along outlines, as many of each, cut with the viewing volumes of all other views.

    Parameters
    ----------
    views : sequence of View
        At least two.
    owners : array of int, shape (k,)
        The views whose outlines are looked at.
    count : int
        Rays of each.
    tolerance : float
        By which every silhouette is widened, relative to the diagonal of its bounds.

    Attributes
    ----------
    count : int
        Rays of each.
    owners : array of int, shape (rays,)
        The view that each ray belongs to.
    """

    def __init__(
        self, views: Sequence[View], owners: NDArray[np.int64], count: int, tolerance: float
    ) -> None:
        rays = _Rays.of(views, owners, count)
        self.count = count
        self.owners = rays.owners
        self._views = len(views)
        cuts = [
            _intervals(rays, _Outline.of(view, tolerance), index)
            for index, view in enumerate(views)
        ]
        self._intervals = _Intervals.joined(cuts)
        # Where the number of viewing volumes changes along the rays, ray by ray:
        places = np.concatenate([self._intervals.begins, self._intervals.ends])
        order = np.lexsort([places, np.tile(self._intervals.rays, 2)])
        self._events = order % len(self._intervals.rays)
        self._changes = np.where(order < len(self._intervals.rays), 1, -1)
        self._places = places[order]

    def refusals(self, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which views refuse each ray at the place where the fewest do.

        Parameters
        ----------
        used : array of bool, shape (views,)
            The views that count.

        Returns
        -------
        refused : array of bool, shape (rays, views)
            All false for rays of views that do not count.
        """
        chosen = used[self._intervals.views] & used[self.owners[self._intervals.rays]]
        places, rays = self._best_places(chosen)
        refused = np.zeros((len(self.owners), self._views), dtype=np.bool_)
        refused[np.ix_(used[self.owners], used)] = True
        refused[np.arange(len(self.owners)), self.owners] = False
        cuts = self._intervals.of(chosen)
        best = np.full(len(self.owners), np.nan)
        best[rays] = places
        there = (cuts.begins <= best[cuts.rays]) & (best[cuts.rays] <= cuts.ends)
        refused[cuts.rays[there], cuts.views[there]] = False
        return refused

    def _best_places(
        self, chosen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return where on each ray most chosen volumes overlap, on the longest such part."""
        kept = chosen[self._events]
        rays = self._intervals.rays[self._events[kept]]
        places = self._places[kept]
        depth = np.cumsum(self._changes[kept])
        if len(rays) == 0:
            return places, rays
        first = np.flatnonzero(np.diff(rays, prepend=-1))
        deepest = np.repeat(np.maximum.reduceat(depth, first), np.diff(first, append=len(rays)))
        best = np.flatnonzero(depth == deepest)
        lengths = places[best + 1] - places[best]
        best = best[np.lexsort([lengths, rays[best]])]
        best = best[np.flatnonzero(np.diff(rays[best], append=-1))]
        return _between(places[best], places[best + 1]), rays[best]


def _between(begins: NDArray[np.float64], ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return numbers inside intervals, of which one end or both may be infinite."""
    low = np.where(np.isfinite(begins), begins, np.where(np.isfinite(ends), ends - 1.0, 0.0))
    high = np.where(np.isfinite(ends), ends, np.where(np.isfinite(begins), begins + 1.0, 0.0))
    return np.asarray((low + high) / 2)


@dataclass(frozen=True, eq=False)
class _Outline:
    """A silhouette widened by a tolerance, in coordinates of about unit size.

    Attributes
    ----------
    projection : array, shape (3, 4)
        From the world, homogeneous, to these coordinates.
    points : array, shape (n, 3)
        The vertices of its rings, homogeneous; each ring's first one again at its end.
    joins : array of int, shape (rings - 1,)
        Vertices after which another ring begins, so that no edge does.
    region : MultiPolygon
        The same, for points.
    """

    projection: NDArray[np.float64]
    points: NDArray[np.float64]
    joins: NDArray[np.int64]
    region: shapely.Geometry

    @classmethod
    def of(cls, view: View, tolerance: float) -> _Outline:
        left, low, right, high = view.silhouette.bounds
        size = float(np.hypot(right - left, high - low))
        middle = np.array([left + right, low + high]) / 2
        unit = shapely.transform(view.silhouette, lambda points: (points - middle) / size)
        simple = shapely.simplify(unit, SIMPLIFICATION * tolerance)
        region = shapely.buffer(simple, tolerance, quad_segs=1)
        rings = [shapely.get_coordinates(ring) for ring in _rings(region)]
        points = np.concatenate(rings)
        to_unit = np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, size]]) / size
        return cls(
            to_unit @ view.camera.matrix,
            np.column_stack([points, np.ones(len(points))]),
            np.cumsum([len(ring) for ring in rings])[:-1] - 1,
            region,
        )


@dataclass(frozen=True, eq=False)
class _Rays:
    """Rays of several views, as many of each.

    Attributes
    ----------
    origins, directions : array, shape (n, 3)
        In the world; points are origin + t direction.
    begin : array, shape (n,)
        Least t: 0 from a pinhole, else minus infinity.
    owners : array of int, shape (n,)
        The view of each.
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    begin: NDArray[np.float64]
    owners: NDArray[np.int64]

    @classmethod
    def of(cls, views: Sequence[View], owners: NDArray[np.int64], count: int) -> _Rays:
        owning = [views[owner] for owner in owners]
        rays = [_rays_world(view.camera, outline_points(view.visible, count)) for view in owning]
        origins, directions = (np.concatenate(parts) for parts in zip(*rays, strict=True))
        begin = [0.0 if view.camera.is_pinhole else -np.inf for view in owning]
        return cls(origins, directions, np.repeat(begin, count), np.repeat(owners, count))


@dataclass(frozen=True, eq=False)
class _Intervals:
    """Where along rays viewing volumes are: ray, view, begin and end of each interval."""

    rays: NDArray[np.int64]
    views: NDArray[np.int64]
    begins: NDArray[np.float64]
    ends: NDArray[np.float64]

    @classmethod
    def joined(cls, parts: Sequence[_Intervals]) -> _Intervals:
        return cls(
            np.concatenate([part.rays for part in parts]),
            np.concatenate([part.views for part in parts]),
            np.concatenate([part.begins for part in parts]),
            np.concatenate([part.ends for part in parts]),
        )

    def of(self, chosen: NDArray[np.bool_]) -> _Intervals:
        return _Intervals(
            self.rays[chosen], self.views[chosen], self.begins[chosen], self.ends[chosen]
        )


def _intervals(rays: _Rays, outline: _Outline, view: int) -> _Intervals:
    """Cut rays with one viewing volume, as their images cut its silhouette."""
    others = np.flatnonzero(rays.owners != view)
    linear, shift = outline.projection[:, :3], outline.projection[:, 3]
    starts = rays.origins[others] @ linear.T + shift
    steps = rays.directions[others] @ linear.T
    lines = np.cross(starts, steps)
    lengths = np.linalg.norm(lines, axis=1)
    scale = np.linalg.norm(starts, axis=1) * np.linalg.norm(steps, axis=1)
    is_point = ~(lengths > PARALLEL * scale)
    sides = lines @ outline.points.T
    positive = sides >= 0
    changes = positive[:, 1:] != positive[:, :-1]
    changes[:, outline.joins] = False
    rows, edges = np.divmod(np.flatnonzero(changes), changes.shape[1])
    here, there = sides[rows, edges], sides[rows, edges + 1]
    crossings = outline.points[edges] + (here / (here - there))[:, None] * (
        outline.points[edges + 1] - outline.points[edges]
    )
    start, step = starts[rows], steps[rows]
    above = crossings[:, :2] * start[:, 2:] - start[:, :2]
    below = step[:, :2] - crossings[:, :2] * step[:, 2:]
    axis = np.abs(below).argmax(axis=1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (np.take_along_axis(above, axis, 1) / np.take_along_axis(below, axis, 1))[:, 0]
        valid = (start[:, 2] + t * step[:, 2] > 0) & ~is_point[rows] & np.isfinite(t)
    rows, t = rows[valid], t[valid]
    # The image of a ray begins outside; where an end is missing it lies at infinity.
    counts = np.bincount(rows, minlength=len(others))
    odd = np.flatnonzero(counts % 2)
    missing = np.where(steps[odd, 2] < 0, -np.inf, np.inf)
    seen = np.flatnonzero(is_point)
    seen = seen[_contains(outline, starts[seen])]
    rows = np.concatenate([rows, odd, seen, seen])
    t = np.concatenate([t, missing, np.full(len(seen), -np.inf), np.full(len(seen), np.inf)])
    order = np.lexsort([t, rows])
    rows, bounds = rows[order].reshape(-1, 2)[:, 0], t[order].reshape(-1, 2)
    ids = others[rows]
    begins = np.maximum(bounds[:, 0], rays.begin[ids])
    found = _Intervals(ids, np.full(len(ids), view), begins, bounds[:, 1])
    return found.of(found.ends > found.begins)


def _contains(outline: _Outline, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    depths = points[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = shapely.contains_xy(outline.region, *(points[:, :2] / depths[:, None]).T)
    return np.asarray(inside & (depths > 0))


def _rings(region: shapely.Geometry) -> NDArray[np.object_]:
    return np.asarray(shapely.get_rings(shapely.get_parts(region)))


def _rays_world(
    camera: Camera, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a point on the ray behind each image point, and the ray's direction."""
    if camera.is_pinhole:
        directions = camera.rays_camera(points) @ camera.rotation.T
        return np.broadcast_to(camera.position, directions.shape), directions
    origins = camera.position + points @ camera.rotation[:, :2].T
    return origins, np.broadcast_to(camera.rotation[:, 2], origins.shape)
