"""Feature vectors of canonical shapes: their normalised moments (section 5 of the paper)."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from momrec_core.canonical import CANONICAL_AREA, CanonicalShape

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["feature_vectors", "moment_indices"]

CONSTANT = {(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 1, 1), (1, 0, 1), (1, 1, 0)}


def moment_indices(order: int = 5) -> list[tuple[int, int, int]]:
    """Return the indices (i, j, k) of the moments that tell shapes apart.

    All of i + j + k up to the order but the seven that the normalisation makes constant: 3 for
    order 2, 13 for order 3, 28 for order 4, 49 for order 5.
    """
    powers = range(order + 1)
    indices = product(powers, powers, powers)
    kept = [index for index in indices if sum(index) <= order and index not in CONSTANT]
    return sorted(kept, key=lambda index: (sum(index), [-power for power in index]))


def feature_vectors(
    shape: CanonicalShape, indices: list[tuple[int, int, int]]
) -> NDArray[np.float64]:
    """Return a shape's moments in each of its admissible principal frames.

    Parameters
    ----------
    shape : CanonicalShape
        Of any canonical area.
    indices : list of (int, int, int)
        The moments eta_ijk to take, of order 5 at most.

    Returns
    -------
    vectors : array, shape (1 + len(shape.alternatives), len(indices))
        For area 100; the principal frame's first. Another frame's axes are the principal ones in
        another order or direction, so its moments are the same up to order and sign.
    """
    powers = np.array(indices)
    alpha = np.sqrt(CANONICAL_AREA / shape.moments[0, 0, 0])
    scales = alpha ** (powers.sum(axis=1) + 2)
    frames = [shape.principal_frame, *shape.alternatives]
    vectors = []
    for frame in frames:
        turn = np.rint(frame[:3, :3].T @ shape.principal_frame[:3, :3]).astype(np.int64)
        axes = np.abs(turn).argmax(axis=1)
        signs = turn[np.arange(3), axes]
        source = np.empty_like(powers)
        source[:, axes] = powers
        vectors.append(np.prod(signs**powers, axis=1) * shape.moments[tuple(source.T)])
    return np.asarray(np.array(vectors) * scales)
