"""Folders of synthetic masks: cameras are found again, bad folders are refused with reasons."""

import json

import numpy as np
import pytest
import shapely
from PIL import Image

from momrec_core import reconstruct
from momrec_ros.cameras_json import CamerasError, read_cameras_json
from momrec_ros.mask_coverage import mask_coverage

SIZE = 160, 120  # width, height
K = np.array([[300.0, 4.0, 80.0], [0.0, 280.0, 60.0], [0.0, 0.0, 1.0]])
CENTER = np.array([5.0, -3.0, 2.0])


def ring_of_poses(count=5):
    """Return poses on a circle that look at the centre, world z upwards."""
    poses = []
    for angle in 2 * np.pi * np.arange(count) / count:
        forward = -np.array([np.cos(angle), np.sin(angle), 0.3])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = CENTER - 2.0 * forward
        poses.append(pose)
    return poses


def projection(pose, intrinsics=K):
    return intrinsics @ np.linalg.inv(pose)[:3]


def mask_of_ball(P):
    """Return the pixels near the projection of the ball that all cameras look at."""
    homogeneous = P @ np.append(CENTER, 1.0)
    x, y = homogeneous[:2] / homogeneous[2]
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    return np.hypot(columns - x, rows - y) < 35


def write_folder(folder, projections, change=lambda content: content):
    (folder / "masks").mkdir(parents=True, exist_ok=True)
    views = []
    for number, P in enumerate(projections):
        name = f"masks/{number}.png"
        Image.fromarray(mask_of_ball(P)).save(folder / name)
        views.append({"mask": name, "P": np.asarray(P).tolist(), "width": 160, "height": 120})
    content = json.dumps(change({"views": views}))
    (folder / "cameras.json").write_text(content, encoding="utf-8")
    return folder


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_cameras_are_found_again_whatever_the_scale_and_sign_of_p(tmp_path, mirror):
    rng = np.random.default_rng(3)
    intrinsics = K * [mirror, 1.0, 1.0]
    poses = ring_of_poses()
    factors = rng.uniform(0.01, 100, len(poses)) * rng.choice([-1, 1], len(poses))
    projections = [f * projection(pose, intrinsics) for f, pose in zip(factors, poses, strict=True)]
    found = read_cameras_json(write_folder(tmp_path, projections))
    assert not found.rejected
    for pose, masked in zip(poses, found.views, strict=True):
        camera = masked.view.camera
        np.testing.assert_allclose(camera.pose, pose, atol=1e-9)
        np.testing.assert_allclose(camera.K, intrinsics, rtol=1e-9, atol=1e-6)


def test_a_parallel_projection_gives_silhouettes_in_world_units(tmp_path):
    projections = []
    for pose in ring_of_poses():
        P = np.vstack([120.0 * np.linalg.inv(pose)[:2], [0, 0, 0, 1]])
        P[:2, 3] += 80, 60
        projections.append(-3.0 * P)
    found = read_cameras_json(write_folder(tmp_path, projections))
    for masked in found.views:
        camera = masked.view.camera
        assert not camera.is_pinhole
        disc = shapely.Point(camera.project(CENTER[None])[0][0]).buffer(35 / 120)
        seen = masked.view.silhouette
        assert seen.symmetric_difference(disc).area < 0.02 * disc.area


def test_silhouettes_are_those_of_the_masks(tmp_path):
    projections = [projection(pose) for pose in ring_of_poses()]
    for masked in read_cameras_json(write_folder(tmp_path, projections)).views:
        middle = masked.view.camera.project(CENTER[None])[0][0]
        disc = shapely.Point(middle).buffer(35)
        assert masked.view.silhouette.symmetric_difference(disc).area < 0.02 * disc.area
        assert not masked.touches_border
        assert masked.specks == 0


def empty(path):
    Image.fromarray(np.zeros((120, 160), bool)).save(path)


def cut(path):
    path.write_bytes(path.read_bytes()[:60])


def no_image(path):
    path.write_text("mask")


def of_another_size(path):
    Image.fromarray(np.ones((10, 20), bool)).save(path)


def transparent(path):
    Image.fromarray(np.full((120, 160, 4), 255, np.uint8)).save(path)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (empty, "shows an object, got an empty one"),
        (cut, "got a damaged or unknown one"),
        (no_image, "got a damaged or unknown one"),
        (of_another_size, "160 x 120 pixels, as its view says, got 20 x 10"),
        (transparent, "without transparency, got RGBA"),
    ],
)
def test_a_bad_mask_costs_its_own_view_only(tmp_path, damage, reason):
    folder = write_folder(tmp_path, [projection(pose) for pose in ring_of_poses()])
    damage(folder / "masks/2.png")
    found = read_cameras_json(folder)
    assert [masked.name for masked in found.views] == [f"masks/{n}.png" for n in (0, 1, 3, 4)]
    assert [rejected.name for rejected in found.rejected] == ["masks/2.png"]
    assert reason in found.rejected[0].reason


def test_a_mask_of_too_many_pixels_is_not_even_decoded(tmp_path):
    folder = write_folder(tmp_path, [projection(pose) for pose in ring_of_poses()])
    header = Image.new("1", (20_000, 20_000))
    header.save(folder / "masks/2.png")
    content = json.loads((folder / "cameras.json").read_text())
    del content["views"][2]["width"], content["views"][2]["height"]
    (folder / "cameras.json").write_text(json.dumps(content))
    (rejected,) = read_cameras_json(folder).rejected
    assert "pixels" in rejected.reason


def with_view_2(**fields):
    def change(content):
        content["views"][2].update(fields)
        return content

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda _: [], "Expected 'views' in .*, got None"),
        (lambda _: {"views": {}}, "Expected 'views' in .*, got dict"),
        (lambda _: {"views": []}, "list of 1 to 10000, got 0 of them"),
        (lambda _: {"views": ["masks/0.png"]}, "View 0: expected an object, got 'masks/0.png'"),
        (with_view_2(mask=None), "View 2: expected the path 'mask', got None"),
        (with_view_2(mask="masks/9.png"), "View 2 .*masks/9.png.* a mask file, got none"),
        (with_view_2(mask="masks"), "View 2 .* a mask file, got something else"),
        (with_view_2(mask="../masks/1.png"), "View 2 .* inside the folder, got a path out of it"),
        (with_view_2(mask="/etc/passwd"), "View 2 .* inside the folder, got a path out of it"),
        (with_view_2(mask="m\0.png"), "View 2 .* inside the folder, got a path out of it"),
        (with_view_2(mask="m" * 5000), "View 2 .* a mask file, got none"),
        (with_view_2(P=None), "View 2 .*'P', 3 rows of 4 numbers, got None"),
        (with_view_2(P=[[1, 2, 3]]), r"View 2 .* got shape \(1, 3\)"),
        (with_view_2(P=[["a"] * 4] * 3), "View 2 .* got list"),
        (with_view_2(P=[[10**400] * 4] * 3), "View 2 .* got list"),
        (with_view_2(P=[[float("nan")] * 4] * 3), "View 2 .* finite numbers in 'P'"),
        (with_view_2(P=[[1, 2, 3, 4]] * 3), "View 2 .* left 3 x 3 is regular"),
        (with_view_2(P=[[0] * 4] * 3), "View 2 .* left 3 x 3 is regular"),
        (with_view_2(width="wide"), "View 2 .* 'width' and 'height' in pixels, got 'wide' and 120"),
    ],
)
def test_a_wrong_cameras_json_is_refused_and_the_view_named(tmp_path, change, message):
    folder = write_folder(tmp_path, [projection(pose) for pose in ring_of_poses()], change)
    with pytest.raises(CamerasError, match=message):
        read_cameras_json(folder)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "Expected JSON in"),
        (b"\xff\xfe\xff", "Expected JSON in"),
        (b"[" * 100_000, "nested too deep"),
        (b"1" * 10_000, "Expected JSON in"),
    ],
)
def test_what_is_no_json_is_refused(tmp_path, content, message):
    (tmp_path / "cameras.json").write_bytes(content)
    with pytest.raises(CamerasError, match=message):
        read_cameras_json(tmp_path)


def test_a_folder_without_cameras_json_is_refused(tmp_path):
    with pytest.raises(CamerasError, match=r"Expected a file .*cameras\.json, got none there"):
        read_cameras_json(tmp_path)


def test_a_link_out_of_the_folder_is_not_followed(tmp_path):
    folder = write_folder(tmp_path / "in", [projection(pose) for pose in ring_of_poses()])
    (folder / "masks/2.png").rename(tmp_path / "secret.png")
    (folder / "masks/2.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(CamerasError, match="got a link out of it"):
        read_cameras_json(folder)


def test_a_mask_cut_by_its_image_does_not_cut_the_object(tmp_path):
    """One camera sees only a part of the ball; the hull is that of the others."""
    poses = ring_of_poses(6)
    aside = projection(poses[2], np.array([[300.0, 4.0, 5.0], [0.0, 280.0, 60.0], [0.0, 0.0, 1.0]]))
    whole = [projection(pose) for pose in poses]
    cut = [*whole[:2], aside, *whole[3:]]
    found = read_cameras_json(write_folder(tmp_path / "cut", cut)).views
    assert [view.touches_border for view in found] == [False, False, True, False, False, False]
    clean = read_cameras_json(write_folder(tmp_path / "whole", whole)).views
    others = [view.view for number, view in enumerate(clean) if number != 2]
    mesh = reconstruct([view.view for view in found], 32).mesh()
    assert mesh.volume > 0.9 * reconstruct([view.view for view in clean], 32).mesh().volume
    assert mesh.volume < 1.01 * reconstruct(others, 32).mesh().volume
    for view in found:
        assert mask_coverage(view, mesh).covered > 0.97
