"""The meaning of messages: views, requests to forget, and every reason to reject."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from shapely import MultiPolygon, Polygon

from momrec_core.camera import Camera
from momrec_core.view import View
from momrec_ros.errors import MessageError
from momrec_ros.interfaces import (
    Header,
    Marker,
    MarkerAction,
    MarkerType,
    PolygonStamped,
    Pose,
    PoseStamped,
    decode_marker_array,
    encode_marker_array,
    encode_polygon_stamped,
    encode_pose_stamped,
)
from momrec_ros.messages import (
    Forget,
    Rejected,
    StampedView,
    ViewDecoder,
    encode_view,
    pose_from_matrix,
)

HEADER = Header(5_000_000_001, "map")
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
AHEAD = np.array([0.0, 0.0, 1.0])
ORIGIN = Pose()
RING = Marker(header=HEADER, ns="box", type=MarkerType.LINE_STRIP, points=SQUARE)


def events_of(*markers, **options):
    return ViewDecoder(**options).marker_array(encode_marker_array(markers))


def rejection_of(*markers, **options):
    (event,) = events_of(*markers, **options)
    assert isinstance(event, Rejected)
    assert event.text.startswith("Expected")
    return event


def with_points(points):
    return replace(RING, points=np.asarray(points, float))


def random_pose(rng):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    pose[:3, 3] = rng.normal(size=3)
    return pose


def test_a_ring_on_the_image_plane_is_an_orthographic_view():
    (event,) = events_of(RING)
    assert (event.object_id, event.stamp, event.frame_id) == ("box", 5_000_000_001, "map")
    assert not event.view.camera.is_pinhole
    assert event.view.silhouette.equals(Polygon(SQUARE[:, :2]))


def test_rays_of_any_length_make_a_central_view_in_normalised_coordinates():
    directions = np.column_stack([SQUARE[:, :2], np.ones(4)])
    (event,) = events_of(with_points(directions * [[1.0], [2.0], [3.0], [0.5]]))
    np.testing.assert_array_equal(event.view.camera.K, np.eye(3))
    assert event.view.silhouette.equals(Polygon(SQUARE[:, :2]))


def test_a_last_point_that_repeats_the_first_changes_nothing():
    (event,) = events_of(with_points([*SQUARE, SQUARE[0]]))
    assert event.view.silhouette.equals(Polygon(SQUARE[:, :2]))


def test_a_ring_inside_another_is_a_hole():
    inner = replace(RING, id=1, points=0.5 * SQUARE + [0.25, 0.25, 0])
    (event,) = events_of(RING, inner)
    assert event.view.silhouette.area == pytest.approx(0.75)


@given(seed=st.integers(0, 1000), pinhole=st.booleans())
@settings(max_examples=60, deadline=None, derandomize=True)
def test_a_view_survives_being_a_message(seed, pinhole):
    rng = np.random.default_rng(seed)
    pose = random_pose(rng)
    K = np.array([[rng.uniform(300, 900), 1.5, 320], [0, -rng.uniform(300, 900), 240], [0, 0, 1]])
    camera = Camera.pinhole(pose, K) if pinhole else Camera.orthographic(pose)
    square = Polygon(SQUARE[:, :2] * 3 - 1.5, [SQUARE[::-1, :2] - 0.5])
    region = MultiPolygon([square, Polygon(SQUARE[:, :2] + 5)])
    stamped = StampedView("ob/ject é", int(rng.integers(2**60)), "world", View(camera, region))
    (event,) = ViewDecoder().marker_array(encode_view(stamped))
    assert (event.object_id, event.stamp) == (stamped.object_id, stamped.stamp)
    np.testing.assert_allclose(event.view.camera.pose, pose, atol=1e-14)
    rings = event.view.rings
    assert len(rings) == 3
    for ours, expected in zip(rings, stamped.view.rings, strict=True):
        if pinhole:
            expected = camera.rays_camera(expected)[:, :2]  # noqa: PLW2901 - the same ring
            assert event.view.camera.is_pinhole
        assert Polygon(ours).symmetric_difference(Polygon(expected)).area < 1e-12


def test_a_written_view_is_what_displays_want():
    square = Polygon(SQUARE[:, :2] * 3 - 1, [SQUARE[:, :2]])
    view = View(Camera.orthographic(random_pose(np.random.default_rng(0))), square)
    markers = decode_marker_array(encode_view(StampedView("box", 7, "map", view)))
    assert [marker.id for marker in markers] == [0, 1]
    for marker in markers:
        assert (marker.header, marker.ns, marker.pose) == (Header(7, "map"), "box", markers[0].pose)
        assert (marker.type, marker.action) == (MarkerType.LINE_STRIP, MarkerAction.ADD)
        assert marker.scale[0] > 0
        assert marker.color[3] > 0
        assert np.linalg.norm(marker.pose.orientation) == pytest.approx(1, abs=1e-15)
        np.testing.assert_array_equal(marker.points[0], marker.points[-1])


@pytest.mark.parametrize(
    ("reason", "markers"),
    [
        ("empty", []),
        ("contour", [with_points(SQUARE[:1])]),
        ("contour", [with_points(SQUARE[[0, 1, 0, 1]])]),
        ("points", [with_points(np.empty((0, 3)))]),
        ("points", [with_points([[0, 0, 0], [np.nan, 0, 0], [1, 1, 0]])]),
        ("points", [with_points([[0, 0, 0], [1, 0, np.inf], [1, 1, 0]])]),
        ("contour", [with_points(np.column_stack([SQUARE[:, :2] * 1e300, np.full(4, 1e-300)]))]),
        ("type", [replace(RING, type=MarkerType.LINE_LIST)]),
        ("type", [RING, replace(RING, type=MarkerType.TRIANGLE_LIST)]),
        ("action", [replace(RING, action=1)]),
        ("quaternion", [replace(RING, pose=Pose(orientation=(0.0, 0.0, 0.0, 0.0)))]),
        ("quaternion", [replace(RING, pose=Pose(orientation=(0.0, 0.0, 0.0, 1.02)))]),
        ("pose", [replace(RING, pose=Pose(orientation=(0.0, 0.0, np.nan, 1.0)))]),
        ("pose", [replace(RING, pose=Pose((np.inf, 0.0, 0.0)))]),
        ("pose", [RING, replace(RING, pose=Pose((1.0, 0.0, 0.0)))]),
        ("header", [RING, replace(RING, header=Header(6, "map"))]),
        ("header", [RING, replace(RING, header=Header(HEADER.stamp, "odom"))]),
        ("ns", [RING, replace(RING, ns="ball")]),
        ("frame", [replace(RING, header=Header(5, ""))]),
        ("projection", [RING, with_points(SQUARE + AHEAD)]),
        ("projection", [with_points(SQUARE - AHEAD)]),
    ],
)
def test_a_message_that_is_no_view_is_rejected_with_its_reason(reason, markers):
    assert rejection_of(*markers).reason == reason


def test_a_rejection_names_the_object_and_the_time():
    event = rejection_of(replace(RING, type=0))
    assert (event.object_id, event.stamp) == ("box", HEADER.stamp)


@pytest.mark.parametrize(
    ("projection", "depth", "accepted"),
    [
        ("orthographic", 0, True),
        ("orthographic", 1, False),
        ("central", 1, True),
        ("central", 0, False),
    ],
)
def test_a_given_projection_is_enforced(projection, depth, accepted):
    (event,) = events_of(with_points(SQUARE + depth * AHEAD), projection=projection)
    assert isinstance(event, StampedView if accepted else Rejected)


def test_an_unknown_projection_is_an_error():
    with pytest.raises(MessageError, match="got 'fisheye'"):
        ViewDecoder("fisheye")


def test_a_quaternion_of_few_digits_is_renormalised():
    half = 0.71
    (event,) = events_of(replace(RING, pose=Pose(orientation=(half, 0.0, 0.0, half))))
    np.testing.assert_allclose(
        event.view.camera.rotation, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15
    )


def test_too_many_points_are_refused():
    event = rejection_of(RING, with_points(np.zeros((9, 3))), max_points=12)
    assert event.reason == "size"
    assert "at most 12 points in a view, got 13" in event.text
    assert isinstance(events_of(RING, max_points=4)[0], StampedView)


def test_names_are_of_limited_length():
    longest = 1000 * "n"
    (event,) = events_of(replace(RING, ns=longest, header=Header(1, longest)))
    assert isinstance(event, StampedView)
    for field, changed in {
        "ns": {"ns": longest + "n"},
        "frame": {"header": Header(1, longest + "n")},
    }.items():
        event = rejection_of(replace(RING, **changed))
        assert event.reason == field
        assert "at most 1000 characters, got 1001" in event.text
        assert len(event.object_id) <= 1000


def test_names_in_what_is_told_of_a_message_stay_in_one_line():
    event = rejection_of(RING, replace(RING, ns="a\nb"))
    assert event.reason == "ns"
    assert "\n" not in event.text


def test_deletions_beside_a_ring_are_housekeeping():
    stale = replace(RING, header=Header(1, "other"), ns="ball", action=MarkerAction.DELETE)
    (event,) = events_of(replace(stale, action=MarkerAction.DELETEALL), stale, RING)
    assert isinstance(event, StampedView)
    assert event.object_id == "box"


def test_deletions_alone_forget_as_they_say():
    delete_all = replace(RING, action=MarkerAction.DELETEALL)
    assert events_of(delete_all) == (Forget("box"),)
    assert events_of(replace(delete_all, ns="")) == (Forget(""),)
    assert events_of(delete_all, replace(delete_all, ns="b")) == (Forget("box"), Forget("b"))
    assert events_of(replace(RING, action=MarkerAction.DELETE)) == ()


def test_the_first_good_view_names_the_world_and_others_are_rejected():
    decoder = ViewDecoder()
    bad = replace(RING, header=Header(1, "odom"), type=0)
    decoder.marker_array(encode_marker_array([bad]))
    assert decoder.world_frame == ""
    decoder.marker_array(encode_marker_array([RING]))
    assert decoder.world_frame == "map"
    elsewhere = replace(RING, header=Header(1, "odom"))
    (event,) = decoder.marker_array(encode_marker_array([elsewhere]))
    assert event.reason == "frame"
    assert rejection_of(RING, world_frame="odom").reason == "frame"


def polygon(stamp, points=SQUARE):
    return encode_polygon_stamped(
        PolygonStamped(Header(stamp, "optical"), np.asarray(points, np.float32))
    )


def camera_pose(stamp, pose=ORIGIN):
    return encode_pose_stamped(PoseStamped(Header(stamp, "map"), pose))


def test_halves_with_equal_stamps_make_a_view_in_either_order():
    decoder = ViewDecoder()
    assert decoder.polygon(polygon(1)) == ()
    assert decoder.camera_pose(camera_pose(2)) == ()
    (first,) = decoder.camera_pose(camera_pose(1))
    (second,) = decoder.polygon(polygon(2, SQUARE + 2 * AHEAD))
    assert [(event.object_id, event.stamp, event.frame_id) for event in (first, second)] == [
        ("", 1, "map"),
        ("", 2, "map"),
    ]
    assert [event.view.camera.is_pinhole for event in (first, second)] == [False, True]
    assert decoder.flush() == ()


def test_halves_of_different_cameras_do_not_pair():
    decoder = ViewDecoder()
    decoder.polygon(polygon(1), "left")
    assert decoder.camera_pose(camera_pose(1), "right") == ()
    assert [event.reason for event in decoder.flush()] == ["pair", "pair"]


def test_a_bounded_number_of_halves_waits():
    decoder = ViewDecoder(max_pending=2)
    assert [len(decoder.polygon(polygon(stamp))) for stamp in range(5)] == [0, 0, 1, 1, 1]
    (event,) = decoder.camera_pose(camera_pose(4))
    assert isinstance(event, StampedView)
    assert [event.stamp for event in decoder.flush()] == [3]
    assert decoder.flush() == ()


def test_a_half_that_comes_twice_is_told():
    decoder = ViewDecoder()
    decoder.camera_pose(camera_pose(1))
    (event,) = decoder.camera_pose(camera_pose(1, Pose((1.0, 0.0, 0.0))))
    assert event.reason == "pair"
    (view,) = decoder.polygon(polygon(1))
    assert view.view.camera.position[0] == 1


def test_broken_halves_are_rejected():
    decoder = ViewDecoder(max_points=3)
    assert decoder.polygon(b"\x00\x01\x00\x00")[0].reason == "encoding"
    assert decoder.camera_pose(b"")[0].reason == "encoding"
    assert decoder.polygon(polygon(1))[0].reason == "size"
    decoder.polygon(polygon(2, SQUARE[:3]))
    bad = Pose(orientation=(0.0, 0.0, 0.0, 3.0))
    assert decoder.camera_pose(camera_pose(2, bad))[0].reason == "quaternion"


def test_the_quaternions_of_poses_are_those_of_scipy():
    rng = np.random.default_rng(10)
    turns = [rng.uniform(-np.pi, np.pi) * np.eye(3)[axis] for axis in range(3)]
    half_turns = np.pi * np.vstack([np.eye(3), -np.eye(3), [[0.6, -0.8, 0.0], [0.0, -0.6, 0.8]]])
    every = Rotation.concatenate(
        [
            Rotation.random(200, random_state=rng),
            Rotation.from_rotvec([*turns, *half_turns]),
            Rotation.create_group("O"),
        ]
    )
    for rotation in every:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), rng.normal(size=3)
        pose = pose_from_matrix(matrix)
        expected = Rotation.from_matrix(matrix[:3, :3]).as_quat(canonical=True)
        np.testing.assert_allclose(pose.orientation, expected, atol=1e-15)
        assert pose.position == tuple(matrix[:3, 3])
