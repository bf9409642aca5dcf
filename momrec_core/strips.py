"""Where the viewing cones bound the hull, by samples, without the hull.

Of the cone over a silhouette's outline, each line of sight bounds the hull where it is inside all
other viewing volumes: strips along the outline make up the hull's surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from momrec_core._strips import bound
from momrec_core.lines import cross_products
from momrec_core.rings import Rings, ends_of
from momrec_core.view import View, evenly_chosen

__all__ = ["Strips", "surface_strips"]

MAX_VIEWS = 16  # that are sampled: their hull has about the same facets
MOST_RAYS = 16  # lines of sight of each view, and
ALL_RAYS = 144  # of all views together, about
POINT_SINE = 1e-6  # a line of sight that another view sees as a point, to within so much
STEEPEST = 5.0  # times its height: how wide a strip between two planes counts at most
FLAT_SINE = 1e-3  # of the angle between planes and facet: below, it is an end or a ledge


@dataclass(frozen=True, eq=False)
class Strips:
    """Samples of a hull's surface.

    Attributes
    ----------
    normals : array, shape (n, 3)
        Unit normals in the world, of either sign.
    areas : array, shape (n,)
        Squared metres; their sum estimates the hull's area.
    """

    normals: NDArray[np.float64]
    areas: NDArray[np.float64]

    def leaning(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Tell how much wider the surface is between two planes than they are apart, on average.

        Facets that lean towards the planes are met by few of them, and contours move far on
        them from plane to plane. Facets parallel to the planes are no matter: ends and ledges
        are located.

        Parameters
        ----------
        directions : array, shape (m, 3)
            Unit normals of planes, in the world.

        Returns
        -------
        leaning : array, shape (m,)
            From 1, where all of the surface is perpendicular to the planes, to 5.
        """
        cosines = np.clip(self.normals @ directions.T, -1.0, 1.0)
        sines = np.sqrt(1 - cosines**2)
        areas = np.where(sines > FLAT_SINE, self.areas[:, None], 0.0)
        total = areas.sum(axis=0)
        widths = (areas / np.maximum(sines, 1 / STEEPEST)).sum(axis=0)
        found = total > 0
        return np.where(found, widths, 1.0) / np.where(found, total, 1.0)


@dataclass(frozen=True, eq=False)
class _Outlines:
    """The outlines of several views, and lines of sight through points spread evenly over them.

    Attributes
    ----------
    rings : Rings
        The outlines in their images, view by view.
    first : array of int, shape (views + 1,)
        The first ring of each view, and the number of rings.
    origins, directions, edges : array, shape (r, 3)
        Points and directions of the lines of sight, and how far each is from the next one there,
        in the world.
    depths : array, shape (r,)
        From a pinhole to the point, in lengths of the direction; 0 for parallel projection.
    views : array of int, shape (r,)
        The view of each line of sight.
    """

    rings: Rings
    first: NDArray[np.int64]
    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    edges: NDArray[np.float64]
    depths: NDArray[np.float64]
    views: NDArray[np.int64]

    def bounding_parts(
        self, matrices: NDArray[np.float64], spare: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the parts of lines of sight that are in just enough of the other volumes.

        Parameters
        ----------
        matrices : array, shape (views, 3, 4)
            From homogeneous points of the world to those of each image.
        spare : int
            How many volumes a part may be outside of.

        Returns
        -------
        rays : array of int, shape (m,)
            Numbers of lines of sight.
        low, high : array, shape (m,)
            Where the parts begin and end, in lengths of their directions.
        """
        rays, ends = bound(
            self.rings.points,
            self.rings.first,
            self.first,
            matrices.reshape(-1, 4),
            self.origins,
            np.ascontiguousarray(self.directions),
            self.views,
            spare,
            POINT_SINE,
        )
        low, high = np.frombuffer(ends).reshape(-1, 2).T
        return np.frombuffer(rays, dtype=np.int64), low, high


def surface_strips(views: Sequence[View], middle: NDArray[np.float64], spare: int = 0) -> Strips:
    """Sample the surface of the hull of some of the views, evenly chosen.

    Parameters
    ----------
    views : sequence of View
        The views.
    middle : array, shape (3,)
        A point somewhere in the hull, metres.
    spare : int, default 0
        How many viewing volumes a point of the hull may be outside of.

    Returns
    -------
    strips : Strips
        Of each line of sight the parts that bound the hull, as far as the next line of sight.

    References
    ----------
    W. Matusik et al., Image-based visual hulls, 2000; S. Lazebnik et al., Projective visual
    hulls, 2007 (cone strips).
    """
    chosen = [views[number] for number in evenly_chosen(views, MAX_VIEWS)]
    outlines = _outlines(chosen, middle)
    matrices = np.array([view.camera.matrix for view in chosen])
    rays, low, high = outlines.bounding_parts(matrices, spare)
    is_pinhole = np.array([view.camera.is_pinhole for view in chosen])[outlines.views[rays]]
    near, far = (np.maximum(outlines.depths[rays] + ends, 0.0) for ends in (low, high))
    lengths = np.where(is_pinhole, (far**2 - near**2) / 2, high - low)
    normals = cross_products(outlines.directions[rays], outlines.edges[rays])
    widths = np.linalg.norm(normals, axis=1)
    return Strips(normals / widths[:, None], lengths * widths)


def _outlines(views: Sequence[View], middle: NDArray[np.float64]) -> _Outlines:
    thinned = [view.sketch for view in views]
    points = np.concatenate([rings.points for rings in thinned])
    counts = np.concatenate([rings.counts for rings in thinned])
    numbers = np.array([len(rings.points) for rings in thinned])
    rings = Rings(points, ends_of(counts))
    origins, directions, edges = _lines_of_sight(views, *_sampled(rings, numbers))
    depths = ((middle - origins) * directions).sum(axis=1) / (directions**2).sum(axis=1)
    return _Outlines(
        rings,
        ends_of(np.array([len(rings.counts) for rings in thinned])),
        origins + depths[:, None] * directions,
        directions,
        edges,
        depths,
        np.repeat(np.arange(len(views)), len(origins) // len(views)),
    )


def _sampled(
    rings: Rings, numbers: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points evenly spread over the outlines of views, and how far it is to the next ones.

    Parameters
    ----------
    rings : Rings
        Those of all views.
    numbers : array of int, shape (v,)
        How many vertices each view has.

    Returns
    -------
    points, steps : array, shape (v, r, 2)
        In image coordinates; the steps along the outline.
    """
    lengths = np.hypot(*rings.edges.T)
    reached = np.cumsum(lengths)
    totals = np.diff(reached[np.cumsum(numbers) - 1], prepend=0.0)
    begins = np.cumsum(totals) - totals
    count = min(MOST_RAYS, -(-ALL_RAYS // len(numbers)))
    positions = begins[:, None] + totals[:, None] * (np.arange(count) + 0.5) / count
    edges = np.searchsorted(reached, positions)
    along = rings.edges[edges] / lengths[edges][..., None]
    ends = rings.points[rings.following[edges]]
    points = ends - (reached[edges] - positions)[..., None] * along
    return points, along * (totals / count)[:, None, None]


def _lines_of_sight(
    views: Sequence[View], points: NDArray[np.float64], steps: NDArray[np.float64]
) -> tuple[NDArray[np.float64], ...]:
    """Return origins, directions and steps in the world of lines of sight, shape (v * r, 3).

    For parallel projection in metres; for a pinhole at a depth of one, where the camera is the
    origin of all.
    """
    rotations = np.array([view.camera.rotation for view in views])
    positions = np.array([view.camera.position for view in views])[:, None]
    across = rotations[:, :, :2].transpose(0, 2, 1)
    origins, edges = positions + points @ across, steps @ across
    directions = np.repeat(rotations[:, None, :, 2], points.shape[1], axis=1)
    for index, view in enumerate(views):
        if view.camera.is_pinhole:
            both = np.concatenate([points[index], points[index] + steps[index]])
            starts, stops = np.split(view.camera.rays_camera(both) @ rotations[index].T, 2)
            origins[index] = positions[index]
            directions[index], edges[index] = starts, stops - starts
    return origins.reshape(-1, 3), directions.reshape(-1, 3), edges.reshape(-1, 3)
