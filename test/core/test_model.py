"""Recognition: known, unknown and ambiguous objects, and model files whole and damaged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from momrec_core import (
    DegenerateShapeError,
    ModelFormatError,
    RecognitionModel,
    load_model,
    normalize,
    surface_moments,
)
from momrec_core.features import feature_vectors, moment_indices

MESHES = Path(__file__).parents[2] / "meshes"
NOISE = 0.01  # of the extent: vertices of simulated instances are off by so much


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


def test_unseen_instances_get_their_label(
    model: RecognitionModel, objects: dict[str, trimesh.Trimesh]
) -> None:
    rng = np.random.default_rng(2)
    labels = [label for label in objects for _ in range(10)]
    given_labels = [model.recognize(instance_of(objects[label], rng)).label for label in labels]
    assert np.mean(np.array(labels) == given_labels) >= 0.95


def test_strangers_are_unknown(model: RecognitionModel) -> None:
    rng = np.random.default_rng(3)
    stranger = trimesh.load(MESHES / "stranger.ply", process=False)
    for _ in range(10):
        recognition = model.recognize(instance_of(stranger, rng))
        assert (recognition.label, recognition.known) == ("unknown", False)
        assert recognition.distance > model.threshold


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


def test_there_are_3_13_28_and_49_moments_that_tell_shapes_apart() -> None:
    assert [len(moment_indices(order)) for order in (2, 3, 4, 5)] == [3, 13, 28, 49]


def test_features_in_an_alternative_frame_are_the_moments_of_the_turned_mesh() -> None:
    mesh = trimesh.convex.convex_hull(np.random.default_rng(5).normal(size=(12, 3)))
    shape = normalize(mesh, area=7.0, gap_tolerance=0.9, sign_tolerance=0.99)
    indices = moment_indices(5)
    vectors = feature_vectors(shape, indices)
    assert len(vectors) == 1 + len(shape.alternatives) == 24
    for frame, vector in zip([shape.principal_frame, *shape.alternatives], vectors, strict=True):
        turned = mesh.copy()
        turned.apply_transform(np.linalg.inv(frame))
        turned.apply_scale(np.sqrt(100.0 / mesh.area))
        expected = surface_moments(turned)[tuple(np.transpose(indices))]
        np.testing.assert_allclose(vector, expected, rtol=1e-9, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_an_object_with_an_ambiguous_frame_is_named_in_each_of_its_frames(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wedge = trimesh.convex.convex_hull(
        [[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1], [0, 2, 1], [3, 0, 0.9], [3, 2, 0]]
    )
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    shapes = {"wedge": wedge, "box": box}
    settings_used = {"sign_tolerance": 0.9}  # every sign is open: alternatives decide
    labels = [label for label in shapes for _ in range(6)]
    trained = [normalize(instance_of(shapes[label], rng), **settings_used) for label in labels]
    assert not any(shape.is_unique for shape in trained)
    model = RecognitionModel.fit(trained, labels, max_features=3)
    for label, mesh in shapes.items():
        shape = normalize(mesh, **settings_used)
        assert model.recognize(shape).ranking[0][0] == label


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
    "a later version": {"version": 2},
    "no version": {"version": None},
    "classes that are no list": {"classes": "ab"},
    "classes twice": {"classes": ["a", "a"]},
    "a single class": {"classes": ["a"]},
    "a class called unknown": {"classes": ["a", "unknown"]},
    "a class that is no text": {"classes": ["a", 1]},
    "no moments": {"moments": []},
    "a moment of order 6": {"moments": [[2, 0, 0], [6, 0, 0]]},
    "a constant moment": {"moments": [[2, 0, 0], [1, 0, 0]]},
    "a fractional moment": {"moments": [[2.0, 0, 0], [0, 2, 0]]},
    "a nested moment": {"moments": [[2, 0, 0], [[0], 2, 0]]},
    "a moment that is no list": {"moments": [[2, 0, 0], 5, [0, 2, 0]]},
    "means of another shape": {"means": [[1.0, 2.0]]},
    "ragged means": {"means": [[1.0, 2.0], [1.0]]},
    "means that are text": {"means": [["1", "2"], ["3", "4"]]},
    "means that are not finite": {"means": [[1.0, float("nan")], [0.0, 1.0]]},
    "means too large for a float": {"means": [[1.0, 10**400], [0.0, 1.0]]},
    "a covariance that is not symmetric": {"covariance": [[1.0, 0.5], [0.0, 1.0]]},
    "a negative covariance": {"covariance": [[1.0, 0.0], [0.0, -1.0]]},
    "no threshold": {"threshold": None},
    "a negative threshold": {"threshold": -1.0},
    "an infinite threshold": {"threshold": float("inf")},
    "a negative spread": {"spread": -0.1},
}
SOUND = {
    "format": "momrec recognition model",
    "version": 1,
    "classes": ["a", "b"],
    "moments": [[2, 0, 0], [0, 2, 0]],
    "means": [[1.0, 2.0], [3.0, 4.0]],
    "covariance": [[1.0, 0.5], [0.5, 1.0]],
    "threshold": 1.0,
    "spread": 0.5,
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
        (["a", "a", "unknown", "unknown"], {}, 'labels other than "unknown"'),
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
