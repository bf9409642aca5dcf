"""The paper's experiment on moments: splits, names after each step, rates."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import cdist

from momrec_core.canonical import normalize
from momrec_core.features import moment_indices
from momrec_core.model import RecognitionModel
from momrec_core.simulation import random_similarity
from momrec_core.stepwise import Instances, Split, model_names, paper_names, random_split


def drawn_instances(seed: int, classes: int = 4, of_each: int = 9, order: int = 3) -> Instances:
    """Return instances whose frames all are unique, scattered about their class's mean."""
    rng = np.random.default_rng(seed)
    indices = tuple(moment_indices(order))
    labels = np.repeat([f"class {index}" for index in range(classes)], of_each)
    means = np.repeat(rng.normal(0.0, 2.0, (classes, len(indices))), of_each, axis=0)
    vectors = means + rng.normal(size=means.shape)
    return Instances(labels, indices, tuple(vectors[:, None]))


def shaken_boxes(seed: int) -> tuple[list[str], list[trimesh.Trimesh]]:
    """Return instances of boxes (24 admissible frames or 4) and of cones, slightly deformed."""
    rng = np.random.default_rng(seed)
    models = {
        "cube": trimesh.creation.box((1.0, 1.0, 1.0)),
        "beam": trimesh.creation.box((1.0, 1.1, 3.0)),
        "cone": trimesh.creation.cone(1.0, 2.0, sections=24),
    }
    labels, shapes = [], []
    for label, model in models.items():
        for _ in range(6):
            mesh = model.copy()
            mesh.vertices = mesh.vertices + rng.normal(0.0, 1e-3, mesh.vertices.shape)
            labels.append(label)
            shapes.append(random_similarity(mesh, rng))
    return labels, shapes


@pytest.mark.parametrize("seed", range(5))
def test_a_split_takes_as_many_of_each_class_and_loses_none(seed):
    rng = np.random.default_rng(seed)
    labels = rng.permutation(np.repeat(["a", "b", "c"], [11, 8, 9]))
    split = random_split(labels, 7, rng)
    assert Counter(labels[split.train].tolist()) == {"a": 7, "b": 7, "c": 7}
    assert Counter(labels[split.test].tolist()) == {"a": 4, "b": 1, "c": 2}
    assert sorted([*split.train, *split.test]) == list(range(28))


def test_every_instance_is_held_back_about_as_often():
    labels = np.repeat(["a", "b"], 11)
    rng = np.random.default_rng(0)
    counts = np.zeros(22)
    for _ in range(2000):
        counts[random_split(labels, 7, rng).test] += 1
    np.testing.assert_allclose(counts / 2000, 4 / 11, atol=0.05)


@pytest.mark.parametrize("training", [0, 5, 6])
def test_a_split_without_instances_on_both_sides_is_refused(training):
    labels = np.repeat(["a", "b"], [9, 5])
    with pytest.raises(ValueError, match=f"Expected more than {training} instances of each class"):
        random_split(labels, training, np.random.default_rng(0))


@pytest.mark.parametrize("seed", range(3))
def test_names_are_those_of_mahalanobis_distances_to_the_training_means(seed):
    instances = drawn_instances(seed)
    split = random_split(instances.labels, 5, np.random.default_rng(seed))
    names = paper_names(instances, split, 6)
    assert len(names.selected) == len(set(names.selected)) == 6
    table = np.concatenate(instances.candidates)
    labels = instances.labels[split.train]
    for step in range(1, 7):
        columns = [instances.indices.index(index) for index in names.selected[:step]]
        learned = table[np.ix_(split.train, columns)]
        means = [learned[labels == label].mean(axis=0) for label in np.unique(labels)]
        inverse = np.linalg.inv(np.atleast_2d(np.cov(learned.T, bias=True)))
        distances = cdist(table[:, columns], means, "mahalanobis", VI=inverse)
        expected = np.unique(labels)[distances.argmin(axis=1)]
        assert names.named[step - 1].tolist() == expected.tolist()


def test_what_is_held_back_teaches_nothing():
    instances = drawn_instances(7)
    split = random_split(instances.labels, 5, np.random.default_rng(7))
    other = tuple(
        vectors if index in split.train else 3.0 * vectors + 1.0
        for index, vectors in enumerate(instances.candidates)
    )
    changed = Instances(instances.labels, instances.indices, other)
    for names in (paper_names, model_names):
        before, after = names(instances, split), names(changed, split)
        assert before.selected == after.selected
        assert (before.named[:, split.train] == after.named[:, split.train]).all()


def test_rates_count_what_is_named_rightly():
    instances = drawn_instances(1)
    everyone = np.arange(len(instances.labels))
    names = paper_names(instances, random_split(instances.labels, 5, np.random.default_rng(1)), 4)
    rates = names.rates(instances.labels, everyone)
    for step, rate in enumerate(rates):
        right = [
            given == label for given, label in zip(names.named[step], instances.labels, strict=True)
        ]
        assert rate == sum(right) / len(right)


def test_orders_keep_their_moments_only():
    instances = drawn_instances(2, order=5)
    for order, count in ((2, 3), (3, 13), (4, 28), (5, 49)):
        kept = instances.up_to(order)
        assert kept.indices == tuple(moment_indices(order))
        assert len(kept.indices) == count
        for all_moments, vectors in zip(instances.candidates, kept.candidates, strict=True):
            np.testing.assert_array_equal(vectors, all_moments[:, :count])


def test_both_ways_agree_where_every_frame_is_unique():
    instances = drawn_instances(3)
    split = random_split(instances.labels, 6, np.random.default_rng(3))
    ruled, free = paper_names(instances, split), model_names(instances, split)
    assert ruled.selected == free.selected
    assert (ruled.named[-1] == free.named[-1]).mean() > 0.9  # the metrics differ


def test_alternatives_are_tried_as_the_model_does():
    labels, meshes = shaken_boxes(0)
    shapes = [normalize(mesh) for mesh in meshes]
    instances = Instances.of_shapes(labels, shapes)
    assert max(map(len, instances.candidates)) >= 24
    assert min(map(len, instances.candidates)) > 1
    split = random_split(instances.labels, 4, np.random.default_rng(0))
    names = model_names(instances, split, 3)
    model = RecognitionModel.fit(
        [shapes[index] for index in split.train], instances.labels[split.train], max_features=3
    )
    assert names.selected == model.indices
    nearest = [model.recognize(shape).ranking[0][0] for shape in shapes]
    assert names.named[-1].tolist() == nearest


def test_in_the_frame_by_rules_the_alternatives_do_not_count():
    labels, meshes = shaken_boxes(1)
    instances = Instances.of_shapes(labels, [normalize(mesh) for mesh in meshes])
    ruled = instances.by_rules_only()
    split = random_split(instances.labels, 4, np.random.default_rng(1))
    np.testing.assert_array_equal(
        [len(vectors) for vectors in ruled.candidates], np.ones(len(labels))
    )
    for all_frames, vectors in zip(instances.candidates, ruled.candidates, strict=True):
        np.testing.assert_array_equal(vectors[0], all_frames[0])
    assert (paper_names(instances, split).named == paper_names(ruled, split).named).all()


def test_fewer_steps_where_the_moments_are_used_up():
    instances = drawn_instances(4, order=2)
    split = Split(np.arange(0, 36, 2), np.arange(1, 36, 2))
    assert paper_names(instances, split).named.shape == (3, 36)
