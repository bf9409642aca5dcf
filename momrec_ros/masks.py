"""Occluding contours of binary masks, finer than a pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon

from momrec_core import InvalidContourError
from momrec_ros.tracing import pixel_outline

__all__ = ["MaskContours", "Straighten", "contours_of_mask", "hull_silhouette", "object_pixels"]

MAX_PIXELS = 64_000_000  # bounds the memory of one mask: about 0.6 GB while it is traced
MAX_POINTS = 1_000_000  # of an outline: far above any object's, and noise is refused before tracing
# Pixels: joining the midpoints of an outline's edges moves it by 0.25 at most. The rest keeps the
# simplification below the 0.25 by which it would shift whole edges along rows and columns.
CORNER_CUT = 0.26
# Of the image's larger side: how far an object that the border cuts may go on beyond it.
OPEN_DEPTH = 0.25
BORDER_STEP = 4.0  # pixels between points of the border where a lens bends it
OUTWARDS = ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))  # left, right, top, bottom

# From pixels of the image, shape (n, 2), to those that a lens without distortion would show.
Straighten: TypeAlias = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class MaskContours:
    """The region that a binary mask shows.

    Attributes
    ----------
    region : MultiPolygon
        Valid; in pixels with pixel centres at integers, x the column and y the row; straightened
        where the mask was traced so.
    size : tuple of int
        Width and height of the image; it covers x from -0.5 to width - 0.5, y likewise.
    beyond : MultiPolygon
        Where the object may go on outside of the image, and a seam inside; in the pixels of
        ``region``, empty where the object does not reach the border.
    specks : int
        Pieces and holes that were left out as too small.
    """

    region: MultiPolygon
    size: tuple[int, int]
    beyond: MultiPolygon
    specks: int

    @property
    def touches_border(self) -> bool:
        """Whether the object reaches the border of the image, which cuts it there."""
        return not self.beyond.is_empty

    @property
    def frame(self) -> Polygon:
        """The rectangle that the image covers, pixels of the image itself."""
        width, height = self.size
        return shapely.box(-0.5, -0.5, width - 0.5, height - 0.5)


def contours_of_mask(
    mask: ArrayLike,
    *,
    tolerance: float = 0.5,
    min_area: float = 16.0,
    straighten: Straighten | None = None,
) -> MaskContours:
    """Trace the outline of a binary mask.

    The outline runs halfway between the centres of object and background pixels (marching
    squares), so that it keeps the area; joining the midpoints of its edges takes most of the
    staircase away, and the simplification (Douglas and Peucker, preserving topology) uses what
    is left of the tolerance.

    Parameters
    ----------
    mask : array-like, shape (height, width)
        As for `object_pixels`.
    tolerance : float
        Largest distance in pixels between the pixels' outline and the result; below 0.26 the
        outline is returned as it is.
    min_area : float
        Pieces and holes below this area, in pixels, are left out.
    straighten : callable, optional
        Undoes the distortion of the lens. It is applied to the fine outline, so that the
        tolerance holds in straightened pixels.

    Returns
    -------
    contours : MaskContours
        The region in pixels, pixel centres at integers.

    Raises
    ------
    InvalidContourError
        If the mask is no binary image, is too large, or shows no object.
    ValueError
        If the tolerance or the smallest area is negative or not finite.
    """
    for name, value in (("tolerance", tolerance), ("smallest area", min_area)):
        if not 0 <= value < np.inf:
            raise ValueError(f"Expected a {name} of 0 pixels or more, got {value}")
    inside = object_pixels(mask)
    rows = np.flatnonzero(inside.any(axis=1))
    columns = np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        values = np.asarray(mask)
        hint = "" if values.dtype == np.bool_ else f" (largest value {values.max(initial=0):d})"
        raise InvalidContourError(f"Expected a mask that shows an object, got an empty one{hint}")
    cropped = inside[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    _check_length(cropped)
    outline = pixel_outline(cropped, columns[0], rows[0])
    region, specks = _without_specks(outline, min_area)
    if region.is_empty:
        raise InvalidContourError(
            f"Expected a mask that shows an object of {min_area:g} pixels or more, got "
            f"{len(outline.geoms)} pieces of at most {shapely.area(outline.geoms).max():g} pixels"
        )
    height, width = inside.shape
    return MaskContours(
        _smooth(region, tolerance, straighten),
        (width, height),
        _beyond_border(region, (width, height), tolerance, straighten),
        specks,
    )


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
    silhouette = shapely.union(grown, contours.beyond)
    return MultiPolygon(list(shapely.get_parts(silhouette)))


def _beyond_border(
    region: MultiPolygon, size: tuple[int, int], tolerance: float, straighten: Straighten | None
) -> MultiPolygon:
    """Return where the object may go on outside of the image, for each run along a border."""
    low, high = np.full(2, -0.5), np.array(size) - 0.5
    left, top, right, bottom = region.bounds
    if min(left, top) > 0 and (np.array([right, bottom]) < high - 0.5).all():
        return MultiPolygon()
    parts: list[Polygon] = []
    for outward in np.array(OUTWARDS):
        along = 1 - np.abs(outward)
        # The line between the border and the centres of the pixels along it.
        middle = np.where(along, 0.0, np.where(outward > 0, high - 0.25, low + 0.25))
        line = shapely.linestrings([middle + along * low, middle + along * high])
        runs = shapely.get_parts(shapely.intersection(region, line))
        for run in runs[shapely.length(runs) > 0]:
            start, end = np.reshape(run.bounds, (2, 2))
            # Half a pixel longer: runs along two borders meet in the corner between them.
            start, end = start - 0.5 * along, end + 0.5 * along
            seam = np.array([start, end, end, start])
            seam += outward * np.array([[0.25], [0.25], [-0.25 - tolerance], [-0.25 - tolerance]])
            parts += _going_on(seam, outward, OPEN_DEPTH * max(size), straighten)
    return MultiPolygon(list(shapely.get_parts(shapely.union_all(parts))))


def _going_on(
    seam: NDArray[np.float64],
    outward: NDArray[np.float64],
    depth: float,
    straighten: Straighten | None,
) -> list[Polygon]:
    """Return a seam along the border, and what may be outside: wider by 45 degrees on either side.

    The seam's first two corners, shape (4, 2), are on the border.
    """
    border, inside = seam[:2], shapely.polygons(seam)
    if straighten is not None:
        inside = shapely.transform(shapely.segmentize(inside, BORDER_STEP), straighten)
        border = straighten(_points_along(border))
    along = border[-1] - border[0]
    along /= np.hypot(*along)
    corners = border[[-1, 0]] + depth * (outward + np.array([along, -along]))
    outside = shapely.make_valid(Polygon([*border, *corners]), method="structure")
    return [part for part in shapely.get_parts([inside, outside]) if isinstance(part, Polygon)]


def _points_along(ends: NDArray[np.float64]) -> NDArray[np.float64]:
    line = shapely.segmentize(shapely.linestrings(ends), BORDER_STEP)
    return np.asarray(shapely.get_coordinates(line))


def object_pixels(mask: ArrayLike) -> NDArray[np.bool_]:
    """Return which pixels of a mask are object.

    Parameters
    ----------
    mask : array-like, shape (height, width)
        Booleans, or unsigned integers: where none is above 1, those of 1 are object, else those
        above half the range (of 8 bits: from 128 on).

    Returns
    -------
    inside : array of bool, shape (height, width)
        True for object.

    Raises
    ------
    InvalidContourError
        If the mask is no image of such values, or too large.
    """
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
    highest_background = np.iinfo(values.dtype).max // 2 if values.max(initial=0) > 1 else 0
    inside: NDArray[np.bool_] = values > highest_background
    return inside


def _check_length(inside: NDArray[np.bool_]) -> None:
    """Refuse a mask whose outline, a point for each edge between two kinds of pixels, is noise."""
    padded = np.pad(inside, 1)
    points = np.count_nonzero(padded[1:] != padded[:-1])
    points += np.count_nonzero(padded[:, 1:] != padded[:, :-1])
    if points > MAX_POINTS:
        raise InvalidContourError(
            f"Expected an outline of at most {MAX_POINTS} points, got {points}"
        )


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


def _smooth(region: MultiPolygon, tolerance: float, straighten: Straighten | None) -> MultiPolygon:
    is_simplified = tolerance >= CORNER_CUT
    fine = (
        MultiPolygon([_corners_cut(piece) for piece in region.geoms]) if is_simplified else region
    )
    if straighten is not None:
        fine = shapely.transform(fine, straighten)
    if not is_simplified:
        return fine
    spare = tolerance - CORNER_CUT
    smooth = shapely.simplify(fine, spare, preserve_topology=False)  # ten times as fast
    if not (shapely.is_valid(smooth) and _ring_counts(smooth) == _ring_counts(fine)):
        smooth = shapely.simplify(fine, spare, preserve_topology=True)
    return MultiPolygon(list(shapely.get_parts(smooth)))


def _ring_counts(region: shapely.Geometry) -> list[int]:
    return [len(shapely.get_rings(piece)) for piece in shapely.get_parts(region)]


def _corners_cut(piece: Polygon) -> Polygon:
    rings = [shapely.get_coordinates(ring) for ring in (piece.exterior, *piece.interiors)]
    midpoints = [0.5 * (ring[1:] + ring[:-1]) for ring in rings]
    return Polygon(midpoints[0], midpoints[1:])
