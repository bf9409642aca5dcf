from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Footprint: TypeAlias = tuple[
    NDArray[np.float64],  # outline points
    NDArray[np.int64],  # outline rings
    NDArray[np.int64],  # outline regions
    NDArray[np.int64],  # chosen
    NDArray[np.float64],  # scales
    NDArray[np.float64],  # shifts
]

def clip(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    done: NDArray[np.int64],
    footprints: tuple[Footprint, ...],
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
def take(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    regions: NDArray[np.int64],
    chosen: NDArray[np.int64],
    /,
) -> tuple[bytes, bytes, bytes]: ...
