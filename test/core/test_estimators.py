"""The estimators against scikit-learn's own checks and against the formulas written out."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import check_estimator

from momrec_core import MinimumDistanceClassifier, StepwiseSelector

if TYPE_CHECKING:
    from sklearn.base import BaseEstimator

seeds = st.integers(0, 2**32 - 1)


def classes_of_points(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return 60 points of five classes in six dimensions, mixed and unequally scaled."""
    y = np.repeat(np.arange(5), 12)
    X = rng.normal(size=(5, 6))[y] * 2.0 + rng.normal(size=(60, 6))
    return X @ rng.normal(size=(6, 6)) * 10.0 ** rng.uniform(-3, 3, 6), y


def criterion(X: np.ndarray, y: np.ndarray) -> float:
    """Return trace(T^-1 B) = features - trace(T^-1 W), by the scatter within classes."""
    within = sum(np.cov(X[y == c].T, bias=True) * np.mean(y == c) for c in np.unique(y))
    total = np.atleast_2d(np.cov(X.T, bias=True))
    return X.shape[1] - float(np.trace(np.linalg.inv(total) @ np.atleast_2d(within)))


@pytest.mark.parametrize(
    "estimator", [StepwiseSelector(), MinimumDistanceClassifier()], ids=["selector", "classifier"]
)
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
def test_scikit_learn_accepts_the_estimators(estimator: BaseEstimator) -> None:
    check_estimator(estimator)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_each_step_takes_the_feature_that_the_formula_prefers(seed: int) -> None:
    X, y = classes_of_points(np.random.default_rng(seed))
    selector = StepwiseSelector(max_features=4).fit(X, y)
    chosen: list[int] = []
    for feature, trace in zip(selector.selected_, selector.traces_, strict=True):
        others = [index for index in range(6) if index not in chosen]
        values = [criterion(X[:, [*chosen, index]], y) for index in others]
        assert trace == pytest.approx(max(values), rel=1e-6)
        chosen.append(int(feature))
        assert criterion(X[:, chosen], y) == pytest.approx(max(values), rel=1e-6)


def test_the_criterion_grows_and_stays_below_the_number_of_classes() -> None:
    X, y = classes_of_points(np.random.default_rng(6))
    traces = StepwiseSelector(max_features=6).fit(X, y).traces_
    assert (np.diff(traces) > 0).all()
    assert 0 < traces[0] < traces[-1] < 4


def test_copies_sums_and_constants_are_never_chosen_twice() -> None:
    X, y = classes_of_points(np.random.default_rng(7))
    redundant = np.column_stack([X, X[:, 0] * -3.0, X[:, 1] + X[:, 2], np.full(len(X), 7.0)])
    selected = StepwiseSelector(max_features=9).fit(redundant, y).selected_
    assert len(selected) == 6
    assert 8 not in selected
    assert np.linalg.matrix_rank(redundant[:, selected] / redundant[:, selected].std(axis=0)) == 6


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_distances_are_mahalanobis_distances_in_the_total_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    X, y = classes_of_points(rng)
    classifier = MinimumDistanceClassifier().fit(X, y)
    means = np.array([X[y == c].mean(axis=0) for c in range(5)])
    inverse = np.linalg.inv(np.cov(X.T, bias=True))
    expected = cdist(X, means, "mahalanobis", VI=inverse)
    np.testing.assert_allclose(classifier.distances(X), expected, rtol=1e-5)
    assert not classifier.regularized_
    np.testing.assert_array_equal(classifier.predict(X), expected.argmin(axis=1))


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_labels_do_not_depend_on_the_units_of_the_features(seed: int) -> None:
    rng = np.random.default_rng(seed)
    X, y = classes_of_points(rng)
    units = 10.0 ** rng.uniform(-4, 4, 6)
    before = MinimumDistanceClassifier().fit(X, y).distances(X)
    after = MinimumDistanceClassifier().fit(X * units, y).distances(X * units)
    np.testing.assert_allclose(after, before, rtol=1e-6)
    np.testing.assert_array_equal(
        StepwiseSelector(3).fit(X * units, y).selected_, StepwiseSelector(3).fit(X, y).selected_
    )


def test_a_singular_covariance_is_told_and_measured_within_what_varies() -> None:
    X, y = classes_of_points(np.random.default_rng(9))
    doubled = np.column_stack([X, X, np.ones(len(X))])
    classifier = MinimumDistanceClassifier().fit(doubled, y)
    assert classifier.regularized_
    plain = MinimumDistanceClassifier().fit(X, y)
    np.testing.assert_allclose(classifier.distances(doubled), plain.distances(X), rtol=1e-5)


def test_one_instance_a_class_is_enough_for_the_nearest_one() -> None:
    X = np.random.default_rng(10).normal(size=(4, 9))
    classifier = MinimumDistanceClassifier().fit(X, list("abcd"))
    assert classifier.regularized_
    assert "".join(classifier.predict(X + 1e-6)) == "abcd"
    distances = [classifier.distances(X)[i, j] for i, j in combinations(range(4), 2)]
    np.testing.assert_allclose(distances, np.sqrt(8.0))  # a simplex, in the metric of its own T


def test_selector_and_classifier_work_in_a_pipeline() -> None:
    X, y = classes_of_points(np.random.default_rng(11))
    pipeline = make_pipeline(StepwiseSelector(4), MinimumDistanceClassifier()).fit(X, y)
    assert pipeline.score(X, y) > 0.7
    assert pipeline[:-1].transform(X).shape == (60, 4)


@pytest.mark.parametrize(
    ("estimator", "y", "message"),
    [
        (StepwiseSelector(0), [0, 1, 1], "at least one feature, got 0"),
        (MinimumDistanceClassifier(), [1, 1, 1], "at least two classes, got one class"),
    ],
)
def test_what_cannot_be_learned_is_refused(
    estimator: BaseEstimator, y: list[int], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        estimator.fit(np.eye(3), y)
