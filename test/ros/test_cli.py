"""The command line, run as a user runs it, on small real bags, meshes and masks."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from PIL import Image

from momrec_core.hull import reconstruct
from momrec_core.model import load_model
from momrec_core.simulation import look_at, random_directions, simulate_views
from momrec_core.view import View
from momrec_ros.bag import StampedView, read_bag
from momrec_ros.bag_writer import BagWriter
from momrec_ros.commands import run_simulate
from momrec_ros.demo_folder import replaced_folder
from momrec_ros.training import reconstructed_instances

MESHES = Path(__file__).parents[2] / "meshes"
OBJECTS = ("castle", "l_bracket", "uneven_t")
MOMREC = Path(sys.executable).with_name("momrec")
FEW = ("--instances", 8, "--views", 8, "--max-features", 4, "--workers", 1)
KEYS = [
    "object",
    "label",
    "known",
    "distance",
    "score",
    "views",
    "slices",
    "area",
    "volume",
    "scale",
    "position",
    "orientation",
    "unique_frame",
    "rejected_views",
    "contradicting_views",
    "cut_views",
    "coverage_mean",
    "coverage_worst",
]


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    """Return a folder with a bag of three objects and a model that knows them."""
    folder = tmp_path_factory.mktemp("shop")
    meshes = [MESHES / "ten_objects" / f"{name}.ply" for name in OBJECTS]
    for arguments in (
        ["simulate", *meshes, "--output", folder / "bag", "--views", "8", "--seed", "5"],
        ["train", *meshes, "--output", folder / "model.json", "--slices", 16, *FEW],
    ):
        subprocess.run([MOMREC, *map(str, arguments)], check=True, capture_output=True)
    return folder


def lines(text):
    return [json.loads(line) for line in text.splitlines()]


def content(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- replay ---------------------------------------------------------------------------------


def test_replay_names_every_object_in_a_json_line(momrec, shop):
    ended = momrec("replay", shop / "bag", "--model", shop / "model.json", "--json", "--slices", 16)
    assert ended.code == 0
    results = lines(ended.out)
    assert [list(result) for result in results] == [KEYS] * 3
    assert [result["object"] for result in results] == list(OBJECTS)
    for result in results:
        assert result["known"] == (result["label"] != "unknown")
        assert (result["views"], result["slices"], result["rejected_views"]) == (8, 16, 0)
        assert result["distance"] > 0
        assert 0 <= result["score"] <= 1
        assert np.linalg.norm(result["orientation"]) == pytest.approx(1.0)
        assert result["scale"] == pytest.approx(np.sqrt(100 / result["area"]))
    assert [result["label"] for result in results] == list(OBJECTS)


def test_replay_says_what_the_library_says(momrec, shop):
    views = {}
    for event in read_bag(shop / "bag"):
        views.setdefault(event.object_id, []).append(event.view)
    ended = momrec("replay", shop / "bag", "--json", "--slices", 16)
    for result in lines(ended.out):
        mesh = reconstruct(views[result["object"]], 16).mesh()
        assert result["area"] == pytest.approx(mesh.area)
        assert result["volume"] == pytest.approx(mesh.volume)
        centroid = np.average(mesh.triangles_center, axis=0, weights=mesh.area_faces)
        np.testing.assert_allclose(result["position"], centroid, atol=1e-9)


def test_without_a_model_objects_are_reconstructed_but_not_named(momrec, shop):
    ended = momrec("replay", shop / "bag", "--json", "--slices", 8)
    assert ended.code == 0
    assert "no --model" in ended.err
    for result in lines(ended.out):
        assert (result["label"], result["known"]) == ("unknown", False)
        assert (result["distance"], result["score"]) == (None, None)


def test_replay_shows_a_table_on_stdout(momrec, shop):
    ended = momrec("replay", shop / "bag", "--model", shop / "model.json", "--slices", 16)
    assert ended.code == 0
    for name in OBJECTS:
        assert ended.out.count(name) == 2
    assert "3 objects" in ended.out


def test_replay_writes_a_bag_and_a_picture_of_each_object(momrec, shop, tmp_path):
    bag, figures = tmp_path / "results", tmp_path / "new" / "figures"
    ended = momrec("replay", shop / "bag", "--slices", 8, "--output", bag, "--figures", figures)
    assert ended.code == 0
    for name in OBJECTS:
        with Image.open(figures / f"{name}.png") as picture:
            assert min(picture.size) > 100
    assert len(list(figures.iterdir())) == 3
    replayed = [momrec("replay", each, "--slices", 8, "--json") for each in (bag, shop / "bag")]
    for again, before in zip(*(lines(ended.out) for ended in replayed), strict=True):
        assert again["object"] == before["object"]
        assert again["volume"] == pytest.approx(before["volume"], rel=1e-6)
        assert again["position"] == pytest.approx(before["position"], abs=1e-6)


@pytest.mark.parametrize("option", ["--output", "--figures"])
def test_replay_overwrites_nothing_and_begins_no_work(momrec, shop, tmp_path, option):
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "file").write_text("kept")
    ended = momrec("replay", shop / "bag", option, kept, "--json")
    assert ended.code == 1
    assert ended.out == ""
    assert ended.err.count("\n") == 1
    assert "does not exist yet" in ended.err
    assert content(tmp_path) == {"file": b"kept"}


def test_a_cut_bag_gives_what_is_whole_and_exit_code_3(momrec, shop, tmp_path):
    whole = next((shop / "bag").glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    ended = momrec("replay", cut, "--json", "--slices", 8)
    assert ended.code == 3
    assert 1 <= len(lines(ended.out)) < 3
    assert "lost: " in ended.err


def write_bag(path, stamped):
    with BagWriter(path) as writer:
        for view in stamped:
            writer.write_view(view)


def box_views(count, object_id="box", start=0, shift=0.0):
    mesh = trimesh.creation.box((1, 2, 3)).apply_translation((shift, 0, 0))
    views = simulate_views(mesh, count, np.random.default_rng(3))
    return [
        StampedView(object_id, (start + number) * 1_000_000_000, "map", view)
        for number, view in enumerate(views, start=1)
    ]


def test_a_view_that_contradicts_the_others_is_told_and_counted(momrec, tmp_path):
    wrong = box_views(4, shift=500.0)[3]
    write_bag(tmp_path / "bag", [*box_views(4), wrong])
    ended = momrec("replay", tmp_path / "bag", "--json", "--slices", 8)
    assert ended.code == 3
    (result,) = lines(ended.out)
    assert (result["views"], result["rejected_views"]) == (4, 1)
    assert "left out" in ended.err


def eroded(stamped):
    """Return the view with a silhouette that lost its right half."""
    view = stamped.view
    left, low, right, high = view.silhouette.bounds
    kept = view.silhouette.intersection(shapely.box(left, low, (left + right) / 2, high))
    return replace(stamped, view=View(view.camera, kept))


def test_a_bad_mask_is_told_by_its_stamp_and_left_out_unless_none_may_be(momrec, tmp_path):
    views = box_views(8)
    views[2] = eroded(views[2])
    write_bag(tmp_path / "bag", views)
    ended = momrec("replay", tmp_path / "bag", "--json", "--slices", 16)
    assert ended.code == 3
    (result,) = lines(ended.out)
    assert (result["views"], result["rejected_views"], result["contradicting_views"]) == (7, 1, 1)
    assert result["coverage_mean"] >= result["coverage_worst"] > 0.98
    assert "view of object 'box' at 3.000 s left out: it contradicts" in " ".join(ended.err.split())
    kept = momrec("replay", tmp_path / "bag", "--json", "--slices", 16, "--max-bad-views", 0)
    assert kept.code == 0
    (spoiled,) = lines(kept.out)
    assert (spoiled["views"], spoiled["contradicting_views"]) == (8, 0)
    assert spoiled["coverage_worst"] < 0.9
    assert spoiled["volume"] < 0.8 * result["volume"]


def test_views_in_another_frame_are_told_and_counted(momrec, tmp_path):
    views = box_views(4)
    views[2] = StampedView("box", views[2].stamp, "elsewhere", views[2].view)
    write_bag(tmp_path / "bag", views)
    ended = momrec("replay", tmp_path / "bag", "--json", "--slices", 8)
    assert ended.code == 3
    (result,) = lines(ended.out)
    assert (result["views"], result["rejected_views"]) == (3, 1)
    assert "elsewhere" in ended.err


def test_nothing_recognisable_is_exit_code_1_and_no_output(momrec, tmp_path):
    write_bag(tmp_path / "bag", box_views(1))
    before = content(tmp_path)
    ended = momrec("replay", tmp_path / "bag", "--json", "--output", tmp_path / "results")
    assert ended.code == 1
    assert ended.out == ""
    assert "no result" in ended.err
    assert content(tmp_path) == before


def test_an_evicted_object_yields_its_line_then(momrec, tmp_path):
    write_bag(tmp_path / "bag", [*box_views(3, "a"), *box_views(3, "b", 3), *box_views(2, "a", 6)])
    ended = momrec("replay", tmp_path / "bag", "--json", "--slices", 8, "--max-objects", 1)
    assert ended.code == 0
    results = [(result["object"], result["views"]) for result in lines(ended.out)]
    assert results == [("a", 3), ("b", 3), ("a", 2)]


def test_an_object_without_views_for_long_yields_its_line(momrec, tmp_path):
    write_bag(tmp_path / "bag", [*box_views(3, "a"), *box_views(3, "a", 100)])
    ended = momrec("replay", tmp_path / "bag", "--json", "--slices", 8, "--object-timeout", 50)
    assert [result["views"] for result in lines(ended.out)] == [3, 3]
    ended = momrec("replay", tmp_path / "bag", "--json", "--slices", 8)
    assert [result["views"] for result in lines(ended.out)] == [6]


def test_projection_is_enforced(momrec, shop):
    ended = momrec("replay", shop / "bag", "--projection", "central", "--json")
    assert ended.code == 1
    assert ended.out == ""
    assert "central" in ended.err


@pytest.mark.parametrize(
    "damage",
    [b"", b"{", b"null", b'{"version": 99}', b"\x80\x04N.", b"[" * 100_000],
    ids=["empty", "cut", "null", "version", "pickle", "deep"],
)
def test_a_broken_model_is_one_line_and_exit_code_1(momrec, shop, tmp_path, damage):
    model = tmp_path / "model.json"
    model.write_bytes(damage)
    ended = momrec("replay", shop / "bag", "--model", model, "--json")
    assert ended.code == 1
    assert ended.out == ""
    assert ended.err.count("\n") == 1
    assert ended.err.startswith("momrec: ")


@pytest.mark.parametrize("damage", [b"", b"no bag", b"\x89MCAP0\r\n"])
def test_a_file_that_is_no_bag_is_an_error_in_one_line(momrec, tmp_path, damage):
    path = tmp_path / "bag.mcap"
    path.write_bytes(damage)
    ended = momrec("replay", path)
    assert ended.code == 1
    assert "Traceback" not in ended.err
    assert ended.err.splitlines()[-1].startswith("momrec: ")


@pytest.mark.parametrize(
    "arguments",
    [
        ["no-such-command"],
        ["replay"],
        ["replay", "no such bag"],
        ["replay", ".", "--slices", "1"],
        ["replay", ".", "--slices", "many"],
        ["replay", ".", "--object-timeout", "nan"],
        ["replay", ".", "--projection", "sideways"],
        ["replay", ".", "--model", "no such model"],
        ["replay", ".", "--no-such-option"],
        ["simulate", "--output", "bag"],
        ["train", ".", "--output", "model.json", "--instances", "0"],
        ["learn", "."],
        ["learn", __file__, __file__, "--output", "model.json"],
        ["learn", __file__, "no such mesh", "--label", "new", "--output", "model.json"],
        ["reconstruct", "."],
    ],
)
def test_wrong_usage_is_exit_code_2(momrec, arguments):
    ended = momrec(*arguments)
    assert ended.code == 2
    assert ended.out == ""
    assert "Usage" in ended.err


# --- simulate -------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", ["orthographic", "central"])
def test_simulate_writes_views_of_each_mesh_under_its_stem(momrec, tmp_path, projection):
    meshes = [MESHES / "stranger.ply", MESHES / "ten_objects" / "castle.ply"]
    bags = tmp_path / "first" / "bag", tmp_path / "second" / "bag"
    for bag in bags:
        ended = momrec(
            *("simulate", *meshes, "--output", bag, "--views", 5),
            *("--projection", projection, "--noise", 0.002, "--seed", 9),
        )
        assert ended.code == 0
    events = list(read_bag(bags[0]))
    assert [event.object_id for event in events] == ["stranger"] * 5 + ["castle"] * 5
    stamps = [event.stamp for event in events]
    assert stamps == sorted(set(stamps))
    assert {event.view.camera.is_pinhole for event in events} == {projection == "central"}
    assert content(bags[0]) == content(bags[1])


def test_simulate_overwrites_nothing(momrec, shop):
    before = content(shop)
    ended = momrec("simulate", MESHES / "stranger.ply", "--output", shop / "bag")
    assert ended.code == 1
    assert content(shop) == before


def test_simulate_refuses_two_objects_of_one_name(momrec, tmp_path):
    copy = shutil.copy(MESHES / "stranger.ply", tmp_path)
    ended = momrec("simulate", copy, MESHES / "stranger.ply", "--output", tmp_path / "bag")
    assert ended.code == 1
    assert "stranger" in ended.err
    assert not (tmp_path / "bag").exists()


# --- train ----------------------------------------------------------------------------------

QUICK = ("--instances", 5, "--views", 5, "--slices", 8, "--max-features", 2)


def test_a_class_is_a_subfolder_or_a_file(momrec, tmp_path):
    folder = tmp_path / "meshes"
    (folder / "bracket").mkdir(parents=True)
    for name in ("l_bracket", "holed_bracket"):
        shutil.copy(MESHES / "ten_objects" / f"{name}.ply", folder / "bracket")
    shutil.copy(MESHES / "ten_objects" / "castle.ply", folder)
    (folder / "notes.txt").write_text("no mesh")
    model = tmp_path / "model.json"
    ended = momrec("train", folder, MESHES / "stranger.ply", "--output", model, *QUICK)
    assert ended.code == 0
    assert load_model(model).classes == ("bracket", "castle", "stranger")
    assert "cross-validated" in ended.out
    before = model.read_bytes()
    assert momrec("train", folder, "--output", model, *QUICK).code == 1
    assert model.read_bytes() == before


def test_training_does_not_depend_on_the_number_of_workers(tmp_path):
    meshes = [MESHES / "ten_objects" / f"{name}.ply" for name in OBJECTS]
    models = []
    for workers in (1, 2):
        model = tmp_path / f"{workers}.json"
        arguments = ["train", *meshes, "--output", model, "--workers", workers, *QUICK]
        arguments += ["--instances", 12]
        subprocess.run([MOMREC, *map(str, arguments)], check=True, capture_output=True)
        models.append(model.read_bytes())
    assert models[0] == models[1]


def test_no_class_is_named_as_what_is_not_known(momrec, tmp_path):
    for name in ("unknown.ply", "two\nlines.ply"):
        shutil.copy(MESHES / "stranger.ply", tmp_path / name)
        ended = momrec("train", tmp_path / name, "--output", tmp_path / "model.json", *QUICK)
        assert ended.code == 1
        assert 'Expected printable names other than "unknown"' in ended.err
        assert ended.err.count("\n") == 1


def test_a_folder_without_meshes_is_an_error(momrec, tmp_path):
    ended = momrec("train", tmp_path, "--output", tmp_path / "model.json")
    assert ended.code == 1
    assert "Expected meshes" in ended.err


def write_rig(path):
    """Write a camera file of eight pinholes without masks."""
    rng = np.random.default_rng(6)
    K = np.array([[220.0, 0, 79.5], [0, 220.0, 59.5], [0, 0, 1]])
    views = []
    for direction in random_directions(8, rng):
        pose = look_at(np.array([0.1, 0.2, 0.3]), direction, 8.0, rng.uniform(0, 6))
        P = K @ np.linalg.inv(pose)[:3]
        views.append({"P": P.tolist(), "width": 160, "height": 120})
    path.write_text(json.dumps({"views": views}))


def test_classes_of_one_shape_are_told_apart_by_size_as_the_rig_would_see_them(momrec, tmp_path):
    meshes, rig, model = tmp_path / "meshes", tmp_path / "rig.json", tmp_path / "model.json"
    meshes.mkdir()
    castle = trimesh.load(MESHES / "ten_objects" / "castle.ply")
    castle.apply_scale(1.0 / castle.extents.max())
    for name, scale in (("small", 1000.0), ("large", 1500.0)):  # millimetres
        castle.copy().apply_scale(scale).export(meshes / f"{name}.stl")
    (meshes / "broken.ply").write_bytes(b"ply\n\xff")
    write_rig(rig)
    arguments = ("train", meshes, "--rig", rig, "--unit", 0.001, "--workers", 1)
    ended = momrec(
        *(*arguments, "--output", model, "--size", "--upright", "--slices", 16),
        *("--instances", 6, "--max-features", 3, "--figures", tmp_path / "figures"),
    )
    assert ended.code == 3, ended.err
    (lost,) = [line for line in ended.err.splitlines() if line.startswith("lost")]
    assert lost.startswith(f"lost: {meshes / 'broken.ply'}: Expected a mesh, got a damaged file")
    known = load_model(model)
    assert known.sized
    assert known.classes == ("large", "small")
    assert "most like" in ended.out
    with Image.open(tmp_path / "figures" / "confusions.png") as image:
        assert image.format == "PNG"
    for label, scale in (("small", 1.0), ("large", 1.5)):
        seen = castle.copy().apply_scale(scale)
        assert known.recognize(seen).ranking[0][0] == label


def test_a_rig_recorded_in_a_bag_and_given_pixels_train_a_model(momrec, shop, tmp_path):
    meshes = [MESHES / "ten_objects" / f"{name}.ply" for name in OBJECTS]
    for number, options in enumerate(
        (["--rig", shop / "bag", "--image-size", "160x120"], ["--image-size", "160x120"])
    ):
        model = tmp_path / f"{number}.json"
        ended = momrec("train", *meshes, "--output", model, *options, "--invariants", *QUICK)
        assert ended.code == 0, ended.err
        assert load_model(model).with_invariants
    ended = momrec("train", *meshes, "--output", tmp_path / "no.json", "--image-size", "160")
    assert ended.code == 1
    assert "as in 640x480" in ended.err


# --- learn ----------------------------------------------------------------------------------

LIKE_SHOP = ("--views", 8, "--slices", 16)
STRANGER = MESHES / "stranger.ply"


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    """Return bags of the stranger, each with it elsewhere, from elsewhere and in another size."""
    folder = tmp_path_factory.mktemp("sessions")
    bags = [folder / str(seed) for seed in range(4)]
    how = {"views": 8, "projection": "orthographic", "distance": 4.0, "noise": 0.0}
    for seed, bag in enumerate(bags):
        run_simulate([STRANGER], bag, seed=seed, **how)
    return bags


def labels(momrec, bag, model):
    ended = momrec("replay", bag, "--model", model, "--json", "--slices", 16)
    return [result["label"] for result in lines(ended.out)]


def test_a_class_learned_from_a_mesh_is_recognised(momrec, shop, sessions, tmp_path):
    mesh, model = tmp_path / "any name.stl", tmp_path / "new" / "model.json"
    trimesh.load(STRANGER).export(mesh)
    assert labels(momrec, sessions[0], shop / "model.json") == ["unknown"]
    ended = momrec(
        *("learn", shop / "model.json", mesh, "--label", "scissors", "--output", model),
        *("--instances", 6, *LIKE_SHOP),
    )
    assert ended.code == 0, ended.err
    assert re.search(r"scissors .* 6 .* 6 .* 6 ", ended.out)
    for name in OBJECTS:
        assert name in ended.out
    assert "warning" not in ended.err
    learned = load_model(model)
    assert learned.classes == (*OBJECTS, "scissors")
    unseen = reconstructed_instances(
        {"scissors": [trimesh.load(STRANGER)]}, instances=10, views=8, slices=16, seed=31
    )
    assert sum(learned.recognize(shape).label == label for label, shape in unseen) >= 9
    assert labels(momrec, sessions[0], model) == ["scissors"]
    assert labels(momrec, shop / "bag", model) == list(OBJECTS)


def test_a_class_learned_from_recorded_sessions_is_recognised(momrec, shop, sessions, tmp_path):
    *bags, unseen = sessions
    (mcap,) = bags[2].glob("*.mcap")
    model = tmp_path / "model.json"
    ended = momrec(
        *("learn", shop / "model.json", bags[0], bags[1], mcap, "--label", "scissors"),
        *("--output", model, "--slices", 16),
    )
    assert ended.code == 0, ended.err
    assert re.search(r"scissors .* 3 .* 3 .* 3 ", ended.out)
    assert labels(momrec, unseen, model) == ["scissors"]
    assert labels(momrec, shop / "bag", model) == list(OBJECTS)


def test_meshes_and_bags_teach_a_class_together(momrec, shop, sessions, tmp_path):
    model = tmp_path / "model.json"
    ended = momrec(
        *("learn", shop / "model.json", STRANGER, sessions[0], "--label", "scissors"),
        *("--output", model, "--instances", 5, *LIKE_SHOP, "--projection", "orthographic"),
    )
    assert ended.code == 0, ended.err
    assert re.search(r"scissors [^0-9]* 6 ", ended.out)
    assert labels(momrec, sessions[1], model) == ["scissors"]


def test_a_class_like_another_is_warned_of(momrec, shop, tmp_path):
    castle = MESHES / "ten_objects" / "castle.ply"
    ended = momrec(
        *("learn", shop / "model.json", castle, "--label", "fort"),
        *("--output", tmp_path / "model.json", "--instances", 5, *LIKE_SHOP),
    )
    assert ended.code == 0
    (warning,) = [line for line in ended.err.splitlines() if line.startswith("warning: ")]
    assert "fort may be confused with castle: 5 of 5 instances" in warning


def test_what_a_damaged_session_loses_is_told_and_the_rest_is_learned(
    momrec, shop, sessions, tmp_path
):
    (mcap,) = sessions[0].glob("*.mcap")
    whole = mcap.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: 3 * len(whole) // 4])
    ended = momrec(
        *("learn", shop / "model.json", cut, sessions[1], "--label", "scissors"),
        *("--output", tmp_path / "model.json", "--slices", 16),
    )
    assert ended.code == 3
    assert "lost: " in ended.err
    assert "too few" in ended.out  # of two instances none can be held back
    assert load_model(tmp_path / "model.json").classes[-1] == "scissors"


@pytest.fixture(scope="module")
def bench(shop, sessions, tmp_path_factory):
    """Return a folder with a model, and what can and cannot be learned from."""
    folder = tmp_path_factory.mktemp("bench")
    shutil.copy(shop / "model.json", folder)
    shutil.copy(STRANGER, folder)
    shutil.copytree(sessions[0], folder / "bag")
    (folder / "folder").mkdir()
    for name in ("notes.txt", "damaged.ply"):
        (folder / name).write_text("no mesh")
    return folder


@pytest.mark.parametrize(
    ("source", "label", "message"),
    [
        ("stranger.ply", "castle", "Expected a label other than those of the model"),
        ("stranger.ply", "unknown", "Expected a printable label"),
        ("stranger.ply", "two\nlines", "Expected a printable label"),
        ("bag", "scissors", "Expected two instances or more of 'scissors', got 1"),
        ("notes.txt", "scissors", "Expected meshes (.ply, .stl, .obj, .off, .glb), rosbag2"),
        ("damaged.ply", "scissors", "Expected a mesh"),
        ("folder", "scissors", "folder"),
    ],
)
def test_what_cannot_be_learned_is_one_line_and_no_model(momrec, bench, source, label, message):
    before = content(bench)
    ended = momrec(
        *("learn", bench / "model.json", bench / source, "--label", label),
        *("--output", bench / "new.json"),
    )
    assert ended.code == 1
    assert ended.out == ""
    assert message in ended.err
    assert ended.err.count("\n") == 1
    assert content(bench) == before


def test_learning_overwrites_nothing(momrec, shop):
    before = content(shop)
    model = shop / "model.json"
    ended = momrec("learn", model, STRANGER, "--label", "scissors", "--output", model)
    assert ended.code == 1
    assert "does not exist yet" in ended.err
    assert content(shop) == before


# --- reconstruct ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Return a folder of masks of a known object with their cameras, and the object."""
    folder = tmp_path_factory.mktemp("photographs") / "object"
    folder.mkdir()
    mesh = trimesh.load(MESHES / "ten_objects" / "l_bracket.ply")
    entries = []
    views = simulate_views(mesh, 8, np.random.default_rng(8), projection="central")
    for number, view in enumerate(views):
        name = f"{number:02d}.png"
        draw_mask(view).save(folder / name)
        world_to_camera = np.linalg.inv(view.camera.pose)[:3]
        entries.append({"mask": name, "P": (view.camera.K @ world_to_camera).tolist()})
    (folder / "cameras.json").write_text(json.dumps({"views": entries}))
    return folder, mesh


def draw_mask(view: View) -> Image.Image:
    x, y = np.meshgrid(np.arange(1024), np.arange(1024))
    shapely.prepare(view.silhouette)
    inside = shapely.contains_xy(view.silhouette, x, y)
    return Image.fromarray(np.where(inside, 255, 0).astype(np.uint8))


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".glb"])
def test_reconstruct_turns_masks_into_a_mesh(momrec, photographs, tmp_path, suffix):
    folder, mesh = photographs
    output = tmp_path / f"mesh{suffix}"
    ended = momrec("reconstruct", folder, "--output", output, "--slices", 32)
    assert ended.code == 0, ended.err
    found = trimesh.load(output, force="mesh")
    assert 0.99 * mesh.volume < found.volume < 1.5 * mesh.volume
    np.testing.assert_allclose(found.bounds, mesh.bounds, atol=0.1 * mesh.scale)


def test_reconstruct_writes_the_same_views_as_a_bag_and_a_picture(momrec, photographs, tmp_path):
    folder, _ = photographs
    output, bag, figures = tmp_path / "mesh.ply", tmp_path / "bag", tmp_path / "figures"
    ended = momrec(
        *("reconstruct", folder, "--output", output, "--slices", 16),
        *("--bag", bag, "--figures", figures),
    )
    assert ended.code == 0, ended.err
    assert sorted(path.name for path in figures.iterdir()) == ["coverage.png", "object.png"]
    assert "% of the silhouettes" in ended.err
    replayed = momrec("replay", bag, "--json", "--slices", 16)
    assert replayed.code == 0
    (result,) = lines(replayed.out)
    assert result["volume"] == pytest.approx(trimesh.load(output).volume, rel=1e-4)
    before = content(tmp_path)
    for options in (["--output", output], ["--output", tmp_path / "new.ply", "--bag", bag]):
        assert momrec("reconstruct", folder, *options).code == 1
    assert content(tmp_path) == before


def test_a_mask_that_cannot_be_used_is_told_and_the_rest_is_used(momrec, photographs, tmp_path):
    folder = tmp_path / "damaged"
    shutil.copytree(photographs[0], folder)
    (folder / "03.png").write_bytes(b"no image")
    ended = momrec("reconstruct", folder, "--output", tmp_path / "mesh.ply", "--slices", 8)
    assert ended.code == 3
    assert "03.png" in ended.err
    assert (tmp_path / "mesh.ply").exists()


def test_a_bad_mask_is_told_by_its_name_and_left_out(momrec, photographs, tmp_path):
    folder = tmp_path / "spoiled"
    shutil.copytree(photographs[0], folder)
    with Image.open(folder / "03.png") as image:
        mask = np.array(image)
    mask[:, : int(np.flatnonzero(mask.any(axis=0)).mean())] = 0
    Image.fromarray(mask).save(folder / "03.png")
    ended = momrec("reconstruct", folder, "--output", tmp_path / "mesh.ply", "--slices", 16)
    assert ended.code == 3
    assert "03.png: it contradicts the other views" in " ".join(ended.err.split())
    assert trimesh.load(tmp_path / "mesh.ply").volume > 0.99 * photographs[1].volume
    options = ("--slices", 16, "--max-bad-views", 0)
    kept = momrec("reconstruct", folder, "--output", tmp_path / "spoiled.ply", *options)
    assert kept.code == 0
    assert trimesh.load(tmp_path / "spoiled.ply").volume < 0.9 * photographs[1].volume


def test_reconstruct_wants_a_mesh_format_that_it_can_write(momrec, photographs, tmp_path):
    ended = momrec("reconstruct", photographs[0], "--output", tmp_path / "mesh.txt")
    assert ended.code == 1
    assert ".ply, .stl, .glb" in ended.err


# --- the whole ------------------------------------------------------------------------------


def test_the_demo_names_the_ten_objects_and_not_the_stranger(momrec, tmp_path):
    with replaced_folder(tmp_path / "demo") as earlier:
        (earlier / "overview.png").write_text("an earlier demo's")
    ended = momrec("demo", "--output", tmp_path / "demo")
    assert ended.code == 0, ended.err
    for path in (MESHES / "ten_objects").iterdir():
        assert ended.out.count(path.stem) == 2
    assert ended.out.count("unknown") == 1
    assert len(list((tmp_path / "demo" / "figures").glob("*.png"))) == 11
    with Image.open(tmp_path / "demo" / "overview.png") as picture:
        assert min(picture.size) > 100
    assert sum(1 for _ in read_bag(tmp_path / "demo" / "results")) == 110


def test_help_and_version_need_no_geometry():
    code = "import sys, momrec_ros.cli; print(*{'numpy', 'trimesh', 'scipy'} & set(sys.modules))"
    imported = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert imported.stdout.strip() == b""
    shown = subprocess.run([MOMREC, "--version"], capture_output=True, check=True, text=True)
    assert shown.stdout.startswith("momrec 0.")


def test_an_interrupt_leaves_nothing_behind_and_no_traceback(tmp_path):
    arguments = ["train", MESHES / "ten_objects", "--output", tmp_path / "model.json"]
    with subprocess.Popen(
        [MOMREC, *map(str, arguments), "--instances", "1000", "--workers", "2"],
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPROFILEIMPORTTIME": "1"},
        start_new_session=True,
    ) as process:
        for line in process.stderr:
            if b"momrec_ros.commands" in line:
                break
        os.killpg(process.pid, signal.SIGINT)
        errors = process.stderr.read()
    # While modules load, the signal itself ends the process, which a shell shows as 130 as well.
    assert process.returncode in {130, -signal.SIGINT}
    assert b"Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_goes_away_is_no_traceback(shop):
    with subprocess.Popen(
        [MOMREC, "replay", shop / "bag", "--json", "--slices", "8"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        process.stdout.close()
        errors = process.stderr.read()
    assert process.returncode == 1
    assert b"Traceback" not in errors
    assert b"Exception ignored" not in errors
