import numpy as np
from numpy.typing import NDArray

def contacts(
    points: NDArray[np.float64],
    first: NDArray[np.int64],
    chosen: NDArray[np.int64],
    groups: NDArray[np.int64],
    is_above: NDArray[np.bool_],
    touch: float,
    /,
) -> bytes: ...
