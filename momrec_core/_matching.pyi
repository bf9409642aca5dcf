from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Batch: TypeAlias = tuple[
    NDArray[np.float64],  # points
    NDArray[np.int64],  # rings
    NDArray[np.int64],  # pieces
    NDArray[np.float64],  # areas
    NDArray[np.float64],  # boxes
]

def match(
    layers: NDArray[np.int64],
    listed: NDArray[np.int64],
    batches: tuple[Batch, ...],
    library: Callable[[int, int, int], float],
    most_tried: int,
    area_ratio: float,
    width_ratio: float,
    tolerance: float,
    /,
) -> tuple[bytes, bytes, bytes, bytes]: ...
