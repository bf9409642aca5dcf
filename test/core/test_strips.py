"""Samples of the hull's surface: against the facets of the exact hull."""

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold, OpType
from reference import exact_hull, random_solid, to_trimesh

from momrec_core import Camera, View, silhouette_of_mesh
from momrec_core.simulation import look_at, random_directions, simulate_views
from momrec_core.strips import Strips, surface_strips

K = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])


def surface_of(exact):
    """Return an exact hull's facets in place of samples."""
    mesh = to_trimesh(exact)
    return Strips(mesh.face_normals, mesh.area_faces)


def ring_of_views(mesh, count, camera, slope=0.0):
    angles = 2 * np.pi * np.arange(count) / count
    directions = np.c_[np.cos(angles), np.sin(angles), np.full(count, slope)]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return [
        silhouette_of_mesh(mesh, camera(look_at(np.zeros(3), towards, 5.0, 0.3)))
        for towards in directions
    ]


def pinhole(pose):
    return Camera.pinhole(pose, K)


def centred(mesh):
    return mesh.apply_translation(-mesh.bounds.mean(axis=0))


@pytest.mark.parametrize("projection", ["orthographic", "central"])
def test_strips_have_the_area_of_the_exact_hull_and_lean_as_its_facets(projection):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        mesh = centred(random_solid(rng))
        views = simulate_views(mesh, 10, rng, projection=projection)
        strips, exact = surface_strips(views, np.zeros(3)), surface_of(exact_hull(views, 100.0))
        assert strips.areas.sum() == pytest.approx(exact.areas.sum(), rel=0.15)
        directions = random_directions(50, rng)
        np.testing.assert_allclose(strips.leaning(directions), exact.leaning(directions), rtol=0.15)


@pytest.mark.parametrize("camera", [Camera.orthographic, pinhole])
@pytest.mark.parametrize("slope", [0.0, -0.7])
def test_cameras_that_face_each_other_do_not_hide_the_surface(camera, slope):
    box = trimesh.creation.box((1.0, 0.7, 1.3))
    views = ring_of_views(box, 8, camera, slope)
    exact = exact_hull(views).surface_area()
    assert surface_strips(views, np.zeros(3)).areas.sum() == pytest.approx(exact, rel=0.15)


def test_a_view_to_spare_gives_the_surface_of_the_hull_without_it():
    mesh = centred(random_solid(np.random.default_rng(2)))
    views = simulate_views(mesh, 5, np.random.default_rng(3))
    hulls = [exact_hull(views[:left] + views[left + 1 :]) for left in range(5)]
    exact = Manifold.batch_boolean(hulls, OpType.Add).surface_area()
    assert surface_strips(views, np.zeros(3), 1).areas.sum() == pytest.approx(exact, rel=0.15)


def test_silhouettes_in_many_pieces_are_sampled_by_their_largest():
    grid = np.stack(np.meshgrid(np.arange(10.0), np.arange(9.0)), axis=-1).reshape(-1, 1, 2)
    specks = list(500.0 + grid + 0.2 * np.array([[0, 0], [1, 0], [0, 1]]))
    turns = 2 * np.pi * np.arange(3000) / 3000
    disc = 100.0 * np.column_stack([np.cos(turns), np.sin(turns)])
    views = [
        View.from_rings(
            Camera.orthographic(look_at(np.zeros(3), towards, 0.0, 0.0)), [disc, *specks]
        )
        for towards in np.eye(3)
    ]
    exact = 24 * (2 - np.sqrt(2)) * 100.0**2  # three cylinders' common part
    assert surface_strips(views, np.zeros(3)).areas.sum() == pytest.approx(exact, rel=0.05)


def test_leaning_is_the_width_of_the_surface_between_two_planes():
    cylinder = trimesh.creation.cylinder(1.0, 2.0, sections=256)
    strips = Strips(cylinder.face_normals, cylinder.area_faces)
    roof = Strips(np.array([[0.0, 0.6, 0.8]]), np.ones(1))
    up = np.array([[0.0, 0.0, 1.0]])
    assert strips.leaning(up) == pytest.approx(1.0)
    assert roof.leaning(up) == pytest.approx(1 / 0.6)


def test_nothing_leans_where_no_surface_is_found():
    none = Strips(np.empty((0, 3)), np.empty(0))
    assert np.array_equal(none.leaning(np.eye(3)), np.ones(3))
    views = simulate_views(trimesh.creation.box(), 3, np.random.default_rng(0))
    assert len(surface_strips(views, np.zeros(3), 8).areas) == 0
