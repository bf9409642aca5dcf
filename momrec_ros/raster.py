"""Binary masks as a camera would give them: a region's pixels."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["mask_of_region"]


def mask_of_region(region: shapely.MultiPolygon, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the pixels whose centres a region holds.

    Parameters
    ----------
    region : MultiPolygon
        In pixels, pixel centres at integers, x the column and y the row; may reach beyond the
        image.
    size : tuple of int
        Width and height of the image.

    Returns
    -------
    mask : array of bool, shape (height, width)
        By the even-odd rule. A boundary through a centre leaves it to one side, so that regions
        that share it share no pixel.
    """
    width, height = size
    starts, ends = _edges(region)
    rises = ends[:, 1] - starts[:, 1]
    rising = rises > 0
    low, high = np.where(rising[:, None], starts, ends), np.where(rising[:, None], ends, starts)
    # A row meets an edge from its lower end on, that included, to its upper end, that not.
    first = np.clip(np.ceil(low[:, 1]), 0, height).astype(np.int64)
    stop = np.clip(np.ceil(high[:, 1]), 0, height).astype(np.int64)
    counts = stop - first
    owners = np.repeat(np.arange(len(first)), counts)
    rows = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts - first, counts)
    along = (rows - low[owners, 1]) / np.abs(rises[owners])
    crossings = low[owners, 0] + along * (high[owners, 0] - low[owners, 0])
    columns = np.clip(np.ceil(crossings), 0, width).astype(np.int64)
    counts = np.bincount(rows * (width + 1) + columns, minlength=height * (width + 1))
    changes = (counts % 2 == 1).reshape(height, width + 1)[:, :width]
    return np.asarray(np.logical_xor.accumulate(changes, axis=1))


def _edges(region: shapely.MultiPolygon) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return both ends of every edge of a region's rings, shape (n, 2)."""
    rings = [
        shapely.get_coordinates(ring)
        for piece in region.geoms
        for ring in (piece.exterior, *piece.interiors)
    ]
    if not rings:
        return np.empty((0, 2)), np.empty((0, 2))
    return np.concatenate([ring[:-1] for ring in rings]), np.concatenate(
        [ring[1:] for ring in rings]
    )
