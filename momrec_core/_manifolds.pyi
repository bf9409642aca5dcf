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
    rows: NDArray[np.int64],
    is_used: NDArray[np.bool_],
    taken: NDArray[np.int64],
    /,
) -> None: ...
