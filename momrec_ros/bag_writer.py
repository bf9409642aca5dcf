"""Writes rosbag2 bags (mcap) that `ros2 bag play` can play, at once or not at all.

References
----------
rosbag2 of ROS 2 Jazzy: metadata.yaml version 9, storage plugin mcap. REP 2016: type hashes.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import yaml  # type: ignore[import-untyped]
from mcap.writer import CompressionType, Writer

from momrec_ros.definitions import TYPE_HASHES, message_definition
from momrec_ros.errors import BagError
from momrec_ros.files import new_file, new_folder
from momrec_ros.messages import StampedView, encode_mask, encode_view
from momrec_ros.outputs import markers_message, object_markers, result_messages
from momrec_ros.session import Result

if TYPE_CHECKING:  # bags without results need no scikit-learn
    import numpy as np
    from numpy.typing import NDArray

    from momrec_core.camera import Camera
    from momrec_core.recognizer import ObjectResult

__all__ = [
    "CAMERA_INFO_TYPE",
    "CONTOURS_TOPIC",
    "CONTOURS_TYPE",
    "MASK_TYPE",
    "METADATA_FILE",
    "NODE_NAME",
    "POSE_TYPE",
    "BagWriter",
]

CONTOURS_TOPIC = "/contours"
CONTOURS_TYPE = "visualization_msgs/msg/MarkerArray"
NODE_NAME = "recognizer"
METADATA_FILE = "metadata.yaml"
MASK_TYPE = "sensor_msgs/msg/Image"
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
MASK_TOPICS = {"/mask": MASK_TYPE, "/camera_info": CAMERA_INFO_TYPE, "/camera_pose": POSE_TYPE}
CAMERA_FRAME = "camera"  # the optical frame of masks
METADATA_VERSION = 9
CHUNK_SIZE = 786_432  # bytes, as rosbag2's mcap plugin writes
LAST_STAMP = (1 << 31) * 1_000_000_000  # nanoseconds: what builtin_interfaces/Time can hold
CONTOURS_DEPTH = 100  # messages: ten seconds of a 10 Hz camera
RESULTS_DEPTH = 16  # messages: the last result of each of the default number of objects
INFINITE = {"sec": 9_223_372_036, "nsec": 854_775_807}  # rmw's infinite duration


def _qos(*, durability: str, depth: int) -> list[dict[str, Any]]:
    """Return the offered profile of a topic as metadata.yaml of version 9 has it."""
    return [
        {
            "history": "keep_last",
            "depth": depth,
            "reliability": "reliable",
            "durability": durability,
            "deadline": dict(INFINITE),
            "lifespan": dict(INFINITE),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(INFINITE),
            "avoid_ros_namespace_conventions": False,
        }
    ]


class _Topic:
    """A channel of the file with what metadata.yaml says about it."""

    def __init__(self, writer: Writer, schema_id: int, name: str, type_name: str) -> None:
        self.name = name
        self.type_name = type_name
        self.count = 0
        is_result = name.startswith(f"/{NODE_NAME}/")
        self.qos = (
            _qos(durability="transient_local", depth=RESULTS_DEPTH)
            if is_result
            else _qos(durability="volatile", depth=CONTOURS_DEPTH)
        )
        self.channel_id = writer.register_channel(
            name,
            "cdr",
            schema_id,
            {
                "offered_qos_profiles": yaml.safe_dump(self.qos, sort_keys=False).strip(),
                "topic_type_hash": TYPE_HASHES[type_name],
            },
        )

    def metadata(self) -> dict[str, Any]:
        """Return the topic's entry of metadata.yaml."""
        return {
            "topic_metadata": {
                "name": self.name,
                "type": self.type_name,
                "serialization_format": "cdr",
                "offered_qos_profiles": self.qos,
                "type_description_hash": TYPE_HASHES[self.type_name],
            },
            "message_count": self.count,
        }


class BagWriter:
    """Writes views and results to a new bag; a context manager.

    The bag appears under its name when the context ends well; else nothing is left behind. The
    same input gives the same bytes.

    Parameters
    ----------
    path : path-like
        A rosbag2 folder to be or, with the suffix ``.mcap``, a single file.

    Raises
    ------
    FileExistsError
        On entering or leaving the context, if there is something of that name.

    Examples
    --------
    >>> with BagWriter("views") as bag:  # doctest: +SKIP
    ...     bag.write_view(StampedView("box", 0, "map", view))
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path).absolute()
        self._is_file = self._path.suffix == ".mcap"
        self._stack = ExitStack()
        self._folder: Path | None = None
        self._schemas: dict[str, int] = {}
        self._topics: dict[str, _Topic] = {}
        self._first_stamp: int | None = None
        self._last_stamp = 0

    @property
    def _file_name(self) -> str:
        return self._path.name if self._is_file else f"{self._path.name}_0.mcap"

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            if self._is_file:
                target = stack.enter_context(new_file(self._path))
            else:
                self._folder = stack.enter_context(new_folder(self._path))
                target = self._folder / self._file_name
            stream: BinaryIO = stack.enter_context(target.open("wb"))
            self._writer = Writer(stream, CHUNK_SIZE, compression=CompressionType.NONE)
            self._writer.start(profile="ros2", library="momrec")
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if error is not None:
            self._stack.__exit__(kind, error, traceback)
            return
        with self._stack:
            self._finish()

    def _finish(self) -> None:
        information = self._information()
        text = yaml.safe_dump(information, sort_keys=False)
        self._writer.add_metadata("rosbag2", {"serialized_metadata": text.strip()})
        self._writer.finish()  # type: ignore[no-untyped-call]
        if self._folder is not None:
            whole = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
            (self._folder / METADATA_FILE).write_text(whole, encoding="utf-8")

    def _span(self) -> dict[str, Any]:
        start = self._first_stamp or 0
        return {
            "duration": {"nanoseconds": self._last_stamp - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": sum(topic.count for topic in self._topics.values()),
        }

    def _information(self) -> dict[str, Any]:
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **self._span(),
            "topics_with_message_count": [topic.metadata() for topic in self._topics.values()],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file_name],
            "files": [{"path": self._file_name, **self._span()}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }

    def write_view(self, stamped: StampedView) -> None:
        """Write a view on ``/contours``, at its stamp.

        Parameters
        ----------
        stamped : StampedView
            Object, time, frame and view.

        Raises
        ------
        CdrError, BagError
            If the stamp or a name fits no message.
        """
        self._write(CONTOURS_TOPIC, CONTOURS_TYPE, stamped.stamp, encode_view(stamped))

    def write_mask(
        self, inside: NDArray[np.bool_], camera: Camera, stamp: int, frame_id: str
    ) -> None:
        """Write a mask on ``/mask`` with ``/camera_info`` and ``/camera_pose``, at its stamp.

        Parameters
        ----------
        inside : array of bool, shape (height, width)
            Which pixels are object.
        camera : Camera
            A pinhole without distortion.
        stamp : int
            Time of exposure, nanoseconds.
        frame_id : str
            Name of the world frame.

        Raises
        ------
        CdrError, BagError
            If the stamp or a name fits no message.
        InvalidCameraError
            If the projection is parallel, which no camera_info tells of.
        """
        parts = encode_mask(inside, camera, stamp, frame_id, CAMERA_FRAME)
        for (topic, type_name), data in zip(MASK_TOPICS.items(), parts, strict=True):
            self._write(topic, type_name, stamp, data)

    def write_result(
        self, result: ObjectResult, stamp: int, frame_id: str, *, cut_views: int = 0
    ) -> None:
        """Write what the node publishes for a result, below ``/recognizer``.

        Parameters
        ----------
        result : ObjectResult
            Of one object.
        stamp : int
            Of the last view used, nanoseconds.
        frame_id : str
            Name of the world frame.
        cut_views : int
            Views used in which the border of the image cuts the object.

        Raises
        ------
        CdrError, BagError
            If the stamp or a name fits no message.
        """
        markers = markers_message([object_markers(Result(result, stamp, frame_id))])
        outputs = result_messages(result, stamp, frame_id, cut_views=cut_views)
        for output in (*outputs, markers):
            self._write(f"/{NODE_NAME}/{output.name}", output.type_name, stamp, output.data)

    def _write(self, name: str, type_name: str, stamp: int, data: bytes) -> None:
        if not 0 <= stamp < LAST_STAMP:
            raise BagError(f"Expected a stamp from 0 to {LAST_STAMP} ns, got {stamp}")
        topic = self._topics.get(name) or self._add_topic(name, type_name)
        self._writer.add_message(topic.channel_id, stamp, data, stamp, topic.count)
        topic.count += 1
        self._first_stamp = min(stamp, stamp if self._first_stamp is None else self._first_stamp)
        self._last_stamp = max(stamp, self._last_stamp)

    def _add_topic(self, name: str, type_name: str) -> _Topic:
        if type_name not in self._schemas:
            definition = message_definition(type_name).encode()
            self._schemas[type_name] = self._writer.register_schema(
                type_name, "ros2msg", definition
            )
        self._topics[name] = _Topic(self._writer, self._schemas[type_name], name, type_name)
        return self._topics[name]
