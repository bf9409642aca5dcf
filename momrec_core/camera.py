"""Calibrated cameras: where they stand and how they project."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from momrec_core.errors import InvalidCameraError

__all__ = ["Camera", "check_pose"]

ROTATION_TOLERANCE = 1e-6  # design.md: what a pose computed in float32 may be off from a rotation


def check_pose(pose: ArrayLike) -> NDArray[np.float64]:
    """Validate a rigid motion and make its rotation exact.

    Parameters
    ----------
    pose : array-like, shape (4, 4)
        Homogeneous matrix ``[R t; 0 1]``, R a rotation within 1e-6, t in metres.

    Returns
    -------
    pose : array, shape (4, 4)
        The same motion with R replaced by the nearest rotation (orthogonal polar factor).

    Raises
    ------
    InvalidCameraError
        If the matrix has another shape, is not finite, or is no rigid motion.
    """
    checked = _finite_matrix(pose, (4, 4), "pose")
    if np.abs(checked[3] - (0.0, 0.0, 0.0, 1.0)).max() > ROTATION_TOLERANCE:
        raise InvalidCameraError(f"Expected [0, 0, 0, 1] as the pose's last row, got {checked[3]}")
    rotation = checked[:3, :3]
    deviation = np.abs(rotation @ rotation.T - np.eye(3)).max()
    determinant = np.linalg.det(rotation)
    if deviation > 2 * ROTATION_TOLERANCE or determinant < 0:
        raise InvalidCameraError(
            "Expected a rotation in the pose (R R^T = 1 within 1e-6, det R = 1), got one that "
            f"deviates by {deviation:.3g} with determinant {determinant:.6g}"
        )
    left, _, right = np.linalg.svd(rotation)
    checked[:3, :3] = left @ right
    checked[3] = 0.0, 0.0, 0.0, 1.0
    return checked


def _finite_matrix(values: ArrayLike, shape: tuple[int, int], name: str) -> NDArray[np.float64]:
    try:
        matrix = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidCameraError(f"Expected a {name} of shape {shape}, got {values!r}") from error
    if matrix.shape != shape:
        raise InvalidCameraError(f"Expected a {name} of shape {shape}, got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise InvalidCameraError(f"Expected a finite {name}, got NaN or infinity in it")
    return matrix


def _check_intrinsics(K: ArrayLike) -> NDArray[np.float64]:
    matrix = _finite_matrix(K, (3, 3), "K")
    lower = matrix[[1, 2, 2], [0, 0, 1]]
    if np.abs(lower).max() > ROTATION_TOLERANCE * np.abs(matrix).max() or matrix[2, 2] == 0:
        raise InvalidCameraError(f"Expected an upper triangular K with K[2, 2] = 1, got\n{matrix}")
    matrix = np.triu(matrix / matrix[2, 2])
    focal_lengths = np.abs(np.diag(matrix)[:2])
    if focal_lengths.min() < np.finfo(np.float64).eps * np.abs(matrix).max():
        raise InvalidCameraError(
            f"Expected focal lengths other than zero, got {matrix[0, 0]:.6g}, {matrix[1, 1]:.6g}"
        )
    return matrix


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera, made with `Camera.orthographic` or `Camera.pinhole`.

    Attributes
    ----------
    pose : array, shape (4, 4)
        The optical frame in the world, ``world_from_camera``: x right, y down, z forward
        (REP 103); translation in metres.
    K : array, shape (3, 3), or None
        Intrinsic matrix in pixels of a pinhole camera; None for parallel projection, whose
        image coordinates are the optical frame's x and y in metres.
    """

    pose: NDArray[np.float64]
    K: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", check_pose(self.pose))
        if self.K is not None:
            object.__setattr__(self, "K", _check_intrinsics(self.K))

    @classmethod
    def orthographic(cls, pose: ArrayLike) -> Camera:
        """Make a camera of parallel projection along its z axis, as in the paper.

        Parameters
        ----------
        pose : array-like, shape (4, 4)
            The optical frame in the world; a rotation within 1e-6, then made exact.

        Raises
        ------
        InvalidCameraError
            If the pose is no rigid motion.
        """
        return cls(cast("NDArray[np.float64]", pose))

    @classmethod
    def pinhole(cls, pose: ArrayLike, K: ArrayLike) -> Camera:
        """Make a camera of central projection.

        Parameters
        ----------
        pose : array-like, shape (4, 4)
            The optical frame in the world; a rotation within 1e-6, then made exact.
        K : array-like, shape (3, 3)
            Upper triangular intrinsic matrix, in pixels with pixel centres at integers. Skew and
            a mirroring (negative) focal length are allowed. The identity stands for normalised
            image coordinates.

        Raises
        ------
        InvalidCameraError
            If the pose is no rigid motion or K no intrinsic matrix.
        """
        return cls(cast("NDArray[np.float64]", pose), cast("NDArray[np.float64]", K))

    @property
    def is_pinhole(self) -> bool:
        """Whether the projection is central."""
        return self.K is not None

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Axes of the optical frame as columns, in the world; shape (3, 3)."""
        return self.pose[:3, :3]

    @property
    def position(self) -> NDArray[np.float64]:
        """Origin of the optical frame in the world, metres; shape (3,)."""
        return self.pose[:3, 3]

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """The projection of homogeneous points of the world to homogeneous image coordinates.

        Shape (3, 4), not to be written to. For parallel projection the last row is
        ``[0, 0, 0, 1]``.
        """
        matrix = np.column_stack([self.rotation.T, -self.rotation.T @ self.position])
        if self.K is None:
            matrix[2] = 0.0, 0.0, 0.0, 1.0
        else:
            matrix = self.K @ matrix
        matrix.flags.writeable = False
        return matrix

    def project(self, points_world: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project points into the image.

        Parameters
        ----------
        points_world : array-like, shape (n, 3)
            Points in the world, metres.

        Returns
        -------
        points_image : array, shape (n, 2)
            Metres for parallel projection, pixels for central projection; not finite where a
            pinhole's depth is zero.
        depths : array, shape (n,)
            Distance along the optical axis, metres; negative behind the camera.
        """
        points_camera = (np.asarray(points_world, dtype=np.float64) - self.position) @ self.rotation
        depths = points_camera[:, 2]
        if self.K is None:
            return points_camera[:, :2], depths
        with np.errstate(divide="ignore", invalid="ignore"):
            homogeneous = points_camera @ self.K.T
            return homogeneous[:, :2] / depths[:, None], depths

    def rays_camera(self, points_image: ArrayLike) -> NDArray[np.float64]:
        """Return the points of the plane z = 1 of the optical frame behind image points.

        Parameters
        ----------
        points_image : array-like, shape (n, 2)
            Pixels of a pinhole camera.

        Returns
        -------
        rays : array, shape (n, 3)
            In the optical frame, third component 1.

        Raises
        ------
        InvalidCameraError
            If the projection is parallel, which has no bundle of rays.
        """
        if self.K is None:
            raise InvalidCameraError("Expected a pinhole camera, got one of parallel projection")
        points = np.asarray(points_image, dtype=np.float64)
        homogeneous = np.column_stack([points, np.ones(len(points))])
        rays = np.linalg.solve(self.K, homogeneous.T).T
        rays[:, 2] = 1.0
        return np.asarray(rays)
