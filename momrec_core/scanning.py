"""Regions of an image seen along parallel scan lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from momrec_core._scanning import scan
from momrec_core.rings import Rings

__all__ = ["outline_edges", "outline_points", "scan_spans"]


def scan_spans(
    outline: Rings, offsets: NDArray[np.float64], clearance: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the segments of scan lines that lie inside an outline, by the even-odd rule.

    Parameters
    ----------
    outline : Rings
        Its vertices' coordinates along and across the scan lines.
    offsets : array, shape (n,)
        Where the scan lines are, across.
    clearance : float
        Segments of a line that are no further apart are taken as one, and those that are no
        longer are left out.

    Returns
    -------
    spans : array, shape (m, 2)
        Line by line, as intervals of the coordinate along the lines, increasing.
    counts : array of int, shape (n,)
        How many each line has.
    """
    points, lines = np.ascontiguousarray(outline.points), np.ascontiguousarray(offsets)
    spans, counts = scan(points, outline.first, lines, clearance)
    return np.frombuffer(spans).reshape(-1, 2), np.frombuffer(counts, dtype=np.int64)


def outline_edges(
    regions: shapely.Geometry | Sequence[shapely.Geometry],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the edges of regions' outlines.

    Parameters
    ----------
    regions : Polygon or MultiPolygon, or several of them
        With areas.

    Returns
    -------
    starts, ends : array, shape (e, 2)
        In the regions' coordinates.
    owners : array of int, shape (e,)
        The place of each edge's region.
    """
    parts, of_part = shapely.get_parts(regions, return_index=True)
    outlines, of_ring = shapely.get_rings(parts, return_index=True)
    points, rings = shapely.get_coordinates(outlines, return_index=True)
    inner = rings[1:] == rings[:-1]
    return points[:-1][inner], points[1:][inner], of_part[of_ring[rings[1:][inner]]]


def outline_points(region: shapely.Geometry, count: int) -> NDArray[np.float64]:
    """Return points at equal steps along a region's outline, its rings one behind the other.

    Parameters
    ----------
    region : Polygon or MultiPolygon
        With an area.
    count : int
        Number of points.

    Returns
    -------
    points : array, shape (count, 2)
    """
    starts, ends, _ = outline_edges(region)
    lengths = np.hypot(*(ends - starts).T)
    reached = np.cumsum(lengths)
    steps = reached[-1] * (np.arange(count) + 0.5) / count
    edges = np.searchsorted(reached, steps)
    fractions = (steps - reached[edges]) / lengths[edges] + 1
    return np.asarray(starts[edges] + fractions[:, None] * (ends - starts)[edges])
