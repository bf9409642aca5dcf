"""The messages of common_interfaces and vision_msgs that momrec meets, in serialised form.

Every class holds the fields of one message of ROS 2 Jazzy, in the message's order. Times are
nanoseconds; arrays of points stay arrays. The meaning of the messages is in `momrec_ros.messages`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from momrec_ros.cdr import CdrReader, CdrWriter
from momrec_ros.errors import CdrError

__all__ = [
    "BoundingBox3D",
    "CameraInfo",
    "CompressedImage",
    "Detection3D",
    "Detection3DArray",
    "DiagnosticArray",
    "DiagnosticStatus",
    "Header",
    "Image",
    "Level",
    "Marker",
    "MarkerAction",
    "MarkerBlock",
    "MarkerType",
    "MeshFile",
    "ObjectHypothesisWithPose",
    "PolygonStamped",
    "Pose",
    "PoseStamped",
    "RegionOfInterest",
    "Transform",
    "decode_camera_info",
    "decode_detection_array",
    "decode_diagnostic_array",
    "decode_image",
    "decode_marker_array",
    "decode_mesh",
    "decode_polygon_stamped",
    "decode_pose_stamped",
    "decode_string",
    "decode_transforms",
    "encode_camera_info",
    "encode_detection_array",
    "encode_diagnostic_array",
    "encode_image",
    "encode_marker",
    "encode_marker_array",
    "encode_marker_blocks",
    "encode_mesh",
    "encode_polygon_stamped",
    "encode_pose_stamped",
    "encode_string",
    "encode_transforms",
]

SECOND = 1_000_000_000  # nanoseconds
SMALLEST_MARKER = 200  # bytes: less than its fixed fields take, to judge a count by
SMALLEST_STATUS = 20
SMALLEST_PAIR = 8
SMALLEST_TRANSFORM = 70
SMALLEST_DETECTION = 80
SMALLEST_HYPOTHESIS = 356


class MarkerType(IntEnum):
    """The types of visualization_msgs/Marker that momrec reads or writes."""

    LINE_STRIP = 4
    LINE_LIST = 5
    TEXT_VIEW_FACING = 9
    TRIANGLE_LIST = 11


class MarkerAction(IntEnum):
    """The actions of visualization_msgs/Marker."""

    ADD = 0
    DELETE = 2
    DELETEALL = 3


class Level(IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Header:
    """std_msgs/Header: when, in nanoseconds, and in which frame."""

    stamp: int = 0
    frame_id: str = ""


@dataclass(frozen=True)
class Pose:
    """geometry_msgs/Pose: position in metres (x, y, z) and quaternion (x, y, z, w)."""

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class PoseStamped:
    """geometry_msgs/PoseStamped."""

    header: Header = Header()
    pose: Pose = Pose()


@dataclass(frozen=True)
class Transform:
    """geometry_msgs/TransformStamped: the pose of a child frame in the frame of the header."""

    header: Header = Header()
    child_frame_id: str = ""
    pose: Pose = Pose()


@dataclass(frozen=True, eq=False)
class PolygonStamped:
    """geometry_msgs/PolygonStamped; points float32, shape (n, 3)."""

    header: Header
    points: NDArray[np.float32]


@dataclass(frozen=True)
class Image:
    """sensor_msgs/Image; ``step`` is the length of a row in bytes."""

    header: Header = Header()
    height: int = 0
    width: int = 0
    encoding: str = ""
    is_bigendian: int = 0
    step: int = 0
    data: bytes = b""


@dataclass(frozen=True)
class RegionOfInterest:
    """sensor_msgs/RegionOfInterest; all zeros for the whole image."""

    x_offset: int = 0
    y_offset: int = 0
    height: int = 0
    width: int = 0
    do_rectify: bool = False


@dataclass(frozen=True)
class CameraInfo:
    """sensor_msgs/CameraInfo; k, r (3 x 3) and p (3 x 4) row by row, for the full resolution."""

    header: Header = Header()
    height: int = 0
    width: int = 0
    distortion_model: str = ""
    d: tuple[float, ...] = ()
    k: tuple[float, ...] = (0.0,) * 9
    r: tuple[float, ...] = (0.0,) * 9
    p: tuple[float, ...] = (0.0,) * 12
    binning_x: int = 0
    binning_y: int = 0
    roi: RegionOfInterest = RegionOfInterest()


@dataclass(frozen=True)
class CompressedImage:
    """sensor_msgs/CompressedImage."""

    header: Header = Header()
    format: str = ""
    data: bytes = b""


@dataclass(frozen=True)
class MeshFile:
    """visualization_msgs/MeshFile."""

    filename: str = ""
    data: bytes = b""


def _no_rows(columns: int, dtype: type[np.floating[Any]]) -> NDArray[Any]:
    return np.empty((0, columns), dtype)


@dataclass(frozen=True, eq=False)
class Marker:
    """visualization_msgs/Marker.

    Attributes
    ----------
    scale : tuple of 3 floats
        Its meaning depends on the type; metres.
    color : tuple of 4 floats
        Red, green, blue, alpha, 0 to 1.
    lifetime : int
        Nanoseconds; 0 is for ever.
    points : array, shape (n, 3)
        float64, in the frame of ``pose``.
    colors : array, shape (n, 4)
        float32; none, or one a point.
    uv_coordinates : array, shape (n, 2)
        float32.
    """

    header: Header = Header()
    ns: str = ""
    id: int = 0
    type: int = 0
    action: int = MarkerAction.ADD
    pose: Pose = Pose()
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    lifetime: int = 0
    frame_locked: bool = False
    points: NDArray[np.float64] = field(default_factory=lambda: _no_rows(3, np.float64))
    colors: NDArray[np.float32] = field(default_factory=lambda: _no_rows(4, np.float32))
    texture_resource: str = ""
    texture: CompressedImage = CompressedImage()
    uv_coordinates: NDArray[np.float32] = field(default_factory=lambda: _no_rows(2, np.float32))
    text: str = ""
    mesh_resource: str = ""
    mesh_file: MeshFile = MeshFile()
    mesh_use_embedded_materials: bool = False


@dataclass(frozen=True)
class MarkerBlock:
    """Markers serialised once for any place in any array.

    From the first marker's pose on everything is aligned to 8 bytes; only the few fields before
    it, aligned to 4, may lie in two ways.

    Attributes
    ----------
    count : int
        Markers.
    name : bytes
        The first marker's fields before its pose.
    rest : bytes
        All that follows.
    """

    count: int
    name: bytes
    rest: bytes


@dataclass(frozen=True)
class DiagnosticStatus:
    """diagnostic_msgs/DiagnosticStatus; values are pairs of key and value."""

    level: int = Level.OK
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class DiagnosticArray:
    """diagnostic_msgs/DiagnosticArray."""

    header: Header = Header()
    status: tuple[DiagnosticStatus, ...] = ()


@dataclass(frozen=True)
class ObjectHypothesisWithPose:
    """vision_msgs/ObjectHypothesisWithPose, with the messages inside it.

    Attributes
    ----------
    class_id : str
        The class label.
    score : float
        0 to 1.
    pose : Pose
        Of the object.
    covariance : tuple of 36 floats
        Of the pose (x, y, z, and rotations about these axes), row by row; zeros for unknown.
    """

    class_id: str = ""
    score: float = 0.0
    pose: Pose = Pose()
    covariance: tuple[float, ...] = (0.0,) * 36


@dataclass(frozen=True)
class BoundingBox3D:
    """vision_msgs/BoundingBox3D: pose of its centre, and lengths of its edges in metres."""

    center: Pose = Pose()
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Detection3D:
    """vision_msgs/Detection3D; the hypotheses are in ``results``, best first."""

    header: Header = Header()
    results: tuple[ObjectHypothesisWithPose, ...] = ()
    bbox: BoundingBox3D = BoundingBox3D()
    id: str = ""


@dataclass(frozen=True)
class Detection3DArray:
    """vision_msgs/Detection3DArray."""

    header: Header = Header()
    detections: tuple[Detection3D, ...] = ()


def _read_time(reader: CdrReader, what: str) -> int:
    seconds, nanoseconds = reader.numbers("iI", 4, what)
    if nanoseconds >= SECOND:
        raise CdrError(f"Expected less than {SECOND} nanoseconds in {what}, got {nanoseconds}")
    return int(seconds) * SECOND + int(nanoseconds)


def _write_time(writer: CdrWriter, nanoseconds: int) -> None:
    writer.numbers("iI", 4, *divmod(nanoseconds, SECOND))


def _read_header(reader: CdrReader, what: str) -> Header:
    stamp = _read_time(reader, f"{what}.stamp")
    return Header(stamp, reader.string(f"{what}.frame_id"))


def _write_header(writer: CdrWriter, header: Header) -> None:
    _write_time(writer, header.stamp)
    writer.string(header.frame_id)


def _read_compressed_image(reader: CdrReader) -> CompressedImage:
    return CompressedImage(
        _read_header(reader, "texture.header"),
        reader.string("texture.format"),
        reader.octets("texture.data"),
    )


def _write_compressed_image(writer: CdrWriter, image: CompressedImage) -> None:
    _write_header(writer, image.header)
    writer.string(image.format)
    writer.octets(image.data)


def _read_marker(reader: CdrReader) -> Marker:
    header = _read_header(reader, "header")
    ns = reader.string("ns")
    identifier, kind, action = reader.numbers("3i", 4, "id, type and action")
    numbers = reader.numbers("10d4f", 8, "pose, scale and color")
    return Marker(
        header=header,
        ns=ns,
        id=identifier,
        type=kind,
        action=action,
        pose=Pose(numbers[:3], numbers[3:7]),
        scale=numbers[7:10],
        color=numbers[10:],
        lifetime=_read_time(reader, "lifetime"),
        frame_locked=reader.boolean("frame_locked"),
        points=reader.array("f8", 3, "points"),
        colors=reader.array("f4", 4, "colors"),
        texture_resource=reader.string("texture_resource"),
        texture=_read_compressed_image(reader),
        uv_coordinates=reader.array("f4", 2, "uv_coordinates"),
        text=reader.string("text"),
        mesh_resource=reader.string("mesh_resource"),
        mesh_file=MeshFile(reader.string("mesh_file.filename"), reader.octets("mesh_file.data")),
        mesh_use_embedded_materials=reader.boolean("mesh_use_embedded_materials"),
    )


def _write_marker(writer: CdrWriter, marker: Marker) -> None:
    _write_marker_name(writer, marker)
    _write_marker_shape(writer, marker)


def _write_marker_name(writer: CdrWriter, marker: Marker) -> None:
    _write_header(writer, marker.header)
    writer.string(marker.ns)
    writer.numbers("3i", 4, marker.id, marker.type, marker.action)


def _write_marker_shape(writer: CdrWriter, marker: Marker) -> None:
    pose = marker.pose
    numbers = (*pose.position, *pose.orientation, *marker.scale, *marker.color)
    lifetime = divmod(marker.lifetime, SECOND)
    writer.numbers("10d4fiIB", 8, *numbers, *lifetime, bool(marker.frame_locked))
    writer.array("f8", 3, marker.points)
    writer.array("f4", 4, marker.colors)
    writer.string(marker.texture_resource)
    _write_compressed_image(writer, marker.texture)
    writer.array("f4", 2, marker.uv_coordinates)
    writer.string(marker.text)
    writer.string(marker.mesh_resource)
    writer.string(marker.mesh_file.filename)
    writer.octets(marker.mesh_file.data)
    writer.numbers("B", 1, bool(marker.mesh_use_embedded_materials))


def decode_marker_array(data: bytes, max_markers: int | None = None) -> tuple[Marker, ...]:
    """Read a visualization_msgs/MarkerArray.

    Parameters
    ----------
    data : bytes-like
        The serialised message.
    max_markers : int, optional
        Refuse a message with more, before any is decoded.

    Returns
    -------
    markers : tuple of Marker
        Their arrays are read-only views of ``data``.

    Raises
    ------
    CdrError
        If the bytes are not exactly such a message, or hold too many markers.
    """
    reader = CdrReader(data)
    count = reader.count(SMALLEST_MARKER, "markers")
    if max_markers is not None and count > max_markers:
        raise CdrError(f"Expected at most {max_markers} markers in a message, got {count}")
    markers = tuple(_read_marker(reader) for _ in range(count))
    reader.finish()
    return markers


def encode_marker_array(markers: Sequence[Marker]) -> bytes:
    """Write a visualization_msgs/MarkerArray; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    writer.count(len(markers))
    for marker in markers:
        _write_marker(writer, marker)
    return writer.finish()


def marker_block(first: Marker, *others: Marker) -> MarkerBlock:
    """Write markers for an array that is put together later.

    Raises
    ------
    CdrError
        If a value fits no message.
    """
    name, rest = CdrWriter(), CdrWriter()
    _write_marker_name(name, first)
    _write_marker_shape(rest, first)
    for marker in others:
        _write_marker(rest, marker)
    return MarkerBlock(1 + len(others), name.content(), rest.content())


def encode_marker_blocks(blocks: Sequence[MarkerBlock]) -> bytes:
    """Write a visualization_msgs/MarkerArray of all markers of blocks, in their order."""
    writer = CdrWriter()
    writer.count(sum(block.count for block in blocks))
    for block in blocks:
        writer.fields(block.name, 4)
        writer.fields(block.rest, 8)
    return writer.finish()


def encode_marker(marker: Marker) -> bytes:
    """Write a visualization_msgs/Marker; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    _write_marker(writer, marker)
    return writer.finish()


def decode_polygon_stamped(data: bytes) -> PolygonStamped:
    """Read a geometry_msgs/PolygonStamped; `CdrError` if the bytes are not exactly one."""
    reader = CdrReader(data)
    polygon = PolygonStamped(_read_header(reader, "header"), reader.array("f4", 3, "points"))
    reader.finish()
    return polygon


def encode_polygon_stamped(polygon: PolygonStamped) -> bytes:
    """Write a geometry_msgs/PolygonStamped; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    _write_header(writer, polygon.header)
    writer.array("f4", 3, polygon.points)
    return writer.finish()


def decode_pose_stamped(data: bytes) -> PoseStamped:
    """Read a geometry_msgs/PoseStamped; `CdrError` if the bytes are not exactly one."""
    reader = CdrReader(data)
    header = _read_header(reader, "header")
    numbers = reader.numbers("7d", 8, "pose")
    reader.finish()
    return PoseStamped(header, Pose(numbers[:3], numbers[3:]))


def encode_pose_stamped(pose: PoseStamped) -> bytes:
    """Write a geometry_msgs/PoseStamped; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    _write_header(writer, pose.header)
    writer.numbers("7d", 8, *pose.pose.position, *pose.pose.orientation)
    return writer.finish()


def decode_image(data: bytes) -> Image:
    """Read a sensor_msgs/Image; `CdrError` if the bytes are not exactly one."""
    reader = CdrReader(data)
    header = _read_header(reader, "header")
    height, width = reader.numbers("2I", 4, "height and width")
    encoding = reader.string("encoding")
    (is_bigendian,) = reader.numbers("B", 1, "is_bigendian")
    (step,) = reader.numbers("I", 4, "step")
    pixels = reader.octets("data")
    reader.finish()
    return Image(header, height, width, encoding, is_bigendian, step, pixels)


def encode_image(image: Image) -> bytes:
    """Write a sensor_msgs/Image; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    _write_header(writer, image.header)
    writer.numbers("2I", 4, image.height, image.width)
    writer.string(image.encoding)
    writer.numbers("B", 1, image.is_bigendian)
    writer.numbers("I", 4, image.step)
    writer.octets(image.data)
    return writer.finish()


def decode_camera_info(data: bytes) -> CameraInfo:
    """Read a sensor_msgs/CameraInfo; `CdrError` if the bytes are not exactly one."""
    reader = CdrReader(data)
    header = _read_header(reader, "header")
    height, width = reader.numbers("2I", 4, "height and width")
    model = reader.string("distortion_model")
    d = tuple(reader.array("f8", 1, "d").ravel().tolist())
    numbers = reader.numbers("30d", 8, "k, r and p")
    binning_x, binning_y = reader.numbers("2I", 4, "binning")
    x, y, roi_height, roi_width = reader.numbers("4I", 4, "roi")
    roi = RegionOfInterest(x, y, roi_height, roi_width, reader.boolean("roi.do_rectify"))
    reader.finish()
    k, r, p = numbers[:9], numbers[9:18], numbers[18:]
    return CameraInfo(header, height, width, model, d, k, r, p, binning_x, binning_y, roi)


def encode_camera_info(info: CameraInfo) -> bytes:
    """Write a sensor_msgs/CameraInfo; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    _write_header(writer, info.header)
    writer.numbers("2I", 4, info.height, info.width)
    writer.string(info.distortion_model)
    writer.array("f8", 1, np.reshape(info.d, (-1, 1)))
    for form, values in (("9d", info.k), ("9d", info.r), ("12d", info.p)):
        writer.numbers(form, 8, *values)
    roi = info.roi
    region = (roi.x_offset, roi.y_offset, roi.height, roi.width)
    writer.numbers("6I", 4, info.binning_x, info.binning_y, *region)
    writer.numbers("B", 1, bool(roi.do_rectify))
    return writer.finish()


def decode_transforms(data: bytes) -> tuple[Transform, ...]:
    """Read a tf2_msgs/TFMessage; `CdrError` if the bytes are not exactly one."""
    reader = CdrReader(data)
    count = reader.count(SMALLEST_TRANSFORM, "transforms")
    transforms = tuple(_read_transform(reader) for _ in range(count))
    reader.finish()
    return transforms


def _read_transform(reader: CdrReader) -> Transform:
    header = _read_header(reader, "header")
    child = reader.string("child_frame_id")
    numbers = reader.numbers("7d", 8, "transform")
    return Transform(header, child, Pose(numbers[:3], numbers[3:]))


def encode_transforms(transforms: Sequence[Transform]) -> bytes:
    """Write a tf2_msgs/TFMessage; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    writer.count(len(transforms))
    for transform in transforms:
        _write_header(writer, transform.header)
        writer.string(transform.child_frame_id)
        writer.numbers("7d", 8, *transform.pose.position, *transform.pose.orientation)
    return writer.finish()


def decode_string(data: bytes) -> str:
    """Read a std_msgs/String; `CdrError` if the bytes are not exactly one."""
    reader = CdrReader(data)
    text = reader.string("data")
    reader.finish()
    return text


def encode_string(text: str) -> bytes:
    """Write a std_msgs/String; `CdrError` if it holds a NUL or is no Unicode."""
    writer = CdrWriter()
    writer.string(text)
    return writer.finish()


def decode_mesh(data: bytes) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
    """Read a shape_msgs/Mesh: triangles (n, 3) and vertices (m, 3); `CdrError` if it is none."""
    reader = CdrReader(data)
    triangles = reader.array("u4", 3, "triangles")
    vertices = reader.array("f8", 3, "vertices")
    reader.finish()
    return triangles, vertices


def encode_mesh(triangles: NDArray[np.integer[Any]], vertices: NDArray[np.float64]) -> bytes:
    """Write a shape_msgs/Mesh; `CdrError` if an index or a shape fits no message.

    Parameters
    ----------
    triangles : array, shape (n, 3)
        Indices of vertices.
    vertices : array, shape (m, 3)
        Coordinates.
    """
    writer = CdrWriter()
    writer.array("u4", 3, triangles)
    writer.array("f8", 3, vertices)
    return writer.finish()


def _read_status(reader: CdrReader) -> DiagnosticStatus:
    (level,) = reader.numbers("B", 1, "level")
    name = reader.string("name")
    message = reader.string("message")
    hardware_id = reader.string("hardware_id")
    count = reader.count(SMALLEST_PAIR, "values")
    values = tuple((reader.string("key"), reader.string("value")) for _ in range(count))
    return DiagnosticStatus(level, name, message, hardware_id, values)


def _write_status(writer: CdrWriter, status: DiagnosticStatus) -> None:
    writer.numbers("B", 1, status.level)
    writer.string(status.name)
    writer.string(status.message)
    writer.string(status.hardware_id)
    writer.count(len(status.values))
    for key, value in status.values:
        writer.string(key)
        writer.string(value)


def decode_diagnostic_array(data: bytes) -> DiagnosticArray:
    """Read a diagnostic_msgs/DiagnosticArray; `CdrError` if the bytes are not exactly one."""
    reader = CdrReader(data)
    header = _read_header(reader, "header")
    count = reader.count(SMALLEST_STATUS, "status")
    status = tuple(_read_status(reader) for _ in range(count))
    reader.finish()
    return DiagnosticArray(header, status)


def encode_diagnostic_array(diagnostics: DiagnosticArray) -> bytes:
    """Write a diagnostic_msgs/DiagnosticArray; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    _write_header(writer, diagnostics.header)
    writer.count(len(diagnostics.status))
    for status in diagnostics.status:
        _write_status(writer, status)
    return writer.finish()


def _read_hypothesis(reader: CdrReader) -> ObjectHypothesisWithPose:
    class_id = reader.string("class_id")
    numbers = reader.numbers("44d", 8, "score, pose and covariance")
    return ObjectHypothesisWithPose(
        class_id, numbers[0], Pose(numbers[1:4], numbers[4:8]), numbers[8:]
    )


def _write_hypothesis(writer: CdrWriter, hypothesis: ObjectHypothesisWithPose) -> None:
    writer.string(hypothesis.class_id)
    pose = hypothesis.pose
    numbers = (hypothesis.score, *pose.position, *pose.orientation, *hypothesis.covariance)
    writer.numbers("44d", 8, *numbers)


def _read_detection(reader: CdrReader) -> Detection3D:
    header = _read_header(reader, "header")
    count = reader.count(SMALLEST_HYPOTHESIS, "results")
    results = tuple(_read_hypothesis(reader) for _ in range(count))
    numbers = reader.numbers("10d", 8, "bbox")
    bbox = BoundingBox3D(Pose(numbers[:3], numbers[3:7]), numbers[7:])
    return Detection3D(header, results, bbox, reader.string("id"))


def _write_detection(writer: CdrWriter, detection: Detection3D) -> None:
    _write_header(writer, detection.header)
    writer.count(len(detection.results))
    for hypothesis in detection.results:
        _write_hypothesis(writer, hypothesis)
    center, size = detection.bbox.center, detection.bbox.size
    writer.numbers("10d", 8, *center.position, *center.orientation, *size)
    writer.string(detection.id)


def decode_detection_array(data: bytes) -> Detection3DArray:
    """Read a vision_msgs/Detection3DArray; `CdrError` if the bytes are not exactly one."""
    reader = CdrReader(data)
    header = _read_header(reader, "header")
    count = reader.count(SMALLEST_DETECTION, "detections")
    detections = tuple(_read_detection(reader) for _ in range(count))
    reader.finish()
    return Detection3DArray(header, detections)


def encode_detection_array(array: Detection3DArray) -> bytes:
    """Write a vision_msgs/Detection3DArray; `CdrError` if a value fits no message."""
    writer = CdrWriter()
    _write_header(writer, array.header)
    writer.count(len(array.detections))
    for detection in array.detections:
        _write_detection(writer, detection)
    return writer.finish()
