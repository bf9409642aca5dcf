"""Which classes are taken for each other: counted, ordered and drawn."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from momrec_core.canonical import normalize
from momrec_core.model import Recognition
from momrec_ros.confusion_figures import draw_confusions
from momrec_ros.confusions import confusions

LETTERS = "abcdefgh"
PLACES = dict(zip(LETTERS, (0.0, 9.0, 1.0, 30.0, 10.0, 31.0, 2.0, 60.0), strict=True))
BOX = normalize(trimesh.creation.box((1, 2, 3)))


def recognition(place, threshold=20.0):
    """Return what a model of classes along a line says."""
    distances = {label: abs(place - there) for label, there in PLACES.items()}
    weights = {label: np.exp(-(distance**2) / 2) for label, distance in distances.items()}
    total = sum(weights.values())
    ranking = sorted(
        ((label, distances[label], weights[label] / total) for label in LETTERS),
        key=lambda found: found[1],
    )
    label, distance, score = ranking[0]
    known = distance < threshold
    return Recognition(label if known else "unknown", known, distance, score, tuple(ranking), BOX)


@pytest.fixture
def found():
    labels = [label for label in LETTERS for _ in range(3)]
    places = [PLACES[label] + step for label in LETTERS for step in (-0.3, 0.0, 0.6)]
    return confusions(labels, [recognition(place) for place in places])


def test_classes_that_are_alike_stand_beside_each_other(found):
    assert sorted(found.labels) == list(LETTERS)
    order = [PLACES[label] for label in found.labels]
    assert order in (sorted(order), sorted(order, reverse=True))


def test_instances_are_counted_with_the_class_that_is_nearest(found):
    row = found.labels.index("a")
    assert found.nearest[row, row] == 2
    assert found.nearest[row, found.labels.index("c")] == 1
    assert found.nearest.sum() == 24
    np.testing.assert_allclose(found.shares.sum(axis=1), 1.0)
    assert found.taken_for("a")[0] == "c"
    assert found.taken_for("h") is None


def test_pairs_come_with_the_worst_first(found):
    pairs = found.pairs()
    assert len(pairs) == 28
    assert {pairs[0].one, pairs[0].other} in ({"a", "c"}, {"c", "g"}, {"d", "f"}, {"b", "e"})
    counts = [pair.mistaken for pair in pairs]
    assert counts == sorted(counts, reverse=True)
    assert sum(counts) == 24 - np.trace(found.nearest)


def test_unknown_instances_are_counted():
    labels = ["a", "a", "b", "b"]
    seen = [recognition(place, threshold=1.0) for place in (0.0, 4.0, 9.0, 9.5)]
    two = [
        Recognition(each.label, each.known, each.distance, each.score, each.ranking, BOX)
        for each in seen
    ]
    kept = [
        Recognition(
            each.label,
            each.known,
            each.distance,
            each.score,
            tuple(row for row in each.ranking if row[0] in "ab"),
            BOX,
        )
        for each in two
    ]
    found = confusions(labels, kept)
    assert found.unknown[found.labels.index("a")] == 1
    assert found.unknown[found.labels.index("b")] == 0


@pytest.mark.parametrize("count", [2, 8, 40])
def test_a_picture_shows_few_classes_and_many(tmp_path, count):
    names = [f"a rather long name of class {number} $x$" for number in range(count)]
    rng = np.random.default_rng(0)
    seen = []
    for own in range(count):
        distances = np.abs(np.arange(count) - own - rng.normal(0, 0.4))
        weights = np.exp(-(distances**2))
        order = np.argsort(distances)
        ranking = tuple(
            (names[index], float(distances[index]), float(weights[index] / weights.sum()))
            for index in order
        )
        seen.append(Recognition(ranking[0][0], True, 0.0, 1.0, ranking, BOX))
    path = tmp_path / "confusions.png"
    draw_confusions(confusions(names, seen), dict.fromkeys(names, BOX.mesh), path)
    with Image.open(path) as image:
        assert image.format == "PNG"
        assert min(image.size) > 700
        assert max(image.size) < 2600
        assert len(np.unique(np.asarray(image.convert("L")))) > 50
