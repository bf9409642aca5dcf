import numpy as np
from numpy.typing import NDArray

def outline(
    points: NDArray[np.float64],
    vertices: NDArray[np.int64],
    is_own: NDArray[np.bool_],
    first: NDArray[np.int64],
    pieces: NDArray[np.int64],
    knots: NDArray[np.int64],
    is_above: NDArray[np.bool_],
    links: NDArray[np.int64],
    /,
) -> tuple[bytes, bytes, bytes, bytes, bytes, bytes]: ...
