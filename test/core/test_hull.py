"""Visual hulls: against exact intersections of viewing volumes, in any order, of any camera."""

import copy
import io
import tracemalloc
from itertools import combinations

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold, OpType
from reference import exact_hull, random_solid

from momrec_core import (
    Camera,
    EmptyHullError,
    InvalidContourError,
    NoCommonLineError,
    View,
    VisualHull,
    reconstruct,
    silhouette_of_mesh,
)
from momrec_core.layers import layers_of_sections, match_layers
from momrec_core.regions import Regions
from momrec_core.simulation import random_directions, simulate_views

K = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])


def pose_towards(direction, target=(0.0, 0.0, 0.0), distance=0.0, up=(0.0, 0.0, 1.0)):
    z = np.asarray(direction, dtype=float)
    z /= np.linalg.norm(z)
    up = up if abs(z @ up) < 0.99 else (1.0, 0.0, 0.0)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    pose[:3, 3] = np.asarray(target) - distance * z
    return pose


def ring_of_cameras(mesh, count, height, distance=3.0):
    center, size = mesh.bounds.mean(axis=0), np.ptp(mesh.bounds, axis=0).max()
    angles = 2 * np.pi * np.arange(count) / count
    directions = np.c_[np.cos(angles), np.sin(angles), np.full(count, -height)]
    return [
        silhouette_of_mesh(
            mesh, Camera.pinhole(pose_towards(direction, center, distance * size), K)
        )
        for direction in directions
    ]


def turntable(mesh, count):
    angles = np.pi * np.arange(count) / count
    return [
        silhouette_of_mesh(mesh, Camera.orthographic(pose_towards((np.cos(a), np.sin(a), 0.0))))
        for a in angles
    ]


def volume_of_slices(hull):
    spacing = hull.offsets[1] - hull.offsets[0]
    return spacing * sum(section.area for section in hull.sections)


def compare(hull, views):
    """Return relative errors: volume of the slices, volume and area of the mesh."""
    exact, mesh = exact_hull(views), hull.mesh()
    return np.array(
        [
            volume_of_slices(hull) / exact.volume() - 1,
            mesh.volume / exact.volume() - 1,
            mesh.area / exact.surface_area() - 1,
        ]
    )


def test_slices_and_mesh_agree_with_the_exact_hull_of_parallel_views():
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        views = simulate_views(random_solid(rng), 10, rng)
        errors.append(compare(reconstruct(views, 64), views))
    errors = np.abs(errors)
    assert errors[:, 0].max() < 3e-3
    assert errors[:, 1].max() < 5e-3
    assert np.median(errors[:, 2]) < 5e-3
    assert errors[:, 2].max() < 2e-2


@pytest.mark.parametrize("height", [0.0, 0.3])
def test_a_ring_of_pinholes_agrees_with_the_exact_hull(height):
    errors = []
    for seed in range(6):
        mesh = random_solid(np.random.default_rng(seed))
        views = ring_of_cameras(mesh, 10, height)
        errors.append(compare(reconstruct(views, 64), views))
    errors = np.median(np.abs(errors), axis=0)
    assert errors[0] < 5e-3
    assert errors[1] < 5e-3
    assert errors[2] < 1e-2


def test_a_sphere_of_pinholes_agrees_with_the_exact_hull():
    errors = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        views = simulate_views(random_solid(rng), 10, rng, projection="central")
        errors.append(compare(reconstruct(views, 64), views))
    errors = np.median(np.abs(errors), axis=0)
    assert errors[1] < 5e-3
    assert errors[2] < 1e-2


def test_pinholes_and_parallel_views_mix():
    rng = np.random.default_rng(5)
    mesh = random_solid(rng)
    views = ring_of_cameras(mesh, 5, 0.2)
    views += simulate_views(mesh, 5, rng)
    for order in (views, views[::-1]):
        assert np.abs(compare(reconstruct(order, 64), order)).max() < 1e-2


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=40, deadline=None)
def test_meshes_are_closed_manifold_and_outward(seed, is_central):
    rng = np.random.default_rng(seed)
    mesh = random_solid(rng)
    count, slices = int(rng.integers(2, 21)), int(rng.integers(8, 129))
    if is_central:
        views = ring_of_cameras(mesh, max(count, 3), rng.uniform(0, 1))
    else:
        views = simulate_views(mesh, count, rng)
    surface = reconstruct(views, slices).mesh()
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume > 0


def test_area_hardly_depends_on_the_order_of_the_views():
    spreads = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        views = simulate_views(random_solid(rng), 8, rng)
        orders = [rng.permutation(8) for _ in range(4)]
        areas = [reconstruct([views[k] for k in order], 64).mesh().area for order in orders]
        spreads.append(np.ptp(areas) / np.mean(areas))
    assert np.median(spreads) < 5e-3


def test_the_hull_holds_the_object_after_every_view():
    rng = np.random.default_rng(3)
    mesh = random_solid(rng)
    hull, volume = VisualHull(48), np.inf
    for view in simulate_views(mesh, 8, rng):
        hull.add(view)
        if hull.ready:
            now = hull.mesh().volume
            assert 0.995 * mesh.volume < now < 1.005 * volume
            volume = now


def test_slices_are_perpendicular_to_the_common_line_and_equidistant():
    rng = np.random.default_rng(4)
    views = simulate_views(random_solid(rng), 3, rng)
    hull = reconstruct(views, 20)
    normal = hull.plane_frame[:3, 2]
    assert abs(normal @ views[0].camera.rotation[:, 2]) < 1e-12
    assert abs(normal @ views[1].camera.rotation[:, 2]) < 1e-12
    np.testing.assert_allclose(np.diff(hull.offsets), np.diff(hull.offsets)[0], rtol=1e-12)
    assert len(hull.offsets) == len(hull.sections) == 20


def test_two_views_of_two_intervals_each_meet_in_four_parallelograms():
    spans = shapely.box(0, 0, 1, 1).union(shapely.box(2, 0, 3, 1))
    views = [
        View(Camera.orthographic(pose_towards(direction)), spans)
        for direction in ((1.0, 0.0, 0.0), (0.6, 0.8, 0.0))
    ]
    for section in reconstruct(views, 8).sections:
        assert len(section.geoms) == 4
        np.testing.assert_allclose([piece.area for piece in section.geoms], 1 / 0.8, rtol=1e-9)
        assert all(len(piece.exterior.coords) == 5 for piece in section.geoms)


def test_a_view_along_the_slicing_planes_clips_by_strips():
    cylinder = trimesh.creation.cylinder(radius=1.0, height=1.0, sections=720)
    views = turntable(cylinder, 6)
    hull = reconstruct(views, 32)
    dodecagon = 12 * np.tan(np.pi / 12)
    np.testing.assert_allclose([section.area for section in hull.sections], dodecagon, rtol=1e-4)
    assert np.abs(compare(hull, views)).max() < 5e-3


def test_flat_ends_keep_their_place():
    box = trimesh.creation.box((1.0, 2.0, 0.7))
    mesh = reconstruct(turntable(box, 4), 8).mesh()
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0)[2], 0.7, rtol=1e-3)
    assert mesh.volume == pytest.approx(1.4, rel=1e-3)
    assert mesh.area == pytest.approx(box.area, rel=2e-3)


@pytest.mark.parametrize(
    ("mesh", "euler", "bodies"),
    [
        (trimesh.creation.torus(1.0, 0.4), 0, 1),
        (trimesh.creation.icosphere(3), 2, 1),
        (
            trimesh.util.concatenate(
                [
                    trimesh.creation.icosphere(2),
                    trimesh.creation.icosphere(2).apply_translation((0, 0, 3)),
                ]
            ),
            4,
            2,
        ),
    ],
)
def test_holes_and_pieces_are_those_of_the_object(mesh, euler, bodies):
    directions = random_directions(16, np.random.default_rng(0))
    directions[0] = (1.0, 0.3, 0.1)
    directions[1] = (0.1, 0.2, 1.0)
    views = [
        silhouette_of_mesh(mesh, Camera.orthographic(pose_towards(direction)))
        for direction in directions
    ]
    surface = reconstruct(views, 48).mesh()
    assert surface.euler_number == euler
    assert surface.body_count == bodies


def test_thousands_of_holes_find_their_own_ones_without_trying_all_pairs():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners = np.stack(np.divmod(np.arange(2500), 50), axis=-1)[:, None]
    rings = [152.0 * square - 1, *(3.0 * corners + square[::-1])]
    layers = layers_of_sections([0.0, 1.0], Regions.of_rings([rings, rings]))
    tracemalloc.start()
    slab = match_layers(layers, layers.adjacent)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 150e6  # bytes: all pairs of holes, six million, take several times as much
    rings = np.arange(2501)
    assert (slab.pairs[:, :3] == 0).all()
    assert (slab.pairs[:, 3:5] == rings[:, None]).all()


def test_views_from_the_same_side_wait_and_then_take_part():
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    front, back, side = (
        silhouette_of_mesh(mesh, Camera.orthographic(pose_towards(direction)))
        for direction in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    )
    hull = VisualHull(16)
    for view in (front, front, back):
        hull.add(view)
        assert not hull.ready
        with pytest.raises(NoCommonLineError, match="from the same side"):
            hull.mesh()
    hull.add(side)
    assert hull.ready
    assert len(hull.views) == 4
    assert hull.mesh().volume == pytest.approx(6.0, rel=1e-3)


def test_an_empty_hull_names_the_view_that_emptied_it():
    square = shapely.box(-1, -1, 1, 1)
    far = shapely.box(9, 9, 10, 10)
    directions = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.3)]
    poses = [pose_towards(direction) for direction in directions]
    views = [View(Camera.orthographic(pose), square) for pose in poses]
    for position in range(3):
        bad = [*views]
        bad[position] = View(views[position].camera, far)
        hull = VisualHull(16)
        for view in bad:
            hull.add(view)
        assert hull.emptied_by == max(position, 1)
        with pytest.raises(EmptyHullError, match=f"view {max(position, 1)} "):
            hull.mesh()
        assert all(section.is_empty for section in hull.sections)


def test_a_copy_is_independent_of_its_original():
    rng = np.random.default_rng(6)
    views = simulate_views(random_solid(rng), 4, rng)
    hull = reconstruct(views[:3], 16)
    before = hull.mesh().volume
    trial = copy.copy(hull)
    trial.add(views[3])
    assert len(hull.views) == 3
    assert len(trial.views) == 4
    assert hull.mesh().volume == before


def test_a_hull_thinner_than_the_spacing_is_not_lost():
    directions = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.6, 0.5)]
    tall = shapely.box(-1, -10, 1, 10)
    views = [View(Camera.orthographic(pose_towards(d)), tall) for d in directions[:2]]
    thin = shapely.box(-20, -0.01, 20, 0.01)
    views.append(View(Camera.orthographic(pose_towards((1.0, 1.0, 0.0))), thin))
    mesh = reconstruct(views, 16).mesh()
    assert np.ptp(mesh.bounds, axis=0)[2] == pytest.approx(0.02, rel=1e-2)
    assert mesh.volume == pytest.approx(0.08, rel=1e-2)


@pytest.mark.parametrize("count", [2, 6])
def test_pieces_that_two_planes_would_pass_between_are_not_lost(count):
    plates = shapely.MultiPolygon([shapely.box(-1, z, 1, z + 0.1) for z in (-1.0, -0.05, 0.9)])
    hull = VisualHull(2)
    for angle in np.pi / 2 * np.arange(count):
        direction = (np.cos(angle), np.sin(angle), 0.0)
        hull.add(View(Camera.orthographic(pose_towards(direction)), plates))
    mesh = hull.mesh()
    assert mesh.is_watertight
    assert mesh.body_count == 3
    assert mesh.volume == pytest.approx(1.2, rel=1e-2)
    assert len(hull.sections) == len(hull.offsets)


def test_cameras_level_with_the_object_cut_planes_through_their_centres():
    mesh = trimesh.creation.icosphere(3, radius=0.5)
    views = ring_of_cameras(mesh, 9, 0.0)
    for slices in (31, 32):
        assert np.abs(compare(reconstruct(views, slices), views)).max() < 1e-2


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_size_and_place_do_not_matter(scale):
    mesh = random_solid(np.random.default_rng(7))
    mesh.apply_scale(scale)
    mesh.apply_translation(np.array([3.0, -2.0, 5.0]) * scale)
    views = ring_of_cameras(mesh, 8, 0.4)
    exact = exact_hull([_scaled(view, 1 / scale) for view in views])
    assert reconstruct(views, 48).mesh().volume / scale**3 == pytest.approx(
        exact.volume(), rel=5e-3
    )


def _scaled(view, factor):
    pose = view.camera.pose.copy()
    pose[:3, 3] *= factor
    return View(Camera.pinhole(pose, view.camera.K), view.silhouette)


def test_what_is_no_view_and_too_few_slices_are_refused():
    with pytest.raises(InvalidContourError, match="Expected a View, got int"):
        VisualHull().add(3)
    hull = VisualHull()
    with pytest.raises(InvalidContourError, match="Expected a View, got str"):
        hull.extend([*turntable(trimesh.creation.box(), 2), "view"])
    assert hull.views == []
    for slices in (1, 2.5, "64", None, float("nan")):
        with pytest.raises(ValueError, match="whole number of at least 2 slices, got"):
            VisualHull(slices)


def test_saved_meshes_are_closed_when_they_are_loaded_again():
    """Files hold single precision, and readers merge vertices that fall together."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        mesh = reconstruct(simulate_views(random_solid(rng), 8, rng), 48).mesh()
        for kind in ("stl", "ply"):
            loaded = trimesh.load(io.BytesIO(mesh.export(file_type=kind)), file_type=kind)
            loaded.merge_vertices()
            assert loaded.is_watertight
            assert loaded.volume == pytest.approx(mesh.volume, rel=1e-4)


def test_a_slanted_needle_whose_sections_do_not_overlap_stays_in_one_piece():
    needle = trimesh.creation.box((0.01, 0.01, 2.0))
    needle.apply_transform(trimesh.transformations.rotation_matrix(0.9, (1.0, 0.4, 0.0)))
    directions = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.5, 0.5, 0.7), (-0.3, 0.8, 0.5)]
    views = [
        silhouette_of_mesh(needle, Camera.orthographic(pose_towards(direction)))
        for direction in directions
    ]
    mesh = reconstruct(views, 24).mesh()
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(exact_hull(views).volume(), rel=2e-2)


def test_sheets_that_slide_from_slice_to_slice_keep_their_volume():
    bars = [shapely.box(x, -1, x + 0.16, 1) for x in np.arange(-1.0, 1.0, 0.4)]
    directions = [(0.9, 0.2, 0.4), (-0.3, 0.8, 0.5)]
    views = [
        View(Camera.orthographic(pose_towards(direction)), shapely.union_all(bars))
        for direction in directions
    ]
    mesh = reconstruct(views, 64).mesh()
    assert mesh.volume == pytest.approx(exact_hull(views).volume(), rel=5e-3)


def test_pinholes_too_close_together_wait_for_a_better_pair():
    mesh = trimesh.creation.box((1.0, 0.8, 0.6))
    hull = VisualHull(32)
    for angle in (0.0, 0.02, 0.04):
        hull.add(pinhole_at(mesh, angle))
        assert not hull.ready
    for angle in (1.0, 2.5, 4.0):
        hull.add(pinhole_at(mesh, angle))
    assert hull.ready
    assert np.abs(compare(hull, hull.views)).max() < 1e-2


def pinhole_at(mesh, angle):
    direction = (np.cos(angle), np.sin(angle), -0.2)
    return silhouette_of_mesh(mesh, Camera.pinhole(pose_towards(direction, distance=3.0), K))


def test_contours_of_thousands_of_vertices_are_joined_within_bounded_memory():
    angles = 2 * np.pi * np.arange(2100) / 2100
    radii = 1 + 0.05 * np.sign(np.sin(60 * angles))
    gear = np.c_[np.cos(angles), np.sin(angles)] * radii[:, None]
    side, top = (Camera.orthographic(pose_towards(d)) for d in ((1.0, 0.0, 0.0), (0.0, 0.02, 1.0)))
    views = [View(side, shapely.box(-2, -1, 2, 1)), View.from_rings(top, [gear])]
    front = View(Camera.orthographic(pose_towards((0.0, 1.0, 0.0))), shapely.box(-2, -1, 2, 1))
    hull = reconstruct([views[0], front, views[1]], 3)
    mesh = hull.mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume_of_slices(hull), rel=1e-2)


def turntable_of_pinholes(mesh, count, distance, height):
    """Look with one fixed camera at a turning object; poses in the turntable's frame."""
    size = np.linalg.norm(np.ptp(mesh.bounds, axis=0))
    fixed = pose_towards((1.0, 0.0, -height), distance=distance * size)
    turns = [
        trimesh.transformations.rotation_matrix(-angle, (0.0, 0.0, 1.0))
        for angle in 2 * np.pi * np.arange(count) / count
    ]
    return [silhouette_of_mesh(mesh, Camera.pinhole(turn @ fixed, K)) for turn in turns]


def centred(mesh):
    return mesh.apply_translation(-mesh.bounds.mean(axis=0))


@pytest.mark.parametrize("distance", [2.0, 50.0])
@pytest.mark.parametrize("height", [0.0, 0.4])
def test_one_camera_and_a_turntable_give_the_exact_hull(distance, height):
    for seed in range(3):
        mesh = centred(random_solid(np.random.default_rng(seed)))
        views = turntable_of_pinholes(mesh, 12, distance, height)
        exact = exact_hull(views, 200.0)
        surface = reconstruct(views, 64).mesh()
        assert surface.is_watertight
        assert surface.volume == pytest.approx(exact.volume(), rel=5e-3)
        assert surface.area == pytest.approx(exact.surface_area(), rel=1e-2)


def test_cameras_may_be_inside_the_bounding_sphere():
    long = trimesh.creation.box((2.0, 0.2, 0.3))
    ball = trimesh.creation.icosphere(3, radius=0.2).apply_translation((0.6, 0.0, 0.1))
    mesh = trimesh.boolean.union([long, ball])
    directions = [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (0, 1, 1), (0, -1, 1), (0.3, 1, -1)]
    views = [
        silhouette_of_mesh(mesh, Camera.pinhole(pose_towards(direction, distance=0.8), K))
        for direction in directions
    ]
    for order in (views, views[::-1], views[3:] + views[:3]):
        assert np.abs(compare(reconstruct(order, 64), order)).max() < 5e-3


def test_planes_turn_to_where_few_facets_lean_towards_them():
    """The first two views are beside each other, and so slice a plate almost along its faces."""
    plate = trimesh.creation.box((3.0, 2.5, 0.02))
    plate.apply_transform(trimesh.transformations.rotation_matrix(0.25, (1.0, 0.3, 0.0)))
    directions = [(1.0, 0.1, 0.0), (0.3, 1.0, 0.0), (0.2, 0.4, -1.0), (1.0, 1.0, -0.5)]
    views = [
        silhouette_of_mesh(plate, Camera.pinhole(pose_towards(direction, distance=5.0), K))
        for direction in directions
    ]
    hull = reconstruct(views[:2], 32)
    assert abs(hull.plane_frame[2, 2]) > 0.99
    hull.add(views[2])
    hull.add(views[3])
    assert abs(hull.plane_frame[2, 2]) < 0.5
    assert np.abs(compare(hull, views)).max() < 5e-3


@pytest.mark.parametrize("height", [0.0, 0.6])
def test_the_hull_does_not_depend_on_when_it_was_asked_for(height):
    mesh = random_solid(np.random.default_rng(4))
    views = ring_of_cameras(mesh, 9, height)
    asked = VisualHull(24)
    for view in views:
        asked.add(view)
        if asked.ready:
            asked.mesh()
    once = reconstruct(views, 24)
    assert np.array_equal(asked.plane_frame, once.plane_frame)
    assert np.array_equal(asked.offsets, once.offsets)
    assert np.array_equal(asked.mesh().vertices, once.mesh().vertices)


@given(st.integers(0, 2**32 - 1), st.booleans(), st.integers(0, 2))
@settings(max_examples=25, deadline=None)
def test_views_at_once_give_the_hull_of_one_after_the_other(seed, is_central, wrong):
    rng = np.random.default_rng(seed)
    mesh = random_solid(rng)
    views = ring_of_cameras(mesh, 18, 0.5) if is_central else simulate_views(mesh, 18, rng)
    aside = trimesh.creation.icosphere(radius=0.1 * mesh.scale).apply_translation(mesh.centroid)
    for place, smaller in zip(rng.integers(3, 18, wrong), (1.0, 0.2), strict=False):
        seen = aside.copy().apply_translation(smaller * rng.normal(size=3) * mesh.scale)
        views[place] = silhouette_of_mesh(seen, views[place].camera)
    hull = VisualHull(24)
    for view in views:
        hull.add(view)
    at_once = reconstruct(views, 24)
    assert at_once.views == hull.views
    assert at_once.emptied_by == hull.emptied_by
    if hull.emptied_by is None:
        assert np.array_equal(at_once.offsets, hull.offsets)
        assert at_once.sections == hull.sections


def test_volume_and_area_do_not_depend_on_the_order_of_pinholes():
    for seed in range(2):
        rng = np.random.default_rng(seed)
        views = ring_of_cameras(random_solid(rng), 12, 0.3)
        meshes = [reconstruct([views[k] for k in rng.permutation(12)], 64).mesh() for _ in range(2)]
        assert np.ptp([mesh.volume for mesh in meshes]) < 5e-3 * meshes[0].volume
        assert np.ptp([mesh.area for mesh in meshes]) < 1e-2 * meshes[0].area


def exact_with_spare(views, spare):
    """Return what is in all viewing volumes but some, whichever."""
    kept = combinations(views, len(views) - spare)
    return Manifold.batch_boolean([exact_hull(views) for views in kept], OpType.Add)


@pytest.mark.parametrize("spare", [1, 2])
@pytest.mark.parametrize("projection", ["orthographic", "central"])
def test_silhouettes_to_spare_give_the_union_of_the_hulls_without_them(spare, projection):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        views = simulate_views(random_solid(rng), 5, rng, projection=projection)
        exact = exact_with_spare(views, spare)
        hull = reconstruct(views, 64, spare=spare)
        mesh = hull.mesh()
        assert mesh.is_watertight
        assert volume_of_slices(hull) == pytest.approx(exact.volume(), rel=5e-3)
        assert mesh.volume == pytest.approx(exact.volume(), rel=5e-3)
        assert mesh.area == pytest.approx(exact.surface_area(), rel=2e-2)


@pytest.mark.parametrize("position", [0, 1, 7])
def test_a_wrong_view_takes_nothing_away_where_one_is_spared(position):
    rng = np.random.default_rng(8)
    mesh = random_solid(rng)
    views = simulate_views(mesh, 8, rng)
    far = shapely.affinity.translate(views[position].silhouette, 3.0, 3.0)
    views[position] = View(views[position].camera, far)
    assert reconstruct(views, 32).emptied_by is not None
    without = exact_hull([view for index, view in enumerate(views) if index != position])
    tolerant = reconstruct(views, 64, spare=1)
    assert tolerant.emptied_by is None
    assert tolerant.mesh().volume == pytest.approx(without.volume(), rel=5e-3)


def test_two_wrong_views_empty_a_hull_that_spares_one():
    mesh = trimesh.creation.box((1.0, 0.7, 0.5))
    views = turntable(mesh, 6)
    for index in (1, 4):
        far = shapely.affinity.translate(views[index].silhouette, 0.0, 9.0 + index)
        views[index] = View(views[index].camera, far)
    hull = reconstruct(views, 16, spare=1)
    assert hull.emptied_by == 4
    with pytest.raises(EmptyHullError, match="view 4 "):
        hull.mesh()
    assert reconstruct(views, 16, spare=2).mesh().volume > 0.99 * mesh.volume


def test_a_hull_is_ready_when_views_from_two_sides_are_left_whichever_are_spared():
    mesh = trimesh.creation.box((1.0, 0.7, 0.5))
    sides = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)]
    hull = VisualHull(16, spare=1)
    for ready, direction in zip((False, False, False, True), sides, strict=True):
        hull.add(silhouette_of_mesh(mesh, Camera.orthographic(pose_towards(direction))))
        assert hull.ready == ready
    assert hull.mesh().volume == pytest.approx(mesh.volume, rel=1e-3)
    with pytest.raises(NoCommonLineError, match="from the same side without 3 of them"):
        reconstruct(hull.views, spare=3).mesh()
    assert copy.copy(hull).spare == 1


def test_silhouettes_to_spare_are_a_small_whole_number():
    for spare in (-1, 9, 0.5, "1", None):
        with pytest.raises(ValueError, match="Expected 0 to 8 silhouettes to spare, got"):
            VisualHull(16, spare=spare)
