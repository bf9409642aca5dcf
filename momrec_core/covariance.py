"""Covariance matrices that may be singular."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["SINGULAR", "correlation", "invert_covariance"]

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


def invert_covariance(covariance: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """Invert a covariance matrix within the directions that vary.

    Parameters
    ----------
    covariance : array, shape (n, n)
        Symmetric, positive semidefinite.

    Returns
    -------
    inverse : array, shape (n, n)
        Of each feature's own unit, whatever those units are; zero along what does not vary.
    regularized : bool
        Whether some directions do not vary.
    """
    correlations, spread = correlation(covariance)
    values, vectors = np.linalg.eigh(correlations)
    varies = values > SINGULAR * max(float(values[-1]), np.finfo(np.float64).tiny)
    kept = vectors[:, varies] / spread[:, None]
    return np.asarray(kept / values[varies] @ kept.T), not bool(varies.all())
