import numpy as np
from numpy.typing import NDArray

def scan(
    points: NDArray[np.float64],
    rings: NDArray[np.int64],
    offsets: NDArray[np.float64],
    clearance: float,
    /,
) -> tuple[bytes, bytes]: ...
