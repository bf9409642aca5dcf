"""Admissible frames: as many as the shape's symmetry leaves open, and they move along with it."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from momrec_core.canonical import normalize
from momrec_core.features import feature_vectors, moment_indices
from momrec_core.frames import turned_moments
from momrec_core.moments import surface_moments

SYMMETRIC = {
    "square prism": trimesh.creation.box((1.0, 1.0, 2.0)),
    "triangular prism": trimesh.creation.cylinder(1.0, 2.0, sections=3),
    "pentagonal prism": trimesh.creation.cylinder(1.0, 2.0, sections=5),
    "square pyramid": trimesh.creation.cone(1.0, 1.5, sections=4),
    "cube": trimesh.creation.box(),
    "tetrahedron": trimesh.Trimesh(
        [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]],
        [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
    ),
}


def turned(mesh: trimesh.Trimesh, seed: int) -> trimesh.Trimesh:
    rotation = Rotation.random(rng=np.random.default_rng(seed))
    return trimesh.Trimesh(rotation.apply(mesh.vertices), mesh.faces, process=False)


@given(seed=st.integers(0, 1000))
def test_moments_along_other_axes_are_those_of_the_turned_mesh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = trimesh.convex.convex_hull(rng.normal(size=(12, 3)))
    frames = Rotation.random(3, rng=rng).as_matrix()
    found = turned_moments(surface_moments(mesh), frames)
    for frame, moments in zip(frames, found, strict=True):
        along = trimesh.Trimesh(mesh.vertices @ frame, mesh.faces, process=False)
        expected = surface_moments(along)
        np.testing.assert_allclose(moments, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("name", SYMMETRIC)
@pytest.mark.parametrize("seed", [1, 2])
def test_degenerate_axes_are_found_again_whatever_the_eigenvectors_are(
    name: str, seed: int
) -> None:
    mesh = SYMMETRIC[name]
    one, other = (
        feature_vectors(normalize(shape), moment_indices())
        for shape in (turned(mesh, 10 * seed), turned(mesh, 10 * seed + 1))
    )
    nearest = np.abs(one[:, None] - other).max(axis=2).min(axis=1)
    # The eigenvectors of a degenerate matrix are anywhere; half of the frames and more are not.
    assert (nearest < 1e-9 * np.abs(one).max()).mean() >= 0.5


def test_a_body_of_revolution_has_no_frames_beyond_those_of_its_eigenvectors() -> None:
    shape = normalize(trimesh.creation.cylinder(1.0, 5.0, sections=64))
    assert len(shape.alternatives) == 7


def test_a_ball_has_no_frames_beyond_those_of_its_eigenvectors() -> None:
    assert len(normalize(trimesh.creation.icosphere(subdivisions=3)).alternatives) == 23
