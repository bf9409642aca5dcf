"""A user's own cameras, simulated: from camera files and from recorded bags."""

import json

import numpy as np
import pytest
import shapely
import trimesh

from momrec_core import Camera, InvalidCameraError, MomrecError
from momrec_core.simulation import look_at, random_directions, simulate_views
from momrec_ros.bag_writer import BagWriter
from momrec_ros.cameras_json import CamerasError
from momrec_ros.messages import StampedView
from momrec_ros.rigs import (
    Imager,
    _imager_of,
    fitted_imager,
    image_size,
    placed,
    read_rig,
    views_by,
)

K = np.array([[900.0, 2.0, 330.0], [0.0, 880.0, 230.0], [0.0, 0.0, 1.0]])
SIZE = (640, 480)
TARGET = np.array([0.3, -0.2, 0.5])


def poses(count=6, seed=1):
    rng = np.random.default_rng(seed)
    return [look_at(TARGET, way, 1.2, rng.uniform(0, 6)) for way in random_directions(count, rng)]


def projection(pose, camera_matrix=K):
    return camera_matrix @ np.linalg.inv(pose)[:3]


def write_cameras(folder, matrices, **fields):
    views = [{"P": matrix.tolist(), **fields} for matrix in matrices]
    path = folder / "cameras.json"
    path.write_text(json.dumps({"views": views}))
    return path


def centred(pose):
    """Return K whose image's middle looks at the target."""
    matrix = K.copy()
    matrix[:2, 2] = (np.array(SIZE) - 1) / 2
    return projection(pose, matrix)


def test_a_camera_file_without_masks_tells_cameras_images_and_where_they_look(tmp_path):
    signs = [1.0, -2.0, 0.5, -1.0, 1.0, 3.0]  # P is known up to scale and sign
    matrices = [sign * centred(pose) for sign, pose in zip(signs, poses(), strict=True)]
    path = write_cameras(tmp_path, matrices, width=640, height=480)
    for source in (path, tmp_path):
        rig = read_rig(source)
        np.testing.assert_allclose(rig.target, TARGET, atol=1e-9)
        for imager, pose in zip(rig.imagers, poses(), strict=True):
            assert imager.size == SIZE
            np.testing.assert_allclose(imager.camera.pose, pose, atol=1e-9)


def test_an_image_size_is_for_cameras_that_tell_none(tmp_path):
    path = write_cameras(tmp_path, [projection(pose) for pose in poses()])
    assert {imager.size for imager in read_rig(path).imagers} == {None}
    assert {imager.size for imager in read_rig(path, (320, 200)).imagers} == {(320, 200)}


def test_parallel_cameras_of_a_file_have_pixels(tmp_path):
    pixels = np.array([[400.0, 0.0, 319.5], [0.0, 400.0, 239.5]])
    matrices = [
        np.vstack([pixels @ np.vstack([np.linalg.inv(pose)[:2], [0, 0, 0, 1]]), [0, 0, 0, 1]])
        for pose in poses()
    ]
    rig = read_rig(write_cameras(tmp_path, matrices, width=640, height=480))
    np.testing.assert_allclose(rig.target, TARGET, atol=1e-9)
    ball = trimesh.creation.icosphere(radius=0.2)
    stands = placed(ball, rig.target, np.random.default_rng(0))
    for view in views_by(rig.imagers, stands, np.random.default_rng(0)):
        assert view.silhouette.area == pytest.approx(np.pi * 0.2**2, rel=0.02)


@pytest.mark.parametrize(
    ("views", "message"),
    [
        ([{"P": "none"}], "expected 'P', 3 rows of 4 numbers"),
        ([7], "View 0: expected an object, got 7"),
        ([], "Expected 'views'"),
        ([{"P": projection(poses()[0]).tolist(), "width": -1, "height": 3}], "width"),
    ],
)
def test_a_damaged_camera_file_is_refused(tmp_path, views, message):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"views": views}))
    with pytest.raises(CamerasError, match=message):
        read_rig(path)


def test_cameras_that_look_nowhere_in_common_are_refused(tmp_path):
    with pytest.raises(MomrecError, match="two cameras or more"):
        read_rig(write_cameras(tmp_path, [projection(poses()[0])]))
    aside = np.array(poses()[0])
    aside[:3, 3] += aside[:3, 0]
    with pytest.raises(MomrecError, match="parallel central rays"):
        read_rig(write_cameras(tmp_path, [projection(pose) for pose in (poses()[0], aside)]))


@pytest.mark.parametrize("kind", ["orthographic", "central"])
def test_a_recorded_bag_tells_the_cameras_of_its_first_object(tmp_path, kind):
    rng = np.random.default_rng(2)
    mesh = trimesh.creation.box((0.2, 0.3, 0.4)).apply_translation(TARGET)
    views = simulate_views(mesh, 5, rng, projection=kind)
    others = simulate_views(mesh, 3, rng, projection=kind)
    with BagWriter(tmp_path / "bag") as writer:
        for number, view in enumerate([*views, *others]):
            name = "first" if number < 5 else "second"
            writer.write_view(StampedView(name, 10**9 * (number + 1), "world", view))
    rig = read_rig(tmp_path / "bag", (320, 240))
    assert len(rig.imagers) == 5
    np.testing.assert_allclose(rig.target, TARGET, atol=1e-6)
    for imager, view in zip(rig.imagers, views, strict=True):
        np.testing.assert_allclose(imager.camera.pose, view.camera.pose, atol=1e-9)
        assert imager.camera.is_pinhole == (kind == "central")
    for view in views_by(rig.imagers, mesh, rng):  # the recorded object is in all images
        low, high = np.reshape(view.silhouette.bounds, (2, 2))
        size = fine_size(view.camera, mesh)
        np.testing.assert_allclose(high - low, size, atol=0.03 * max(size))


def test_a_bag_of_masks_tells_the_pixels_of_its_cameras():
    mesh = trimesh.creation.box((0.2, 0.3, 0.4)).apply_translation(TARGET)
    scene = [Imager(Camera.pinhole(pose, K), SIZE) for pose in poses()]
    views = list(views_by(scene, mesh, np.random.default_rng(0)))
    for size, expected in ((None, (661, 461)), (SIZE, SIZE)):
        imagers = [_imager_of(view, size, 1.0) for view in views]
        assert {imager.size for imager in imagers} == {expected}
        again = views_by(imagers, mesh, np.random.default_rng(0))
        for one, other in zip(again, views, strict=True):
            assert one.silhouette.equals(other.silhouette)


def fine_size(camera, mesh):
    points, _ = camera.project(mesh.vertices)
    return np.ptp(points, axis=0)


def test_an_object_stands_where_the_rig_looks_in_its_own_size():
    rng = np.random.default_rng(3)
    mesh = trimesh.creation.box((0.2, 0.3, 0.4))
    mesh.apply_translation([5, 6, 7])
    for upright in (False, True):
        stands = placed(mesh, TARGET, rng, upright=upright)
        np.testing.assert_allclose(stands.bounds.mean(axis=0), TARGET, atol=1e-12)
        assert stands.volume == pytest.approx(mesh.volume)
        assert (np.ptp(stands.vertices[:, 2]) == pytest.approx(0.4)) == upright


@pytest.mark.parametrize("pinhole", [False, True])
def test_a_fitted_image_holds_its_object_and_not_much_more(pinhole):
    rng = np.random.default_rng(4)
    ball = trimesh.creation.icosphere(radius=0.2).apply_translation(TARGET)
    pose = poses()[0]
    camera = Camera.pinhole(pose, K) if pinhole else Camera.orthographic(pose)
    imager = fitted_imager(camera, ball, SIZE)
    (view,) = views_by([imager], ball, rng)
    low, high = np.reshape(shapely.transform(view.silhouette, imager.to_pixels).bounds, (2, 2))
    assert (high - low).max() == pytest.approx(0.9 * 480, abs=12)
    np.testing.assert_allclose((low + high) / 2, [319.5, 239.5], atol=1.5)


def test_views_without_the_object_are_left_out_and_objects_too_large_refused():
    rng = np.random.default_rng(5)
    rig = [Imager(Camera.pinhole(pose, K), SIZE) for pose in poses()]
    away = trimesh.creation.icosphere(radius=0.01).apply_translation(TARGET + np.array([0, 0, 0.6]))
    assert len(list(views_by(rig, away, rng))) < len(rig)
    huge = trimesh.creation.icosphere(radius=2.0).apply_translation(TARGET)
    with pytest.raises(InvalidCameraError, match="before the camera"):
        list(views_by(rig, huge, rng))


@pytest.mark.parametrize("text", ["640", "640x", "0x3", "640 x 480", "99999999x99999999", "axb"])
def test_what_is_no_image_size_is_refused(text):
    with pytest.raises(MomrecError, match="as in 640x480"):
        image_size(text)
    assert image_size("") is None
    assert image_size("640x480") == SIZE


@pytest.mark.parametrize("size", [(10**6, 10**6), (10**30, 10**30), (8001, 8000), (True, True)])
def test_images_of_no_size_or_too_large_are_refused(tmp_path, size):
    path = write_cameras(tmp_path, map(projection, poses()), width=size[0], height=size[1])
    with pytest.raises(CamerasError, match="at most 64000000 pixels"):
        read_rig(path)


def test_a_recorded_principal_point_far_outside_makes_no_huge_images():
    matrix = K.copy()
    matrix[:2, 2] = 1e7
    box = trimesh.creation.box((0.2, 0.2, 0.2)).apply_translation(TARGET)
    (view,) = views_by([Imager(Camera.pinhole(poses()[0], matrix))], box, np.random.default_rng(0))
    with pytest.raises(MomrecError, match="tell the image size"):
        _imager_of(view, None, 1.0)
