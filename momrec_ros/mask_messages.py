"""Masks as messages: sensor_msgs/Image read, kept small while they wait, and made views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from momrec_core.camera import Camera
from momrec_core.view import View
from momrec_ros.calibration import Calibration
from momrec_ros.errors import MessageError, Reason
from momrec_ros.interfaces import CameraInfo, Header, Image
from momrec_ros.masks import (
    MAX_PIXELS,
    MaskContours,
    contours_of_mask,
    hull_silhouette,
    object_pixels,
)

__all__ = ["MaskRules", "PackedMask", "camera_info_of", "image_of_mask", "view_of_mask"]

ENCODINGS = ("mono8", "8UC1")
OBJECT = 255  # in masks that are written
FRAME_STEP = 16.0  # pixels between points of the image's border where a lens bends it


@dataclass(frozen=True)
class MaskRules:
    """How masks become silhouettes; the fields are the parameters of the same names.

    Attributes
    ----------
    tolerance, margin : float
        Pixels, as for `contours_of_mask` and `hull_silhouette`.
    rectified : bool
        Whether masks are of rectified images, as for `calibration_of`.
    """

    tolerance: float = 0.5
    margin: float = 0.25
    rectified: bool = False


@dataclass(frozen=True, eq=False)
class PackedMask:
    """A mask of one bit a pixel.

    Attributes
    ----------
    header : Header
        Time of exposure, and the camera's optical frame.
    size : tuple of int
        Width and height.
    bits : array, shape (height, width / 8 rounded up)
        As of `numpy.packbits`.
    """

    header: Header
    size: tuple[int, int]
    bits: NDArray[np.uint8]

    @classmethod
    def of_image(cls, image: Image) -> PackedMask:
        """Read an image.

        Parameters
        ----------
        image : Image
            Of encoding mono8 or 8UC1; rows may be padded.

        Raises
        ------
        MessageError
            If it is of another encoding, too large, its sizes contradict each other, or its
            values, as of labels, are neither object nor background.
        """
        if image.encoding not in ENCODINGS:
            raise MessageError(
                Reason.IMAGE,
                f"Expected a mask of encoding {' or '.join(ENCODINGS)}, got {image.encoding!r:.80}",
            )
        if image.width * image.height > MAX_PIXELS:
            raise MessageError(
                Reason.SIZE,
                f"Expected at most {MAX_PIXELS} pixels, got {image.width} x {image.height}",
            )
        if not 0 < image.width <= image.step or image.height * image.step != len(image.data):
            raise MessageError(
                Reason.IMAGE,
                f"Expected an image whose step is its width or more and whose data are height "
                f"times step, got {image.width} x {image.height} pixels, a step of {image.step} "
                f"and {len(image.data)} bytes",
            )
        rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)
        values = rows[:, : image.width]
        inside = object_pixels(values)
        if values.any() and not inside.any():
            raise MessageError(
                Reason.CONTOUR,
                "Expected a mask whose object is 1 where no value is above, else 128 or more, got "
                f"a largest value of {values.max()}",
            )
        return cls(image.header, (image.width, image.height), np.packbits(inside, axis=1))

    @property
    def pixels(self) -> NDArray[np.bool_]:
        """Which pixels are object, shape (height, width)."""
        return np.unpackbits(self.bits, axis=1, count=self.size[0]).view(np.bool_)


def view_of_mask(
    mask: PackedMask,
    calibration: Calibration,
    world_from_camera: NDArray[np.float64],
    rules: MaskRules,
) -> tuple[View, bool]:
    """Turn a mask into a view.

    Parameters
    ----------
    mask : PackedMask
        What was seen.
    calibration : Calibration
        Of its camera.
    world_from_camera : array, shape (4, 4)
        Pose of the optical frame in the world.
    rules : MaskRules
        How.

    Returns
    -------
    view : View
        In pixels without distortion.
    is_cut : bool
        Whether the border of the image cuts the object.

    Raises
    ------
    MessageError
        If the calibration is of images of another size, or its lens can't be undone there.
    MomrecError
        If the mask shows no object.
    """
    if mask.size != calibration.size:
        raise MessageError(
            Reason.CALIBRATION,
            f"Expected a mask of {calibration.size[0]} x {calibration.size[1]} pixels, as its "
            f"camera_info says, got {mask.size[0]} x {mask.size[1]}",
        )
    camera = Camera.pinhole(world_from_camera, calibration.K)
    contours = contours_of_mask(
        mask.pixels, tolerance=rules.tolerance, straighten=calibration.straighten
    )
    silhouette = hull_silhouette(contours, margin=rules.margin)
    return View(camera, silhouette, _frame(contours, calibration)), contours.touches_border


def _frame(contours: MaskContours, calibration: Calibration) -> Polygon | None:
    """Return what the image covers, without distortion; None where its lens cannot be undone."""
    if calibration.straighten is None:
        return contours.frame
    try:
        fine = shapely.segmentize(contours.frame, FRAME_STEP)
        return shapely.transform(fine, calibration.straighten)
    except MessageError:
        return None


def image_of_mask(inside: NDArray[np.bool_], header: Header) -> Image:
    """Return a mask as an image of encoding mono8, 255 for object.

    Parameters
    ----------
    inside : array of bool, shape (height, width)
        Which pixels are object.
    header : Header
        Time of exposure, and the camera's optical frame.
    """
    height, width = inside.shape
    data = np.where(inside, np.uint8(OBJECT), np.uint8(0)).tobytes()
    return Image(header, height, width, "mono8", 0, width, data)


def camera_info_of(K: NDArray[np.float64], size: tuple[int, int], header: Header) -> CameraInfo:
    """Return the calibration of a camera without distortion, rectified as it is.

    Parameters
    ----------
    K : array, shape (3, 3)
        Intrinsic matrix, pixel centres at integers.
    size : tuple of int
        Width and height of its images.
    header : Header
        As of the image.
    """
    width, height = size
    return CameraInfo(
        header,
        height,
        width,
        "plumb_bob",
        d=(0.0,) * 5,
        k=tuple(K.ravel().tolist()),
        r=tuple(np.eye(3).ravel().tolist()),
        p=tuple(np.column_stack([K, np.zeros(3)]).ravel().tolist()),
    )
