"""Covariance matrices that may be singular."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["SINGULAR", "correlation", "distances_from_means", "whitening"]

SINGULAR = 1e-10  # of a feature's variance: what the others may leave of it in an invertible T


def correlation(
    covariance: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a covariance matrix for features of unit variance, and what they were divided by.

    Parameters
    ----------
    covariance : array, shape (n, n)
        Symmetric, positive semidefinite.

    Returns
    -------
    correlation : array, shape (n, n)
    spread : array, shape (n,)
        Standard deviations; 1 for features that do not vary.
    """
    spread = np.sqrt(np.diag(covariance))
    spread = np.where(spread > 0, spread, 1.0)
    return covariance / spread / spread[:, None], spread


def whitening(covariance: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """Return W, in whose columns' directions the features have unit variance, uncorrelated.

    The inverse of the covariance matrix is W W^T, so |x W| is the length of x in its metric.

    Parameters
    ----------
    covariance : array, shape (n, n)
        Symmetric, positive semidefinite; each feature in a unit of its own.

    Returns
    -------
    matrix : array, shape (n, directions)
        Without the directions along which nothing varies.
    regularized : bool
        Whether there are such directions: the covariance matrix has no inverse.
    """
    correlations, spread = correlation(covariance)
    values, vectors = np.linalg.eigh(correlations)
    varies = values > SINGULAR * max(float(values[-1]), np.finfo(np.float64).tiny)
    matrix = vectors[:, varies] / np.sqrt(values[varies]) / spread[:, None]
    return np.asarray(matrix), not bool(varies.all())


def distances_from_means(
    vectors: NDArray[np.float64], means: NDArray[np.float64], matrix: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances (n, classes) of vectors (n, features) in the metric of `whitening`."""
    return np.asarray(np.linalg.norm((vectors[:, None] - means) @ matrix, axis=2))
