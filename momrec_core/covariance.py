"""Covariance matrices that may be singular."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = [
    "SINGULAR",
    "correlation",
    "distances_from_means",
    "distances_in_own_metrics",
    "drawn_covariance",
    "whitening",
]

SINGULAR = 1e-10  # of a feature's variance: what the others may leave of it in an invertible T
# That a class's own covariance counts besides its members as if they had the common one: with a
# few members in many features it tells little by itself. From 2 to 50, rates are much the same.
COMMON_MEMBERS = 5


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


def drawn_covariance(
    offsets: NDArray[np.float64], common: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariance of one class, drawn towards that which all classes have in common.

    Parameters
    ----------
    offsets : array, shape (members, n)
        Of the members of the class from their mean.
    common : array, shape (n, n)
        Covariance within classes.

    Returns
    -------
    covariance : array, shape (n, n)
        The common one for a single member; its own where there are very many.

    References
    ----------
    J. H. Friedman, Regularized discriminant analysis, 1989.
    """
    scatter = offsets.T @ offsets + COMMON_MEMBERS * common
    return np.asarray(scatter / (len(offsets) - 1 + COMMON_MEMBERS))


def distances_in_own_metrics(
    vectors: NDArray[np.float64],
    means: NDArray[np.float64],
    matrices: Sequence[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return the distances (n, classes) of vectors, each class with its matrix of `whitening`."""
    return np.stack(
        [
            distances_from_means(vectors, mean[None], matrix)[:, 0]
            for mean, matrix in zip(means, matrices, strict=True)
        ],
        axis=1,
    )
