"""The estimators against scikit-learn's own checks and against the formulas written out."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh
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
    """Return trace(T^-1 B) as the sum of the generalised eigenvalues of B x = l T x."""
    X = X / X.std(axis=0)
    within = sum(np.cov(X[y == c].T, bias=True) * np.mean(y == c) for c in np.unique(y))
    total = np.atleast_2d(np.cov(X.T, bias=True))
    return float(eigh(total - np.atleast_2d(within), total, eigvals_only=True).sum())


def exact_criterion(X: list[list[int]], y: list[int]) -> Fraction | None:
    """Return trace(T^-1 B) in rational arithmetic, by Cramer's rule; None if T is singular."""
    n, size = len(X), len(X[0])
    features = range(size)
    mean = [Fraction(sum(row[f] for row in X), n) for f in features]
    total = [
        [sum((r[f] - mean[f]) * (r[g] - mean[g]) for r in X) for g in features] for f in features
    ]
    between = [[Fraction(0)] * size for _ in features]
    for c in set(y):
        rows = [row for row, label in zip(X, y, strict=True) if label == c]
        off = [Fraction(sum(row[f] for row in rows), len(rows)) - mean[f] for f in features]
        for f, g in product(features, features):
            between[f][g] += len(rows) * off[f] * off[g]
    whole = determinant(total)
    if whole == 0:
        return None
    trace = Fraction(0)
    for f in features:  # T x = (column f of B): x_f by Cramer
        replaced = [[between[g][f] if h == f else total[g][h] for h in features] for g in features]
        trace += determinant(replaced) / whole
    return trace


def determinant(matrix: list[list[Fraction]]) -> Fraction:
    if not matrix:
        return Fraction(1)
    first, *rest = matrix
    minors = ([row[:k] + row[k + 1 :] for row in rest] for k in range(len(first)))
    return sum(
        ((-1) ** k * first[k] * determinant(minor) for k, minor in enumerate(minors)), Fraction(0)
    )


@pytest.mark.parametrize("estimator", [StepwiseSelector(), MinimumDistanceClassifier()], ids=type)
def test_scikit_learn_accepts_the_estimators(estimator: BaseEstimator) -> None:
    results = check_estimator(estimator, on_skip=None, on_fail="raise")
    passed = {result["check_name"] for result in results if result["status"] == "passed"}
    needs_other_arrays = {"check_array_api_input", "check_classifier_data_not_an_array"}
    assert {result["check_name"] for result in results} - passed <= needs_other_arrays
    assert len(passed) > 30


@settings(max_examples=30, deadline=None)
@given(
    rows=st.lists(st.lists(st.integers(-4, 4), min_size=4, max_size=4), min_size=5, max_size=9),
    data=st.data(),
)
def test_each_step_is_the_best_one_in_rational_arithmetic(
    rows: list[list[int]], data: st.DataObject
) -> None:
    y = data.draw(st.lists(st.integers(0, 2), min_size=len(rows), max_size=len(rows)))
    selector = StepwiseSelector(max_features=4).fit(np.array(rows, dtype=float), y)
    chosen: list[int] = []
    for feature, trace in zip(selector.selected_, selector.traces_, strict=True):
        columns = [[*chosen, index] for index in range(4) if index not in chosen]
        values = [exact_criterion([[row[k] for k in ks] for row in rows], y) for ks in columns]
        best = max((value for value in values if value is not None), default=Fraction(0))
        chosen.append(int(feature))
        own = exact_criterion([[row[k] for k in chosen] for row in rows], y) or Fraction(0)
        assert trace == pytest.approx(float(best), abs=1e-9)
        assert float(own) == pytest.approx(float(best), abs=1e-9)
    rest = [[*chosen, index] for index in range(4) if index not in chosen]
    assert all(exact_criterion([[row[k] for k in ks] for row in rows], y) is None for ks in rest)


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
def test_classes_may_have_metrics_of_their_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    X, y = classes_of_points(rng)
    X, y = X[:-11], y[:-11]  # the last class has one member, the others have twelve
    classifier = MinimumDistanceClassifier("own").fit(X, y)
    means = [X[y == c].mean(axis=0) for c in range(5)]
    scatters = [12 * np.cov(X[y == c].T, bias=True) for c in range(4)] + [np.zeros((6, 6))]
    within = sum(scatters) / len(X)
    common = within + 0.1 * np.diag(np.diag(within)) + 1e-4 * np.cov(X.T, bias=True)
    for c, (mean, scatter) in enumerate(zip(means, scatters, strict=True)):
        covariance = (scatter + 5 * common) / (11 + 5) if c < 4 else common
        expected = cdist(X, [mean], "mahalanobis", VI=np.linalg.inv(covariance))[:, 0]
        np.testing.assert_allclose(classifier.distances(X)[:, c], expected, rtol=1e-5)


def test_what_lies_between_is_of_the_class_that_varies_more_in_its_own_metric_only() -> None:
    rng = np.random.default_rng(11)
    y = np.repeat(["narrow", "wide"], 10)
    X = rng.normal(size=(20, 2)) * np.where(y == "narrow", 0.1, 2.0)[:, None]
    X[y == "wide", 0] += 10.0
    between = [[4.0, 0.0]]
    assert MinimumDistanceClassifier("within").fit(X, y).predict(between) == ["narrow"]
    assert MinimumDistanceClassifier("own").fit(X, y).predict(between) == ["wide"]


@pytest.mark.parametrize("metric", ["total", "within", "own"])
@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_labels_do_not_depend_on_the_units_of_the_features(metric: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    X, y = classes_of_points(rng)
    units = 10.0 ** rng.uniform(-4, 4, 6)
    before = MinimumDistanceClassifier(metric).fit(X, y).distances(X)
    after = MinimumDistanceClassifier(metric).fit(X * units, y).distances(X * units)
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


@settings(max_examples=25, deadline=None)
@given(seed=seeds, samples=st.integers(2, 6))
def test_fewer_samples_than_features_are_told_and_cost_nothing(seed: int, samples: int) -> None:
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(samples, 8)) * 10.0 ** rng.uniform(-6, 6, 8)
    y = np.arange(samples) % 2
    selector = StepwiseSelector(max_features=8).fit(X, y)
    assert len(selector.selected_) == samples - 1  # so many directions, at most, vary
    classifier = MinimumDistanceClassifier().fit(X, y)
    assert classifier.regularized_
    assert classifier.whitening_.shape == (8, samples - 1)
    assert np.isfinite(classifier.distances(X)).all()
    assert classifier.score(X, y) == 1.0


@pytest.mark.parametrize("value", [0.0, 7.0, 1e300, 1e-300])
def test_features_that_are_all_constant_leave_every_class_as_near(value: float) -> None:
    X, y = np.full((6, 3), value), [0, 0, 0, 1, 1, 1]
    selector = StepwiseSelector().fit(X, y)
    assert selector.selected_.tolist() == [0]
    assert selector.traces_.tolist() == [0.0]
    classifier = MinimumDistanceClassifier().fit(X, y)
    assert classifier.regularized_
    assert (classifier.distances(X) == 0.0).all()


def test_the_inverse_of_the_covariance_is_the_whitening_times_itself() -> None:
    X, y = classes_of_points(np.random.default_rng(12))
    classifier = MinimumDistanceClassifier().fit(X / X.std(axis=0), y)
    inverse = classifier.whitening_ @ classifier.whitening_.T
    np.testing.assert_allclose(inverse @ classifier.covariance_, np.eye(6), atol=1e-8)


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
