"""Feature vectors of canonical shapes: their normalised moments (section 5 of the paper)."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from momrec_core.canonical import CANONICAL_AREA, CanonicalShape
from momrec_core.frames import admissible_frames, different, moment_tensor, turned_moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["INVARIANTS", "feature_vectors", "invariants", "log_size", "moment_indices"]

# What eigenvalues and axis ends of an object differ by, from one reconstruction by ten views to the
# next: with less, symmetric objects get a sign by chance; with more, classes look alike.
GAP_TOLERANCE = SIGN_TOLERANCE = 0.05
INVARIANTS = 11  # numbers that `invariants` returns
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
    shape: CanonicalShape,
    indices: list[tuple[int, int, int]],
    gap_tolerance: float = GAP_TOLERANCE,
    sign_tolerance: float = SIGN_TOLERANCE,
) -> NDArray[np.float64]:
    """Return a shape's moments in each frame that may be its principal one.

    Parameters
    ----------
    shape : CanonicalShape
        Of any canonical area.
    indices : list of (int, int, int)
        The moments eta_ijk to take, of order 5 at most.
    gap_tolerance, sign_tolerance : float
        As for `normalize`, but for how far eigenvalues and axis ends of one object differ from
        one reconstruction to the next.

    Returns
    -------
    vectors : array, shape (frames, len(indices))
        For area 100; the principal frame's first, then those of the alternatives and of further
        frames within these tolerances.
    """
    powers = np.array(indices)
    alpha = np.sqrt(CANONICAL_AREA / shape.moments[0, 0, 0])
    scales = alpha ** (powers.sum(axis=1) + 2)
    own = shape.principal_frame[:3, :3]
    frames = [np.eye(3), *(own.T @ frame[:3, :3] for frame in shape.alternatives)]
    frames += _frames_within(shape, gap_tolerance, sign_tolerance)
    moments = turned_moments(shape.moments, np.array(different(frames)))
    return np.asarray(moments[:, *powers.T] * scales)


def log_size(shape: CanonicalShape) -> float:
    """Return the natural logarithm of a shape's size.

    The size is the square root of its area in the world over that of the canonical area, in
    metres: what a unit of the canonical shape is long. The logarithm makes equal shares equal
    differences, whether objects are small or large.
    """
    alpha = np.sqrt(CANONICAL_AREA / shape.moments[0, 0, 0])
    return -float(np.log(alpha * shape.scale))


def invariants(shape: CanonicalShape) -> NDArray[np.float64]:
    """Return numbers of a shape's moments that are the same in every frame.

    The moments of one order are a symmetric tensor. Its length, and the lengths of what is left
    when pairs of its indices are contracted, depend on no axes: noise that turns the principal
    frame, or makes a round shape's frame any, does not touch them.

    Parameters
    ----------
    shape : CanonicalShape
        Of any canonical area.

    Returns
    -------
    invariants : array, shape (11,)
        Without unit. The logarithm of the squared radius of gyration over the area; then, in
        units of the area and that radius: of second order how far the tensor is from a sphere's
        and its determinant; of third to fifth order lengths, the most contracted first.

    References
    ----------
    F. A. Sadjadi and E. L. Hall, Three-dimensional moment invariants, 1980, for those of second
    order.
    """
    area = shape.moments[0, 0, 0]
    squared = np.trace(moment_tensor(shape.moments, 2)) / area
    second, third, fourth, fifth = (
        moment_tensor(shape.moments, order) / (area * squared ** (order / 2))
        for order in range(2, 6)
    )
    pair, one = np.trace(fourth), np.trace(fifth)
    return np.array(
        [
            np.log(squared / area),
            np.linalg.norm(_without_trace(second)),
            np.linalg.det(second),
            *(np.linalg.norm(np.trace(third)), np.linalg.norm(third)),
            *(np.trace(pair), np.linalg.norm(_without_trace(pair)), np.linalg.norm(fourth)),
            *(np.linalg.norm(np.trace(one)), np.linalg.norm(one), np.linalg.norm(fifth)),
        ]
    )


def _without_trace(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(matrix - np.trace(matrix) / 3.0 * np.eye(3))


def _frames_within(
    shape: CanonicalShape, gap_tolerance: float, sign_tolerance: float
) -> list[NDArray[np.float64]]:
    """Return further frames as columns v2, v3, v1 in canonical coordinates."""
    found = admissible_frames(
        np.ones(3),
        np.array([*(shape.sign_margins >= sign_tolerance), False]),
        shape.eigenvalue_gaps < gap_tolerance,
        shape.moments.transpose(2, 0, 1),
    )
    return [frame[[1, 2, 0]] for frame in found]
