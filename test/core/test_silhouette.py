"""Silhouettes of meshes as they come: open, badly wound, with holes in their data."""

import numpy as np
import pytest
import shapely
import trimesh

from momrec_core import Camera, DegenerateShapeError
from momrec_core.silhouette import silhouette_of_mesh, silhouettes_of_mesh
from momrec_core.simulation import look_at, random_directions, random_rotation


def cameras(count, seed):
    rng = np.random.default_rng(seed)
    K = [[500.0, 0.0, 320.0], [0.0, 480.0, 240.0], [0.0, 0.0, 1.0]]
    for number, direction in enumerate(random_directions(count, rng)):
        pose = look_at(np.zeros(3), direction, 8.0, rng.uniform(0, 6))
        yield Camera.pinhole(pose, K) if number % 2 else Camera.orthographic(pose)


def union_of_faces(mesh, camera):
    points, _ = camera.project(mesh.vertices)
    triangles = shapely.polygons(points[mesh.faces])
    return shapely.union_all(triangles[shapely.area(triangles) > 1e-12])


def assert_the_same(region, expected):
    assert shapely.symmetric_difference(region, expected).area < 1e-6 * expected.area


def open_vase():
    profile = [[0.4, -1.0], [0.9, -0.4], [0.5, 0.5], [0.8, 1.0]]
    return trimesh.creation.revolve(profile, sections=17)


@pytest.mark.parametrize("seed", range(3))
def test_an_open_badly_wound_surface_has_the_silhouette_of_its_faces(seed):
    rng = np.random.default_rng(seed)
    mesh = open_vase()
    faces = mesh.faces[rng.permutation(len(mesh.faces))[: len(mesh.faces) * 3 // 4]]
    flipped = np.where(rng.random((len(faces), 1)) < 0.5, faces, faces[:, ::-1])
    torn = trimesh.Trimesh(mesh.vertices, flipped, process=False)
    for camera in cameras(4, seed):
        assert_the_same(silhouette_of_mesh(torn, camera).silhouette, union_of_faces(torn, camera))


def test_faces_that_share_no_vertices_or_lie_on_each_other_make_no_difference():
    mesh = open_vase()
    soup = trimesh.Trimesh(
        mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False
    )
    twice = trimesh.Trimesh(
        mesh.vertices, np.vstack([mesh.faces, mesh.faces[:, ::-1]]), process=False
    )
    for camera in cameras(4, 5):
        expected = union_of_faces(mesh, camera)
        for other in (soup, twice):
            assert_the_same(silhouette_of_mesh(other, camera).silhouette, expected)


def test_an_edge_of_three_faces_is_no_trouble():
    rng = np.random.default_rng(8)
    turn = random_rotation(rng)
    boxes = [trimesh.creation.box(bounds=[low, np.add(low, 1)]) for low in ([0, 0, 0], [1, 1, 0])]
    joined = trimesh.util.concatenate(boxes)
    joined.merge_vertices()
    joined.vertices = joined.vertices @ turn.T
    for camera in cameras(4, 6):
        region = silhouette_of_mesh(joined, camera).silhouette
        assert_the_same(region, union_of_faces(joined, camera))


def test_stray_vertices_and_faces_that_are_not_finite_do_not_count():
    mesh = open_vase()
    stray = np.vstack([mesh.vertices, [[1e9, 0, 0]], [[np.nan, 0, 0]]])
    count = len(stray)
    faces = np.vstack([mesh.faces, [[0, 1, count - 1]], [[2, 2, 3]]])
    spoilt = trimesh.Trimesh(stray, faces, process=False)
    for camera in cameras(4, 7):
        region = silhouette_of_mesh(spoilt, camera).silhouette
        assert_the_same(region, silhouette_of_mesh(mesh, camera).silhouette)


def test_a_mesh_without_a_finite_face_is_refused():
    nowhere = trimesh.Trimesh(np.full((3, 3), np.nan), [[0, 1, 2]], process=False)
    with pytest.raises(DegenerateShapeError, match="0 faces of finite vertices"):
        silhouette_of_mesh(nowhere, Camera.orthographic(np.eye(4)))


def test_several_cameras_see_what_each_sees_alone():
    mesh = open_vase()
    seen = list(silhouettes_of_mesh(mesh, cameras(5, 9)))
    alone = [silhouette_of_mesh(mesh, camera) for camera in cameras(5, 9)]
    for one, other in zip(seen, alone, strict=True):
        assert one.silhouette.equals(other.silhouette)
        np.testing.assert_array_equal(one.camera.pose, other.camera.pose)


@pytest.mark.parametrize("seed", [430, *range(20)])
def test_a_seam_open_by_rounding_leaves_no_ring_that_crosses_itself(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(8, 40))
    along = np.sort(rng.random(count))
    along[[0, -1]] = 0.0, 1.0
    seam = np.array([0.3, 0.2]) + np.outer(along, rng.uniform(-0.5, 0.5, 2))
    gap = 10.0 ** rng.uniform(-9, -7)
    left, right = (seam + rng.normal(size=(count, 2)) * gap for _ in range(2))
    fans = np.vstack([left, [[-1.0, -1.0]], right, [[1.0, 1.3]]])
    first = np.arange(count - 1)
    faces = np.vstack(
        [
            np.column_stack([start + first, start + first + 1, np.full(count - 1, start + count)])
            for start in (0, count + 1)
        ]
    )
    mesh = trimesh.Trimesh(np.column_stack([fans, np.zeros(len(fans))]), faces, process=False)
    camera = Camera.orthographic(np.eye(4))
    assert_the_same(silhouette_of_mesh(mesh, camera).silhouette, union_of_faces(mesh, camera))
