"""Views that lie: found among views that agree, whatever is wrong with them."""

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from momrec_core import Camera, View, reconstruct
from momrec_core.agreement import contradicting_views
from momrec_core.silhouette import silhouette_of_mesh
from momrec_core.simulation import look_at, noisy_view, simulate_instance, simulate_views

PROJECTIONS = ("orthographic", "central")


def solid():
    """Return a body without symmetry: a long box with an arm and a smaller one across."""
    parts = [
        trimesh.creation.box((1.0, 1.4, 3.0)),
        trimesh.creation.box((2.0, 0.5, 0.6)).apply_translation((1.2, 0.2, 1.0)),
        trimesh.creation.box((0.4, 2.0, 0.5)).apply_translation((0.1, 0.9, -1.0)),
    ]
    return trimesh.boolean.union(parts)


def views_of(count, seed, projection, noise=0.0):
    return list(
        simulate_views(
            solid(), count, np.random.default_rng(seed), projection=projection, noise=noise
        )
    )


def ring_views(count, noise):
    """Return noisy views from a ring of pinholes, a little above the object."""
    rng = np.random.default_rng(count)
    intrinsics = np.array([[2000.0, 0.0, 500.0], [0.0, 2000.0, 500.0], [0.0, 0.0, 1.0]])
    views = []
    for angle in 2 * np.pi * np.arange(count) / count:
        direction = np.array([np.cos(angle), np.sin(angle), 0.3]) / np.sqrt(1.09)
        camera = Camera(look_at(solid().centroid, direction, 12.0, 0.0), intrinsics)
        view = silhouette_of_mesh(solid(), camera)
        views.append(noisy_view(view, noise, rng) if noise > 0 else view)
    return views


def turned(view, degrees, axis, about):
    """Return a view whose camera is turned about an axis of its own through a point."""
    pose = view.camera.pose.copy()
    turn = Rotation.from_rotvec(np.radians(degrees) * view.camera.rotation[:, axis]).as_matrix()
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] = about + turn @ (pose[:3, 3] - about)
    return View(Camera(pose, view.camera.K), view.silhouette)


def resized(view, share):
    """Return a view whose silhouette is eroded or dilated to a share of its area."""
    size = np.sqrt(view.silhouette.area)
    low, high = -size, size
    for _ in range(40):
        middle = (low + high) / 2
        if view.silhouette.buffer(middle).area < share * view.silhouette.area:
            low = middle
        else:
            high = middle
    return View(view.camera, view.silhouette.buffer(high))


def of_another_object(view):
    """Return a view that shows a disk where the object is, as large as the object."""
    region = view.silhouette
    return View(view.camera, region.centroid.buffer(np.sqrt(region.area / np.pi)))


LIES = {
    "turned about the object": lambda view: turned(view, 12.0, 2, solid().centroid),
    "turned about the camera": lambda view: turned(view, 5.0, 0, view.camera.position),
    "eroded by half": lambda view: resized(view, 0.5),
    "twice as large": lambda view: resized(view, 2.0),
    "of another object": of_another_object,
}


@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize(("count", "place"), [(8, 0), (10, 5), (16, 15)])
def test_the_view_that_lies_is_named_wherever_it_comes(projection, lie, count, place):
    views = views_of(count, count + place, projection)
    views[place] = LIES[lie](views[place])
    assert contradicting_views(views, 10) == (place,)


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 1000),
    place=st.integers(0, 9),
    lie=st.sampled_from(["turned about the object", "eroded by half", "of another object"]),
    projection=st.sampled_from(PROJECTIONS),
)
def test_no_view_is_named_but_one_that_lies(seed, place, lie, projection):
    views = views_of(10, seed, projection, noise=0.001)
    assert contradicting_views(views, 10) == ()
    views[place] = LIES[lie](views[place])
    assert contradicting_views(views, 10) in {(place,), ()}


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_the_order_of_the_views_does_not_matter(projection):
    views = views_of(12, 3, projection)
    views[4] = LIES["eroded by half"](views[4])
    for seed in range(4):
        order = np.random.default_rng(seed).permutation(12)
        named = contradicting_views([views[index] for index in order], 10)
        assert [order[index] for index in named] == [4]


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_several_views_that_lie_are_named_together(projection):
    views = views_of(16, 1, projection)
    liars = {2: "turned about the camera", 7: "eroded by half", 11: "of another object"}
    for place, lie in liars.items():
        views[place] = LIES[lie](views[place])
    assert contradicting_views(views, 10) == (2, 7, 11)
    assert contradicting_views(views, 2) != (2, 7, 11)


@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("noise", [0.0, 0.001, 0.003])
@pytest.mark.parametrize("count", [5, 12, 36])
def test_noisy_views_that_agree_are_not_named(projection, noise, count):
    rng = np.random.default_rng(count)
    for mesh in (solid(), trimesh.creation.torus(1.0, 0.3)):
        instance = simulate_instance(mesh, count, rng, projection=projection, noise=noise)
        assert contradicting_views(instance.views, 10) == ()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_a_view_from_nearly_where_it_says_is_named_in_a_dense_ring(axis, noise):
    """Five degrees off where the neighbours are ten away, seen with more noise or less."""
    views = ring_views(36, noise)
    assert contradicting_views(views, 10) == ()
    views[8] = turned(views[8], 5.0, axis, solid().centroid)
    assert contradicting_views(views, 10) == (8,)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_among_three_views_nobody_can_tell(count):
    views = views_of(count, 2, "central")
    views[0] = LIES["eroded by half"](views[0])
    assert contradicting_views(views, 10) == ()


def test_none_is_named_where_none_may_be():
    views = views_of(8, 0, "central")
    views[0] = LIES["eroded by half"](views[0])
    assert contradicting_views(views, 0) == ()


def test_two_views_that_accuse_one_another_are_not_named():
    """Both halves of the views see another object; neither is the majority."""
    one = views_of(4, 5, "orthographic")
    other = [resized(view, 0.5) for view in views_of(4, 6, "orthographic")]
    assert contradicting_views([*one, *other], 10) == ()


def test_opposite_and_equal_views_contradict_nothing():
    """Their rays are points in one another's images."""
    views = views_of(6, 4, "orthographic")
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    opposite = [
        View(
            Camera.orthographic(view.camera.pose @ flip),
            shapely.transform(view.silhouette, lambda points: points * (1.0, -1.0)),
        )
        for view in views
    ]
    assert contradicting_views([*views, *opposite, *views], 10) == ()
    bad = [*views, *opposite, LIES["eroded by half"](views[0])]
    assert contradicting_views(bad, 10) == (12,)


def test_what_is_outside_of_the_image_accuses_nobody():
    """A silhouette that the border cuts goes on beyond it, where it says what is possible."""
    views = views_of(10, 7, "central")
    left, low, right, high = views[3].silhouette.bounds
    middle = (left + right) / 2
    frame = shapely.box(middle, low - 10, right + 10, high + 10)
    opened = shapely.box(left - 300, low - 300, middle, high + 300)
    wide = View(views[3].camera, views[3].silhouette.union(opened), frame)
    views[3] = wide
    assert contradicting_views(views, 10) == ()
    views[3] = View(wide.camera, wide.silhouette)
    assert contradicting_views(views, 10) == (3,)


def test_what_the_liar_took_from_the_hull_is_back_without_it():
    """Without the liar, the hull covers the other silhouettes; with it, it does not."""
    views = views_of(8, 9, "central")
    views[2] = LIES["eroded by half"](views[2])
    (named,) = contradicting_views(views, 10)
    kept = [view for index, view in enumerate(views) if index != named]
    true_volume = reconstruct(views_of(8, 9, "central"), 32).mesh().volume
    assert reconstruct(views, 32).mesh().volume < 0.8 * true_volume
    assert reconstruct(kept, 32).mesh().volume > 0.999 * true_volume
