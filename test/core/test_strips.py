"""Samples of the hull's surface: against the facets of the exact hull."""

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold, OpType
from reference import exact_hull, random_solid, to_trimesh

from momrec_core import Camera, View, silhouette_of_mesh
from momrec_core._strips import bound
from momrec_core.rings import ends_of
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


@given(st.integers(0, 2**32 - 1), st.booleans(), st.integers(0, 2))
@settings(max_examples=30, deadline=None)
def test_parts_of_lines_of_sight_are_in_all_other_volumes_but_those_to_spare(seed, central, spare):
    rng = np.random.default_rng(seed)
    projection = "central" if central else "orthographic"
    views = simulate_views(centred(random_solid(rng)), 6, rng, projection=projection)
    rings = [view.outline for view in views]
    points = np.concatenate([outline.points for outline in rings])
    first = ends_of(np.concatenate([outline.counts for outline in rings]))
    outlines = ends_of(np.array([len(outline.counts) for outline in rings]))
    matrices = np.array([view.camera.matrix for view in views])
    origins, directions = rng.normal(0, 0.3, (60, 3)), random_directions(60, rng)
    owners = rng.integers(0, 6, 60)
    lines = (origins, directions, owners)
    rays, ends = bound(points, first, outlines, matrices.reshape(-1, 4), *lines, spare, 1e-6)
    low, high = np.frombuffer(ends).reshape(-1, 2).T
    assert (high >= low).all()
    chosen = np.frombuffer(rays, dtype=np.int64)

    def outside(at):
        """Tell how many of the other volumes points on all lines are outside of."""
        places = origins[chosen] + at[:, None] * directions[chosen]
        held = [
            (owners[chosen] == view)
            | shapely.contains_xy(views[view].silhouette, views[view].camera.project(places)[0])
            for view in range(6)
        ]
        return 6 - np.sum(held, axis=0)

    long = high - low > 1e-6
    assert (outside((low + high) / 2)[long] == spare).all()
    beyond = np.minimum(outside(low - 1e-7), outside(high + 1e-7))
    assert (beyond[long] >= spare - 1).all()
    assert np.mean(outside(high + 1e-7)[long] != spare) > 0.9 or not long.any()


def test_outlines_and_lines_of_sight_that_do_not_agree_are_refused():
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    ends, rays, views = np.array([0, 4]), np.zeros((2, 3)), np.zeros(2, dtype=np.int64)
    good = [square, ends, np.array([0, 1]), np.eye(4)[:3], rays, rays + 1.0, views, 0, 1e-6]
    assert bound(*good) == (b"", b"")
    for place, bad in (
        (1, np.array([0, 5])),
        (1, np.array([1, 4])),
        (2, np.array([0, 2])),
        (2, np.array([], dtype=np.int64)),
        (3, np.eye(4)),
        (4, rays[:1]),
        (5, np.zeros((3, 3))),
    ):
        with pytest.raises(ValueError, match="that agree"):
            bound(*good[:place], bad, *good[place + 1 :])
    with pytest.raises(TypeError, match="kind or shape of views"):
        bound(*good[:6], rays, *good[7:])
    with pytest.raises(TypeError, match="Expected 9 arguments, got 8"):
        bound(*good[:8])


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
