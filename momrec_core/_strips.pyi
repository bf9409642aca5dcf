import numpy as np
from numpy.typing import NDArray

def bound(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    outlines: NDArray[np.int64],
    matrices: NDArray[np.float64],
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    views: NDArray[np.int64],
    spare: int,
    point_sine: float,
    /,
) -> tuple[bytes, bytes]: ...
