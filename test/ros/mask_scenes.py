"""Cameras around an object, and the masks that they see: through a lens, as messages."""

from dataclasses import replace
from functools import cache

import numpy as np
import shapely
import trimesh

from momrec_core import Camera, Lens, silhouette_of_mesh
from momrec_ros.interfaces import (
    CameraInfo,
    Header,
    Image,
    PoseStamped,
    Transform,
    encode_camera_info,
    encode_image,
    encode_pose_stamped,
    encode_transforms,
)
from momrec_ros.mask_messages import camera_info_of, image_of_mask
from momrec_ros.poses import pose_from_matrix

SIZE = 320, 240  # width, height
K = np.array([[420.0, 0.0, 158.0], [0.0, 410.0, 121.0], [0.0, 0.0, 1.0]])
WORLD, FRAME = "map", "camera_optical"
BARREL = (-0.25, 0.08, 0.001, -0.0015, 0.0)


@cache
def solid():
    """Return a body without symmetry, half a metre large."""
    return trimesh.util.concatenate(
        [
            trimesh.creation.box((0.3, 0.16, 0.1)),
            trimesh.creation.box((0.08, 0.12, 0.3)).apply_translation((0.08, 0.02, 0.14)),
        ]
    )


@cache
def cameras(count=6, intrinsics=None, distance=1.3):
    """Return pinholes on a spiral that look at the body."""
    found = []
    for number in range(count):
        angle = 2 * np.pi * number / count
        forward = -np.array([np.cos(angle), np.sin(angle), 0.5 * np.sin(2.3 * angle) + 0.2])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -distance * forward
        found.append(Camera.pinhole(pose, K if intrinsics is None else np.array(intrinsics)))
    return tuple(found)


def rasterised(region, size=SIZE):
    """Return which pixel centres lie in a region."""
    columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    shapely.prepare(region)
    return shapely.contains_xy(region, columns, rows)


def through_lens(region, intrinsics, coefficients):
    """Return how a lens shows a region, by closed form."""
    lens = Lens(coefficients)

    def shown(pixels):
        rays = np.linalg.solve(intrinsics, np.column_stack([pixels, np.ones(len(pixels))]).T)
        moved = lens.distort(rays[:2].T)
        return (np.column_stack([moved, np.ones(len(moved))]) @ intrinsics.T)[:, :2]

    return shapely.transform(shapely.segmentize(region, 1.0), shown)


@cache
def mask(camera, coefficients=(), size=SIZE):
    """Return the pixels that a camera sees of the body."""
    region = silhouette_of_mesh(solid(), camera).silhouette
    return rasterised(through_lens(region, camera.K, coefficients), size)


def image(inside, stamp, **changes):
    return replace(image_of_mask(inside, Header(stamp, FRAME)), **changes)


def camera_info(camera, stamp, coefficients=(), size=SIZE, **changes):
    info = camera_info_of(camera.K, size, Header(stamp, FRAME))
    model = "rational_polynomial" if len(coefficients) > 5 else "plumb_bob"
    return replace(info, distortion_model=model, d=tuple(coefficients), **changes)


def encoded(message):
    encode = {Image: encode_image, CameraInfo: encode_camera_info, PoseStamped: encode_pose_stamped}
    return encode[type(message)](message)


def camera_pose(camera, stamp):
    return PoseStamped(Header(stamp, WORLD), pose_from_matrix(camera.pose))


def view_messages(camera, stamp, coefficients=()):
    """Return a mask, its camera_info and its camera_pose, serialised, by their inputs' names."""
    return {
        "mask": encoded(image(mask(camera, coefficients), stamp)),
        "camera_info": encoded(camera_info(camera, stamp, coefficients)),
        "camera_pose": encoded(camera_pose(camera, stamp)),
    }


def transform(parent, child, stamp, matrix):
    return Transform(Header(stamp, parent), child, pose_from_matrix(np.asarray(matrix)))


def transforms(*given):
    return encode_transforms([transform(*item) for item in given])
