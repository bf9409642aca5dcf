"""Regions of many planes intersected in C, where nothing is degenerate."""

import numpy as np
from numpy.typing import NDArray

def intersect(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    outline_points: NDArray[np.float64],
    outline_rings: NDArray[np.int64],
    outline_regions: NDArray[np.int64],
    chosen: NDArray[np.int64],
    scales: NDArray[np.float64],
    shifts: NDArray[np.float64],
    is_doubtful: NDArray[np.bool_],
    tolerance: float,
    /,
) -> tuple[bytes, bytes, bytes]:
    """Intersect the region of each plane with an outline, scaled and shifted.

    Regions are three arrays: the points of rings, one behind the other, where each ring begins,
    and the first ring of each region; the latter two also tell where the last one ends. The
    result is such three arrays; a plane that is doubtful has an empty region in it.
    """

def simplify(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    tolerance: float,
    /,
) -> tuple[bytes, bytes, bytes]:
    """Leave out vertices that lie within a tolerance of the edge which that makes.

    Takes regions and returns them as `intersect` does; rings that are left with fewer than three
    vertices are left out.
    """
