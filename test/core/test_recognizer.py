"""The accumulating pipeline: bounded, refined view by view, unharmed by bad views."""

from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from shapely import Polygon, box

from momrec_core import (
    Camera,
    EmptyHullError,
    MomrecError,
    NoCommonLineError,
    View,
    silhouette_of_mesh,
)
from momrec_core.hull import reconstruct
from momrec_core.model import RecognitionModel
from momrec_core.recognizer import Recognizer
from momrec_core.simulation import random_similarity, simulate_views

SLICES = 16


def box_views(count=6, seed=0, extents=(1.0, 2.0, 3.0)):
    return simulate_views(trimesh.creation.box(extents), count, np.random.default_rng(seed))


def far_view(view):
    """Return the same silhouette as seen by a camera a hundred metres to the right."""
    pose = view.camera.pose.copy()
    pose[:3, 3] += 100 * pose[:3, 0]
    return View(Camera.orthographic(pose), view.silhouette)


def far_half(view):
    """Return the view as one of the half of the box beyond z = 0.4 would be."""
    half = trimesh.creation.box((1.0, 2.0, 1.1)).apply_translation((0.0, 0.0, 0.95))
    return silhouette_of_mesh(half, view.camera)


def filled(views, **options):
    recognizer = Recognizer(slices=SLICES, **options)
    for view in views:
        recognizer.add_view("box", view)
    return recognizer


def test_a_result_is_that_of_the_visual_hull_of_the_views():
    views = box_views()
    result = filled(views).result("box")
    expected = reconstruct(views, SLICES).mesh()
    np.testing.assert_array_equal(result.mesh.vertices, expected.vertices)
    np.testing.assert_array_equal(result.mesh.faces, expected.faces)
    assert (result.object_id, result.views, result.slices) == ("box", 6, SLICES)
    assert result.rejected_views == 0
    assert result.volume == pytest.approx(expected.volume)
    assert result.area == pytest.approx(expected.area)
    assert result.recognition is None
    assert result.canonical.mesh.area == pytest.approx(100.0)


def test_each_view_refines_the_object_and_former_results_stay():
    views = box_views(8)
    recognizer = filled(views[:1])
    results = []
    for view in views[1:]:
        recognizer.add_view("box", view)
        results.append(recognizer.result("box"))
    assert [result.views for result in results] == list(range(2, 9))
    volumes = [result.volume for result in results]
    assert all(later < 1.001 * earlier for earlier, later in pairwise(volumes))
    assert 6.0 < volumes[-1] < 1.25 * 6.0  # the hull holds the box, and little more
    assert [len(result.hull.views) for result in results] == list(range(2, 9))


def test_a_result_is_computed_once_and_anew_after_a_view():
    views = box_views()
    recognizer = filled(views[:-1])
    first = recognizer.result("box")
    assert recognizer.result("box").mesh is first.mesh
    recognizer.add_view("box", views[-1])
    assert recognizer.result("box").mesh is not first.mesh


def test_objects_do_not_touch_each_other():
    shapes = {"flat": (1.0, 2.0, 0.2), "long": (4.0, 1.0, 1.0), "": (1.0, 1.0, 1.0)}
    streams = {
        name: box_views(6, seed, extents) for seed, (name, extents) in enumerate(shapes.items())
    }
    recognizer = Recognizer(slices=SLICES)
    for views in zip(*streams.values(), strict=True):
        for name, view in zip(streams, views, strict=True):
            recognizer.add_view(name, view)
    assert recognizer.objects == tuple(streams)
    for name, views in streams.items():
        alone = reconstruct(views, SLICES).mesh()
        np.testing.assert_array_equal(recognizer.result(name).mesh.vertices, alone.vertices)


@pytest.mark.parametrize("position", range(6))
def test_one_contradicting_view_is_counted_and_costs_nothing_else(position):
    views = box_views()
    stream = [*views]
    stream.insert(position, far_view(views[position]))
    recognizer = Recognizer(slices=SLICES)
    errors = []
    for view in stream:
        try:
            recognizer.add_view("box", view)
        except EmptyHullError as error:
            errors.append(str(error))
    result = recognizer.result("box")
    assert errors
    assert all("leaves nothing" in error for error in errors)
    assert (result.views, result.rejected_views) == (6, 1)
    assert result.volume == pytest.approx(reconstruct(views, SLICES).mesh().volume, rel=0.02)


def eroded(view):
    """Return the view with a silhouette that lost its right half."""
    left, low, right, high = view.silhouette.bounds
    kept = view.silhouette.intersection(box(left, low, (left + right) / 2, high))
    return View(view.camera, kept)


@pytest.mark.parametrize("position", range(8))
def test_a_bad_mask_is_left_out_wherever_it_comes(position):
    views = box_views(8)
    clean = reconstruct([*views[:position], *views[position + 1 :]], SLICES).mesh().volume
    views[position] = eroded(views[position])
    result = filled(views).result("box")
    assert result.left_out == (views[position],)
    assert (result.views, result.rejected_views) == (7, 1)
    assert views[position] not in result.hull.views
    assert result.volume == pytest.approx(clean, rel=1e-3)
    assert result.coverage.shape == (7,)
    assert result.coverage.min() > 0.98


def test_with_none_to_be_left_out_a_bad_mask_stays_and_shows_in_the_coverage():
    views = box_views(8)
    clean = reconstruct(views, SLICES).mesh().volume
    views[2] = eroded(views[2])
    result = filled(views, max_bad_views=0).result("box")
    assert (result.views, result.rejected_views, result.left_out) == (8, 0, ())
    assert result.volume < 0.8 * clean
    assert result.volume == pytest.approx(reconstruct(views, SLICES).mesh().volume)
    assert result.coverage.min() < 0.9


def test_later_views_bring_back_the_one_that_was_left_out():
    """Of five views, four that lost a half outvote the right one; then right ones outvote them."""
    views = box_views(17)
    halves = [far_half(view) for view in views[:4]]
    recognizer = filled([*halves, views[4]])
    early = recognizer.result("box")
    for view in views[5:]:
        with suppress(EmptyHullError):
            recognizer.add_view("box", view)
        last = recognizer.result("box")
    assert early.left_out == (views[4],)
    assert last.left_out == tuple(halves)
    expected = reconstruct(views[4:], SLICES).mesh().volume
    assert last.volume == pytest.approx(expected, rel=1e-2)


def test_a_result_after_every_view_ends_as_one_after_the_last():
    views = box_views(10)
    views[0] = eroded(views[0])
    recognizer = Recognizer(slices=SLICES)
    for number, view in enumerate(views):
        recognizer.add_view("box", view)
        if number:
            recognizer.result("box")
    gradual, final = recognizer.result("box"), filled(views).result("box")
    assert gradual.left_out == final.left_out == (views[0],)
    np.testing.assert_array_equal(gradual.mesh.vertices, final.mesh.vertices)


def test_views_left_out_do_not_pile_up():
    views = box_views(4)
    recognizer = filled(views, max_views=4)
    wrong = [far_view(view) for view in views] * 5
    for view in wrong:
        with pytest.raises(MomrecError):
            recognizer.add_view("box", view)
    result = recognizer.result("box")
    assert len(result.left_out) <= 4
    assert (result.views, result.rejected_views) == (4, 20)


def test_views_too_far_off_to_be_computed_with_give_way_to_the_majority():
    recognizer = Recognizer(slices=SLICES)
    views = box_views()
    for view in views[:2]:
        pose = view.camera.pose.copy()
        pose[:3, 3] += 1e13
        recognizer.add_view("box", View.from_rings(Camera.orthographic(pose), view.rings))
    for view in views[:3]:
        with pytest.raises(EmptyHullError, match=r"far off|leaves nothing"):
            recognizer.add_view("box", view)
    for view in views[3:]:
        recognizer.add_view("box", view)
    expected = filled(views).result("box").volume
    assert recognizer.result("box").volume == pytest.approx(expected, rel=1e-9)


def test_a_view_that_was_rejected_leaves_the_result_as_it_was():
    views = box_views()
    recognizer = filled(views)
    before = recognizer.result("box")
    with pytest.raises(EmptyHullError, match="after 6 views"):
        recognizer.add_view("box", far_view(views[0]))
    after = recognizer.result("box")
    assert after.mesh is before.mesh
    assert (before.rejected_views, after.rejected_views) == (0, 1)


def test_views_that_could_not_be_decoded_are_counted_also_before_the_first_view():
    recognizer = Recognizer(slices=SLICES)
    recognizer.reject("box")
    assert recognizer.objects == ()
    for view in box_views():
        recognizer.add_view("box", view)
    recognizer.reject("box")
    assert recognizer.result("box").rejected_views == 2


def test_rejected_views_of_unseen_objects_evict_nothing():
    recognizer = filled(box_views(), max_objects=2)
    for number in range(1000):
        recognizer.reject(f"unseen {number}")
    assert recognizer.objects == ("box",)
    assert recognizer.result("box").rejected_views == 0


def test_the_object_without_a_view_for_longest_is_evicted_with_its_result():
    views = box_views(5)
    evicted = []
    recognizer = Recognizer(
        slices=SLICES,
        max_objects=2,
        on_evict=lambda object_id: evicted.append(recognizer.result(object_id)),
    )
    for object_id, view in zip("ababa", views, strict=True):
        recognizer.add_view(object_id, view)
    recognizer.add_view("c", views[0])
    assert [(result.object_id, result.views) for result in evicted] == [("b", 2)]
    assert recognizer.objects == ("a", "c")


def test_views_beyond_the_limit_are_rejected():
    views = box_views(6)
    recognizer = filled(views[:4], max_views=4)
    with pytest.raises(MomrecError, match="at most 4 views of object 'box'"):
        recognizer.add_view("box", views[4])
    result = recognizer.result("box")
    assert (result.views, result.rejected_views) == (4, 1)


def test_too_few_views_are_no_result_yet():
    recognizer = filled(box_views(3), min_views=4)
    with pytest.raises(NoCommonLineError, match="at least 4 views of object 'box', got 3"):
        recognizer.result("box")


def test_views_from_one_side_are_no_result_yet():
    view = box_views(1)[0]
    with pytest.raises(NoCommonLineError, match="different viewing directions"):
        filled([view, view]).result("box")


def test_a_forgotten_object_begins_anew():
    views = box_views()
    recognizer = filled(views)
    recognizer.reject("box")
    recognizer.forget("box")
    recognizer.forget("never seen")
    assert recognizer.objects == ()
    with pytest.raises(KeyError, match="box"):
        recognizer.result("box")
    for view in views[:3]:
        recognizer.add_view("box", view)
    assert (recognizer.result("box").views, recognizer.result("box").rejected_views) == (3, 0)


@pytest.mark.parametrize(
    "options",
    [
        {"min_views": 1},
        {"max_objects": 0},
        {"max_views": 1},
        {"slices": 1},
        {"max_bad_views": -1},
    ],
)
def test_numbers_out_of_range_are_refused(options):
    with pytest.raises(ValueError, match="Expected"):
        Recognizer(**options)


def test_a_model_names_the_object():
    rng = np.random.default_rng(7)
    models = {
        "box": trimesh.creation.box((1, 2, 3)),
        "cone": trimesh.creation.cone(1.0, 3.0, sections=5),
        "wedge": trimesh.creation.extrude_polygon(Polygon([(0, 0), (4, 0), (0, 1.5)]), 1.0),
    }
    shapes, labels = [], []
    for label, mesh in models.items():
        for _ in range(4):
            views = simulate_views(random_similarity(mesh, rng), 8, rng)
            shapes.append(reconstruct(views, SLICES).mesh())
            labels.append(label)
    model = RecognitionModel.fit(shapes, labels, max_features=3)
    recognizer = Recognizer(model, slices=SLICES)
    for label, mesh in models.items():
        for view in simulate_views(random_similarity(mesh, rng), 8, rng):
            recognizer.add_view(label, view)
    for label in models:
        recognition = recognizer.result(label).recognition
        assert recognition.ranking[0][0] == label
