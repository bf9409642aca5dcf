"""Masks with calibrations and poses to views, and every reason to reject one."""

from dataclasses import replace

import mask_scenes as scenes
import numpy as np
import pytest
from mask_scenes import (
    BARREL,
    FRAME,
    SIZE,
    WORLD,
    K,
    camera_info,
    camera_pose,
    cameras,
    encoded,
    image,
    mask,
    transforms,
    view_messages,
)

from momrec_core import Camera, reconstruct
from momrec_ros import matching
from momrec_ros.errors import MessageError
from momrec_ros.interfaces import Header, Image, Pose
from momrec_ros.mask_messages import MaskRules, PackedMask
from momrec_ros.masks import contours_of_mask, hull_silhouette
from momrec_ros.messages import Rejected, StampedView, ViewDecoder, encode_mask
from momrec_ros.transform_buffer import TransformBuffer

STAMP = 5_000_000_001
RATIONAL = (0.9, 0.2, 0.0007, -0.0004, 0.01, 1.2, 0.4, 0.02)
PINCUSHION = (0.2, 0.05, -0.001, 0.002)
WIDE = {"intrinsics": ((255.0, 0.0, 158.0), (0.0, 250.0, 121.0), (0.0, 0.0, 1.0)), "distance": 0.8}
PARTS = ("mask", "camera_info", "camera_pose")


def given(decoder, messages, order=PARTS, **options):
    """Return all events of messages, by their inputs' names, in an order."""
    return [event for name in order for event in getattr(decoder, name)(messages[name], **options)]


def of_changed(decoder=None, **changes):
    """Return the event of a good view of which one message is another."""
    messages = view_messages(cameras()[0], STAMP)
    messages |= {name: encoded(message) for name, message in changes.items()}
    (event,) = given(ViewDecoder() if decoder is None else decoder, messages)
    return event


def rejection_of(decoder=None, **changes):
    event = of_changed(decoder, **changes)
    assert isinstance(event, Rejected)
    assert event.text.startswith("Expected")
    assert event.stamp == STAMP
    return event


@pytest.mark.parametrize(
    "order", [PARTS, PARTS[::-1], (PARTS[1], PARTS[0], PARTS[2]), (*PARTS[1:], PARTS[0])]
)
def test_parts_with_equal_stamps_make_a_view_in_any_order(order):
    decoder = ViewDecoder()
    (event,) = given(decoder, view_messages(cameras()[0], STAMP), order)
    assert isinstance(event, StampedView)
    assert (event.object_id, event.stamp, event.frame_id) == ("", STAMP, WORLD)
    assert not event.is_cut
    np.testing.assert_allclose(event.view.camera.pose, cameras()[0].pose, atol=1e-12)
    np.testing.assert_allclose(event.view.camera.K, K)
    expected = hull_silhouette(contours_of_mask(mask(cameras()[0])))
    assert event.view.silhouette.equals(expected)
    assert (decoder.waiting, decoder.flush()) == (0, ())


def test_tolerance_and_margin_are_those_of_the_rules():
    decoder = ViewDecoder(rules=MaskRules(tolerance=0.0, margin=2.0))
    (event,) = given(decoder, view_messages(cameras()[0], STAMP))
    exact = contours_of_mask(mask(cameras()[0]), tolerance=0.0)
    assert event.view.silhouette.equals(hull_silhouette(exact, margin=2.0))


def volume_of(decoder, coefficients, count=8, **options):
    events = [
        event
        for number, camera in enumerate(cameras(count, **options))
        for event in given(decoder, view_messages(camera, STAMP + number, coefficients))
    ]
    return reconstruct([event.view for event in events], 32).mesh().volume


@pytest.mark.parametrize("coefficients", [BARREL, RATIONAL, PINCUSHION])
def test_an_object_seen_through_a_lens_is_the_one_seen_without(coefficients):
    """The object is rasterised as the closed form shows it."""
    straight = volume_of(ViewDecoder(), (), **WIDE)
    assert volume_of(ViewDecoder(), coefficients, **WIDE) == pytest.approx(straight, rel=0.01)
    ignored = volume_of(ViewDecoder(rules=MaskRules(rectified=True)), coefficients, **WIDE)
    assert abs(ignored - straight) > 0.02 * straight


@pytest.mark.parametrize("coefficients", [BARREL, PINCUSHION])
def test_silhouettes_through_a_lens_are_within_the_tolerance_of_those_without(coefficients):
    for camera in cameras():
        decoder = ViewDecoder(rules=MaskRules(tolerance=0.5, margin=0.0))
        (event,) = given(decoder, view_messages(camera, STAMP, coefficients))
        true = scenes.silhouette_of_mesh(scenes.solid(), camera).silhouette
        outside = event.view.silhouette.difference(true.buffer(1.5))
        inside = true.buffer(-1.5).difference(event.view.silhouette)
        assert outside.area + inside.area < 1.0


def test_mirrored_and_skewed_cameras_see_the_same_object():
    straight = volume_of(ViewDecoder(), BARREL)
    mirrored = ((-420.0, 6.0, 158.0), (0.0, 410.0, 121.0), (0.0, 0.0, 1.0))
    assert volume_of(ViewDecoder(), BARREL, intrinsics=mirrored) == pytest.approx(
        straight, rel=0.01
    )


@pytest.mark.parametrize("coefficients", [(), BARREL, PINCUSHION])
def test_an_object_that_the_border_cuts_is_flagged_and_goes_on_outside(coefficients):
    intrinsics = ((900.0, 0.0, 40.0), (0.0, 900.0, 200.0), (0.0, 0.0, 1.0))
    camera = cameras(intrinsics=intrinsics)[0]
    (event,) = given(ViewDecoder(), view_messages(camera, STAMP, coefficients))
    assert event.is_cut
    true = scenes.silhouette_of_mesh(scenes.solid(), camera).silhouette
    assert 0.3 < mask(camera, coefficients).sum() / true.area < 0.9
    assert true.buffer(-1.5).difference(event.view.silhouette).area < 5
    assert event.view.silhouette.is_valid


def test_padded_rows_and_the_byte_order_do_not_count():
    inside = mask(cameras()[0])
    rows = np.full((SIZE[1], SIZE[0] + 7), 255, np.uint8)
    rows[:, : SIZE[0]] = 255 * inside
    padded = image(inside, STAMP, step=SIZE[0] + 7, data=rows.tobytes(), is_bigendian=1)
    event = of_changed(mask=replace(padded, encoding="8UC1"))
    assert event.view.silhouette.equals(of_changed().view.silhouette)


def test_masks_of_zeros_and_ones_are_those_of_zeros_and_255():
    ones = image(mask(cameras()[0]), STAMP, data=mask(cameras()[0]).tobytes())
    assert of_changed(mask=ones).view.silhouette.equals(of_changed().view.silhouette)
    shades = np.where(mask(cameras()[0]), 128, 127).astype(np.uint8)
    of_shades = of_changed(mask=image(mask(cameras()[0]), STAMP, data=shades.tobytes()))
    assert of_shades.view.silhouette.equals(of_changed().view.silhouette)


@pytest.mark.parametrize(
    ("reason", "text", "changes"),
    [
        ("image", "mono8 or 8UC1, got 'rgb8'", {"encoding": "rgb8"}),
        ("image", "got '32FC1'", {"encoding": "32FC1"}),
        ("image", "a step of 319 and", {"step": 319}),
        ("image", "and 76799 bytes", {"data": bytes(SIZE[0] * SIZE[1] - 1)}),
        ("image", "0 x 240 pixels", {"width": 0, "data": bytes(SIZE[0] * SIZE[1])}),
        ("size", "at most 64000000 pixels", {"width": 65_000, "height": 65_000}),
        ("contour", "an empty one", {"data": bytes(SIZE[0] * SIZE[1])}),
        ("contour", "a largest value of 7", {"data": b"\7" * (SIZE[0] * SIZE[1])}),
        ("calibration", "320 x 240 pixels, as its camera_info", {"height": 120, "step": 640}),
    ],
)
def test_an_image_that_is_no_mask_is_rejected_once(reason, text, changes):
    decoder = ViewDecoder()
    event = rejection_of(decoder, mask=image(mask(cameras()[0]), STAMP, **changes))
    assert event.reason == reason
    assert text in event.text
    assert (decoder.waiting, decoder.flush()) == (0, ())


def test_noise_is_refused_before_it_is_traced(monkeypatch):
    noise = np.random.default_rng(0).random(SIZE[::-1]) < 0.5
    monkeypatch.setattr("momrec_ros.masks.MAX_POINTS", 10_000)
    event = rejection_of(mask=image(noise, STAMP))
    assert (event.reason, "at most 10000 points, got" in event.text) == ("contour", True)


@pytest.mark.parametrize(
    ("reason", "text", "changes"),
    [
        ("calibration", "uncalibrated", {"k": (0.0,) * 9}),
        ("calibration", "as its camera_info says", {"width": 640}),
        ("lens", "got 'equidistant'", {"distortion_model": "equidistant"}),
        ("lens", "where its distortion can be undone", {"d": (-60.0, 0.0, 0.0, 0.0)}),
    ],
)
def test_a_camera_info_that_is_none_rejects_its_mask(reason, text, changes):
    event = rejection_of(camera_info=replace(camera_info(cameras()[0], STAMP), **changes))
    assert event.reason == reason
    assert text in event.text


def test_a_pose_that_is_none_rejects_its_mask():
    pose = camera_pose(cameras()[0], STAMP)
    turned = replace(pose, pose=Pose(orientation=(0.0, 0.0, 0.0, 2.0)))
    assert rejection_of(camera_pose=turned).reason == "quaternion"
    nameless = replace(pose, header=Header(STAMP, ""))
    assert rejection_of(camera_pose=nameless).reason == "frame"
    assert rejection_of(ViewDecoder(world_frame="odom")).reason == "frame"
    assert rejection_of(ViewDecoder("orthographic")).reason == "projection"


def test_bytes_that_are_no_message_are_rejected():
    decoder = ViewDecoder(world_frame=WORLD, transforms=TransformBuffer())
    events = [*decoder.mask(b""), *decoder.camera_info(b"\x00\x01\x00\x00")]
    events += decoder.transforms(b"\x00\x01\x00\x00\xff", is_static=False)
    assert [event.reason for event in events] == ["encoding"] * 3
    long = replace(image(mask(cameras()[0]), STAMP), header=Header(STAMP, 1001 * "n"))
    assert decoder.mask(encoded(long))[0].reason == "frame"


@pytest.mark.parametrize(
    ("names", "texts"),
    [
        (("mask",), ["a camera_info and a camera_pose with the stamp of the mask"]),
        (("mask", "camera_pose"), ["a camera_info with the stamp of the mask"]),
        (("mask", "camera_info"), ["a camera_pose with the stamp of the mask"]),
        (("camera_pose",), ["a contour or mask with the stamp of the camera_pose"]),
        (("camera_pose", "camera_info"), ["a contour or mask with the stamp of the camera_pose"]),
        (("camera_info",), []),
    ],
)
def test_what_is_missing_is_named_once(names, texts):
    decoder = ViewDecoder()
    assert given(decoder, view_messages(cameras()[0], STAMP), names, now=1) == []
    assert decoder.expire(2, 3) == ()
    events = decoder.expire(10, 3)
    assert [event.reason for event in events] == ["pair"] * len(texts)
    for event, text in zip(events, texts, strict=True):
        assert f"Expected {text} ({STAMP} ns" in event.text
    assert decoder.waiting == 0


def test_a_calibration_of_another_frame_is_not_taken():
    decoder = ViewDecoder()
    messages = view_messages(cameras()[0], STAMP)
    other = replace(camera_info(cameras()[0], STAMP), header=Header(STAMP, "other_optical"))
    assert given(decoder, messages | {"camera_info": encoded(other)}) == []
    (event,) = decoder.flush()
    assert f"a camera_info with the stamp of the mask ({STAMP} ns, frame '{FRAME}')" in event.text


def test_parts_of_different_sources_do_not_match():
    decoder = ViewDecoder()
    messages = view_messages(cameras()[0], STAMP)
    assert given(decoder, messages, PARTS[:2], source="left") == []
    assert given(decoder, messages, PARTS[2:], source="right") == []
    assert [event.reason for event in decoder.flush()] == ["pair", "pair"]


def test_a_mask_that_comes_twice_is_told_and_the_later_is_used():
    decoder = ViewDecoder()
    messages = view_messages(cameras()[0], STAMP)
    assert decoder.mask(messages["mask"]) == ()
    later = encoded(image(mask(cameras()[1]), STAMP))
    (event,) = decoder.mask(later)
    assert event.reason == "pair"
    (view,) = given(decoder, messages, PARTS[1:])
    assert view.view.silhouette.equals(hull_silhouette(contours_of_mask(mask(cameras()[1]))))


def test_waiting_masks_take_a_bit_a_pixel_and_are_bounded_in_bytes(monkeypatch):
    packed = PackedMask.of_image(image(mask(cameras()[0]), STAMP))
    assert packed.bits.nbytes == SIZE[0] * SIZE[1] / 8
    np.testing.assert_array_equal(packed.pixels, mask(cameras()[0]))
    monkeypatch.setattr(matching, "MAX_BYTES", 3.9 * packed.bits.nbytes)
    decoder = ViewDecoder()
    lost = []
    for number in range(6):
        lost += decoder.mask(encoded(image(mask(cameras()[0]), STAMP + number)))
    assert [event.stamp - STAMP for event in lost] == [0, 1, 2]
    assert decoder.waiting == 3


def test_a_parallel_projection_has_no_camera_info():
    with pytest.raises(ValueError, match="pinhole camera for a mask, got parallel projection"):
        encode_mask(mask(cameras()[0]), Camera.orthographic(np.eye(4)), 1, WORLD, FRAME)


def tf_decoder():
    return ViewDecoder(world_frame=WORLD, transforms=TransformBuffer())


def seen(decoder, camera, stamp, frame=FRAME, now=1):
    """Give a decoder a mask and its camera_info of a frame."""
    header = Header(stamp, frame)
    found = []
    for name, message in (
        ("mask", image(mask(camera), stamp)),
        ("camera_info", camera_info(camera, stamp)),
    ):
        found += getattr(decoder, name)(encoded(replace(message, header=header)), now=now)
    return found


def test_transforms_place_masks_that_waited_for_them():
    """A camera on an arm: fixed to its hand, which moves from before to after the exposure."""
    decoder, camera = tf_decoder(), cameras()[1]
    hand_from_camera = cameras()[3].pose
    hand = camera.pose @ np.linalg.inv(hand_from_camera)
    static = transforms(("hand", FRAME, 0, hand_from_camera), (WORLD, "base", 0, np.eye(4)))
    assert decoder.transforms(static, is_static=True) == ()
    moved = hand.copy()
    moved[0, 3] += 0.2
    for stamp, shift in ((STAMP - 100, -0.1), (STAMP - 50, -0.05)):
        moved[0, 3] = hand[0, 3] + shift
        data = transforms(("base", "hand", stamp, moved))
        assert decoder.transforms(data, is_static=False) == ()
    assert seen(decoder, camera, STAMP) == []
    assert decoder.waiting == 1
    moved[0, 3] = hand[0, 3] + 0.05
    (event,) = decoder.transforms(transforms(("base", "hand", STAMP + 50, moved)), is_static=False)
    assert (event.stamp, event.frame_id) == (STAMP, WORLD)
    np.testing.assert_allclose(event.view.camera.pose, camera.pose, atol=1e-7)
    assert (decoder.waiting, decoder.flush()) == (0, ())


def test_cameras_of_equal_stamps_are_told_apart_by_their_frames():
    decoder = tf_decoder()
    frames = {f"{side}_optical": camera for side, camera in zip("ab", cameras(), strict=False)}
    static = transforms(*[(WORLD, frame, 0, camera.pose) for frame, camera in frames.items()])
    decoder.transforms(static, is_static=True)
    events = [
        event for frame, camera in frames.items() for event in seen(decoder, camera, STAMP, frame)
    ]
    for event, camera in zip(events, frames.values(), strict=True):
        np.testing.assert_allclose(event.view.camera.pose, camera.pose, atol=1e-7)


def test_a_mask_without_a_transform_is_rejected_in_time_with_what_is_not_known():
    decoder = tf_decoder()
    assert seen(decoder, cameras()[0], STAMP) == []
    (event,) = decoder.expire(2 * STAMP, STAMP // 2)
    assert event.reason == "transform"
    assert f"from '{FRAME}' to '{WORLD}' at {STAMP} ns, got none: nothing is known" in event.text
    assert decoder.transforms(transforms((WORLD, FRAME, 0, np.eye(4))), is_static=True) == ()
    assert decoder.waiting == 0


def test_without_a_world_frame_there_is_nothing_to_transform_to():
    with pytest.raises(MessageError, match="Expected a world_frame where poses come from"):
        ViewDecoder(transforms=TransformBuffer())


def test_transforms_that_were_not_asked_for_are_nothing():
    assert ViewDecoder().transforms(b"", is_static=True) == ()


def test_a_mask_message_without_pixels_is_refused():
    with pytest.raises(MessageError, match="0 x 0 pixels"):
        PackedMask.of_image(Image(encoding="mono8"))
