"""Regions of many planes intersected in C, where nothing is degenerate."""

import numpy as np
from numpy.typing import NDArray

def clip(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    outline_points: NDArray[np.float64],
    outline_rings: NDArray[np.int64],
    outline_regions: NDArray[np.int64],
    chosen: NDArray[np.int64],
    scales: NDArray[np.float64],
    shifts: NDArray[np.float64],
    done: NDArray[np.int64],
    tolerance: float,
    /,
) -> tuple[bytes, bytes, bytes]:
    """Clip the region of each plane with outlines, scaled and shifted, one after the other.

    Regions are three arrays: the points of rings, one behind the other, where each ring begins,
    and the first ring of each region; the latter two also tell where the last one ends. The
    result is such three arrays. `chosen`, `scales` and `shifts` are given step by step, for all
    planes. `done` tells how many steps each plane has behind it, before and after; it stops
    before a step that is doubtful.
    """

def hold(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    chosen: NDArray[np.int64],
    held_points: NDArray[np.float64],
    is_held: NDArray[np.bool_],
    /,
) -> None:
    """Tell for points whether the region of each, chosen among some, holds it."""

def simplify(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    tolerance: float,
    /,
) -> tuple[bytes, bytes, bytes]:
    """Leave out vertices that lie within a tolerance of the edge which that makes.

    Takes regions and returns them as `clip` does; rings that are left with fewer than three
    vertices are left out.
    """
