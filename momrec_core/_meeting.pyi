import numpy as np
from numpy.typing import NDArray

def contacts(
    below_starts: NDArray[np.float64],
    below_ends: NDArray[np.float64],
    below_groups: NDArray[np.int64],
    above_starts: NDArray[np.float64],
    above_ends: NDArray[np.float64],
    above_groups: NDArray[np.int64],
    touch: float,
    /,
) -> bytes: ...
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
