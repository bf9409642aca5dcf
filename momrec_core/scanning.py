"""Regions of an image seen along parallel scan lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["outline_edges", "outline_points", "scan_spans"]


def scan_spans(
    starts: NDArray[np.float64], ends: NDArray[np.float64], offsets: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the segments of scan lines that lie inside an outline, by the even-odd rule.

    Parameters
    ----------
    starts, ends : array, shape (e, 2)
        The outline's edges: coordinates along and across the scan lines.
    offsets : array, shape (n,)
        Where the scan lines are, across.

    Returns
    -------
    spans : array, shape (m, 2)
        Line by line, as intervals of the coordinate along the lines.
    counts : array of int, shape (n,)
        How many each line has.
    """
    first, last = starts[:, 1], ends[:, 1]
    lines, edges = np.nonzero((first <= offsets[:, None]) != (last <= offsets[:, None]))
    start, end = starts[edges], ends[edges]
    fraction = (offsets[lines] - start[:, 1]) / (end[:, 1] - start[:, 1])
    positions = start[:, 0] + fraction * (end[:, 0] - start[:, 0])
    order = np.lexsort([positions, lines])
    counts = np.bincount(lines, minlength=len(offsets)) // 2
    return positions[order].reshape(-1, 2), counts


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
