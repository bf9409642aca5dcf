"""What a recognition model learns from instances (section 5 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from sklearn.model_selection import StratifiedKFold

from momrec_core.canonical import CANONICAL_AREA
from momrec_core.estimators import MinimumDistanceClassifier, StepwiseSelector

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Learned", "learn"]

ALIGNING_ROUNDS = 10  # in which the instances of a class find their common frame
FOLDS = 5  # of the cross-validation that the threshold is learned from
KNOWN_QUANTILE = 0.99  # of the held-back distances lies below the threshold, before its margin
THRESHOLD_MARGIN = 1.5  # on that quantile: few instances show no rare ones
TYPICAL_MEMBERS = 5  # are added to each class, so that a few instances do not make it too narrow
LEAST_SPREAD = 1e-3  # of all instances' spread: equal instances of a class teach none of its own
ROUNDING = 1e-9  # of a moment's natural size: below it, symmetric shapes vary by rounding only


@dataclass(frozen=True, eq=False)
class Learned:
    """Classes in a space of few features, and how far their members stray.

    Attributes
    ----------
    classes : tuple of str
        Labels, sorted.
    selected : tuple of int
        The features in use, in the order of their selection.
    means : array, shape (classes, selected)
    covariance : array, shape (selected, selected)
        T, of all instances.
    threshold : float
        Distance, in spreads of the nearest class, beyond which an instance belongs to none.
    spreads : array, shape (classes,)
        How far held-back instances of each class are from its mean.
    """

    classes: tuple[str, ...]
    selected: tuple[int, ...]
    means: NDArray[np.float64]
    covariance: NDArray[np.float64]
    threshold: float
    spreads: NDArray[np.float64]


def learn(
    candidates: Sequence[NDArray[np.float64]],
    labels: Sequence[str],
    indices: Sequence[tuple[int, int, int]],
    max_features: int,
) -> Learned:
    """Learn classes, and from instances held back, what belongs to none.

    Parameters
    ----------
    candidates : sequence of arrays, shape (frames, len(indices))
        For each instance, its moments in each admissible frame.
    labels : sequence of str
        The class of each instance; at least two classes with two instances each.
    indices : sequence of (int, int, int)
        Which moments the candidates hold.
    max_features : int
        Number of moments at the most.

    Returns
    -------
    learned : Learned
    """
    y = np.array(labels)
    varies = _varies(np.concatenate(candidates), indices)
    X = _aligned([np.where(varies, vectors, 0.0) for vectors in candidates], y)
    selected = StepwiseSelector(max_features).fit(X, y).selected_
    classifier = MinimumDistanceClassifier().fit(X[:, selected], y)
    held_back = _held_back_distances(X, y, max_features)
    members = np.searchsorted(classifier.classes_, y)
    spreads = _spreads(held_back, members)
    quantile = float(np.quantile(held_back / spreads[members], KNOWN_QUANTILE))
    return Learned(
        classes=tuple(classifier.classes_.tolist()),
        selected=tuple(selected.tolist()),
        means=classifier.means_,
        covariance=classifier.covariance_,
        threshold=THRESHOLD_MARGIN * max(quantile, 1.0),
        spreads=spreads,
    )


def _spreads(distances: NDArray[np.float64], members: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the root mean square distance in each class, as if some had the median of all."""
    counts = np.bincount(members)
    sums = np.bincount(members, weights=distances**2)
    typical = float(np.median(distances))
    spreads = np.sqrt((sums + TYPICAL_MEMBERS * typical**2) / (counts + TYPICAL_MEMBERS))
    return np.asarray(np.maximum(spreads, LEAST_SPREAD))


def _varies(
    vectors: NDArray[np.float64], indices: Sequence[tuple[int, int, int]]
) -> NDArray[np.bool_]:
    """Tell the moments whose variation is more than rounding; shape (len(indices),).

    The natural size of a moment of order n is the area times the n-th power of the radius, here
    those of a sphere.
    """
    orders = np.array(indices).sum(axis=1)
    sizes = CANONICAL_AREA * np.sqrt(CANONICAL_AREA / (4.0 * np.pi)) ** orders
    return np.asarray(vectors.std(axis=0) > ROUNDING * sizes)


def _aligned(candidates: Sequence[NDArray[np.float64]], y: NDArray[np.str_]) -> NDArray[np.float64]:
    """Choose, for each instance, the admissible frame that brings it next to its class's mean."""
    X = np.array([vectors[0] for vectors in candidates])
    scale = X.std(axis=0)
    scale[scale == 0] = 1.0
    for label in np.unique(y):
        members = np.flatnonzero(y == label).tolist()
        mean = X[min(members, key=lambda member: len(candidates[member]))]
        for _ in range(ALIGNING_ROUNDS):
            before = X[members]
            for member in members:
                offsets = np.linalg.norm((candidates[member] - mean) / scale, axis=1)
                X[member] = candidates[member][offsets.argmin()]
            mean = X[members].mean(axis=0)
            if (X[members] == before).all():
                break
    return X


def _held_back_distances(
    X: NDArray[np.float64], y: NDArray[np.str_], max_features: int
) -> NDArray[np.float64]:
    """Return each instance's distance from its class, learned without it."""
    fewest = int(np.unique(y, return_counts=True)[1].min())
    folds = StratifiedKFold(min(FOLDS, fewest), shuffle=True, random_state=0)
    distances = np.empty(len(X))
    for learned, held_back in folds.split(X, y):
        chosen = StepwiseSelector(max_features).fit(X[learned], y[learned]).selected_
        classifier = MinimumDistanceClassifier().fit(X[np.ix_(learned, chosen)], y[learned])
        own = np.searchsorted(classifier.classes_, y[held_back])
        to_all = classifier.distances(X[np.ix_(held_back, chosen)])
        distances[held_back] = to_all[np.arange(len(own)), own]
    return distances
