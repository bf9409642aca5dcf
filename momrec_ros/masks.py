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

__all__ = ["MaskContours", "contours_of_mask"]

MAX_PIXELS = 64_000_000  # bounds the memory of one mask: about 0.6 GB while it is traced
# Pixels: joining the midpoints of an outline's edges moves it by 0.25 at most. The rest keeps the
# simplification below the 0.25 by which it would shift whole edges along rows and columns.
CORNER_CUT = 0.26

_Filled: TypeAlias = tuple[list[NDArray[np.float64]], list[NDArray[np.int64]]]


@dataclass(frozen=True, eq=False)
class MaskContours:
    """The region that a binary mask shows.

    Attributes
    ----------
    region : MultiPolygon
        Valid; in pixels with pixel centres at integers, x the column and y the row.
    touches_border : bool
        Whether the object reaches the border of the image, which cuts it there.
    specks : int
        Pieces and holes that were left out as too small.
    """

    region: MultiPolygon
    touches_border: bool
    specks: int


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
    return MaskContours(_smooth(region, tolerance), cut, specks)


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
    simplified = shapely.simplify(cut, tolerance - CORNER_CUT, preserve_topology=True)
    smooth = MultiPolygon(list(shapely.get_parts(simplified)))
    return smooth if smooth.is_valid and len(smooth.geoms) == len(region.geoms) else cut


def _corners_cut(piece: Polygon) -> Polygon:
    rings = [shapely.get_coordinates(ring) for ring in (piece.exterior, *piece.interiors)]
    midpoints = [0.5 * (ring[1:] + ring[:-1]) for ring in rings]
    return Polygon(midpoints[0], midpoints[1:])
