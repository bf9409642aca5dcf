"""Surfaces that touch themselves become edge-manifold, and keep their shape."""

from collections import Counter

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from momrec_core._manifolds import crowded, take
from momrec_core.manifolds import double_shared_edges

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def edge_counts(triangles):
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def test_two_bodies_that_share_an_edge_come_apart():
    points = np.array(
        [[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 1, 0.5], [-1, 0, 0], [-1, -1, 0.5]], dtype=float
    )
    first = TETRAHEDRON.copy()
    second = np.array([0, 1, 4, 5])[TETRAHEDRON]
    for body in (first, second):
        if trimesh.Trimesh(points, body, process=False).volume < 0:
            body[:] = body[:, ::-1]
    both = np.concatenate([first, second])
    assert edge_counts(both).max() == 4
    vertices, triangles = double_shared_edges(points, both)
    assert (edge_counts(triangles) == 2).all()
    surface = trimesh.Trimesh(vertices, triangles, process=False)
    assert surface.is_winding_consistent
    assert surface.body_count == 2
    expected = sum(trimesh.Trimesh(points, body, process=False).volume for body in (first, second))
    assert np.isclose(surface.volume, expected)


def test_a_flap_of_two_triangles_back_to_back_vanishes():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float)
    body = TETRAHEDRON
    flap = np.array([[0, 1, 4], [1, 0, 4]])
    vertices, triangles = double_shared_edges(points, np.concatenate([body, flap]))
    assert len(vertices) == 4
    assert (edge_counts(triangles) == 2).all()


def test_a_manifold_surface_is_left_as_it_is():
    mesh = trimesh.creation.icosphere(1)
    vertices, triangles = double_shared_edges(mesh.vertices, mesh.faces)
    assert vertices is mesh.vertices
    assert triangles is mesh.faces


def random_bodies(rng, count):
    """Return points, and so many outward tetrahedra between them that meet but do not overlap."""
    points = rng.normal(size=(12, 3))
    corners = rng.permutation(Delaunay(points).simplices.astype(np.int64))[:count]
    spans = points[corners[:, 1:]] - points[corners[:, :1]]
    is_inward = np.linalg.det(spans) < 0
    corners[is_inward, :2] = corners[is_inward, 1::-1]
    used, triangles = np.unique(corners[:, TETRAHEDRON], return_inverse=True)
    return points[used], triangles.reshape(-1, 3)


@given(st.integers(0, 2**32 - 1), st.integers(1, 20))
@settings(max_examples=60, deadline=None)
def test_bodies_that_meet_anyhow_become_manifold_and_keep_their_volume(seed, count):
    rng = np.random.default_rng(seed)
    points, triangles = random_bodies(rng, count)
    vertices, surface = double_shared_edges(points, rng.permutation(triangles))
    assert (edge_counts(surface) == 2).all()
    assert np.array_equal(np.unique(surface), np.arange(len(vertices)))
    mesh = trimesh.Trimesh(vertices, surface, process=False)
    assert mesh.is_winding_consistent
    expected = trimesh.Trimesh(points, triangles, process=False).volume
    assert np.isclose(mesh.volume, expected)


@given(st.integers(0, 2**32 - 1), st.integers(1, 20))
@settings(max_examples=60, deadline=None)
def test_crowded_triangles_are_those_whose_edges_count_more_than_two(seed, count):
    rng = np.random.default_rng(seed)
    points, triangles = random_bodies(rng, count)
    sides = [
        [frozenset(side) for side in ((a, b), (b, c), (c, a))] for a, b, c in triangles.tolist()
    ]
    uses = Counter(side for own in sides for side in own)
    expected = [any(uses[side] > 2 for side in own) for own in sides]
    for sound in (0, len(TETRAHEDRON)):  # a body shares no edge with itself
        is_crowded = np.ones(len(triangles), dtype=bool)
        crowded(triangles, is_crowded, sound, len(points))
        assert is_crowded.tolist() == expected


@pytest.mark.parametrize(
    ("place", "value", "error"),
    [
        (0, np.array([[0, 1, 4]]), ValueError),
        (0, np.array([[0, 1, -1]]), ValueError),
        (0, np.array([[0, 1]]), TypeError),
        (1, np.zeros(2, dtype=bool), ValueError),
        (2, 2, ValueError),
        (2, -1, ValueError),
        (3, 2, ValueError),
        (3, "all", TypeError),
    ],
)
def test_triangles_that_do_not_fit_are_refused(place, value, error):
    arguments = [np.array([[0, 1, 2]]), np.zeros(1, dtype=bool), 1, 3]
    crowded(*arguments)
    arguments[place] = value
    with pytest.raises(error):
        crowded(*arguments)
    with pytest.raises(TypeError, match=r"^Expected 2 arrays"):
        crowded(np.array([[0, 1, 2]]), 1, 3)


@given(st.integers(0, 2**32 - 1), st.integers(0, 20))
def test_triangles_that_are_taken_come_with_the_points_they_use(seed, count):
    rng = np.random.default_rng(seed)
    points, triangles = rng.normal(size=(15, 3)), rng.integers(0, 15, (20, 3))
    is_crowded, rows = rng.random(20) < rng.random(), rng.integers(0, 20, count)
    chosen = np.concatenate([triangles[~is_crowded], triangles[rows]])
    taken_points, taken = np.empty((15, 3)), np.empty((len(chosen), 3), dtype=np.int64)
    used = take(triangles, is_crowded, rows, points, taken_points, taken)
    assert np.array_equal(taken_points[:used], points[np.unique(chosen)])
    assert np.array_equal(taken_points[taken], points[chosen])


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (0, np.array([[0, 1, 3]])),
        (0, np.array([[0, -1, 2]])),
        (1, np.array([True, True])),
        (1, np.array([False])),
        (2, np.array([1])),
        (2, np.array([-1])),
        (2, np.array([0, 0])),
        (3, np.zeros((2, 3))),
        (4, np.zeros((2, 3))),
        (5, np.empty((2, 3), dtype=np.int64)),
    ],
)
def test_triangles_that_are_none_are_not_taken(place, value):
    arguments = [
        *(np.array([[0, 1, 2]]), np.array([True]), np.array([0])),
        *(np.zeros((3, 3)), np.empty((3, 3)), np.empty((1, 3), dtype=np.int64)),
    ]
    assert take(*arguments) == 3
    assert arguments[5].tolist() == [[0, 1, 2]]
    arguments[place] = value
    with pytest.raises(ValueError, match=r"^Expected triangles"):
        take(*arguments)
