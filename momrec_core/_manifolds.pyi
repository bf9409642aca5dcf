import numpy as np
from numpy.typing import NDArray

def crowded(
    triangles: NDArray[np.int64],
    is_crowded: NDArray[np.bool_],
    sound: int,
    vertices: int,
    /,
) -> None: ...
def take(
    triangles: NDArray[np.int64],
    is_crowded: NDArray[np.bool_],
    rows: NDArray[np.int64],
    points: NDArray[np.float64],
    taken_points: NDArray[np.float64],
    taken: NDArray[np.int64],
    /,
) -> int: ...
