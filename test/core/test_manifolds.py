"""Surfaces that touch themselves become edge-manifold, and keep their shape."""

import numpy as np
import trimesh

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
