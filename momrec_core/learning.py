"""What a recognition model learns from instances (section 5 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import StratifiedKFold

from momrec_core.canonical import CANONICAL_AREA
from momrec_core.covariance import distances_from_means, drawn_covariance, whitening
from momrec_core.estimators import MinimumDistanceClassifier, StepwiseSelector

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Learned", "learn", "learn_class"]

METRIC = "within"  # the paper's, "total", lets what varies by noise alone count as much
METRIC_OF_MORE = "own"  # where invariants or size count beside the moments
ALIGNING_ROUNDS = 10  # in which the instances of a class find their common frame
FOLDS = 5  # of the cross-validation that the threshold is learned from
KNOWN_QUANTILE = 0.99  # of the held-back distances lies below the threshold, before its margin
THRESHOLD_MARGIN = 1.5  # on that quantile: few instances show no rare ones
TYPICAL_MEMBERS = 5  # are added to each class, so that a few instances do not make it too narrow
LEAST_SPREAD = 1e-3  # of all instances' spread: equal instances of a class teach none of its own
LEAST_CLASSES = 3  # to leave one out and still have two
USUAL_CERTAINTY = 8.0  # where there are fewer
LEAST_CERTAINTY = 1e-3  # what is nearer is not less likely known
SOFTNESS = 1e3  # of the odds: they stay finite where no stranger comes near
WIDEST_CHANGE = np.log(4.0)  # of the blur, from the median spread of the classes
FAR = 10.0  # thresholds: farther strays tell no more
ROUNDING = 1e-9  # of a moment's natural size: below it, symmetric shapes vary by rounding only


@dataclass(frozen=True, eq=False)
class Learned:
    """Classes in a space of few features, and how far their members stray.

    Attributes
    ----------
    classes : tuple of str
        Labels, sorted.
    selected : tuple of int
        The moments in use, in the order of their selection.
    means : array, shape (classes, features)
        Of the selected moments, then of the common features.
    covariance : array, shape (features, features)
        Of the metric: within classes, with a little of T; what the classes' own are drawn towards.
    threshold : float
        Distance, in spreads of the nearest class, beyond which an instance belongs to none.
    spreads : array, shape (classes,)
        How far held-back instances of each class are from its mean.
    blur : float
        Width, in distances, by which the classes share what lies between them.
    certainty : float
        Slope of the log odds that an instance belongs to one of the classes, over its distance in
        thresholds; they are even at the threshold.
    covariances : array, shape (classes, features, features), or None
        Of the classes' own metrics, where there are common features.
    """

    classes: tuple[str, ...]
    selected: tuple[int, ...]
    means: NDArray[np.float64]
    covariance: NDArray[np.float64]
    threshold: float
    spreads: NDArray[np.float64]
    blur: float
    certainty: float
    covariances: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class _Known:
    """Instances, each in the frame in which it is like the others of its class.

    Attributes
    ----------
    moments : array, shape (n, moments)
    common : array, shape (n, c)
        Further features, always in use.
    y : array of str, shape (n,)
        Their classes.
    """

    moments: NDArray[np.float64]
    common: NDArray[np.float64]
    y: NDArray[np.str_]

    def selected(self, rows: NDArray[np.int64], max_features: int) -> NDArray[np.int64]:
        """Return the moments that tell the classes of some instances apart."""
        selector = StepwiseSelector(max_features).fit(self.moments[rows], self.y[rows])
        return np.asarray(selector.selected_)

    def features(self, rows: NDArray[np.int64], selected: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the features in use of some instances."""
        return np.column_stack([self.moments[np.ix_(rows, selected)], self.common[rows]])

    def classifier(
        self, rows: NDArray[np.int64], selected: NDArray[np.int64]
    ) -> MinimumDistanceClassifier:
        """Return what some instances teach."""
        metric = METRIC_OF_MORE if self.common.shape[1] else METRIC
        return MinimumDistanceClassifier(metric).fit(self.features(rows, selected), self.y[rows])


def learn(
    candidates: Sequence[NDArray[np.float64]],
    labels: Sequence[str],
    indices: Sequence[tuple[int, int, int]],
    max_features: int,
    common: NDArray[np.float64] | None = None,
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
    common : array, shape (n, c), or None
        What is the same in all frames of an instance, such as its size: further features, after
        the selected ones, which are always in use.

    Returns
    -------
    learned : Learned
    """
    y = np.array(labels)
    varies = _varies(np.concatenate(candidates), indices)
    moments = _aligned([np.where(varies, vectors, 0.0) for vectors in candidates], y)
    further = np.empty((len(y), 0)) if common is None else common
    further = np.where(further.std(axis=0) > ROUNDING, further, 0.0)
    known = _Known(moments, further, y)
    selected = known.selected(np.arange(len(y)), max_features)
    classifier = known.classifier(np.arange(len(y)), selected)
    members = np.searchsorted(classifier.classes_, y)
    distances = _held_back_distances(known, max_features)
    held_back = distances[np.arange(len(members)), members]
    spreads = _spreads(held_back, members, float(np.median(held_back)))
    quantile = float(np.quantile(held_back / spreads[members], KNOWN_QUANTILE))
    threshold = THRESHOLD_MARGIN * max(quantile, 1.0)
    reach = dict(zip(classifier.classes_.tolist(), threshold * spreads, strict=True))
    return Learned(
        classes=tuple(classifier.classes_.tolist()),
        selected=tuple(selected.tolist()),
        means=classifier.means_,
        covariance=classifier.covariance_,
        threshold=threshold,
        spreads=spreads,
        blur=_blur(distances, members, spreads),
        certainty=_certainty(*_strays(known, max_features, reach)),
        covariances=classifier.covariances_,
    )


def learn_class(
    candidates: Sequence[NDArray[np.float64]],
    covariance: NDArray[np.float64],
    typical: float,
    *,
    own: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Learn one more class in the metric of those that are known, or one drawn towards it.

    Parameters
    ----------
    candidates : sequence of arrays, shape (frames, moments)
        For each instance, two at the least, its moments in each admissible frame.
    covariance : array, shape (moments, moments)
        Of the metric.
    typical : float
        Spread of the known classes.
    own : bool
        Whether the class gets a metric of its own.

    Returns
    -------
    mean : array, shape (moments,)
        Of the instances, in the frames in which they are alike.
    covariance : array, shape (moments, moments)
        Of the metric of the class.
    spread : float
        Root mean square of their distances from the mean of the others, as if some had the
        typical one.
    """
    matrix, _ = whitening(covariance)
    frames = _frames_alike([vectors @ matrix for vectors in candidates])
    X = np.array([vectors[frame] for vectors, frame in zip(candidates, frames, strict=True)])
    held_back = [
        distances_from_means(X[[row]], mean[None], whitening(of_others)[0])[0, 0]
        for row in range(len(X))
        for mean, of_others in [_described(np.delete(X, row, axis=0), covariance, own=own)]
    ]
    (spread,) = _spreads(np.array(held_back), np.zeros(len(X), dtype=np.int64), typical)
    return *_described(X, covariance, own=own), float(spread)


def _described(
    X: NDArray[np.float64], common: NDArray[np.float64], *, own: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean of a class's members and the covariance of its metric."""
    mean = X.mean(axis=0)
    return mean, drawn_covariance(X - mean, common) if own else common


def _spreads(
    distances: NDArray[np.float64], members: NDArray[np.int64], typical: float
) -> NDArray[np.float64]:
    """Return the root mean square distance in each class, as if some had the typical one."""
    counts = np.bincount(members)
    sums = np.bincount(members, weights=distances**2)
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
        frames = _frames_alike([candidates[member] / scale for member in members])
        for member, frame in zip(members, frames, strict=True):
            X[member] = candidates[member][frame]
    return X


def _frames_alike(candidates: Sequence[NDArray[np.float64]]) -> list[int]:
    """Choose a frame for each instance so that they are near each other, by Euclidean distance.

    They gather about the mean in turns; the first is an instance with the fewest frames.
    """
    mean = min(candidates, key=len)[0]
    frames = [0] * len(candidates)
    for _ in range(ALIGNING_ROUNDS):
        before = frames
        frames = [int(np.linalg.norm(each - mean, axis=1).argmin()) for each in candidates]
        chosen = [each[frame] for each, frame in zip(candidates, frames, strict=True)]
        mean = np.mean(chosen, axis=0)
        if frames == before:
            break
    return frames


def _held_back_distances(known: _Known, max_features: int) -> NDArray[np.float64]:
    """Return each instance's distance from each class, learned without it; shape (n, classes)."""
    labels, counts = np.unique(known.y, return_counts=True)
    folds = StratifiedKFold(min(FOLDS, int(counts.min())), shuffle=True, random_state=0)
    distances = np.empty((len(known.y), len(labels)))
    for learned, held_back in folds.split(known.moments, known.y):
        chosen = known.selected(learned, max_features)
        classifier = known.classifier(learned, chosen)
        distances[held_back] = classifier.distances(known.features(held_back, chosen))
    return distances


def _blur(
    distances: NDArray[np.float64], members: NDArray[np.int64], spreads: NDArray[np.float64]
) -> float:
    """Return the width, as of normal distributions, by which classes share what lies between.

    Of the widths between parts of the classes' own, the one that makes the classes of instances
    held back likeliest.
    """

    def unlikeliness(logarithm: float) -> float:
        exponents = -(distances**2) / (2.0 * np.exp(2.0 * logarithm))
        own = exponents[np.arange(len(members)), members]
        return float(np.mean(logsumexp(exponents, axis=1) - own))

    usual = float(np.log(np.median(spreads)))
    around = (usual - WIDEST_CHANGE, usual + WIDEST_CHANGE)
    return float(np.exp(minimize_scalar(unlikeliness, bounds=around, method="bounded").x))


def _strays(
    known: _Known, max_features: int, reach: dict[str, float]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return how far instances held back stray, and which are of classes that were left out.

    The classes are left out in turn, some at a time, and so are the instances.
    """
    y = known.y
    labels, counts = np.unique(y, return_counts=True)
    if len(labels) < LEAST_CLASSES:
        return np.empty(0), np.empty(0, dtype=bool)
    folds = StratifiedKFold(min(FOLDS, int(counts.min())), shuffle=True, random_state=0)
    strays, strange = [], []
    for turn, (learned, held_back) in enumerate(folds.split(known.moments, y)):
        left_out = np.isin(y, labels[turn :: max(FOLDS, len(labels) // 2)])
        rows = learned[~left_out[learned]]
        asked = np.union1d(held_back, np.flatnonzero(left_out))
        chosen = known.selected(rows, max_features)
        classifier = known.classifier(rows, chosen)
        distances = classifier.distances(known.features(asked, chosen))
        nearest = classifier.classes_[distances.argmin(axis=1)]
        strays.append(distances.min(axis=1) / np.array([reach[label] for label in nearest]))
        strange.append(left_out[asked])
    return np.concatenate(strays), np.concatenate(strange)


def _certainty(strays: NDArray[np.float64], strange: NDArray[np.bool_]) -> float:
    """Fit how fast the log odds of being known rise inside the threshold; they are even at it.

    References
    ----------
    J. Platt, Probabilistic outputs for support vector machines, 1999.
    """
    if not strange.any() or strange.all():
        return USUAL_CERTAINTY
    odds = LogisticRegression(C=SOFTNESS, class_weight="balanced", fit_intercept=False)
    odds.fit(1.0 - np.minimum(strays, FAR)[:, None], ~strange)
    return max(float(odds.coef_[0, 0]), LEAST_CERTAINTY)
