"""Feature vectors against the moments of meshes that were turned into each admissible frame."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from momrec_core import normalize, surface_moments
from momrec_core.features import (
    INVARIANTS,
    feature_vectors,
    invariants,
    log_size,
    moment_indices,
)

seeds = st.integers(0, 2**32 - 1)


def random_hull(rng: np.random.Generator) -> trimesh.Trimesh:
    points = rng.normal(size=(12, 3)) * rng.uniform(0.3, 3.0, 3)
    return trimesh.convex.convex_hull(points * 10.0 ** rng.uniform(-3, 3) + rng.normal(size=3))


def moments_of_magnitudes(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return the moments of |x|, |y|, |z| by the midpoints of small triangles."""
    for _ in range(3):
        mesh = mesh.subdivide()
    powers = np.abs(mesh.triangles_center)[:, None, :] ** np.array(moment_indices())
    return mesh.area_faces @ powers.prod(axis=2)


@pytest.mark.parametrize(("order", "count"), [(2, 3), (3, 13), (4, 28), (5, 49)])
def test_as_many_moments_tell_shapes_apart_as_the_paper_counts(order: int, count: int) -> None:
    indices = moment_indices(order)
    assert len(set(indices)) == len(indices) == count
    assert indices == moment_indices()[:count]  # by order: higher ones come after lower ones
    assert {sum(index) for index in indices} == set(range(2, order + 1))


@settings(max_examples=15, deadline=None)
@given(seed=seeds, gap_tolerance=st.sampled_from([0.0, 0.9]), area=st.sampled_from([7.0, 100.0]))
def test_features_in_each_admissible_frame_are_the_moments_of_the_mesh_turned_into_it(
    seed: int, gap_tolerance: float, area: float
) -> None:
    mesh = random_hull(np.random.default_rng(seed))
    shape = normalize(mesh, area=area, gap_tolerance=gap_tolerance, sign_tolerance=0.99)
    frames = [shape.principal_frame, *shape.alternatives]
    vectors = feature_vectors(shape, moment_indices())
    assert len(vectors) >= len(frames) >= (4 if gap_tolerance == 0.0 else 24)
    for frame, vector in zip(
        frames, vectors, strict=False
    ):  # frames within wider tolerances follow
        turned = mesh.copy()
        turned.apply_transform(np.linalg.inv(frame))
        turned.apply_scale(np.sqrt(100.0 / mesh.area))
        expected = surface_moments(turned)[tuple(np.transpose(moment_indices()))]
        assert (np.abs(vector - expected) <= 1e-9 * moments_of_magnitudes(turned)).all()


@settings(max_examples=25, deadline=None)
@given(seed=seeds, exponent=st.floats(-6.0, 6.0))
def test_features_are_those_of_a_canonical_area_of_100(seed: int, exponent: float) -> None:
    mesh = random_hull(np.random.default_rng(seed))
    usual, other = normalize(mesh), normalize(mesh, area=10.0**exponent)
    chosen = usual.moments[tuple(np.transpose(moment_indices()))]
    tolerance = 1e-12 * moments_of_magnitudes(usual.mesh)
    assert (np.abs(feature_vectors(usual, moment_indices())[0] - chosen) <= tolerance).all()
    assert (np.abs(feature_vectors(other, moment_indices())[0] - chosen) <= tolerance).all()


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_a_turned_shape_has_the_same_set_of_features(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = trimesh.creation.box(rng.uniform(1.0, 2.0, 2)[[0, 1, 1]])  # square: 8 frames at least
    box.vertices[0] *= rng.uniform(0.9, 0.95)  # no two of its frames see the same
    turned = trimesh.Trimesh(Rotation.random(rng=rng).apply(box.vertices), box.faces)
    before, after = (
        feature_vectors(normalize(mesh, gap_tolerance=0.1, sign_tolerance=0.1), moment_indices())
        for mesh in (box, turned)
    )
    assert len(after) == len(before) >= 8
    apart = np.abs(after[:, None, :] - before[None, :, :]).max(axis=2)
    assert apart.min(axis=0).max() < 1e-6 * np.abs(before).max()
    assert apart.min(axis=1).max() < 1e-6 * np.abs(before).max()


def test_features_are_taken_in_the_order_asked_for() -> None:
    shape = normalize(random_hull(np.random.default_rng(1)))
    indices = [(0, 0, 3), (2, 0, 0), (1, 2, 2)]
    vector = feature_vectors(shape, indices)[0]
    np.testing.assert_allclose(vector, [shape.moments[index] for index in indices], rtol=1e-12)


@settings(max_examples=25, deadline=None)
@given(seed=seeds, scale=st.floats(0.01, 100.0))
def test_invariants_are_the_same_however_a_shape_lies_and_size_is_its_own(
    seed: int, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    mesh = random_hull(rng)
    moved = mesh.copy()
    moved.vertices = scale * Rotation.random(rng=rng).apply(mesh.vertices) + rng.normal(size=3)
    mirrored = trimesh.Trimesh(mesh.vertices * [1, 1, -1], mesh.faces)
    expected = invariants(normalize(mesh))
    assert expected.shape == (INVARIANTS,)
    for other in (normalize(moved), normalize(moved, area=3.0), normalize(mirrored)):
        np.testing.assert_allclose(invariants(other), expected, rtol=1e-6, atol=1e-9)
    grown = log_size(normalize(moved)) - log_size(normalize(mesh))
    assert grown == pytest.approx(np.log(scale), abs=1e-9)
    assert log_size(normalize(mesh)) == pytest.approx(np.log(np.sqrt(mesh.area / 100.0)))


def test_invariants_of_a_sphere_are_those_of_its_closed_form() -> None:
    found = invariants(normalize(trimesh.creation.icosphere(subdivisions=5)))
    # Radius 1: the mean of x^2 is 1/3, of x^4 1/5, of x^2 y^2 1/15; odd powers vanish.
    fourth = np.sqrt(3 * (1 / 5) ** 2 + 18 * (1 / 15) ** 2)
    expected = [-np.log(4 * np.pi), 0, 1 / 27, 0, 0, 1, 0, fourth, 0, 0, 0]
    np.testing.assert_allclose(found, expected, atol=2e-3)
