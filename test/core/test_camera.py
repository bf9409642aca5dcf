"""Cameras: poses are checked and made exact, projections agree with homogeneous algebra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from momrec_core import Camera, InvalidCameraError

K = np.array([[500.0, 2.0, 320.0], [0.0, -480.0, 240.0], [0.0, 0.0, 1.0]])


def pose_of(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    pose[:3, 3] = rng.normal(size=3)
    return pose


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_projection_agrees_with_the_projection_matrix(seed):
    pose = pose_of(seed)
    camera = Camera.pinhole(pose, K)
    points = np.random.default_rng(seed).normal(size=(20, 3))
    camera_from_world = np.linalg.inv(pose)[:3]
    homogeneous = np.c_[points, np.ones(20)] @ (K @ camera_from_world).T
    image, depths = camera.project(points)
    np.testing.assert_allclose(depths, homogeneous[:, 2], atol=1e-12)
    np.testing.assert_allclose(image * depths[:, None], homogeneous[:, :2], atol=1e-8)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_a_ray_leads_back_to_its_pixel(seed):
    camera = Camera.pinhole(pose_of(seed), K)
    pixels = np.random.default_rng(seed).uniform(0, 640, (10, 2))
    points_world = camera.rays_camera(pixels) * 3.0 @ camera.rotation.T + camera.position
    image, depths = camera.project(points_world)
    np.testing.assert_allclose(image, pixels, atol=1e-8)
    np.testing.assert_allclose(depths, 3.0, atol=1e-9)


def test_parallel_projection_is_the_optical_frames_x_and_y():
    pose = pose_of(1)
    points = np.random.default_rng(2).normal(size=(20, 3))
    points_camera = np.c_[points, np.ones(20)] @ np.linalg.inv(pose).T
    image, depths = Camera.orthographic(pose).project(points)
    np.testing.assert_allclose(np.c_[image, depths], points_camera[:, :3], atol=1e-12)


def test_a_rotation_within_tolerance_is_made_exact():
    pose = pose_of(3)
    rounded = pose.copy()
    rounded[:3, :3] = rounded[:3, :3].astype(np.float32)
    rotation = Camera.orthographic(rounded).rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(rotation, pose[:3, :3], atol=1e-6)


def broken(change):
    pose = np.eye(4)
    change(pose)
    return pose


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), r"shape \(4, 4\), got shape \(3, 3\)"),
        ("pose", r"shape \(4, 4\)"),
        ([[1.0], [1.0, 2.0]], r"shape \(4, 4\)"),
        (broken(lambda pose: pose.__setitem__((0, 0), np.nan)), "finite pose"),
        (broken(lambda pose: pose.__setitem__((0, 0), 1.001)), "rotation in the pose"),
        (broken(lambda pose: pose.__setitem__((0, 0), -1.0)), "determinant -1"),
        (broken(lambda pose: pose.__setitem__((3, 0), 0.5)), "last row"),
    ],
)
def test_a_pose_that_is_no_rigid_motion_is_refused(pose, message):
    with pytest.raises(InvalidCameraError, match=message):
        Camera.orthographic(pose)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(4), r"shape \(3, 3\), got shape \(4, 4\)"),
        (np.full((3, 3), np.inf), "finite K"),
        (np.ones((3, 3)), "upper triangular"),
        (np.diag([0.0, 1.0, 1.0]), "focal lengths other than zero"),
    ],
)
def test_a_matrix_that_is_no_intrinsic_matrix_is_refused(matrix, message):
    with pytest.raises(InvalidCameraError, match=message):
        Camera.pinhole(np.eye(4), matrix)


def test_parallel_projection_has_no_bundle_of_rays():
    with pytest.raises(InvalidCameraError, match="Expected a pinhole"):
        Camera.orthographic(np.eye(4)).rays_camera([[0.0, 0.0]])


@pytest.mark.parametrize("intrinsics", [None, K])
def test_the_matrix_projects_as_the_camera_does(intrinsics):
    camera = Camera(pose_of(3), intrinsics)
    points = np.random.default_rng(3).normal(size=(20, 3))
    homogeneous = np.column_stack([points, np.ones(20)]) @ camera.matrix.T
    image = homogeneous[:, :2] / homogeneous[:, 2:]
    np.testing.assert_allclose(image, camera.project(points)[0], rtol=1e-9)
