"""Simulated views: checked against closed forms and plain projection."""

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from momrec_core import Camera, DegenerateShapeError, View
from momrec_core.simulation import (
    look_at,
    noisy_view,
    random_directions,
    random_rotation,
    random_similarity,
    simulate_instance,
    simulate_views,
)

PROJECTIONS = ("orthographic", "central")


def bracket():
    return trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[0, 0, 0], [3, 1, 1]]),
            trimesh.creation.box(bounds=[[0, 0, 1], [1, 1, 2]]),
        ]
    )


def test_random_rotations_are_uniform():
    rng = np.random.default_rng(1)
    rotations = np.array([random_rotation(rng) for _ in range(2000)])
    deviations = rotations @ rotations.transpose(0, 2, 1) - np.eye(3)
    assert np.abs(deviations).max() < 1e-12
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-12)
    for entry in rotations.reshape(-1, 9).T:  # Archimedes: a coordinate on the sphere is uniform
        assert stats.kstest(entry, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    angles = np.arccos(np.clip((np.trace(rotations, axis1=1, axis2=2) - 1) / 2, -1, 1))
    haar = stats.kstest(angles, lambda angle: (angle - np.sin(angle)) / np.pi)
    assert haar.pvalue > 1e-3


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_random_similarity_keeps_the_shape_and_leaves_the_mesh_alone(seed):
    mesh = trimesh.creation.box((1, 2, 3))
    before = mesh.vertices.copy()
    moved = random_similarity(mesh, np.random.default_rng(seed))
    scale = (moved.volume / mesh.volume) ** (1 / 3)
    assert 0.5 <= scale <= 2.0
    assert moved.area == pytest.approx(scale**2 * mesh.area)
    np.testing.assert_allclose(moved.edges_unique_length, scale * mesh.edges_unique_length)
    np.testing.assert_array_equal(mesh.vertices, before)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 20))
def test_directions_are_well_spread_from_the_second_on(seed, count):
    directions = random_directions(count, np.random.default_rng(seed))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    cosines = np.abs(directions @ directions.T)[np.triu_indices(count, 1)]
    packed = np.sqrt(8 * np.pi / (np.sqrt(12) * 2 * count))  # angle of the densest packing of axes
    assert np.arccos(cosines.max()) > 0.2 * packed


@given(
    direction=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3),
    roll=st.floats(-7, 7),
)
def test_a_camera_looks_at_its_target(direction, roll):
    direction = np.array(direction) / np.linalg.norm(direction)
    pose = look_at(np.array([1.0, 2.0, 3.0]), direction, 5.0, roll)
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(pose @ [0, 0, 5, 1], [1, 2, 3, 1], atol=1e-12)


def test_the_silhouette_of_a_box_has_the_area_of_cauchys_formula():
    mesh = trimesh.creation.box((1, 2, 3))
    faces = np.array([6.0, 3.0, 2.0])
    for view in simulate_views(mesh, 10, np.random.default_rng(2)):
        expected = faces @ np.abs(view.camera.rotation[:, 2])
        assert view.silhouette.area == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_each_view_shows_the_whole_object_and_nothing_beside_it(projection):
    rng = np.random.default_rng(3)
    instance = simulate_instance(bracket(), 8, rng, projection=projection)
    assert len(instance.views) == 8
    for view in instance.views:
        points, depths = view.camera.project(instance.mesh.vertices)
        assert depths.min() > 0
        size = np.sqrt(view.silhouette.area)
        assert shapely.covers(view.silhouette.buffer(1e-6 * size), shapely.points(points)).all()
        hull = shapely.MultiPoint(points).convex_hull
        assert hull.buffer(1e-6 * size).covers(view.silhouette)


def test_the_object_nearly_fills_the_image_of_a_pinhole():
    views = simulate_views(bracket(), 8, np.random.default_rng(4), projection="central")
    bounds = np.array([view.silhouette.bounds for view in views])
    assert bounds.min() > 0
    assert bounds.max() < 1023
    assert (bounds[:, 2:] - bounds[:, :2]).max() > 600


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), noise=st.sampled_from([0.001, 0.005, 0.02]))
def test_noise_moves_the_contour_by_as_much_as_it_says(seed, noise):
    rng = np.random.default_rng(seed)
    view = simulate_views(bracket(), 1, rng)[0]
    noisy = noisy_view(view, noise, rng)
    assert noisy.camera is view.camera
    low, high = np.reshape(view.silhouette.bounds, (2, 2))
    points = shapely.points(np.concatenate(noisy.rings))
    distances = shapely.distance(view.silhouette.boundary, points)
    sigma = noise * np.linalg.norm(high - low)
    assert distances.max() < 6 * sigma
    assert 0.4 * sigma < np.sqrt(np.mean(distances**2)) < 1.6 * sigma


def test_noise_swallows_slits_and_specks_but_not_the_object():
    body = shapely.box(0.0, 0.0, 1.0, 1.0).difference(shapely.box(0.2, 0.5, 0.8, 0.502))
    view = View(
        Camera.orthographic(np.eye(4)),
        shapely.MultiPolygon([body, shapely.box(1.2, 0.0, 1.202, 0.5)]),
    )
    rng = np.random.default_rng(11)
    for _ in range(50):
        noisy = noisy_view(view, 0.01, rng)
        assert noisy.silhouette.is_valid
        assert noisy.silhouette.area == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("projection", PROJECTIONS)
def test_the_same_seed_gives_the_same_views(projection):
    first, second = (
        simulate_instance(bracket(), 3, np.random.default_rng(5), projection=projection, noise=0.01)
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.mesh.vertices, second.mesh.vertices)
    for one, other in zip(first.views, second.views, strict=True):
        np.testing.assert_array_equal(one.camera.pose, other.camera.pose)
        for ring, same in zip(one.rings, other.rings, strict=True):
            np.testing.assert_array_equal(ring, same)


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.Trimesh(),
        trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False),
        trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False),
    ],
)
def test_a_mesh_without_area_is_refused(mesh):
    with pytest.raises(DegenerateShapeError, match="Expected a mesh"):
        simulate_views(mesh, 2, np.random.default_rng(6))
