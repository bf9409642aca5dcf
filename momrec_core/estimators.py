"""Linear discrimination as in section 5 of the paper, as scikit-learn estimators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.feature_selection import SelectorMixin
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from momrec_core.covariance import (
    SINGULAR,
    distances_from_means,
    distances_in_own_metrics,
    drawn_covariance,
    whitening,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["MinimumDistanceClassifier", "StepwiseSelector"]


METRICS = ("total", "within", "own")
TOTAL_SHARE = 0.01  # of the metric within classes: more blurs, less trusts few instances too much
# Of the variances, added to what classes with metrics of their own have in common: few instances
# tell how features vary, but hardly how many of them do so together.
DIAGONAL_SHARE = 0.1
TRACE_SHARE = 1e-4  # of T in it: where instances are equal, this tells classes apart


class StepwiseSelector(SelectorMixin, BaseEstimator):  # type: ignore[misc]  # both are untyped
    """Choose features one by one so that trace(T_q^-1 B_q) is largest at each step.

    T_q is the total covariance of the q features chosen so far and the candidate, B_q their
    covariance between classes. A candidate that the chosen ones determine is passed over.

    Parameters
    ----------
    max_features : int, default 10
        Number of steps at the most.

    Attributes
    ----------
    selected_ : array of int, shape (steps,)
        The chosen features in the order of their choice.
    traces_ : array, shape (steps,)
        The criterion after each step; at most the number of classes less one.
    n_features_in_ : int
        Number of features seen in `fit`.

    References
    ----------
    Section 5 of the paper.
    """

    def __init__(self, max_features: int = 10) -> None:
        self.max_features = max_features

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Choose features.

        Parameters
        ----------
        X : array-like, shape (n, features)
        y : array-like, shape (n,)
            Class labels.

        Returns
        -------
        self : StepwiseSelector
        """
        vectors, labels = validate_data(self, X, y, dtype=np.float64)
        check_classification_targets(labels)
        if self.max_features < 1:
            raise ValueError(f"Expected at least one feature, got {self.max_features}")
        total, between = _covariances(_standardised(vectors), labels)
        chosen: list[int] = []
        traces: list[float] = []
        while len(chosen) < min(self.max_features, self.n_features_in_):
            gains = _gains(total, between)
            gains[chosen] = -np.inf
            best = int(np.argmax(gains))
            if not np.isfinite(gains[best]):
                break
            chosen.append(best)
            traces.append(sum(traces[-1:]) + float(gains[best]))
            total, between = _without(total, between, best)
        self.selected_ = np.array(chosen or [0])
        self.traces_ = np.array(traces if chosen else [0.0])
        return self

    def _get_support_mask(self) -> NDArray[np.bool_]:
        check_is_fitted(self)
        mask = np.zeros(self.n_features_in_, dtype=bool)
        mask[self.selected_] = True
        return mask

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        return tags


def _standardised(X: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centre features and scale those that vary to unit variance; the criterion is the same."""
    centred = X - X.mean(axis=0)
    spread = centred.std(axis=0)
    varies = spread > SINGULAR * np.abs(X).max(axis=0)
    return np.asarray(np.where(varies, centred / np.where(varies, spread, 1.0), 0.0))


def _covariances(
    X: NDArray[np.float64], y: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the total covariance T and the covariance between classes B."""
    _, classes, counts = np.unique(y, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), X.shape[1]))
    np.add.at(sums, classes, X)
    offsets = sums / counts[:, None] - X.mean(axis=0)
    centred = X - X.mean(axis=0)
    return centred.T @ centred / len(X), (counts[:, None] * offsets).T @ offsets / len(X)


def _gains(total: NDArray[np.float64], between: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much each feature raises trace(T_q^-1 B_q); -inf if it hangs on the chosen.

    The trace does not depend on the features' basis. Of what the chosen features leave of a
    candidate, uncorrelated with them, it takes the share that is between classes.
    """
    left = np.diag(total)
    usable = left > SINGULAR
    return np.where(usable, np.diag(between) / np.where(usable, left, 1.0), -np.inf)


def _without(
    total: NDArray[np.float64], between: NDArray[np.float64], chosen: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the covariances T and B of what a feature, by regression, leaves of all features."""
    slopes = total[chosen] / total[chosen, chosen]
    residual = np.eye(len(total))
    residual[:, chosen] -= slopes
    return residual @ total @ residual.T, residual @ between @ residual.T


def _blended(
    within: NDArray[np.float64], total: NDArray[np.float64], metric: str
) -> NDArray[np.float64]:
    """Return the covariance within classes as a metric takes it, with a part of T."""
    if metric == "within":
        return (1.0 - TOTAL_SHARE) * within + TOTAL_SHARE * total
    return within + DIAGONAL_SHARE * np.diag(np.diag(within)) + TRACE_SHARE * total


class MinimumDistanceClassifier(ClassifierMixin, BaseEstimator):  # type: ignore[misc]  # likewise
    """Give each vector the class with the nearest mean, by a covariance matrix or one per class.

    Parameters
    ----------
    metric : {"total", "within", "own"}, default "total"
        Which one: T, of all vectors about their common mean, as in the paper; or that of the
        vectors about their own class's mean, with a hundredth of T so that it tells classes
        apart even where their instances are equal; or each class's own, as far as its few
        instances tell it, for many features and classes of which some vary much more than others.
        Distances are then in the spreads of each class: which class is wider does not count, as
        it would for normal distributions, which instances that stray far do not have.

    Attributes
    ----------
    classes_ : array, shape (classes,)
        The labels, sorted.
    means_ : array, shape (classes, features)
        Mean of each class.
    covariance_ : array, shape (features, features)
        Of the metric; of the common part of the classes' own.
    covariances_ : array, shape (classes, features, features), or None
        The classes' own, where they have them.
    whitening_ : array, shape (features, directions)
        W with W W^T the inverse of the covariance.
    regularized_ : bool
        Whether the covariance was singular, so that the directions in which the vectors do not
        vary were left out of the metric.
    n_features_in_ : int
        Number of features seen in `fit`.

    References
    ----------
    Section 5 of the paper; R. A. Fisher, The use of multiple measurements in taxonomic problems,
    1936, for the metric within classes; J. H. Friedman, Regularized discriminant analysis, 1989.
    """

    def __init__(self, metric: str = "total") -> None:
        self.metric = metric

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learn the classes' means and the metric.

        Parameters
        ----------
        X : array-like, shape (n, features)
        y : array-like, shape (n,)
            Class labels.

        Returns
        -------
        self : MinimumDistanceClassifier
        """
        vectors, labels = validate_data(self, X, y, dtype=np.float64)
        check_classification_targets(labels)
        if self.metric not in METRICS:
            raise ValueError(f"Expected a metric of {', '.join(METRICS)}, got {self.metric!r}")
        self.classes_, classes = np.unique(labels, return_inverse=True)
        if len(self.classes_) < 2:
            raise ValueError(
                f"Expected at least two classes, got one class: {self.classes_.tolist()}"
            )
        self.means_ = np.array(
            [vectors[classes == index].mean(axis=0) for index in np.unique(classes)]
        )
        self.covariance_ = np.atleast_2d(np.cov(vectors.T, bias=True))
        offsets = vectors - self.means_[classes]
        if self.metric != "total":
            within = offsets.T @ offsets / len(offsets)
            self.covariance_ = _blended(within, self.covariance_, self.metric)
        self.whitening_, self.regularized_ = whitening(self.covariance_)
        self.covariances_ = None
        if self.metric == "own":
            self.covariances_ = np.array(
                [
                    drawn_covariance(offsets[classes == index], self.covariance_)
                    for index in range(len(self.classes_))
                ]
            )
        return self

    def distances(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the distance of each vector from each class's mean; shape (n, classes)."""
        check_is_fitted(self)
        vectors = validate_data(self, X, reset=False, dtype=np.float64)
        if self.covariances_ is None:
            return distances_from_means(vectors, self.means_, self.whitening_)
        matrices = [whitening(covariance)[0] for covariance in self.covariances_]
        return distances_in_own_metrics(vectors, self.means_, matrices)

    def predict(self, X: ArrayLike) -> NDArray[Any]:
        """Return the label of each vector; shape (n,)."""
        nearest = self.distances(X).argmin(axis=1)
        return np.asarray(self.classes_[nearest])
