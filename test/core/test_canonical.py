"""Canonical shapes: invariance, the paper's criteria, and the truth about ambiguous frames."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from momrec_core import CanonicalShape, DegenerateShapeError, normalize, surface_moments

seeds = st.integers(0, 2**32 - 1)


def random_hull(rng: np.random.Generator) -> trimesh.Trimesh:
    return trimesh.convex.convex_hull(rng.normal(size=(14, 3)) * [1.0, 1.6, 2.4])


def random_union(rng: np.random.Generator) -> trimesh.Trimesh:
    """Return four overlapping boxes as one solid, mostly not convex."""
    solid = manifold3d.Manifold()
    for offset in rng.uniform(-1.5, 1.5, (4, 3)):
        solid += manifold3d.Manifold.cube(rng.uniform(0.5, 3.0, 3)).translate(offset)
    mesh = solid.to_mesh()
    return trimesh.Trimesh(mesh.vert_properties, mesh.tri_verts, process=False)


def tube_with_a_ball() -> trimesh.Trimesh:
    """Return an open tube, whose long axis misses it, with a ball at its upper end."""
    ball = trimesh.creation.icosphere(radius=0.6, subdivisions=2)
    ball.apply_translation([1.8, 0.4, 2.0])
    return trimesh.util.concatenate([trimesh.creation.annulus(0.9, 1.0, 6.0), ball])


def heights_on_line(mesh: trimesh.Trimesh, origin: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Intersect a line with each face on its own by solving origin + t axis = a + u b + v c."""
    heights = []
    for a, b, c in mesh.triangles:
        t, u, v = np.linalg.solve(np.column_stack([axis, a - b, a - c]), a - origin)
        if min(u, v, 1.0 - u - v) >= 0:
            heights.append(t)
    return np.array(heights)


def random_similarity(rng: np.random.Generator, scale: float, far: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = scale * Rotation.random(rng=rng).as_matrix()
    matrix[:3, 3] = rng.normal(size=3) * far * scale
    return matrix


def is_pose(pose: np.ndarray) -> bool:
    rotation = pose[:3, :3]
    return bool(
        np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        and np.linalg.det(rotation) > 0
        and (pose[3] == [0, 0, 0, 1]).all()
    )


@pytest.mark.parametrize("make", [random_hull, random_union])
@settings(max_examples=60, deadline=None)
@given(seed=seeds, exponent=st.floats(-6.0, 6.0))
def test_canonical_coordinates_survive_a_similarity(make, seed: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    mesh = make(rng)
    moved = mesh.copy()
    moved.apply_transform(random_similarity(rng, 10.0**exponent, far=100.0))
    before, after = normalize(mesh), normalize(moved)
    np.testing.assert_allclose(after.eigenvalue_gaps, before.eigenvalue_gaps, atol=1e-9)
    np.testing.assert_allclose(after.sign_margins, before.sign_margins, atol=1e-7)
    assert len(after.alternatives) == len(before.alternatives)
    if before.is_unique:
        np.testing.assert_allclose(after.mesh.vertices, before.mesh.vertices, atol=1e-7)
        np.testing.assert_allclose(after.moments, before.moments, rtol=1e-7, atol=1e-5)


def test_the_random_shapes_are_mostly_unique_so_that_the_property_is_tested() -> None:
    rng = np.random.default_rng(1)
    unique = [normalize(make(rng)).is_unique for make in [random_hull, random_union] * 20]
    assert sum(unique) >= 20


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_the_canonical_shape_meets_the_criteria_of_the_paper(seed: int) -> None:
    mesh = random_union(np.random.default_rng(seed))
    shape = normalize(mesh, area=7.0)
    moments = surface_moments(shape.mesh)
    np.testing.assert_allclose(shape.moments, moments, rtol=1e-12, atol=1e-11)
    assert moments[0, 0, 0] == pytest.approx(7.0)  # criterion 3
    first_order = [moments[1, 0, 0], moments[0, 1, 0], moments[0, 0, 1]]
    mixed = [moments[1, 1, 0], moments[1, 0, 1], moments[0, 1, 1]]
    np.testing.assert_allclose([*first_order, *mixed], 0.0, atol=1e-11)  # criteria 1 and 2
    assert moments[0, 0, 2] >= moments[2, 0, 0] >= moments[0, 2, 0]  # v1 along z, v2 x, v3 y


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_frame_matrix_scale_and_mesh_of_a_shape_agree(seed: int) -> None:
    mesh = random_union(np.random.default_rng(seed))
    shape = normalize(mesh)
    assert is_pose(shape.principal_frame)
    np.testing.assert_array_equal(shape.mesh.faces, mesh.faces)
    by_matrix = trimesh.transform_points(mesh.vertices, shape.matrix)
    np.testing.assert_allclose(shape.mesh.vertices, by_matrix, atol=1e-11)
    in_frame = trimesh.transform_points(mesh.vertices, np.linalg.inv(shape.principal_frame))
    np.testing.assert_allclose(shape.mesh.vertices, shape.scale * in_frame, atol=1e-11)
    assert shape.volume == pytest.approx(shape.mesh.volume, rel=1e-11)


def test_eigenvalues_are_those_of_a_hollow_box() -> None:
    a, b, c = 1.0, 2.0, 3.0
    shape = normalize(trimesh.creation.box((a, b, c)))

    def second_moment(length: float, width: float, height: float) -> float:
        caps = 2 * width * height * (length / 2) ** 2
        return caps + 2 * (width + height) * length**3 / 12

    x, y, z = second_moment(a, b, c), second_moment(b, c, a), second_moment(c, a, b)
    np.testing.assert_allclose(shape.eigenvalues, [x + y, x + z, y + z])
    np.testing.assert_allclose(shape.eigenvalue_gaps, np.diff([x + y, x + z, y + z]) / (y + z))


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_v1_and_v2_point_to_the_farther_end_that_ray_casting_finds(seed: int) -> None:
    mesh = random_union(np.random.default_rng(seed))
    shape = normalize(mesh)
    centroid = shape.principal_frame[:3, 3]
    for column, margin in ((2, shape.sign_margins[0]), (0, shape.sign_margins[1])):
        axis = shape.principal_frame[:3, column]
        along = heights_on_line(mesh, centroid, axis)
        ends = [np.max(along, initial=0.0), np.max(-along, initial=0.0)]
        if len(along) == 0:
            assert np.isnan(margin)
        elif max(ends) > 1e-3:
            assert margin == pytest.approx((ends[0] - ends[1]) / max(ends), abs=1e-7)


@pytest.mark.parametrize(
    ("mesh", "count"),
    [
        (trimesh.creation.box(), 47),
        (trimesh.creation.icosphere(subdivisions=3), 23),
        (trimesh.creation.cylinder(1.0, 5.0), 7),
        (trimesh.creation.torus(2.0, 0.5), 7),
        (trimesh.creation.box((1.0, 2.0, 3.0)), 3),
        (trimesh.creation.box((1.0, 1.0, 3.0)), 15),
    ],
    ids=["cube", "sphere", "cylinder", "torus", "brick", "square prism"],
)
def test_a_symmetric_shape_has_a_frame_and_all_its_alternatives(
    mesh: trimesh.Trimesh, count: int
) -> None:
    shape = normalize(mesh)
    assert not shape.is_unique
    frames = [shape.principal_frame, *shape.alternatives]
    assert len(frames) == count + 1
    assert all(is_pose(frame) for frame in frames)
    origins = np.array([frame[:3, 3] for frame in frames])
    assert (origins == origins[0]).all()
    rotations = np.array([frame[:3, :3].ravel() for frame in frames])
    assert (
        np.linalg.norm(rotations[:, None] - rotations, axis=2)[
            ~np.eye(len(frames), dtype=bool)
        ].min()
        > 0.5
    )


def test_a_brick_looks_the_same_in_each_of_its_alternatives() -> None:
    shape = normalize(trimesh.creation.box((1.0, 2.0, 3.0)))
    for frame in shape.alternatives:
        turned = shape.mesh.copy()
        turned.apply_transform(np.linalg.inv(frame) @ shape.principal_frame)
        np.testing.assert_allclose(surface_moments(turned), shape.moments, atol=1e-9)


def test_a_brick_is_normalised_alike_wherever_it_is() -> None:
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    rng = np.random.default_rng(3)
    expected = normalize(mesh).mesh.vertices
    for _ in range(50):
        moved = mesh.copy()
        moved.apply_transform(random_similarity(rng, 0.01, far=10.0))
        np.testing.assert_allclose(normalize(moved).mesh.vertices, expected, atol=1e-9)


def test_an_axis_that_misses_the_surface_takes_its_sign_from_the_third_moment() -> None:
    tube = tube_with_a_ball()
    rng = np.random.default_rng(4)
    for _ in range(20):
        tube.apply_transform(random_similarity(rng, 1.0, far=1.0))
        shape = normalize(tube)
        assert np.isnan(shape.sign_margins[0])
        assert not shape.is_unique
        assert shape.moments[0, 0, 3] > 0


def fan(apex: float, corners: int, offset: float) -> trimesh.Trimesh:
    """Return a double pyramid whose long axis goes through two vertices."""
    angles = np.arange(corners) * 2 * np.pi / corners
    rim = np.column_stack([1.2 * np.cos(angles), np.sin(angles), np.zeros(corners)])
    vertices = np.vstack([rim, [0.0, 0.0, apex], [0.0, 0.0, -offset]])
    ring = np.column_stack([np.arange(corners), np.roll(np.arange(corners), -1)])
    up = np.column_stack([ring, np.full(corners, corners)])
    down = np.column_stack([ring[:, ::-1], np.full(corners, corners + 1)])
    return trimesh.Trimesh(vertices, np.vstack([up, down]), process=False)


@settings(max_examples=60, deadline=None)
@given(seed=seeds)
def test_an_axis_through_a_vertex_is_hit_whatever_the_order_of_faces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = fan(4.0, 6, 3.0)
    expected = normalize(mesh).sign_margins
    assert expected[0] > 0.01
    order = rng.permutation(len(mesh.vertices))
    shuffled = trimesh.Trimesh(
        mesh.vertices[order],
        rng.permuted(np.argsort(order)[mesh.faces][rng.permutation(len(mesh.faces))], axis=1),
        process=False,
    )
    shuffled.apply_transform(random_similarity(rng, 1.0, far=3.0))
    np.testing.assert_allclose(normalize(shuffled).sign_margins, expected, atol=1e-8)


def test_an_axis_along_an_edge_or_within_a_face_is_hit_where_it_enters_and_leaves() -> None:
    square = trimesh.Trimesh(
        [[-1, -2, 0], [1, -2, 0], [1, 2, 0], [-1, 2, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    np.testing.assert_allclose(normalize(square).sign_margins, 0.0, atol=1e-12)
    kite = trimesh.Trimesh(
        [[0, -1, 0], [1, 0.5, 0], [0, 2, 0], [-1, 0.5, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    kite.vertices[2, 1] = 4.0  # the long axis runs along the edge between the two faces
    centroid = kite.triangles_center[0][1]
    expected = ((4.0 - centroid) - (centroid + 1.0)) / (4.0 - centroid)
    assert normalize(kite).sign_margins[0] == pytest.approx(expected, abs=1e-9)


def test_a_centroid_outside_the_solid_leaves_the_frame_invariant() -> None:
    solid = manifold3d.Manifold.cube([4.0, 0.4, 0.7]) + manifold3d.Manifold.cube([0.5, 3.0, 0.5])
    mesh = solid.to_mesh()
    bent = trimesh.Trimesh(mesh.vert_properties, mesh.tri_verts, process=False)
    before = normalize(bent)
    through = heights_on_line(bent, before.principal_frame[:3, 3], np.array([0.6, 0.64, 0.48]))
    assert np.sum(through > 0) % 2 == 0  # an even number of faces ahead: the centroid is outside
    moved = bent.copy()
    moved.apply_transform(random_similarity(np.random.default_rng(5), 3.0, far=2.0))
    after = normalize(moved)
    np.testing.assert_allclose(after.mesh.vertices, before.mesh.vertices, atol=1e-9)


def test_flips_are_admitted_up_to_the_sign_tolerance_only() -> None:
    mesh = fan(4.0, 7, 3.0)
    margins = normalize(mesh).sign_margins
    at_least = normalize(mesh, gap_tolerance=0.0, sign_tolerance=float(margins.min()) - 1e-6)
    above = normalize(mesh, gap_tolerance=0.0, sign_tolerance=float(margins.min()) + 1e-6)
    assert isinstance(above, CanonicalShape)
    assert (at_least.is_unique, len(at_least.alternatives)) == (True, 0)
    assert (above.is_unique, len(above.alternatives)) == (False, 1)


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        (np.full((3, 3), np.nan), "finite vertices"),
        (np.ones((3, 3)), "with an area, got an extent of 0"),
        ([[0, 0, 0], [1, 1, 1], [3, 3, 3]], "with an area"),
        (np.diag([8e307, -8e307, 8e307]), "with an area, got an extent of 8e[+]307"),
        (np.eye(3) * 1e-70, "with an area, got an extent of 1e-70"),
    ],
)
def test_a_shape_without_area_is_refused(vertices: np.ndarray, message: str) -> None:
    with pytest.raises(DegenerateShapeError, match=message):
        normalize(trimesh.Trimesh(vertices, [[0, 1, 2]], process=False))


@pytest.mark.parametrize(
    "wrong",
    [
        {"area": 0.0},
        {"area": np.nan},
        {"area": 1e41},
        {"gap_tolerance": -0.1},
        {"sign_tolerance": 1.0},
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="Expected"):
        normalize(trimesh.creation.box(), **wrong)
