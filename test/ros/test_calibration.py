"""Calibrations: regions, binning, lenses and rectified images against their meaning."""

from dataclasses import replace

import numpy as np
import pytest

from momrec_core import Camera, Lens
from momrec_ros.calibration import calibration_of
from momrec_ros.errors import MessageError, Reason
from momrec_ros.interfaces import CameraInfo, RegionOfInterest

K = np.array([[700.0, 3.0, 321.5], [0.0, -690.0, 238.25], [0.0, 0.0, 1.0]])
P = np.array([[650.0, 0.0, 300.0, -40.0], [0.0, 650.0, 240.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
PLUMB_BOB = (-0.28, 0.07, 0.0012, -0.0008, 0.01)
RATIONAL = (2.1, 0.9, 0.0007, -0.0004, 0.03, 2.4, 1.3, 0.15)
INFO = CameraInfo(
    height=480,
    width=640,
    distortion_model="plumb_bob",
    d=PLUMB_BOB,
    k=tuple(K.ravel()),
    p=tuple(P.ravel()),
)


def rejection_of(**changes):
    rectified = changes.pop("rectified", False)
    with pytest.raises(MessageError) as raised:
        calibration_of(replace(INFO, **changes), rectified=rectified)
    return raised.value


def test_skew_and_a_negative_focal_length_pass():
    calibration = calibration_of(INFO)
    np.testing.assert_array_equal(calibration.K, K)
    assert calibration.size == (640, 480)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("plumb_bob", PLUMB_BOB),
        ("plumb_bob", PLUMB_BOB[:4]),
        ("plumb_bob", (*PLUMB_BOB, 0.0, 0.0, 0.0)),
        ("rational_polynomial", RATIONAL),
        ("rational_polynomial", (*RATIONAL, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_straightened_pixels_are_those_of_a_pinhole(model, coefficients):
    calibration = calibration_of(replace(INFO, distortion_model=model, d=coefficients))
    camera = Camera.pinhole(np.eye(4), K)
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2))
    rays = np.column_stack([points, np.ones(50)])
    moved = np.column_stack([Lens(coefficients[:8]).distort(points), np.ones(50)])
    shown = camera.project(moved)[0]
    np.testing.assert_allclose(calibration.straighten(shown), camera.project(rays)[0], atol=1e-7)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("", ()), ("plumb_bob", ()), ("plumb_bob", (0.0,) * 5), ("rational_polynomial", (0.0,) * 8)],
)
def test_without_coefficients_nothing_is_straightened(model, coefficients):
    info = replace(INFO, distortion_model=model, d=coefficients)
    assert calibration_of(info).straighten is None


def test_a_rectified_image_has_the_left_of_p_and_no_distortion():
    calibration = calibration_of(replace(INFO, k=(0.0,) * 9), rectified=True)
    np.testing.assert_array_equal(calibration.K, P[:, :3])
    assert calibration.straighten is None


def test_a_binned_region_sees_the_same_rays():
    """A pixel of a binned region is the mean of its neighbourhood in full resolution."""
    roi = RegionOfInterest(x_offset=100, y_offset=60, height=240, width=320)
    calibration = calibration_of(replace(INFO, binning_x=2, binning_y=4, roi=roi))
    assert calibration.size == (160, 60)
    row, column = 7, 11
    rows, columns = np.mgrid[60 + 4 * row : 64 + 4 * row, 100 + 2 * column : 102 + 2 * column]
    full = Camera.pinhole(np.eye(4), K).rays_camera([[columns.mean(), rows.mean()]])
    ours = Camera.pinhole(np.eye(4), calibration.K).rays_camera([[column, row]])
    np.testing.assert_allclose(ours, full, atol=1e-12)


def test_an_uncalibrated_camera_is_called_so():
    assert "uncalibrated" in str(rejection_of(k=(0.0,) * 9))
    assert "uncalibrated" in str(rejection_of(p=(0.0,) * 12, rectified=True))
    assert rejection_of(k=(0.0,) * 9).reason == Reason.CALIBRATION


@pytest.mark.parametrize(
    ("changes", "reason", "text"),
    [
        ({"distortion_model": "equidistant", "d": (0.0,) * 4}, "lens", "got 'equidistant': rectif"),
        ({"distortion_model": ""}, "lens", "plumb_bob or rational_polynomial, got ''"),
        ({"d": (0.1,) * 6}, "lens", "at most 5 coefficients of plumb_bob"),
        ({"d": (np.nan,)}, "lens", "finite coefficients"),
        ({"d": (0.0,) * 1000}, "lens", "at most 5 coefficients"),
        ({"k": (np.nan,) * 9}, "calibration", "K of camera_info: Expected a finite K"),
        ({"k": (1.0,) * 9}, "calibration", "upper triangular"),
        (
            {"roi": RegionOfInterest(x_offset=600, width=100, height=10)},
            "calibration",
            "region of interest inside 640 x 480",
        ),
    ],
)
def test_what_is_no_calibration_is_refused_with_its_reason(changes, reason, text):
    error = rejection_of(**changes)
    assert error.reason == reason
    assert text in str(error)


def test_a_pixel_that_the_lens_cannot_show_is_refused():
    calibration = calibration_of(replace(INFO, d=(-0.9, 0.0, 0.0, 0.0)))
    with pytest.raises(MessageError, match="where its distortion can be undone") as raised:
        calibration.straighten(np.array([[0.0, 0.0]]))
    assert raised.value.reason == Reason.LENS
