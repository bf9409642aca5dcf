"""Strangers among known shapes, and scores that mean what they say."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from sklearn.calibration import calibration_curve
from sklearn.metrics import roc_auc_score, roc_curve

from momrec_core.canonical import normalize
from momrec_core.model import UNKNOWN, RecognitionModel
from momrec_core.trust import Verdicts, judge, rejection_curve, reliability


def drawn_verdicts(seed: int, count: int = 200, digits: int = 2) -> Verdicts:
    """Return verdicts with ties, on strangers that are less familiar on the whole."""
    rng = np.random.default_rng(seed)
    familiar = rng.random(count) < 0.6
    familiarity = np.round(np.clip(rng.normal(np.where(familiar, 0.7, 0.4), 0.2), 0, 1), digits)
    scores = rng.random(count)
    return Verdicts(familiar, familiarity, rng.random(count) < scores, scores)


@pytest.mark.parametrize("seed", range(5))
def test_the_curve_is_the_operating_characteristic_of_scikit_learn(seed):
    verdicts = drawn_verdicts(seed)
    curve = rejection_curve(verdicts)
    strange, strangeness = ~verdicts.familiar, 1.0 - verdicts.familiarity
    assert curve.area == pytest.approx(roc_auc_score(strange, strangeness))
    known, strangers, _ = roc_curve(strange, strangeness, drop_intermediate=False)
    np.testing.assert_allclose(curve.known_rejected, known)
    np.testing.assert_allclose(curve.strangers_rejected, strangers)


def test_the_area_is_the_share_of_pairs_in_the_right_order():
    verdicts = drawn_verdicts(9, 60, 1)
    strangers = verdicts.familiarity[~verdicts.familiar][:, None]
    known = verdicts.familiarity[verdicts.familiar]
    expected = np.mean((strangers < known) + 0.5 * (strangers == known))
    assert rejection_curve(verdicts).area == pytest.approx(expected)


@pytest.mark.parametrize("familiar", [True, False])
def test_a_curve_needs_strangers_and_others(familiar):
    verdicts = Verdicts(np.full(4, familiar), np.ones(4), np.full(4, fill_value=True), np.ones(4))
    with pytest.raises(ValueError, match="Expected strangers and known shapes"):
        rejection_curve(verdicts)


@pytest.mark.parametrize("seed", range(3))
def test_reliability_gathers_labels_as_scikit_learn_does(seed):
    verdicts = drawn_verdicts(seed)
    found = reliability(verdicts)
    rates, scores = calibration_curve(verdicts.right, verdicts.scores, n_bins=10)
    np.testing.assert_allclose(found.scores[found.counts > 0], scores)
    np.testing.assert_allclose(found.rates[found.counts > 0], rates)
    gaps = [
        abs(verdicts.scores[inside].mean() - verdicts.right[inside].mean()) * inside.sum()
        for inside in (np.floor(10 * verdicts.scores) == place for place in range(10))
        if inside.any()
    ]
    assert found.error == pytest.approx(sum(gaps) / 200)


def test_scores_of_the_very_ends_have_a_place():
    right = np.array([True, False, True])
    found = reliability(Verdicts(right, right * 1.0, right, np.array([1.0, 0.0, 0.55])), 2)
    np.testing.assert_array_equal(found.counts, [1, 2])
    assert found.error == pytest.approx((0.0 + 0.45) / 3)
    empty = reliability(Verdicts(right, right * 1.0, right, np.full(3, 0.9)))
    assert empty.counts.tolist() == [0] * 9 + [3]
    assert np.isnan(empty.rates[:9]).all()
    assert empty.error == pytest.approx(0.9 - 2 / 3)


def test_a_stranger_is_rightly_named_where_it_is_unknown():
    rng = np.random.default_rng(4)
    models = {
        "box": trimesh.creation.box((1.0, 2.0, 3.0)),
        "cone": trimesh.creation.cone(1.0, 3.0, sections=12),
        "plate": trimesh.creation.box((3.0, 3.5, 0.2)),
    }
    labels = np.repeat(list(models), 5)
    shapes = []
    for label in labels:
        mesh = models[label].copy()
        mesh.vertices = mesh.vertices + rng.normal(0.0, 0.01, mesh.vertices.shape)
        shapes.append(normalize(mesh))
    model = RecognitionModel.fit(shapes[:10], labels[:10])
    verdicts = judge(model, shapes, labels.tolist())
    np.testing.assert_array_equal(verdicts.familiar, labels != "plate")
    for index, shape in enumerate(shapes):
        found = model.recognize(shape)
        assert verdicts.scores[index] == found.score
        assert verdicts.familiarity[index] == (found.score if found.known else 1 - found.score)
        expected = UNKNOWN if labels[index] == "plate" else labels[index]
        assert verdicts.right[index] == (found.label == expected)
    assert rejection_curve(verdicts).area == 1.0
    joined = Verdicts.joined([verdicts, verdicts])
    assert len(joined.right) == len(joined.scores) == 30
    assert rejection_curve(joined).area == 1.0
