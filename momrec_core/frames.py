"""Principal frames that are as good as each other: what the rules A.1 to A.3 leave open.

Equal eigenvalues leave the axes in their plane, or in space, open to any rotation. There the
moments of higher order take over: the plane's axes are turned to where an angular harmonic of the
shape peaks, and in space the first axis goes where a directional moment does. These frames move
along with the shape, as the eigenvectors of a degenerate matrix do not.
"""

from __future__ import annotations

from functools import cache
from itertools import permutations, product
from math import comb
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

__all__ = ["admissible_frames", "different", "moment_tensor", "turned_moments"]

FAINT = 0.02  # of a harmonic's natural size: what noise makes of a symmetric shape
RIVAL = 0.5  # of the strongest harmonic: others as strong may be the strongest in the next view
PEAK = 0.95  # of the highest directional moment: likewise for peaks
EQUAL = 1e-3  # radians, and entries of frames: nearer than that they are one
ORDERS = (3, 4)  # of directional moments
DIRECTIONS = 128  # from which peaks are sought
ASCENTS = 100  # steps of each search, that bring it near
FLAT = 1e-6  # of a peak's curvature: along a ridge there is no step
LEVEL = 1e-9  # slope at a peak that was reached
REFINEMENTS = 6  # steps of Newton's method, that bring it to the digits of the moments
MOST_PEAKS = 24  # more are those of a round shape: any direction is as good


def admissible_frames(
    signs: NDArray[np.float64],
    signed: NDArray[np.bool_],
    exchangeable: NDArray[np.bool_],
    moments: NDArray[np.float64],
) -> list[NDArray[np.float64]]:
    """Return the right-handed frames, columns v2, v3, v1, the one by A.1 to A.3 first.

    Parameters
    ----------
    signs : array, shape (3,)
        Likely directions along the principal axes, which are the coordinate axes here.
    signed : array of bool, shape (3,)
        Whether the sign of an axis is sure.
    exchangeable : array of bool, shape (2,)
        Whether the first two, the last two axes cannot be told apart.
    moments : array, shape (order + 1,) * 3
        Of the shape along the principal axes, by increasing eigenvalue.

    Returns
    -------
    frames : list of arrays, shape (3, 3)
        Different ones.
    """
    frames = list(_by_eigenvectors(signs, signed, exchangeable))
    if exchangeable.all():
        for peak in _peaks(moments):
            frames += _turned_about(peak, 0, moments)
    elif exchangeable.any():
        single = 2 if exchangeable[0] else 0
        axis = signs[single] * np.eye(3)[single]
        for direction in (axis,) if signed[single] else (axis, -axis):
            frames += _turned_about(direction, single, moments)
    return different(frames)


def _by_eigenvectors(
    signs: NDArray[np.float64], signed: NDArray[np.bool_], exchangeable: NDArray[np.bool_]
) -> Iterator[NDArray[np.float64]]:
    axes = np.diag(signs)
    rank = np.concatenate([[0], np.cumsum(~exchangeable)])  # equal for axes that are alike
    for order in permutations(range(3)):
        if (rank[list(order)] != rank).any():
            continue
        choices = [(1.0,) if signed[axis] else (1.0, -1.0) for axis in order[:2]]
        for first, second in product(*choices):
            v1, v2 = first * axes[:, order[0]], second * axes[:, order[1]]
            yield np.column_stack([v2, _cross(v1, v2), v1])


def _turned_about(
    direction: NDArray[np.float64], single: int, moments: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return the frames with v1 (0) or v3 (2) along a direction, turned to harmonics' peaks."""
    p, q = _tangents(direction[None])[0].T
    frames = []
    (along,) = turned_moments(moments, np.column_stack([p, q, direction])[None])
    for angle in _peak_angles(along):
        found = np.cos(angle) * p + np.sin(angle) * q
        across = _cross(direction, found)
        v1, v2, v3 = (direction, found, across) if single == 0 else (found, across, direction)
        frames.append(np.column_stack([v2, v3, v1]))
    return frames


def _peak_angles(moments: NDArray[np.float64]) -> list[float]:
    """Return the angles about z to which the strongest harmonics of a shape point.

    A harmonic is the moment of (x + iy)^n z^m: it has n peaks. Those of order 2 or less in all
    vanish with the axes' choice.
    """
    order = len(moments) - 1
    area = moments[0, 0, 0]
    radius = np.sqrt((moments[2, 0, 0] + moments[0, 2, 0]) / area)
    height = np.sqrt(moments[0, 0, 2] / area)
    harmonics = {}
    for n in range(1, order + 1):
        for m in range(max(0, 3 - n), order + 1 - n):
            powers = [comb(n, k) * 1j**k * moments[n - k, k, m] for k in range(n + 1)]
            harmonics[n, m] = sum(powers) / (area * radius**n * height**m)
    strongest = max(abs(value) for value in harmonics.values())
    if strongest < FAINT:
        return []
    return [
        (np.angle(value) + 2.0 * np.pi * turn) / n
        for (n, _), value in harmonics.items()
        if abs(value) >= RIVAL * strongest
        for turn in range(n)
    ]


def _peaks(moments: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the directions in which the directional moments that tell most are highest."""
    radius = np.sqrt((moments[2, 0, 0] + moments[0, 2, 0] + moments[0, 0, 2]) / moments[0, 0, 0])
    found = []
    for order in ORDERS:
        tensor = moment_tensor(moments, order) / (moments[0, 0, 0] * radius**order)
        directions = _refined(tensor, _ascended(tensor))
        heights = np.where(_is_summit(tensor, directions), _directional(tensor, directions), 0.0)
        lowest = 0.0 if order % 2 else _directional(tensor, _spread_directions()).min()
        high = heights >= PEAK * heights.max()
        found.append((heights.max() - lowest, different(list(directions[high]))))
    strongest = max(contrast for contrast, _ in found)
    return [
        peak
        for contrast, peaks in found
        if contrast >= max(FAINT, RIVAL * strongest) and len(peaks) <= MOST_PEAKS
        for peak in peaks
    ]


def _ascended(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return directions (n, 3) near which a symmetric tensor's form has a local maximum.

    References
    ----------
    T. G. Kolda and J. R. Mayo, Shifted power method for computing tensor eigenpairs, SIAM Journal
    on Matrix Analysis and Applications 32 (2011).
    """
    rows, columns = tensor.reshape(3, -1), _spread_directions().T
    shift = (tensor.ndim - 1) * np.linalg.norm(tensor)
    for _ in range(ASCENTS):
        powers = columns
        for _ in range(tensor.ndim - 2):
            powers = (powers[:, None] * columns).reshape(-1, DIRECTIONS)
        columns = rows @ powers + shift * columns
        columns /= np.sqrt(np.einsum("in,in->n", columns, columns))
    return columns.T


def _refined(tensor: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return directions (n, 3) where the form of a symmetric tensor is stationary on the sphere."""
    for _ in range(REFINEMENTS):
        tangent = _tangents(directions)
        slope, curvature = _shape_around(tensor, directions, tangent)
        curved, axes = np.linalg.eigh(curvature)
        flat = np.abs(curved) <= FLAT * np.abs(curved).max(axis=1, keepdims=True)
        step = np.einsum("nia,ni->na", axes, slope) / np.where(flat, np.inf, curved)
        directions = directions - (tangent @ axes @ step[:, :, None])[:, :, 0]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions


def _is_summit(tensor: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell whether a symmetric tensor's form is level in a direction and falls on all sides."""
    slope, curvature = _shape_around(tensor, directions, _tangents(directions))
    level = np.abs(slope).max(axis=1) < LEVEL
    return np.asarray(level & (np.linalg.eigvalsh(curvature)[:, -1] < 0.0))


def _shape_around(
    tensor: NDArray[np.float64], directions: NDArray[np.float64], tangent: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how a symmetric tensor's form rises (n, 2) and curves (n, 2, 2) on the sphere.

    Both along the tangents (n, 3, 2).
    """
    second = _contracted(tensor, directions, 2)
    gradient = (second @ directions[:, :, None])[:, :, 0]
    height = (gradient * directions).sum(axis=1)
    across = tangent.transpose(0, 2, 1)
    curvature = (tensor.ndim - 1) * (across @ second @ tangent)
    return (
        (across @ gradient[:, :, None])[:, :, 0],
        np.asarray(curvature - height[:, None, None] * np.eye(2)),
    )


def _tangents(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two orthonormal columns across each direction, shape (n, 3, 2), right-handed."""
    aside = np.eye(3)[np.abs(directions).argmin(axis=1)]
    first = _cross(directions, aside)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, _cross(directions, first)], axis=2)


def _cross(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Do for rows (..., 3) what numpy's function takes several times as long for."""
    after, before = [1, 2, 0], [2, 0, 1]
    return np.asarray(one[..., after] * other[..., before] - one[..., before] * other[..., after])


def _contracted(
    tensor: NDArray[np.float64], directions: NDArray[np.float64], left: int
) -> NDArray[np.float64]:
    """Return a symmetric tensor contracted with each direction until some indices are left."""
    powers = directions
    for _ in range(tensor.ndim - left - 1):
        powers = (powers[:, :, None] * directions[:, None, :]).reshape(len(directions), -1)
    contracted = powers @ tensor.reshape(powers.shape[1], -1)
    return np.asarray(contracted.reshape(-1, *(3,) * left))


def _directional(
    tensor: NDArray[np.float64], directions: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.asarray((_contracted(tensor, directions, 1) * directions).sum(axis=1))


@cache
def _spread_directions() -> NDArray[np.float64]:
    """Return evenly spread directions, shape (n, 3): a spiral with the golden angle."""
    number = np.arange(DIRECTIONS)
    height = 1.0 - (2.0 * number + 1.0) / DIRECTIONS
    angle = np.pi * (3.0 - np.sqrt(5.0)) * number
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def turned_moments(
    moments: NDArray[np.float64], frames: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a shape's moments along other axes.

    Parameters
    ----------
    moments : array, shape (order + 1,) * 3
        m_ijk at [i, j, k], zero where i + j + k exceeds the order.
    frames : array, shape (n, 3, 3)
        Other axes as orthonormal columns.

    Returns
    -------
    turned : array, shape (n,) + (order + 1,) * 3
        Moments of one order depend on those of the same order only: they are the entries of a
        symmetric tensor, which is contracted with the axes.
    """
    turned = np.zeros((*moments.shape, len(frames)))
    for order in range(len(moments)):
        tensor = moment_tensor(moments, order)[..., None]
        for _ in range(order):
            tensor = np.einsum("a...n,nab->...bn", tensor, frames)
        turned[_powers(order)] = tensor
    return np.moveaxis(turned, -1, 0)


def moment_tensor(moments: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Return the moments of one order as a symmetric tensor, shape (3,) * order.

    Parameters
    ----------
    moments : array, shape (order + 1,) * 3, or of a higher order
        m_ijk at [i, j, k].
    order : int
        Of the moments to take.
    """
    return np.asarray(moments[_powers(order)])


@cache
def _powers(order: int) -> tuple[NDArray[np.int64], ...]:
    """Return where the entries of the tensor of an order are among the moments."""
    indices = np.indices((3,) * order) if order else np.zeros((0,), dtype=np.int64)
    return tuple(np.asarray((indices == axis).sum(axis=0)) for axis in range(3))


def different(candidates: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Return directions or frames without those that repeat an earlier one.

    Parameters
    ----------
    candidates : sequence of arrays
        Of one shape.
    """
    columns = np.array(candidates).reshape(len(candidates), -1).T
    is_near = np.ones((len(candidates), len(candidates)), dtype=np.bool_)
    for column in columns:
        is_near &= np.abs(column[:, None] - column) <= EQUAL
    kept: list[int] = []
    for index, near in enumerate(is_near):
        if not near[kept].any():
            kept.append(index)
    return [candidates[index] for index in kept]
