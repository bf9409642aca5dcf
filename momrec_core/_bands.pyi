import numpy as np
from numpy.typing import NDArray

def greedy(
    points: NDArray[np.float64],
    first: NDArray[np.int64],
    pairs: NDArray[np.int64],
    expected: NDArray[np.float64],
    starts: NDArray[np.int64],
    rises: NDArray[np.bool_],
    fits: NDArray[np.float64],
    shifts: NDArray[np.float64],
    /,
) -> None: ...
def least(
    points: NDArray[np.float64],
    first: NDArray[np.int64],
    pairs: NDArray[np.int64],
    expected: NDArray[np.float64],
    starts: NDArray[np.int64],
    rises: NDArray[np.bool_],
    fits: NDArray[np.float64],
    /,
) -> None: ...
def expect(
    points: NDArray[np.float64],
    first: NDArray[np.int64],
    pairs: NDArray[np.int64],
    expected: NDArray[np.float64],
    /,
) -> None: ...
def lay(
    first: NDArray[np.int64],
    pairs: NDArray[np.int64],
    starts: NDArray[np.int64],
    rises: NDArray[np.bool_],
    is_laid: NDArray[np.bool_],
    order: NDArray[np.int64],
    ends: NDArray[np.int64],
    triangles: NDArray[np.int64],
    /,
) -> None: ...
