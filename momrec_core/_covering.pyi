import numpy as np
from numpy.typing import NDArray

def rims(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    projections: NDArray[np.float64],
    eyes: NDArray[np.float64],
    lines: int,
    /,
) -> bytes: ...
