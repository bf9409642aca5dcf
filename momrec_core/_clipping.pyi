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
) -> tuple[bytes, bytes, bytes]: ...
def apart(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    ends: NDArray[np.int64],
    /,
) -> tuple[bytes, bytes, bytes]: ...
def hold(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    chosen: NDArray[np.int64],
    held_points: NDArray[np.float64],
    is_held: NDArray[np.bool_],
    /,
) -> None: ...
def measure(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    areas: NDArray[np.float64],
    boxes: NDArray[np.float64],
    /,
) -> None: ...
def simplify(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    tolerance: float,
    /,
) -> tuple[bytes, bytes, bytes]: ...
