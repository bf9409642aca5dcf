"""Poses of messages as matrices, and back."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from momrec_ros.errors import MessageError, Reason
from momrec_ros.interfaces import Pose

__all__ = ["MAX_NAME", "matrix_from_pose", "pose_from_matrix"]

NORM_TOLERANCE = 1e-2  # of a quaternion: what publishers that print few digits are off
MAX_NAME = 1000  # characters of an object or frame: outputs repeat both, for every contour


def pose_from_matrix(matrix: NDArray[np.float64]) -> Pose:
    """Return the message form of a rigid motion of shape (4, 4).

    Of the two quaternions it has the one whose first number of w, x, y, z that is not zero is
    positive. Scipy's takes thirty times as long for a single matrix.

    References
    ----------
    Shepperd, S. W. (1978). Quaternion from rotation matrix. Journal of Guidance and Control 1(3).
    """
    (xx, xy, xz, tx), (yx, yy, yz, ty), (zx, zy, zz, tz), _ = matrix.tolist()
    products = (  # 4 q q^T for q = (x, y, z, w): each row is q, times four times one of its numbers
        (1 + xx - yy - zz, xy + yx, xz + zx, zy - yz),
        (xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx),
        (xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy),
        (zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz),
    )
    x, y, z, w = products[max(range(4), key=lambda row: products[row][row])]
    norm = math.copysign(math.hypot(x, y, z, w), next(number for number in (w, x, y, z) if number))
    return Pose((tx, ty, tz), (x / norm, y / norm, z / norm, w / norm))


def matrix_from_pose(pose: Pose) -> NDArray[np.float64]:
    """Return the rigid motion of shape (4, 4) that a message stands for.

    A quaternion whose norm is within 0.01 of 1 is renormalised.

    Raises
    ------
    MessageError
        If a number is not finite, or the quaternion's norm is another.
    """
    numbers = np.array([*pose.position, *pose.orientation])
    if not np.isfinite(numbers).all():
        raise MessageError(Reason.POSE, f"Expected a finite camera pose, got {pose}")
    norm = float(np.linalg.norm(numbers[3:]))
    if abs(norm - 1) > NORM_TOLERANCE:
        raise MessageError(
            Reason.QUATERNION,
            f"Expected a quaternion of norm 1 within {NORM_TOLERANCE}, got {pose.orientation} "
            f"of norm {norm:.6g}",
        )
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(numbers[3:]).as_matrix()
    matrix[:3, 3] = numbers[:3]
    return matrix
