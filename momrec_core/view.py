"""One view: a camera and the region that the object covers in its image."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon

from momrec_core.camera import Camera
from momrec_core.errors import InvalidCameraError, InvalidContourError
from momrec_core.rings import Rings, signed_area

__all__ = ["View", "evenly_chosen", "polygon_rings", "region_from_rings"]

NEGLIGIBLE_AREA = 1e-9  # of the view's area: rings below are rounding, not shape
SKETCH_RINGS = 32  # of a silhouette, those of most vertices
SKETCH_VERTICES = 128  # of these rings, about: more are thinned out
MENDABLE_AREA = 0.02  # of the ring's area: what the two readings of a crossing ring may differ by


def _check_ring(ring: ArrayLike) -> NDArray[np.float64]:
    try:
        points = np.array(ring, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidContourError(f"Expected a ring of shape (n, 2), got {ring!r:.80}") from error
    if points.ndim != 2 or points.shape[1] != 2:
        raise InvalidContourError(f"Expected a ring of shape (n, 2), got shape {points.shape}")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise InvalidContourError(
            f"Expected finite vertices, got {points[bad[0]]} at vertex {bad[0]} of {len(points)}"
        )
    following = np.concatenate([points[1:], points[:1]])
    return np.asarray(points[(points != following).any(axis=1)])


def _ring_region(points: NDArray[np.float64]) -> Polygon | MultiPolygon:
    """Return the region that one ring bounds, by the even-odd rule."""
    if len(points) < 3:
        return Polygon()
    polygon = Polygon(points)
    if shapely.is_valid(polygon):
        return polygon
    return _polygonal(shapely.make_valid(polygon, method="linework"))


def _check_crossings(points: NDArray[np.float64], region: Polygon | MultiPolygon) -> None:
    """Reject a ring that crosses itself, unless the meaning is clear.

    It is where the even-odd region and the ring's signed area agree, so that the crossings cut
    off next to nothing.
    """
    signed = abs(signed_area(points))
    if abs(region.area - signed) > MENDABLE_AREA * region.area:
        raise InvalidContourError(
            f"Expected a ring that does not cross itself, got one whose {len(points)} vertices "
            f"bound {region.area:.6g} by the even-odd rule but {signed:.6g} by orientation "
            f"({shapely.is_valid_reason(Polygon(points))})"
        )


def _polygonal(geometry: shapely.Geometry) -> MultiPolygon:
    parts = shapely.get_parts(shapely.get_parts(geometry))
    return MultiPolygon([part for part in parts if isinstance(part, Polygon) and part.area > 0])


def region_from_rings(rings: Iterable[ArrayLike]) -> MultiPolygon:
    """Return the planar region that rings bound by the even-odd rule.

    Parameters
    ----------
    rings : iterable of array-like, shape (n_i, 2)
        Closed or open, of any winding; a ring inside another is a hole.

    Returns
    -------
    region : MultiPolygon
        Valid; rings of negligible area (under 1e-9 of the region's) are left out.

    Raises
    ------
    InvalidContourError
        If a vertex is not finite, a ring crosses itself beyond mending, or nothing is left.
    """
    checked = [_check_ring(ring) for ring in rings]
    regions = [_ring_region(ring) for ring in checked]
    largest = max((region.area for region in regions), default=0.0)
    kept = []
    for ring, region in zip(checked, regions, strict=True):
        if region.area > NEGLIGIBLE_AREA * largest:
            _check_crossings(ring, region)
            kept.append(region)
    if not kept:
        vertices = [len(np.unique(ring, axis=0)) for ring in checked]
        raise InvalidContourError(
            "Expected at least one ring of three distinct vertices that bounds an area, got "
            f"{len(checked)} rings with {vertices[:5]} distinct vertices"
        )
    if len(kept) == 1 and isinstance(kept[0], Polygon):
        return MultiPolygon(kept)
    region = _polygonal(reduce(shapely.symmetric_difference, kept))
    threshold = NEGLIGIBLE_AREA * region.area
    pieces = [
        Polygon(
            piece.exterior,
            [hole for hole in piece.interiors if Polygon(hole).area > threshold],
        )
        for piece in region.geoms
        if piece.area > threshold
    ]
    if not pieces:
        raise InvalidContourError(
            f"Expected rings that bound an area, got {len(checked)} that cancel out by even-odd"
        )
    return MultiPolygon(pieces)


def polygon_rings(region: Polygon | MultiPolygon) -> list[NDArray[np.float64]]:
    """Return the rings of a region without the repeated last vertex, each shape (n_i, 2)."""
    rings: list[NDArray[np.float64]] = []
    for piece in shapely.get_parts(region):
        rings.extend(shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(piece))
    return rings


@dataclass(frozen=True, eq=False)
class View:
    """A silhouette with the camera that saw it.

    Parameters
    ----------
    camera : Camera
        Where from and how the object was seen.
    silhouette : Polygon or MultiPolygon
        The region that the object covers, in the camera's image coordinates: metres for
        parallel projection, pixels (centres at integers) for a pinhole.
    frame : Polygon or None
        What was seen of the image plane, in the same coordinates; None for all of it. The
        silhouette may go on beyond it, where it says what is possible, not what was seen.

    Raises
    ------
    InvalidContourError
        If the silhouette bounds no area, is not finite, or crosses itself beyond mending.
    """

    camera: Camera
    silhouette: MultiPolygon
    frame: Polygon | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.camera, Camera):
            raise InvalidCameraError(f"Expected a Camera, got {type(self.camera).__name__}")
        if not isinstance(self.silhouette, (Polygon, MultiPolygon)):
            raise InvalidContourError(
                f"Expected a Polygon or MultiPolygon, got {type(self.silhouette).__name__}"
            )
        if isinstance(self.silhouette, Polygon) or not _is_clean(self.silhouette):
            rings = polygon_rings(self.silhouette)
            object.__setattr__(self, "silhouette", region_from_rings(rings))

    @classmethod
    def from_rings(cls, camera: Camera, rings: Sequence[ArrayLike]) -> View:
        """Make a view from the rings of its occluding contours.

        Parameters
        ----------
        camera : Camera
            Where from and how the object was seen.
        rings : sequence of array-like, shape (n_i, 2)
            Closed curves in image coordinates; even-odd, any number, winding, closed or not.

        Raises
        ------
        InvalidContourError
            As for `region_from_rings`.
        """
        return cls(camera, region_from_rings(rings))

    @cached_property
    def rings(self) -> list[NDArray[np.float64]]:
        """The silhouette's rings without the repeated last vertex, each shape (n_i, 2)."""
        return polygon_rings(self.silhouette)

    @cached_property
    def outline(self) -> Rings:
        """The silhouette's rings, shells counter-clockwise and holes clockwise."""
        return Rings.of_loops(polygon_rings(shapely.orient_polygons(self.silhouette)))

    @cached_property
    def sketch(self) -> Rings:
        """The largest of the silhouette's rings with evenly chosen vertices, enough for samples."""
        rings = sorted(self.rings, key=len)[-SKETCH_RINGS:]
        step = -(-sum(len(ring) for ring in rings) // SKETCH_VERTICES)
        return Rings.of_loops([ring[:: min(step, len(ring) // 3)] for ring in rings])

    @cached_property
    def visible(self) -> MultiPolygon:
        """The part of the silhouette inside the frame; all of it where none of it is."""
        if self.frame is None or shapely.contains_properly(self.frame, self.silhouette):
            return self.silhouette
        inside = _polygonal(shapely.intersection(self.silhouette, self.frame))
        return inside if inside.area > 0 else self.silhouette


def _is_clean(region: MultiPolygon) -> bool:
    areas = shapely.area(shapely.get_parts(region))
    return bool(
        len(areas)
        and shapely.is_valid(region)
        and np.isfinite(shapely.get_coordinates(region)).all()
        and areas.min() > NEGLIGIBLE_AREA * areas.sum()
    )


def evenly_chosen(views: Sequence[View], most: int) -> NDArray[np.int64]:
    """Return the numbers of all views, or of so many that are evenly spread among them."""
    if len(views) <= most:
        return np.arange(len(views))
    return np.linspace(0, len(views) - 1, most).round().astype(np.int64)
