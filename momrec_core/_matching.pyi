from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

def match(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    pieces: NDArray[np.int64],
    areas: NDArray[np.float64],
    boxes: NDArray[np.float64],
    starts: NDArray[np.int64],
    counts: NDArray[np.int64],
    listed: NDArray[np.int64],
    library: Callable[[int, int], float],
    most_tried: int,
    area_ratio: float,
    width_ratio: float,
    tolerance: float,
    /,
) -> tuple[bytes, bytes, bytes]: ...
