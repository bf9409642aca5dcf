"""Recognition: known, unknown and ambiguous objects, and model files whole and damaged."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import mahalanobis
from scipy.spatial.transform import Rotation

from momrec_core import (
    CanonicalShape,
    DegenerateShapeError,
    ModelFormatError,
    MomrecError,
    RecognitionModel,
    load_model,
    normalize,
    surface_moments,
)
from momrec_core.features import feature_vectors, invariants
from momrec_core.trust import Verdicts, judge, reliability

MESHES = Path(__file__).parents[2] / "meshes"
NOISE = 0.01  # of the extent: vertices of simulated instances are off by so much

SOUND = {
    "format": "momrec recognition model",
    "version": 2,
    "classes": ["a", "b"],
    "moments": [[2, 0, 0], [0, 2, 0]],
    "means": [[1.0, 2.0], [3.0, 4.0]],
    "covariance": [[1.0, 0.5], [0.5, 1.0]],
    "threshold": 2.0,
    "spreads": [0.5, 0.25],
    "blur": 0.125,
    "certainty": 6.0,
}
BOX = normalize(trimesh.creation.box((1.0, 2.0, 3.0)))
TWO_CLASSES = RecognitionModel(
    classes=tuple(SOUND["classes"]),
    indices=tuple(tuple(index) for index in SOUND["moments"]),
    means=np.array(SOUND["means"]),
    covariance=np.array(SOUND["covariance"]),
    threshold=SOUND["threshold"],
    spreads=np.array(SOUND["spreads"]),
    blur=SOUND["blur"],
    certainty=SOUND["certainty"],
)


def instance_of(mesh: trimesh.Trimesh, rng: np.random.Generator) -> trimesh.Trimesh:
    """Return the mesh somewhere else, turned, in another size and with disturbed vertices."""
    noise = rng.normal(size=mesh.vertices.shape) * NOISE * mesh.extents.max()
    vertices = (mesh.vertices + noise) * rng.uniform(0.2, 5.0)
    turned = Rotation.random(rng=rng).apply(vertices) + rng.uniform(-3.0, 3.0, 3)
    return trimesh.Trimesh(turned, mesh.faces, process=False)


@pytest.fixture(scope="module")
def objects() -> dict[str, trimesh.Trimesh]:
    paths = sorted((MESHES / "ten_objects").glob("*.ply"))
    return {path.stem: trimesh.load(path, process=False) for path in paths}


@pytest.fixture(scope="module")
def model(objects: dict[str, trimesh.Trimesh]) -> RecognitionModel:
    rng = np.random.default_rng(1)
    labels = [label for label in objects for _ in range(10)]
    return RecognitionModel.fit([instance_of(objects[label], rng) for label in labels], labels)


def test_the_ten_objects_are_sound_and_have_unique_frames(
    objects: dict[str, trimesh.Trimesh],
) -> None:
    assert len(objects) == 10
    for mesh in [*objects.values(), trimesh.load(MESHES / "stranger.ply", process=False)]:
        assert mesh.is_watertight
        assert mesh.volume > 0
        assert mesh.area_faces.min() > 1e-6
        assert 0.1 <= mesh.extents.max() <= 1.2
        shape = normalize(mesh, gap_tolerance=0.05, sign_tolerance=0.05)
        assert shape.is_unique


def test_unseen_instances_get_their_label_and_few_are_rejected(
    model: RecognitionModel, objects: dict[str, trimesh.Trimesh]
) -> None:
    rng = np.random.default_rng(2)
    labels = [label for label in objects for _ in range(20)]
    recognitions = [model.recognize(instance_of(objects[label], rng)) for label in labels]
    right = [seen.label == label for seen, label in zip(recognitions, labels, strict=True)]
    assert np.mean(right) >= 0.95
    assert np.mean([not seen.known for seen in recognitions]) <= 0.01


def test_strangers_are_unknown(model: RecognitionModel) -> None:
    rng = np.random.default_rng(3)
    stranger = trimesh.load(MESHES / "stranger.ply", process=False)
    for _ in range(10):
        recognition = model.recognize(instance_of(stranger, rng))
        assert (recognition.label, recognition.known) == ("unknown", False)
        nearest = model.classes.index(recognition.ranking[0][0])
        assert recognition.distance > model.threshold * model.spreads[nearest]


def test_a_recognition_ranks_all_classes_by_distance(
    model: RecognitionModel, objects: dict[str, trimesh.Trimesh]
) -> None:
    shape = normalize(objects["castle"])
    recognition = model.recognize(shape)
    labels, distances, scores = zip(*recognition.ranking, strict=True)
    assert recognition.canonical is shape
    assert (recognition.label, recognition.known) == ("castle", True)
    assert (labels[0], distances[0], scores[0]) == (
        recognition.label,
        recognition.distance,
        recognition.score,
    )
    assert sorted(labels) == sorted(model.classes)
    assert (np.diff(distances) >= 0).all()
    assert (np.diff(scores) <= 0).all()
    assert 0.0 <= min(scores) <= max(scores) <= 1.0


def with_moments(
    shape: CanonicalShape, moments: dict[tuple[int, int, int], float]
) -> CanonicalShape:
    changed = shape.moments.copy()
    changed[0, 0, 0] = 100.0
    for index, moment in moments.items():
        changed[index] = moment
    return replace(shape, moments=changed, alternatives=())


@settings(max_examples=50, deadline=None)
@given(x=st.floats(-1e3, 1e3), y=st.floats(-1e3, 1e3))
def test_distances_are_mahalanobis_distances_of_the_moments(x: float, y: float) -> None:
    recognition = TWO_CLASSES.recognize(with_moments(BOX, {(2, 0, 0): x, (0, 2, 0): y}))
    inverse = np.linalg.inv(SOUND["covariance"])
    expected = {
        label: mahalanobis([x, y], mean, inverse)
        for label, mean in zip("ab", SOUND["means"], strict=True)
    }
    assert [label for label, _, _ in recognition.ranking] == sorted(expected, key=expected.get)
    for label, distance, score in recognition.ranking:
        assert distance == pytest.approx(expected[label], rel=1e-9, abs=1e-12)
        assert 0.0 <= score <= 1.0
    nearest = min(expected, key=expected.get)
    limit = SOUND["threshold"] * SOUND["spreads"]["ab".index(nearest)]
    assert recognition.known == (expected[nearest] <= limit)


def test_the_farther_an_object_the_less_it_is_known_and_the_surer_it_is_unknown() -> None:
    away = np.array(SOUND["means"][0]) - np.array(SOUND["means"][1])
    steps = np.linspace(0.0, 4.0, 500)
    places = np.array(SOUND["means"][0]) + steps[:, None] * away  # from a's mean, off b
    shapes = [with_moments(BOX, {(2, 0, 0): x, (0, 2, 0): y}) for x, y in places]
    seen = [TWO_CLASSES.recognize(shape) for shape in shapes]
    known = [recognition.score for recognition in seen if recognition.known]
    unknown = [recognition.score for recognition in seen if not recognition.known]
    assert [one.known for one in seen] == [True] * len(known) + [False] * len(unknown)
    assert (np.diff([one.distance for one in seen]) > 0).all()
    assert (np.diff(known) < 0).all()
    assert (np.diff(unknown) >= 0).all()
    assert 0.9 < known[0] <= 1.0
    assert known[-1] == pytest.approx(0.5, abs=0.05)
    assert unknown[0] == pytest.approx(0.5, abs=0.05)
    assert unknown[-1] == pytest.approx(1.0)


def test_scores_say_how_often_labels_are_right(objects: dict[str, trimesh.Trimesh]) -> None:
    rng = np.random.default_rng(11)
    labels = [label for label in objects for _ in range(10)]
    shapes = [normalize(instance_of(objects[label], rng)) for label in labels]
    learned = [index for index in range(len(labels)) if index % 10 < 6]
    asked = [index for index in range(len(labels)) if index % 10 >= 6]
    verdicts = []
    for left_out in (None, *sorted(objects)[:3]):
        rows = [index for index in learned if labels[index] != left_out]
        model = RecognitionModel.fit([shapes[i] for i in rows], [labels[i] for i in rows])
        verdicts.append(judge(model, [shapes[i] for i in asked], [labels[i] for i in asked]))
    assert reliability(Verdicts.joined(verdicts)).error < 0.05


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_a_model_uses_at_most_the_features_and_the_order_asked_for(
    objects: dict[str, trimesh.Trimesh], order: int
) -> None:
    rng = np.random.default_rng(4)
    labels = [label for label in list(objects)[:4] for _ in range(4)]
    shapes = [instance_of(objects[label], rng) for label in labels]
    model = RecognitionModel.fit(shapes, labels, max_features=3, order=order)
    assert 1 <= len(model.indices) <= 3
    assert max(sum(index) for index in model.indices) <= order


def bumpy_prism(height: float) -> trimesh.Trimesh:
    """Return a square prism that a low bump on one side makes unlike its mirror image."""
    prism = trimesh.creation.box((1.0, 1.0, height)).subdivide()
    prism.vertices[np.argmax(prism.vertices @ [3.0, 2.0, 1.0])] *= 1.15
    return prism


def in_each_frame(shape: CanonicalShape) -> Iterator[CanonicalShape]:
    """Yield the shape as it would be with each of its admissible frames as the principal one."""
    frames = [shape.principal_frame, *shape.alternatives]
    for index, frame in enumerate(frames):
        mesh = shape.mesh.copy()
        mesh.apply_transform(np.linalg.inv(shape.matrix))
        mesh.apply_transform(np.linalg.inv(frame))
        mesh.apply_scale(shape.scale)
        yield replace(
            shape,
            mesh=mesh,
            principal_frame=frame,
            moments=surface_moments(mesh),
            alternatives=(*frames[:index], *frames[index + 1 :]),
        )


def test_an_ambiguous_object_is_the_same_in_each_of_its_admissible_frames() -> None:
    rng = np.random.default_rng(5)
    shapes = {"low": bumpy_prism(0.6), "tall": bumpy_prism(2.0), "cube": bumpy_prism(1.0)}
    shapes["cylinder"] = trimesh.creation.cylinder(0.5, 1.5, sections=16)
    tolerances = {"gap_tolerance": 0.1, "sign_tolerance": 0.3}
    labels = [label for label in shapes for _ in range(6)]
    trained = [normalize(instance_of(shapes[label], rng), **tolerances) for label in labels]
    model = RecognitionModel.fit(trained, labels, max_features=4)
    for label, mesh in shapes.items():
        shape = normalize(instance_of(mesh, rng), **tolerances)
        seen = [model.recognize(turned) for turned in in_each_frame(shape)]
        assert len(seen) >= (24 if label == "cube" else 8)
        assert {recognition.label for recognition in seen} == {label}
        # Frames beyond a shape's own alternatives depend on which of them is called its first.
        np.testing.assert_allclose([one.distance for one in seen], seen[0].distance, rtol=0.5)


def somewhere(mesh: trimesh.Trimesh, rng: np.random.Generator) -> trimesh.Trimesh:
    turned = Rotation.random(rng=rng).apply(mesh.vertices) * rng.uniform(0.2, 5.0)
    return trimesh.Trimesh(turned + rng.uniform(-3.0, 3.0, 3), mesh.faces, process=False)


@pytest.mark.parametrize("instances", [2, 3, 6])
def test_equal_instances_teach_a_class_by_what_is_more_than_rounding(instances: int) -> None:
    rng = np.random.default_rng(8)
    shapes = {"brick": trimesh.creation.box((1, 2, 3)), "beam": trimesh.creation.box((1, 2, 5))}
    labels = [label for label in shapes for _ in range(instances)]
    model = RecognitionModel.fit([somewhere(shapes[label], rng) for label in labels], labels)
    for label, mesh in shapes.items():
        for _ in range(5):
            recognition = model.recognize(somewhere(mesh, rng))
            assert recognition.label == label
            assert recognition.score > 0.99
    assert model.recognize(trimesh.creation.box((1, 2, 4))).label == "unknown"


def test_classes_of_one_and_the_same_shape_are_equally_near(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    box = trimesh.creation.box((1, 2, 3))
    model = RecognitionModel.fit([somewhere(box, rng) for _ in range(4)], list("aabb"))
    model.save(tmp_path / "model.json")
    recognition = load_model(tmp_path / "model.json").recognize(box)
    assert [distance for _, distance, _ in recognition.ranking] == [0.0, 0.0]
    assert [score for _, _, score in recognition.ranking] == pytest.approx([0.5, 0.5], abs=1e-3)


def test_two_instances_of_two_classes_are_enough_to_rank(
    objects: dict[str, trimesh.Trimesh],
) -> None:
    rng = np.random.default_rng(10)
    labels = ["castle", "castle", "chair", "chair"]
    model = RecognitionModel.fit([instance_of(objects[label], rng) for label in labels], labels)
    for label in model.classes:
        assert model.recognize(objects[label]).ranking[0][0] == label


def cups(rng: np.random.Generator, scale: float) -> trimesh.Trimesh:
    """Return a mug of a true size with disturbed vertices, somewhere."""
    mesh = trimesh.creation.annulus(0.03, 0.04, 0.09)
    vertices = mesh.vertices * scale + rng.normal(size=mesh.vertices.shape) * 3e-4 * scale
    return trimesh.Trimesh(Rotation.random(rng=rng).apply(vertices) + 1.0, mesh.faces)


@pytest.mark.parametrize("with_invariants", [False, True])
def test_size_tells_a_small_copy_from_a_large_one_and_shape_does_not(
    tmp_path: Path,
    with_invariants: bool,
) -> None:
    rng = np.random.default_rng(31)
    scales = {"cup": 1.0, "mug": 1.25}
    labels = [label for label in scales for _ in range(8)]
    shapes = [cups(rng, scales[label]) for label in labels]
    labels += ["box"] * 8
    shapes += [trimesh.creation.box(rng.uniform(0.99, 1.01, 3)) for _ in range(8)]
    for sized in (True, False):
        model = RecognitionModel.fit(shapes, labels, sized=sized, with_invariants=with_invariants)
        model.save(tmp_path / f"{sized}.json")
        loaded = load_model(tmp_path / f"{sized}.json")
        asked = [label for label in scales for _ in range(10)]
        found = [loaded.recognize(cups(rng, scales[label])) for label in asked]
        right = np.mean(
            [seen.ranking[0][0] == label for seen, label in zip(found, asked, strict=True)]
        )
        giant = loaded.recognize(cups(rng, 20.0))
        if sized:
            assert right == 1.0
            assert giant.label == "unknown"
        else:
            assert right < 0.9
            assert giant.label in scales


def test_a_class_learned_later_has_its_size() -> None:
    rng = np.random.default_rng(32)
    labels = ["cup"] * 6 + ["box"] * 6
    shapes = [cups(rng, 1.0) for _ in range(6)]
    shapes += [trimesh.creation.box(rng.uniform(0.99, 1.01, 3)) for _ in range(6)]
    model = RecognitionModel.fit(shapes, labels, sized=True, with_invariants=True)
    learned = model.with_class("mug", [cups(rng, 1.4) for _ in range(4)])
    assert learned.recognize(cups(rng, 1.4)).label == "mug"
    assert learned.recognize(cups(rng, 1.0)).label == "cup"


def tubs(
    rng: np.random.Generator, count: int, height: float, varies: float
) -> list[CanonicalShape]:
    """Return boxes of about one height, whose frames differ by signs only."""
    heights = height * (1.0 + varies * rng.normal(size=count))
    return [normalize(trimesh.creation.box((1.0, 2.0, each))) for each in heights]


@pytest.fixture(scope="module")
def tubs_model() -> RecognitionModel:
    """Know a class that hardly varies and one that varies much, by the invariants."""
    rng = np.random.default_rng(33)
    shapes = tubs(rng, 12, 3.0, 0.002) + tubs(rng, 12, 4.5, 0.06)
    return RecognitionModel.fit(shapes, ["same"] * 12 + ["any"] * 12, with_invariants=True)


def test_with_invariants_distances_are_mahalanobis_distances_in_own_metrics(
    tubs_model: RecognitionModel,
) -> None:
    shape = normalize(trimesh.creation.box((1.0, 2.0, 3.5)))
    moments = feature_vectors(shape, list(tubs_model.indices))
    vectors = [[*vector, *invariants(shape)] for vector in moments]
    for label, distance, _ in tubs_model.recognize(shape).ranking:
        number = tubs_model.classes.index(label)
        inverse = np.linalg.pinv(tubs_model.covariances[number], rcond=1e-14, hermitian=True)
        expected = min(mahalanobis(each, tubs_model.means[number], inverse) for each in vectors)
        assert distance == pytest.approx(expected, rel=1e-3)


def test_own_metrics_are_kept_in_the_file_and_files_without_them_have_one(
    tubs_model: RecognitionModel, tmp_path: Path
) -> None:
    path = tmp_path / "model.json"
    tubs_model.save(path)
    loaded = load_model(path)
    np.testing.assert_array_equal(loaded.covariances, tubs_model.covariances)
    content = json.loads(path.read_text())
    del content["covariances"]
    path.write_text(json.dumps(content))
    assert load_model(path).covariances is None
    for damage in ([1.0], [[1.0]], content["covariance"], [[-1.0] * 231] * 2, {}, None, [[]] * 2):
        path.write_text(json.dumps(content | {"covariances": damage}))
        with pytest.raises(ModelFormatError, match="covariance"):
            load_model(path)


def test_a_later_class_gets_a_metric_of_its_own_where_the_others_have_one(
    tubs_model: RecognitionModel, tmp_path: Path
) -> None:
    rng = np.random.default_rng(34)
    shapes = tubs(rng, 9, 7.0, 0.06)
    learned = tubs_model.with_class("new", shapes)
    learned.save(tmp_path / "model.json")
    loaded = load_model(tmp_path / "model.json")
    X = np.array(
        [[*feature_vectors(shape, list(loaded.indices))[0], *invariants(shape)] for shape in shapes]
    )
    scatter = 9 * np.cov(X.T, bias=True) + 5 * tubs_model.covariance
    np.testing.assert_allclose(loaded.covariances[-1], scatter / (8 + 5), rtol=1e-6)
    np.testing.assert_array_equal(loaded.covariances[:-1], tubs_model.covariances)
    for asked in tubs(rng, 10, 7.0, 0.06):
        assert loaded.recognize(asked).label == "new"


def test_recognition_does_not_depend_on_the_canonical_area(
    model: RecognitionModel, objects: dict[str, trimesh.Trimesh]
) -> None:
    for mesh in objects.values():
        small, usual = (model.recognize(normalize(mesh, area=area)) for area in (0.01, 100.0))
        assert small.distance == pytest.approx(usual.distance, rel=1e-6, abs=1e-9)


def test_a_saved_model_says_the_same_after_loading(
    model: RecognitionModel, objects: dict[str, trimesh.Trimesh], tmp_path: Path
) -> None:
    path = tmp_path / "model.json"
    model.save(path)
    loaded = load_model(path)
    assert loaded.classes == model.classes == tuple(sorted(objects))
    for mesh in objects.values():
        assert loaded.recognize(mesh).ranking == model.recognize(mesh).ranking
    loaded.save(path)
    assert load_model(path).threshold == model.threshold
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.json"]


def test_a_model_that_cannot_be_written_leaves_nothing_behind(
    model: RecognitionModel, tmp_path: Path
) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(OSError, match="taken"):
        model.save(tmp_path / "taken")
    assert [entry.name for entry in tmp_path.iterdir()] == ["taken"]


DAMAGES = {
    "another format": {"format": "something else"},
    "a later version": {"version": 4},
    "no word on size": {"version": 3, "invariants": False},
    "no word on invariants": {"version": 3, "sized": False},
    "a number for size": {"version": 3, "invariants": False, "sized": 1},
    "size without its mean": {"version": 3, "invariants": False, "sized": True},
    "invariants without their means": {"version": 3, "invariants": True, "sized": False},
    "no version": {"version": None},
    "classes that are no list": {"classes": "ab"},
    "classes twice": {"classes": ["a", "a"]},
    "a single class": {"classes": ["a"]},
    "a class called unknown": {"classes": ["a", "unknown"]},
    "a class that is no text": {"classes": ["a", 1]},
    "an empty class": {"classes": ["a", ""]},
    "a class of two lines": {"classes": ["a", "b\n"]},
    "half a character": {"classes": ["a", "\ud800"]},
    "true as a version": {"version": True},
    "a fractional version": {"version": 2.0},
    "a long version": {"version": 10**4000},
    "no moments": {"moments": []},
    "a moment of order 6": {"moments": [[2, 0, 0], [6, 0, 0]]},
    "a constant moment": {"moments": [[2, 0, 0], [1, 0, 0]]},
    "a fractional moment": {"moments": [[2.0, 0, 0], [0, 2, 0]]},
    "a nested moment": {"moments": [[2, 0, 0], [[0], 2, 0]]},
    "a moment that is no list": {"moments": [[2, 0, 0], 5, [0, 2, 0]]},
    "means of another shape": {"means": [[1.0, 2.0]]},
    "ragged means": {"means": [[1.0, 2.0], [1.0]]},
    "means that are text": {"means": [["1", "2"], ["3", "4"]]},
    "a truth value among the means": {"means": [[1.0, True], [0.0, 1.0]]},
    "a list among the means": {"means": [[1.0, [2.0]], [0.0, 1.0]]},
    "means as an object": {"means": {"a": [1.0, 2.0], "b": [1.0, 2.0]}},
    "means whose squares are too large": {"means": [[1.0, 1e200], [0.0, 1.0]]},
    "means that are infinite": {"means": [[1.0, float("-inf")], [0.0, 1.0]]},
    "means that are not finite": {"means": [[1.0, float("nan")], [0.0, 1.0]]},
    "means too large for a float": {"means": [[1.0, 10**400], [0.0, 1.0]]},
    "a covariance that is not symmetric": {"covariance": [[1.0, 0.5], [0.0, 1.0]]},
    "a covariance that is indefinite": {"covariance": [[1.0, 2.0], [2.0, 1.0]]},
    "a tiny covariance that is not symmetric": {"covariance": [[1e-12, 1e-13], [0.0, 1e-12]]},
    "a covariance without a variance": {"covariance": [[0.0, 0.5], [0.5, 1.0]]},
    "a variance below all moments": {"covariance": [[1e-300, 0.0], [0.0, 1.0]]},
    "a negative covariance": {"covariance": [[1.0, 0.0], [0.0, -1.0]]},
    "no threshold": {"threshold": None},
    "a negative threshold": {"threshold": -1.0},
    "a threshold of zero": {"threshold": 0},
    "a threshold that is true": {"threshold": True},
    "a threshold that is a list": {"threshold": [1.0]},
    "an infinite threshold": {"threshold": float("inf")},
    "a negative spread": {"spreads": [0.5, -0.1]},
    "a spread too few": {"spreads": [0.5]},
    "no blur": {"blur": 0.0},
    "a certainty below zero": {"certainty": -1.0},
}


def test_the_sound_model_that_is_damaged_below_can_be_loaded(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(SOUND))
    assert load_model(path).classes == ("a", "b")


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_model_is_refused_in_one_line(tmp_path: Path, damage: dict[str, object]) -> None:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(SOUND | damage))
    with pytest.raises(ModelFormatError, match=r"^.*model\.json: Expected .*$") as caught:
        load_model(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b"[]", b"null", b"\x80\x04pickle", b"[" * 200_000, b'{"a": ' + b"9" * 5000 + b"}"],
    ids=["empty", "cut", "list", "null", "binary", "deep", "long number"],
)
def test_a_file_that_is_no_model_is_refused_in_one_line(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "model.json"
    path.write_bytes(data)
    with pytest.raises(ModelFormatError, match="Expected") as caught:
        load_model(path)
    assert "\n" not in str(caught.value)


def check_refused_or_sound(path: Path) -> None:
    """Check that a file is a model that gives numbers, or refused in one line that names it."""
    model, message = None, ""
    try:
        model = load_model(path)
    except ModelFormatError as error:
        message = str(error)
    if model is None:
        assert "\n" not in message
        assert len(message) < 400 + len(str(path))
        assert str(path) in message
        assert "Expected" in message
    else:
        recognition = model.recognize(BOX)
        _, distances, scores = zip(*recognition.ranking, strict=True)
        assert recognition.label in {*model.classes, "unknown"}
        assert np.isfinite(distances).all()
        assert 0.0 <= min(scores) <= max(scores) <= 1.0
        assert 0.0 <= recognition.score <= 1.0


def places_in(
    content: object, place: tuple[str | int, ...] = ()
) -> Iterator[tuple[str | int, ...]]:
    yield place
    if isinstance(content, dict | list):
        for key in content if isinstance(content, dict) else range(len(content)):
            yield from places_in(content[key], (*place, key))


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([0, -1, 2**63, 2**64, 10**400, 1e-300, 1e100, 1e308, -0.0])
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(["unknown", "\ud800", "1.0"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=6,
)


@settings(max_examples=400, deadline=None)
@given(place=st.sampled_from(list(places_in(SOUND))), value=json_values)
def test_a_model_with_any_value_in_any_place_is_refused_or_sound(
    tmp_path_factory: pytest.TempPathFactory, place: tuple[str | int, ...], value: object
) -> None:
    path = tmp_path_factory.getbasetemp() / "mutated.json"
    content = {"whole": copy.deepcopy(SOUND)}
    *way, last = ("whole", *place)
    reduce(getitem, way, content)[last] = value
    path.write_text(json.dumps(content["whole"]))
    check_refused_or_sound(path)


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_a_model_with_bytes_changed_is_refused_or_sound(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "changed.json"
    content = bytearray(json.dumps(SOUND).encode())
    start = data.draw(st.integers(0, len(content) - 1))
    length = data.draw(st.integers(0, 4))
    content[start : start + length] = data.draw(
        st.binary(max_size=3)
        | st.sampled_from([b"9" * 20, b"e9", b"-", b"NaN", b"[", b"true", b"0"])
    )
    path.write_bytes(content)
    check_refused_or_sound(path)


def test_a_model_cut_anywhere_is_refused(model: RecognitionModel, tmp_path: Path) -> None:
    path = tmp_path / "cut.json"
    model.save(path)
    whole = path.read_bytes().rstrip()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(ModelFormatError, match=r"Expected JSON in .*cut\.json"):
            load_model(path)


@pytest.mark.parametrize("field", ["classes", "moments", "means", "covariance", "version"])
def test_a_field_of_any_depth_is_refused_in_one_line(tmp_path: Path, field: str) -> None:
    path = tmp_path / "deep.json"
    for depth in (2, 40, 70, 500, 900, 5_000, 100_000):
        text = json.dumps(SOUND | {field: "here"})
        path.write_text(text.replace('"here"', "[" * depth + "1" + "]" * depth))
        with pytest.raises(ModelFormatError, match="Expected"):
            load_model(path)


def test_a_saved_model_is_json_that_people_can_read(
    model: RecognitionModel, tmp_path: Path
) -> None:
    path = tmp_path / "model.json"
    model.save(path)
    content = json.loads(path.read_text())
    assert content["classes"] == list(model.classes)
    assert content["moments"] == [list(index) for index in model.indices]
    np.testing.assert_array_equal(content["means"], model.means)
    np.testing.assert_array_equal(content["covariance"], model.covariance)
    assert len(path.read_text().splitlines()) > len(model.classes) + 2 * len(model.indices)


def test_a_folder_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(ModelFormatError, match=r"cannot read .*: Is a directory"):
        load_model(tmp_path)


def test_a_missing_model_and_a_huge_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelFormatError, match=r"cannot read .*none\.json"):
        load_model(tmp_path / "none.json")
    huge = tmp_path / "huge.json"
    with huge.open("wb") as stream:
        stream.truncate(2**40)  # sparse: takes no room on the disk
    with pytest.raises(ModelFormatError, match="has more"):
        load_model(huge)


@pytest.mark.parametrize(
    ("labels", "settings_used", "message"),
    [
        (["a", "a"], {}, "a label for each of 4 shapes, got 2"),
        (["a"] * 4, {}, "two classes or more"),
        (["a", "a", "a", "b"], {}, "two instances or more"),
        (["a", "a", "unknown", "unknown"], {}, "labels other than \"unknown\", got 'unknown'"),
        (["a", "a", "", ""], {}, "printable labels .* got ''"),
        (["a", "a", "b", "b"], {"order": 6}, "an order from 2 to 5, got 6"),
        (["a", "a", "b", "b"], {"max_features": 0}, "at least one feature, got 0"),
    ],
)
def test_a_training_set_that_teaches_nothing_is_refused(
    labels: list[str], settings_used: dict[str, int], message: str
) -> None:
    shapes = [trimesh.creation.box((1.0, 2.0, 3.0 + index)) for index in range(4)]
    with pytest.raises(ValueError, match=message):
        RecognitionModel.fit(shapes, labels, **settings_used)


def test_a_shape_without_area_is_refused_not_named(model: RecognitionModel) -> None:
    with pytest.raises(DegenerateShapeError):
        model.recognize(trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False))


# --- one more class -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def further_objects() -> dict[str, trimesh.Trimesh]:
    """Return objects that the model does not know, two of them with ambiguous frames."""
    return {
        "stranger": trimesh.load(MESHES / "stranger.ply", process=False),
        "equilateral prism": trimesh.creation.cylinder(1.0, 1.2, sections=3).subdivide(),
        "box": trimesh.creation.box((1.0, 2.0, 4.0)).subdivide(),
    }


@pytest.mark.parametrize("count", [2, 3, 8])
@pytest.mark.parametrize("label", ["stranger", "equilateral prism", "box"])
def test_a_class_learned_later_is_recognised_and_the_others_still_are(
    model: RecognitionModel,
    objects: dict[str, trimesh.Trimesh],
    further_objects: dict[str, trimesh.Trimesh],
    label: str,
    count: int,
) -> None:
    rng = np.random.default_rng(count)
    mesh = further_objects[label]
    unseen = [normalize(instance_of(mesh, rng)) for _ in range(10)]
    assert {model.recognize(shape).label for shape in unseen} == {"unknown"}
    learned = model.with_class(label, [instance_of(mesh, rng) for _ in range(count)])
    assert sum(learned.recognize(shape).label == label for shape in unseen) >= 9
    for name, known in objects.items():
        instance = normalize(instance_of(known, rng))
        assert learned.recognize(instance).label == model.recognize(instance).label == name


def test_classes_learned_one_after_the_other_are_all_told_apart(
    model: RecognitionModel, further_objects: dict[str, trimesh.Trimesh]
) -> None:
    rng = np.random.default_rng(21)
    learned = model
    for label, mesh in further_objects.items():
        learned = learned.with_class(label, [instance_of(mesh, rng) for _ in range(4)])
    assert learned.classes == (*model.classes, *further_objects)
    for label, mesh in further_objects.items():
        found = [learned.recognize(instance_of(mesh, rng)).label for _ in range(10)]
        assert found.count(label) >= 9


def test_a_later_class_has_the_mean_and_spread_of_its_aligned_instances(
    model: RecognitionModel, further_objects: dict[str, trimesh.Trimesh]
) -> None:
    rng = np.random.default_rng(22)
    shapes = [normalize(instance_of(further_objects["stranger"], rng)) for _ in range(4)]
    vectors = [feature_vectors(shape, list(model.indices)) for shape in shapes]
    assert all(len(frames) == 1 for frames in vectors)  # there is nothing to align
    learned = model.with_class("stranger", shapes)
    instances = np.concatenate(vectors)
    np.testing.assert_allclose(learned.means[-1], instances.mean(axis=0), rtol=1e-12)
    inverse = np.linalg.inv(model.covariance)
    squares = [
        mahalanobis(instances[index], np.delete(instances, index, axis=0).mean(axis=0), inverse)
        ** 2
        for index in range(4)
    ]
    typical = np.median(model.spreads)
    expected = np.sqrt((sum(squares) + 5 * typical**2) / (4 + 5))
    assert learned.spreads[-1] == pytest.approx(expected, rel=1e-6)


def test_instances_of_an_ambiguous_frame_are_aligned_in_whatever_order_they_come(
    model: RecognitionModel, further_objects: dict[str, trimesh.Trimesh]
) -> None:
    rng = np.random.default_rng(23)
    mesh = further_objects["equilateral prism"]
    shapes = [normalize(instance_of(mesh, rng)) for _ in range(6)]
    candidates = [feature_vectors(shape, list(model.indices)) for shape in shapes]
    assert min(map(len, candidates)) > 1
    inverse = np.linalg.inv(model.covariance)
    principal = np.array([frames[0] for frames in candidates])
    unaligned = [mahalanobis(each, principal.mean(axis=0), inverse) for each in principal]
    for order in ([0, 1, 2, 3, 4, 5], [5, 3, 1, 0, 2, 4]):
        learned = model.with_class("prism", [shapes[index] for index in order])
        aligned = [learned.recognize(shape).distance for shape in shapes]
        assert np.mean(aligned) < np.mean(unaligned)
        assert all(learned.recognize(shape).label == "prism" for shape in shapes)


def test_learning_a_class_changes_nothing_else(model: RecognitionModel, tmp_path: Path) -> None:
    learned = model.with_class("box", [BOX, BOX])
    assert "box" not in model.classes
    assert learned.indices == model.indices
    assert (learned.threshold, learned.blur) == (model.threshold, model.blur)
    assert learned.certainty == model.certainty
    np.testing.assert_array_equal(learned.covariance, model.covariance)
    np.testing.assert_array_equal(learned.means[:-1], model.means)
    np.testing.assert_array_equal(learned.spreads[:-1], model.spreads)
    assert learned.spreads[-1] > 0.5 * np.median(model.spreads)  # equal instances teach no spread
    learned.save(tmp_path / "model.json")
    loaded = load_model(tmp_path / "model.json")
    assert loaded.classes == learned.classes
    assert loaded.recognize(BOX).label == "box"


@pytest.mark.parametrize(
    ("label", "count", "message"),
    [
        ("a", 2, "Expected a label other than those of the model, got 'a'"),
        ("unknown", 2, "Expected a printable label other than \"unknown\", got 'unknown'"),
        ("", 2, "Expected a printable label"),
        ("two\nlines", 2, "Expected a printable label"),
        ("c", 1, "Expected two instances or more of 'c', got 1"),
        ("c", 0, "Expected two instances or more of 'c', got 0"),
    ],
)
def test_a_class_that_cannot_be_learned_is_refused(label: str, count: int, message: str) -> None:
    with pytest.raises(MomrecError, match=message):
        TWO_CLASSES.with_class(label, [BOX] * count)


def test_an_instance_without_area_teaches_nothing() -> None:
    flat = trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False)
    with pytest.raises(DegenerateShapeError):
        TWO_CLASSES.with_class("c", [BOX, flat])
