import numpy as np
from numpy.typing import NDArray

def fill(
    points: NDArray[np.float64],
    vertices: NDArray[np.int64],
    loops: NDArray[np.int64],
    regions: NDArray[np.int64],
    faces_up: NDArray[np.bool_],
    triangles: NDArray[np.int64],
    counts: NDArray[np.int64],
    /,
) -> None: ...
