"""Occluding contours of binary masks, finer than a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias, cast

import numpy as np
import shapely
from contourpy import FillType, contour_generator
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon

from momrec_core import InvalidContourError

__all__ = ["MaskContours", "contours_of_mask", "hull_silhouette"]

MAX_PIXELS = 64_000_000  # bounds the memory of one mask: about 0.6 GB while it is traced
# Pixels: joining the midpoints of an outline's edges moves it by 0.25 at most. The rest keeps the
# simplification below the 0.25 by which it would shift whole edges along rows and columns.
CORNER_CUT = 0.26
# Of the image's larger side: how far an object that the border cuts may go on beyond it.
OPEN_DEPTH = 0.25
OUTWARDS = ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))  # left, right, top, bottom

_Filled: TypeAlias = tuple[list[NDArray[np.float64]], list[NDArray[np.int64]]]


@dataclass(frozen=True, eq=False)
class MaskContours:
    """The region that a binary mask shows.

    Attributes
    ----------
    region : MultiPolygon
        Valid; in pixels with pixel centres at integers, x the column and y the row.
    size : tuple of int
        Width and height of the image; it covers x from -0.5 to width - 0.5, y likewise.
    touches_border : bool
        Whether the object reaches the border of the image, which cuts it there.
    specks : int
        Pieces and holes that were left out as too small.
    """

    region: MultiPolygon
    size: tuple[int, int]
    touches_border: bool
    specks: int

    @property
    def frame(self) -> Polygon:
        """The rectangle that the image covers, pixels."""
        width, height = self.size
        return shapely.box(-0.5, -0.5, width - 0.5, height - 0.5)


def contours_of_mask(
    mask: ArrayLike, *, tolerance: float = 0.5, min_area: float = 16.0
) -> MaskContours:
    """Trace the outline of a binary mask.

    The outline runs halfway between the centres of object and background pixels (marching
    squares), so that it keeps the area; joining the midpoints of its edges takes most of the
    staircase away, and the simplification (Douglas and Peucker, preserving topology) uses what
    is left of the tolerance.

    Parameters
    ----------
    mask : array-like, shape (height, width)
        Booleans, or unsigned integers, of which those above half the range are object.
    tolerance : float
        Largest distance in pixels between the pixels' outline and the result; below 0.26 the
        outline is returned as it is.
    min_area : float
        Pieces and holes below this area, in pixels, are left out.

    Returns
    -------
    contours : MaskContours
        The region in pixels, pixel centres at integers.

    Raises
    ------
    InvalidContourError
        If the mask is no binary image, is too large, or shows no object.
    """
    inside = _check_mask(mask)
    rows = np.flatnonzero(inside.any(axis=1))
    columns = np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        raise InvalidContourError("Expected a mask that shows an object, got an empty one")
    cropped = inside[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    outline = _pixel_outline(cropped, columns[0] - 1, rows[0] - 1)
    region, specks = _without_specks(outline, min_area)
    if region.is_empty:
        raise InvalidContourError(
            f"Expected a mask that shows an object of {min_area:g} pixels or more, got "
            f"{len(outline.geoms)} pieces of at most {shapely.area(outline.geoms).max():g} pixels"
        )
    height, width = inside.shape
    left, top, right, bottom = region.bounds
    cut = min(left, top) < 0 or right > width - 1 or bottom > height - 1
    return MaskContours(_smooth(region, tolerance), (width, height), cut, specks)


def hull_silhouette(contours: MaskContours, *, margin: float = 0.25) -> MultiPolygon:
    """Return the silhouette that a visual hull is to be intersected with.

    It holds all that the mask leaves possible. An outline is known to half a pixel at best, and
    the intersection of many views takes the innermost of them everywhere, so that unbiased
    outlines give a hull that is too small; the margin makes up for that. Where the border of the
    image cuts the object, the region goes on outside, to a quarter of the image's larger side
    and ever wider by 45 degrees, because what is beyond the border is unknown and must not cut.

    Parameters
    ----------
    contours : MaskContours
        What the mask shows.
    margin : float
        Pixels by which the region grows on all sides; 0 or more.

    Returns
    -------
    silhouette : MultiPolygon
        Valid; in pixels, beyond the image where the object touches its border.

    Raises
    ------
    ValueError
        If the margin is negative or not finite.
    """
    if not 0 <= margin < np.inf:
        raise ValueError(f"Expected a margin of 0 pixels or more, got {margin}")
    if margin == 0 and not contours.touches_border:
        return contours.region
    grown = shapely.buffer(contours.region, margin, join_style="mitre")
    silhouette = shapely.union_all([grown, *_beyond_border(contours)])
    return MultiPolygon(list(shapely.get_parts(silhouette)))


def _beyond_border(contours: MaskContours) -> list[Polygon]:
    """Return where the object may go on outside of the image, for each run along a border."""
    low, high = np.reshape(contours.frame.bounds, (2, 2))
    depth = OPEN_DEPTH * max(contours.size)
    parts = []
    for outward in np.array(OUTWARDS):
        # The strip between the border and the centres of the pixels along it.
        inward = (high - low - 0.5) * outward
        strip = shapely.box(*np.maximum(low, low + inward), *np.minimum(high, high + inward))
        runs = shapely.get_parts(shapely.intersection(contours.region, strip))
        parts += [_widened(run.bounds, outward, depth) for run in runs if run.area > 0]
    return parts


def _widened(
    bounds: tuple[float, float, float, float], outward: NDArray[np.float64], depth: float
) -> Polygon:
    """Return a rectangle continued outwards, wider by 45 degrees on either side."""
    low, high = np.reshape(bounds, (2, 2))
    along = 1 - np.abs(outward)
    far_low, far_high = low + depth * (outward - along), high + depth * (outward + along)
    return shapely.union(shapely.box(*low, *high), shapely.box(*far_low, *far_high)).convex_hull


def _check_mask(mask: ArrayLike) -> NDArray[np.bool_]:
    values = np.asarray(mask)
    if values.ndim != 2:
        raise InvalidContourError(f"Expected a mask of shape (height, width), got {values.shape}")
    if values.size > MAX_PIXELS:
        raise InvalidContourError(f"Expected at most {MAX_PIXELS} pixels, got {values.size}")
    if values.dtype == np.bool_:
        return values
    if values.dtype.kind != "u":
        raise InvalidContourError(
            f"Expected a mask of booleans or unsigned integers, got {values.dtype}"
        )
    object_pixels: NDArray[np.bool_] = values > np.iinfo(values.dtype).max // 2
    return object_pixels


def _pixel_outline(inside: NDArray[np.bool_], left: int, top: int) -> MultiPolygon:
    """Return the region halfway to the background; left, top: where the padded image starts."""
    generator = contour_generator(
        z=np.pad(inside, 1).astype(np.float64), name="serial", fill_type=FillType.OuterOffset
    )
    points, offsets = cast("_Filled", generator.filled(0.5, np.inf))
    pieces = []
    for vertices, starts in zip(points, offsets, strict=True):
        rings = np.split(np.add(vertices, (left, top)), starts[1:-1])
        pieces.append(Polygon(rings[0], rings[1:]))
    return MultiPolygon(pieces)


def _without_specks(outline: MultiPolygon, min_area: float) -> tuple[MultiPolygon, int]:
    pieces: list[Polygon] = []
    specks = 0
    for piece in outline.geoms:
        if Polygon(piece.exterior).area < min_area:
            specks += 1
            continue
        holes = [hole for hole in piece.interiors if Polygon(hole).area >= min_area]
        specks += len(piece.interiors) - len(holes)
        pieces.append(Polygon(piece.exterior, holes))
    return MultiPolygon(pieces), specks


def _smooth(region: MultiPolygon, tolerance: float) -> MultiPolygon:
    if tolerance < CORNER_CUT:
        return region
    cut = MultiPolygon([_corners_cut(piece) for piece in region.geoms])
    spare = tolerance - CORNER_CUT
    smooth = shapely.simplify(cut, spare, preserve_topology=False)  # ten times as fast
    if not (shapely.is_valid(smooth) and _ring_counts(smooth) == _ring_counts(cut)):
        smooth = shapely.simplify(cut, spare, preserve_topology=True)
    return MultiPolygon(list(shapely.get_parts(smooth)))


def _ring_counts(region: shapely.Geometry) -> list[int]:
    return [len(shapely.get_rings(piece)) for piece in shapely.get_parts(region)]


def _corners_cut(piece: Polygon) -> Polygon:
    rings = [shapely.get_coordinates(ring) for ring in (piece.exterior, *piece.interiors)]
    midpoints = [0.5 * (ring[1:] + ring[:-1]) for ring in rings]
    return Polygon(midpoints[0], midpoints[1:])
