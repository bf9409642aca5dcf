"""Lens distortion of pinhole cameras, and its inverse where there is exactly one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from momrec_core.errors import InvalidCameraError

__all__ = ["Lens"]

RADIAL, TANGENTIAL = (0, 1, 4, 5, 6, 7), (2, 3)  # places of k1 to k6, and of p1 and p2
SMALLEST_COEFFICIENT = 1e-30  # less moves nothing that numbers of this precision can tell
LARGEST_COEFFICIENT = 1e6  # far beyond any lens; products of several stay far from overflow
REAL_ROOT = 1e-6  # of a root's size: an imaginary part below it is rounding (or a double root)
RESIDUAL = 1e-12  # normalised image coordinates: a millionth of a pixel of the longest lens
ITERATIONS = 50  # Newton needs 3 to 8; near the edge, where steps are halved, some tens
SMALLEST = 1e-300  # a length to divide by, in place of zero
HALVINGS = 20  # of one step, until it is shorter than what can be told


@dataclass(frozen=True, eq=False)
class Lens:
    """How a lens moves the image of a point: the models plumb_bob and rational_polynomial.

    Coordinates are normalised: x / z and y / z of a point in the optical frame. The lens moves
    (x, y) with r^2 = x^2 + y^2 to::

        x (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
          + 2 p1 x y + p2 (r^2 + 2 x^2)

    and y likewise, with ``p1 (r^2 + 2 y^2) + 2 p2 x y``.

    Parameters
    ----------
    coefficients : array-like, shape (n,)
        k1, k2, p1, p2, k3, k4, k5, k6, as in sensor_msgs/CameraInfo; of less than eight the
        others are zero.

    Raises
    ------
    InvalidCameraError
        If there are more than eight, or one is not finite or above 1e6.

    References
    ----------
    Brown, D. C. (1966). Decentering distortion of lenses. Photogrammetric Engineering 32(3).
    Claus, D., Fitzgibbon, A. (2005). A rational function lens distortion model. CVPR.
    """

    coefficients: NDArray[np.float64]

    def __post_init__(self) -> None:
        given = _check_coefficients(self.coefficients)
        object.__setattr__(self, "coefficients", np.pad(given, (0, 8 - len(given))))

    @property
    def is_trivial(self) -> bool:
        """Whether the lens moves nothing."""
        return not self.coefficients.any()

    @cached_property
    def radius(self) -> float:
        """Radius of the disc around the optical axis in which the lens can be undone.

        The Jacobian of `distort` is symmetric. Its eigenvalues are those of the radial part,
        f(r) / r and f'(r), changed by at most 6 r |(p1, p2)|. In the disc in which they stay
        positive, `distort` is the gradient of a strictly convex function, so no two points are
        moved to one. Infinite where they always do.
        """
        above, below = map(Polynomial, self._radial)
        s = Polynomial([0.0, 1.0])  # r^2
        slope = (above + 2 * s * above.deriv()) * below - 2 * s * above * below.deriv()
        bend = 6.0 * float(np.hypot(*self._tangential))
        bounds = (
            _in_radius(below),
            _in_radius(above) - Polynomial([0.0, bend]) * _in_radius(below),
            _in_radius(slope) - Polynomial([0.0, bend]) * _in_radius(below) ** 2,
        )
        return min(map(_first_positive_root, bounds))

    def distort(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return where the lens images points.

        Parameters
        ----------
        points : array-like, shape (n, 2)
            Normalised coordinates without distortion.

        Returns
        -------
        distorted : array, shape (n, 2)
            Normalised coordinates.
        """
        x, y = np.asarray(points, dtype=np.float64).T
        p1, p2 = self._tangential
        r2 = x * x + y * y
        above, below = (_value(powers, r2) for powers in self._radial)
        stretch = above / below
        return np.column_stack(
            [
                stretch * x + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                stretch * y + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ]
        )

    def undistort(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the points that the lens images at given ones.

        Newton's method with halved steps, which inside `radius` has one solution at most.

        Parameters
        ----------
        points : array-like, shape (n, 2)
            Distorted normalised coordinates.

        Returns
        -------
        undistorted : array, shape (n, 2)
            Normalised coordinates within `radius`; `distort` moves each to the given point
            within 1e-12 (of its size, where that is above 1).

        Raises
        ------
        InvalidCameraError
            If a point is the image of none within `radius`: the lens's coefficients say nothing
            of it.
        """
        goal = np.array(points, dtype=np.float64).reshape(-1, 2)
        if self.is_trivial:
            return goal
        with np.errstate(all="ignore"):  # of points that are none, and steps beyond the disc
            lengths = _lengths(goal)
            allowed = np.where(np.isfinite(lengths), RESIDUAL * np.maximum(1.0, lengths), 0.0)
            # From inside of the disc, whatever is asked for.
            found = goal * np.minimum(1.0, 0.5 * self.radius / lengths.clip(SMALLEST))[:, None]
            at_work = np.arange(len(goal))
            for _ in range(ITERATIONS):
                points, aims = found[at_work], goal[at_work]
                is_open = ~(self._error(points, aims) <= allowed[at_work])
                at_work, points, aims = at_work[is_open], points[is_open], aims[is_open]
                if not len(at_work):
                    break
                reached = self._advanced(points, self._newton_step(points, aims), aims)
                found[at_work] = reached
                at_work = at_work[(reached != points).any(axis=1)]
            missed = ~(self._error(found, goal) <= allowed)
        if missed.any():
            raise InvalidCameraError(
                f"Expected points of the image that the lens shows within {self.radius:.6g} (tan "
                f"of the angle to the axis), where its distortion can be undone, got "
                f"{int(missed.sum())} of {len(goal)} beyond, such as {goal[missed][0].tolist()}"
            )
        return found

    @property
    def _radial(self) -> NDArray[np.float64]:
        """Numerator and denominator of the radial stretch in r^2, lowest power first; (2, 4)."""
        k = self.coefficients[list(RADIAL)]
        return np.column_stack([np.ones(2), k.reshape(2, 3)])

    @property
    def _tangential(self) -> tuple[float, float]:
        p1, p2 = self.coefficients[list(TANGENTIAL)].tolist()
        return p1, p2

    def _error(self, points: NDArray[np.float64], goal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how much points miss their goal; infinitely beyond the radius."""
        missed = _lengths(self.distort(points) - goal)
        return np.where(_lengths(points) < self.radius, missed, np.inf)

    def _newton_step(
        self, points: NDArray[np.float64], goal: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Solve J step = goal - distort(points) for the symmetric Jacobian J of each point."""
        x, y = points.T
        p1, p2 = self._tangential
        r2 = x * x + y * y
        above, below = (_value(powers, r2) for powers in self._radial)
        above_slope, below_slope = (_value(powers[1:] * (1, 2, 3), r2) for powers in self._radial)
        stretch = above / below
        growth = 2 * (above_slope - stretch * below_slope) / below
        xx = stretch + growth * x * x + 2 * p1 * y + 6 * p2 * x
        yy = stretch + growth * y * y + 6 * p1 * y + 2 * p2 * x
        xy = growth * x * y + 2 * p1 * x + 2 * p2 * y
        right, down = (goal - self.distort(points)).T
        step = np.column_stack([yy * right - xy * down, xx * down - xy * right])
        return np.asarray(step / (xx * yy - xy * xy)[:, None])

    def _advanced(
        self, points: NDArray[np.float64], step: NDArray[np.float64], goal: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Go along each step as far as the error shrinks: all of it, half, a quarter, ..."""
        before = self._error(points, goal)
        reached = points.copy()
        waiting = np.arange(len(points))
        for halving in range(HALVINGS):
            tried = points[waiting] + 0.5**halving * step[waiting]
            is_better = self._error(tried, goal[waiting]) < before[waiting]
            reached[waiting[is_better]] = tried[is_better]
            waiting = waiting[~is_better]
            if not len(waiting):
                break
        return reached


def _check_coefficients(given: ArrayLike) -> NDArray[np.float64]:
    try:
        values = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidCameraError(
            f"Expected the numbers k1, k2, p1, p2, k3 to k6 of a lens, got {given!r:.80}"
        ) from error
    if values.ndim != 1 or len(values) > 8:
        raise InvalidCameraError(
            f"Expected at most 8 coefficients of a lens, got shape {values.shape}"
        )
    if not (np.abs(values) <= LARGEST_COEFFICIENT).all():
        raise InvalidCameraError(
            f"Expected finite coefficients of a lens, none above {LARGEST_COEFFICIENT:g}, got "
            f"{values.tolist()}"
        )
    return np.where(np.abs(values) < SMALLEST_COEFFICIENT, 0.0, values)


def _lengths(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hypot(points[:, 0], points[:, 1])


def _value(powers: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a polynomial's values, lowest power first."""
    total = np.full_like(at, powers[-1])
    for power in powers[-2::-1]:
        total = total * at + power
    return total


def _in_radius(polynomial: Polynomial) -> Polynomial:
    """Return a polynomial in r^2 as one in r."""
    powers = np.zeros(2 * len(polynomial.coef) - 1)
    powers[::2] = polynomial.coef
    return Polynomial(powers)


def _first_positive_root(polynomial: Polynomial) -> float:
    roots = polynomial.trim().roots()
    is_real = np.abs(roots.imag) <= REAL_ROOT * np.abs(roots)
    positive = roots.real[is_real & (roots.real > 0)]
    return float(positive.min(initial=np.inf))
