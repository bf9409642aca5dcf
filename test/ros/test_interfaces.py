"""The serialised form against rclpy (byte for byte) and mcap_ros2 (value for value)."""

import os
import struct
from contextlib import suppress
from functools import cache

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Point32,
    PolygonStamped,
    Pose,
    PoseStamped,
    Quaternion,
    Vector3,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, RegionOfInterest
from shape_msgs.msg import Mesh, MeshTriangle
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray, MeshFile, UVCoordinate

from momrec_ros import cdr, interfaces
from momrec_ros.definitions import message_definition
from momrec_ros.errors import CdrError

# A dependency of rclpy's type support warns when the first message is serialised.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

int32 = st.integers(-(2**31), 2**31 - 1)
text = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=9)
number = st.floats(allow_nan=False)
LARGEST = 2.0**127  # rclpy's own check refuses the largest float32
number32 = st.floats(-LARGEST, LARGEST, width=32)
stamp = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
headers = st.builds(interfaces.Header, stamp, text)
poses = st.builds(interfaces.Pose, st.tuples(*[number] * 3), st.tuples(*[number] * 4))


def rows(columns, dtype):
    elements = number32 if dtype == "f4" else number
    shape = st.tuples(st.integers(0, 4), st.just(columns))
    return hnp.arrays(dtype, shape, elements=elements, fill=st.nothing())


markers = st.builds(
    interfaces.Marker,
    header=headers,
    ns=text,
    id=int32,
    type=int32,
    action=int32,
    pose=poses,
    scale=st.tuples(*[number] * 3),
    color=st.tuples(*[number32] * 4),
    lifetime=stamp,
    frame_locked=st.booleans(),
    points=rows(3, "f8"),
    colors=rows(4, "f4"),
    texture_resource=text,
    texture=st.builds(interfaces.CompressedImage, headers, text, st.binary(max_size=9)),
    uv_coordinates=rows(2, "f4"),
    text=text,
    mesh_resource=text,
    mesh_file=st.builds(interfaces.MeshFile, text, st.binary(max_size=9)),
    mesh_use_embedded_materials=st.booleans(),
)
statuses = st.builds(
    interfaces.DiagnosticStatus,
    st.integers(0, 3),
    text,
    text,
    text,
    st.lists(st.tuples(text, text), max_size=3).map(tuple),
)


def ros_time(kind, nanoseconds):
    sec, nanosec = divmod(nanoseconds, 10**9)
    return kind(sec=sec, nanosec=nanosec)


def ros_header(header):
    return Header(stamp=ros_time(Time, header.stamp), frame_id=header.frame_id)


def ros_pose(pose):
    x, y, z, w = pose.orientation
    return Pose(position=ros_points([pose.position])[0], orientation=Quaternion(x=x, y=y, z=z, w=w))


def ros_points(points, kind=Point):
    return [kind(x=float(x), y=float(y), z=float(z)) for x, y, z in points]


def ros_color(color):
    r, g, b, a = map(float, color)
    return ColorRGBA(r=r, g=g, b=b, a=a)


def ros_marker(marker):
    return Marker(
        header=ros_header(marker.header),
        ns=marker.ns,
        id=marker.id,
        type=marker.type,
        action=marker.action,
        pose=ros_pose(marker.pose),
        scale=ros_points([marker.scale], Vector3)[0],
        color=ros_color(marker.color),
        lifetime=ros_time(Duration, marker.lifetime),
        frame_locked=marker.frame_locked,
        points=ros_points(marker.points),
        colors=[ros_color(color) for color in marker.colors],
        texture_resource=marker.texture_resource,
        texture=CompressedImage(
            header=ros_header(marker.texture.header),
            format=marker.texture.format,
            data=marker.texture.data,
        ),
        uv_coordinates=[UVCoordinate(u=float(u), v=float(v)) for u, v in marker.uv_coordinates],
        text=marker.text,
        mesh_resource=marker.mesh_resource,
        mesh_file=MeshFile(filename=marker.mesh_file.filename, data=marker.mesh_file.data),
        mesh_use_embedded_materials=marker.mesh_use_embedded_materials,
    )


def ros_status(status):
    return DiagnosticStatus(
        level=bytes([status.level]),
        name=status.name,
        message=status.message,
        hardware_id=status.hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in status.values],
    )


def plain(value):
    """Return a message, of rclpy or of mcap_ros2, as nested tuples of numbers and text."""
    if isinstance(value, (bytes, bytearray)):
        return tuple(value)
    if isinstance(value, (str, bool, int, float, np.generic)):
        return value
    if hasattr(value, "__slots__"):
        names = [name.lstrip("_") for name in value.__slots__ if name != "_check_fields"]
        return tuple(plain(getattr(value, name)) for name in names)
    return tuple(plain(item) for item in value)


@cache
def mcap_ros2_decoder(type_name):
    definition = message_definition(type_name).encode()
    schema = Schema(id=1, name=type_name, encoding="ros2msg", data=definition)
    return DecoderFactory().decoder_for("cdr", schema)


def assert_same_as_rclpy(encode, value, expected, type_name):
    """Compare bytes with those of rclpy, which leaves what it happens to find in the padding."""
    ours = encode(value)
    theirs = serialize_message(expected)
    original = cdr.PADDING
    cdr.PADDING = b"\xff"
    try:
        padding = np.frombuffer(encode(value), "u1") != np.frombuffer(ours, "u1")
    finally:
        cdr.PADDING = original
    assert len(ours) == len(theirs)
    different = np.frombuffer(ours, "u1") != np.frombuffer(theirs, "u1")
    assert not different[~padding].any()
    assert deserialize_message(ours, type(expected)) == expected
    assert plain(mcap_ros2_decoder(type_name)(ours)) == plain(expected)


def assert_equal_markers(ours, expected):
    assert plain_marker(ours) == plain_marker(expected)


def plain_marker(marker):
    fields = vars(marker).items()
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields
    }


@given(st.lists(markers, max_size=3))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_marker_arrays_are_the_bytes_of_rclpy_and_come_back(given_markers):
    assert_same_as_rclpy(
        interfaces.encode_marker_array,
        given_markers,
        MarkerArray(markers=[ros_marker(marker) for marker in given_markers]),
        "visualization_msgs/msg/MarkerArray",
    )
    decoded = interfaces.decode_marker_array(interfaces.encode_marker_array(given_markers))
    assert len(decoded) == len(given_markers)
    for ours, expected in zip(decoded, given_markers, strict=True):
        assert_equal_markers(ours, expected)


@given(st.lists(st.lists(markers, min_size=1, max_size=2), max_size=3))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_markers_written_in_blocks_are_those_written_at_once(groups):
    blocks = [interfaces.marker_block(*group) for group in groups]
    at_once = interfaces.encode_marker_array([marker for group in groups for marker in group])
    assert interfaces.encode_marker_blocks(blocks) == at_once


@given(markers)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_a_marker_is_the_bytes_of_rclpy(marker):
    assert_same_as_rclpy(
        interfaces.encode_marker, marker, ros_marker(marker), "visualization_msgs/msg/Marker"
    )


@given(headers, rows(3, "f4"))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_a_polygon_is_the_bytes_of_rclpy_and_comes_back(header, points):
    expected = PolygonStamped(header=ros_header(header))
    expected.polygon.points = ros_points(points, Point32)
    polygon = interfaces.PolygonStamped(header, points)
    assert_same_as_rclpy(
        interfaces.encode_polygon_stamped, polygon, expected, "geometry_msgs/msg/PolygonStamped"
    )
    decoded = interfaces.decode_polygon_stamped(interfaces.encode_polygon_stamped(polygon))
    assert decoded.header == header
    assert decoded.points.tolist() == points.tolist()


@given(headers, poses)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_a_pose_is_the_bytes_of_rclpy_and_comes_back(header, pose):
    stamped = interfaces.PoseStamped(header, pose)
    expected = PoseStamped(header=ros_header(header), pose=ros_pose(pose))
    assert_same_as_rclpy(
        interfaces.encode_pose_stamped, stamped, expected, "geometry_msgs/msg/PoseStamped"
    )
    assert interfaces.decode_pose_stamped(interfaces.encode_pose_stamped(stamped)) == stamped


uint32 = st.integers(0, 2**32 - 1)
images = st.builds(
    interfaces.Image,
    headers,
    uint32,
    uint32,
    text,
    st.integers(0, 255),
    uint32,
    st.binary(max_size=9),
)


@given(images)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_an_image_is_the_bytes_of_rclpy_and_comes_back(image):
    expected = Image(**vars(image) | {"header": ros_header(image.header)})
    assert_same_as_rclpy(interfaces.encode_image, image, expected, "sensor_msgs/msg/Image")
    assert interfaces.decode_image(interfaces.encode_image(image)) == image


def numbers(count):
    return st.tuples(*[number] * count)


camera_infos = st.builds(
    interfaces.CameraInfo,
    headers,
    uint32,
    uint32,
    text,
    st.lists(number, max_size=9).map(tuple),
    numbers(9),
    numbers(9),
    numbers(12),
    uint32,
    uint32,
    st.builds(interfaces.RegionOfInterest, uint32, uint32, uint32, uint32, st.booleans()),
)


@given(camera_infos)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_a_camera_info_is_the_bytes_of_rclpy_and_comes_back(info):
    changed = {"header": ros_header(info.header), "roi": RegionOfInterest(**vars(info.roi))}
    expected = CameraInfo(**vars(info) | changed)
    assert_same_as_rclpy(
        interfaces.encode_camera_info, info, expected, "sensor_msgs/msg/CameraInfo"
    )
    assert interfaces.decode_camera_info(interfaces.encode_camera_info(info)) == info


def test_every_truncation_of_an_image_and_of_its_camera_info_is_refused():
    image = interfaces.Image(interfaces.Header(5, "camera"), 2, 3, "mono8", 0, 3, bytes(6))
    info = interfaces.CameraInfo(interfaces.Header(5, "camera"), d=(0.1,) * 5)
    for decode, data in (
        (interfaces.decode_image, interfaces.encode_image(image)),
        (interfaces.decode_camera_info, interfaces.encode_camera_info(info)),
    ):
        for length in range(len(data)):
            with pytest.raises(CdrError, match="Expected"):
                decode(data[:length])


@given(text)
@settings(max_examples=30, deadline=None, derandomize=True)
def test_a_string_is_the_bytes_of_rclpy_and_comes_back(label):
    assert_same_as_rclpy(interfaces.encode_string, label, String(data=label), "std_msgs/msg/String")
    assert interfaces.decode_string(interfaces.encode_string(label)) == label


@given(hnp.arrays("u4", st.tuples(st.integers(0, 4), st.just(3))), rows(3, "f8"))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_a_mesh_is_the_bytes_of_rclpy_and_comes_back(triangles, vertices):
    expected = Mesh(
        triangles=[MeshTriangle(vertex_indices=row) for row in triangles],
        vertices=ros_points(vertices),
    )
    assert_same_as_rclpy(
        lambda mesh: interfaces.encode_mesh(*mesh),
        (triangles, vertices),
        expected,
        "shape_msgs/msg/Mesh",
    )
    ours = interfaces.decode_mesh(interfaces.encode_mesh(triangles, vertices))
    assert [part.tolist() for part in ours] == [triangles.tolist(), vertices.tolist()]


@given(headers, st.lists(statuses, max_size=3).map(tuple))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_diagnostics_are_the_bytes_of_rclpy_and_come_back(header, given_statuses):
    diagnostics = interfaces.DiagnosticArray(header, given_statuses)
    expected = DiagnosticArray(
        header=ros_header(header), status=[ros_status(status) for status in given_statuses]
    )
    data = interfaces.encode_diagnostic_array(diagnostics)
    assert deserialize_message(data, DiagnosticArray) == expected
    assert len(data) == len(serialize_message(expected))
    assert interfaces.decode_diagnostic_array(data) == diagnostics


def example_markers():
    return [
        interfaces.Marker(
            header=interfaces.Header(5, "map"),
            ns="box",
            points=np.arange(12.0).reshape(4, 3),
            colors=np.ones((4, 4), np.float32),
            text="label",
        )
    ]


def test_every_truncation_of_a_message_is_refused():
    data = interfaces.encode_marker_array(example_markers())
    for length in range(len(data)):
        with pytest.raises(CdrError, match="Expected"):
            interfaces.decode_marker_array(data[:length])


def test_trailing_bytes_are_refused_unless_a_transport_rounds_up_to_four():
    data = interfaces.encode_marker_array(example_markers())
    rounding = -len(data) % 4
    assert rounding
    assert len(interfaces.decode_marker_array(data + bytes(rounding))) == 1
    for extra in {1, 2, 3, 4, 5, 8, 100} - {rounding}:
        with pytest.raises(CdrError, match=f"{extra} bytes more"):
            interfaces.decode_marker_array(data + bytes(extra))


@pytest.mark.parametrize("count", [2, 1000, 2**31, 2**32 - 1])
def test_a_count_beyond_the_message_is_refused_before_anything_is_allocated(count):
    data = interfaces.encode_marker_array(example_markers())
    with pytest.raises(CdrError, match="markers within"):
        interfaces.decode_marker_array(data[:4] + struct.pack("<I", count) + data[8:])
    polygon = b"\x00\x01\x00\x00" + bytes(8) + struct.pack("<I", 1) + bytes(4)
    with pytest.raises(CdrError, match="points within"):
        interfaces.decode_polygon_stamped(polygon + struct.pack("<I", count) + bytes(12))


def test_more_markers_than_asked_for_are_refused():
    data = interfaces.encode_marker_array(example_markers() * 3)
    assert len(interfaces.decode_marker_array(data, 3)) == 3
    with pytest.raises(CdrError, match="at most 2 markers"):
        interfaces.decode_marker_array(data, 2)


@given(st.data())
@settings(max_examples=200, deadline=None, derandomize=True)
def test_a_damaged_message_is_refused_or_read_within_its_bounds(data):
    message = bytearray(interfaces.encode_marker_array(example_markers()))
    for _ in range(data.draw(st.integers(1, 4))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    try:
        decoded = interfaces.decode_marker_array(bytes(message))
    except CdrError:
        return
    assert sum(marker.points.nbytes + marker.colors.nbytes for marker in decoded) < len(message)


@given(st.binary(max_size=300))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_arbitrary_bytes_raise_nothing_but_our_error(data):
    for decode in (
        interfaces.decode_marker_array,
        interfaces.decode_polygon_stamped,
        interfaces.decode_pose_stamped,
        interfaces.decode_image,
        interfaces.decode_camera_info,
        interfaces.decode_transforms,
        interfaces.decode_diagnostic_array,
        interfaces.decode_mesh,
        interfaces.decode_string,
    ):
        with suppress(CdrError):
            decode(b"\x00\x01\x00\x00" + data)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (struct.pack("<I", 3) + b"ab\xff", "one NUL"),
        (struct.pack("<I", 3) + b"\xff\xfe\x00", "UTF-8"),
        (struct.pack("<I", 4) + b"a\x00b\x00", "one NUL"),
        (struct.pack("<I", 9) + b"ab\x00", "within the 3 bytes"),
    ],
)
def test_a_string_that_is_none_is_refused(body, reason):
    with pytest.raises(CdrError, match=reason):
        interfaces.decode_string(b"\x00\x01\x00\x00" + body)


@pytest.mark.parametrize("header", ["0002", "0007", "0100", "ffff"])
def test_another_representation_is_refused(header):
    with pytest.raises(CdrError, match="plain CDR header"):
        interfaces.decode_string(bytes.fromhex(header) + bytes(2) + struct.pack("<I", 1) + b"\x00")


def test_a_big_endian_message_is_read():
    header = bytes(4) + struct.pack(">iII", 7, 9, 4) + b"map\x00"
    polygon = header + struct.pack(">I6f", 2, 1, 2, 3, 4, 5, 6)
    decoded = interfaces.decode_polygon_stamped(polygon)
    assert decoded.header == interfaces.Header(7_000_000_009, "map")
    assert decoded.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert decoded.points.dtype == np.float32
    pose = header + struct.pack(">7d", *range(7))
    assert interfaces.decode_pose_stamped(pose).pose == interfaces.Pose((0, 1, 2), (3, 4, 5, 6))


def test_points_are_a_view_of_the_message():
    data = interfaces.encode_marker_array(example_markers())
    (marker,) = interfaces.decode_marker_array(data)
    assert not marker.points.flags.owndata
    assert not marker.points.flags.writeable


@pytest.mark.parametrize("level", [2, 255])
def test_a_bool_that_is_neither_is_refused(level):
    data = bytearray(interfaces.encode_marker_array(example_markers()))
    data[-1] = level
    with pytest.raises(CdrError, match="0 or 1 for mesh_use_embedded_materials"):
        interfaces.decode_marker_array(bytes(data))


@pytest.mark.parametrize(
    "encode",
    [
        lambda: interfaces.encode_string("a\x00b"),
        lambda: interfaces.encode_string("\ud800"),
        lambda: interfaces.encode_mesh(np.array([[0, 1, -1]]), np.zeros((3, 3))),
        lambda: interfaces.encode_mesh(np.array([[0, 1, 2**32]]), np.zeros((3, 3))),
        lambda: interfaces.encode_mesh(np.array([[0.5, 1, 2]]), np.zeros((3, 3))),
        lambda: interfaces.encode_mesh(np.array([[0, 1, 2]]), np.zeros((3, 2))),
        lambda: interfaces.encode_marker(interfaces.Marker(id=2**31)),
        lambda: interfaces.encode_marker(interfaces.Marker(color=(1e300, 0, 0, 1))),
        lambda: interfaces.encode_marker(interfaces.Marker(lifetime=2**31 * 10**9)),
        lambda: interfaces.encode_marker(interfaces.Marker(scale=(1.0, 2.0))),
    ],
)
def test_a_value_that_no_message_can_hold_is_refused(encode):
    with pytest.raises(CdrError, match="Expected"):
        encode()
