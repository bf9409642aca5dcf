"""What a sensor_msgs/CameraInfo says of a mask's own pixels: intrinsic matrix and lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from momrec_core.camera import Camera
from momrec_core.errors import InvalidCameraError
from momrec_core.lens import Lens
from momrec_ros.errors import MessageError, Reason
from momrec_ros.interfaces import CameraInfo
from momrec_ros.masks import Straighten

__all__ = ["Calibration", "calibration_of"]

COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8}  # further ones must be zero
MOST_COEFFICIENTS = 64  # that are looked at
TOLD_NAME = 80  # characters of a model's name in an error


@dataclass(frozen=True, eq=False)
class Calibration:
    """How a camera's images are to be read.

    Attributes
    ----------
    size : tuple of int
        Width and height of its images, after region of interest and binning.
    K : array, shape (3, 3)
        Intrinsic matrix in pixels of these images, pixel centres at integers.
    lens : Lens
        Its distortion.
    """

    size: tuple[int, int]
    K: NDArray[np.float64]
    lens: Lens

    @property
    def straighten(self) -> Straighten | None:
        """Takes pixels to those without distortion; None where there is none."""
        return None if self.lens.is_trivial else self._straightened

    def _straightened(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        camera = Camera.pinhole(np.eye(4), self.K)
        try:
            rays = self.lens.undistort(camera.rays_camera(pixels)[:, :2])
        except InvalidCameraError as error:
            raise MessageError(Reason.LENS, str(error)) from error
        return camera.project(np.column_stack([rays, np.ones(len(rays))]))[0]


def calibration_of(info: CameraInfo, *, rectified: bool = False) -> Calibration:
    """Read a calibration.

    The message's matrices are for the full resolution. A region of interest moves the pixels'
    origin; of binned pixels the centre is that of the neighbourhood they were made of.

    Parameters
    ----------
    info : CameraInfo
        As it came.
    rectified : bool
        Whether the images are rectified already: P's left 3 x 3 is K then, without distortion.

    Returns
    -------
    calibration : Calibration
        Of the images that come with it.

    Raises
    ------
    MessageError
        If the camera is uncalibrated, its numbers contradict each other, or its distortion is
        none of plumb_bob and rational_polynomial.
    """
    matrix = np.reshape(info.p, (3, 4))[:, :3] if rectified else np.reshape(info.k, (3, 3))
    name = "P" if rectified else "K"
    if not matrix.any():
        raise MessageError(
            Reason.CALIBRATION,
            f"Expected a calibrated camera, got an uncalibrated one: its {name} is all zeros",
        )
    try:
        checked = Camera.pinhole(np.eye(4), matrix).K
    except InvalidCameraError as error:
        raise MessageError(Reason.CALIBRATION, f"{name} of camera_info: {error}") from error
    full_from_own, size = _pixels(info)
    lens = Lens(np.empty(0)) if rectified else _lens(info)
    return Calibration(size, np.linalg.solve(full_from_own, np.asarray(checked)), lens)


def _pixels(info: CameraInfo) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Return the map from an image's pixels to those of full resolution, and the image's size."""
    roi = info.roi
    binning = np.array([info.binning_x or 1, info.binning_y or 1])
    full = np.array([info.width, info.height])
    offset = np.array([roi.x_offset, roi.y_offset])
    region = np.array([roi.width or info.width, roi.height or info.height])
    if (offset + region > full).any():
        raise MessageError(
            Reason.CALIBRATION,
            f"Expected a region of interest inside {info.width} x {info.height} pixels, got {roi}",
        )
    full_from_own = np.eye(3)
    full_from_own[[0, 1], [0, 1]] = binning
    full_from_own[:2, 2] = offset + 0.5 * (binning - 1)
    width, height = (region // binning).tolist()
    return full_from_own, (width, height)


def _lens(info: CameraInfo) -> Lens:
    given = np.array(info.d[:MOST_COEFFICIENTS])
    model = info.distortion_model
    if not (model or np.any(given)):
        return Lens(np.empty(0))
    if model not in COEFFICIENTS:
        raise MessageError(
            Reason.LENS,
            f"Expected the distortion model {' or '.join(COEFFICIENTS)}, got "
            f"{model[:TOLD_NAME]!r}: rectify the masks, or calibrate with one of these",
        )
    used = COEFFICIENTS[model]
    if len(info.d) > MOST_COEFFICIENTS or np.any(given[used:]):
        raise MessageError(
            Reason.LENS,
            f"Expected at most {used} coefficients of {model} other than zero, got "
            f"{given.tolist()}",
        )
    try:
        return Lens(given[:used])
    except InvalidCameraError as error:
        raise MessageError(Reason.LENS, str(error)) from error
