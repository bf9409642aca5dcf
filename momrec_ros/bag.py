"""Reads recorded contours: rosbag2 folders and single mcap files, whole, cut or damaged.

See Also
--------
momrec_ros.bag_writer.BagWriter : writes such bags.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import-untyped]

from momrec_ros.bag_writer import (
    CAMERA_INFO_TYPE,
    CONTOURS_TYPE,
    MASK_TYPE,
    METADATA_FILE,
    POSE_TYPE,
    BagWriter,
)
from momrec_ros.errors import BagError
from momrec_ros.mask_messages import MaskRules
from momrec_ros.mcap_scan import Loss, McapScan, RawMessage
from momrec_ros.messages import MAX_POINTS, Event, Forget, Rejected, StampedView, ViewDecoder
from momrec_ros.parameters import PoseSource
from momrec_ros.transform_buffer import TransformBuffer
from momrec_ros.transforms import TRANSFORMS_TYPE

__all__ = [
    "BagError",
    "BagReader",
    "BagReport",
    "BagWriter",
    "Forget",
    "Loss",
    "Rejected",
    "StampedView",
    "read_bag",
]

# Last part of an input's topic and its type; what stands before is the namespace.
INPUTS = {
    "contours": CONTOURS_TYPE,
    "contour": "geometry_msgs/msg/PolygonStamped",
    "camera_pose": POSE_TYPE,
    "mask": MASK_TYPE,
    "camera_info": CAMERA_INFO_TYPE,
}
SIDE_INPUTS = ("camera_info",)  # alone they are neither a view nor half of one
SILHOUETTES = ("contours", "contour", "mask")
TRANSFORMS = {"/tf": False, "/tf_static": True}  # and whether they hold for ever
ENCODING = "cdr"
SORTING_WINDOW = 1 << 25  # bytes of messages held back to sort them by time
MESSAGE_OVERHEAD = 512  # bytes that a held message takes beside its data
LARGEST_METADATA = 1 << 22  # bytes of a metadata.yaml; a thousand topics take 1 MB
MANY_FILES = 100_000  # in one bag
LISTED_TOPICS = 8  # in a message to people


@dataclass(frozen=True)
class BagReport:
    """How much of a bag was read, and what was not.

    Attributes
    ----------
    messages : int
        Messages of the inputs that were read.
    rejected : int
        How many events of these were rejections.
    losses : tuple of Loss
        What of the files could not be read; empty for a bag that is whole.
    notes : tuple of str
        What else people should know, such as several topics with contours.
    """

    messages: int = 0
    rejected: int = 0
    losses: tuple[Loss, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def lost_bytes(self) -> int:
        """Bytes of the files that are there but of no use."""
        return sum(loss.size for loss in self.losses)

    @property
    def is_whole(self) -> bool:
        """Whether nothing of the files was lost."""
        return not self.losses


def _split_topic(topic: str) -> tuple[str, str]:
    namespace, _, name = topic.rpartition("/")
    return namespace, name


class BagReader:
    """Iterates, once, over the events of a bag in the order in which they were recorded.

    Made with `read_bag`. Messages are sorted by log time within a window of 32 MB, so that memory
    does not grow with the bag.

    Attributes
    ----------
    size : int
        Of all files together, bytes.
    position : int
        Up to where of these the events yielded so far come from, for progress.
    """

    def __init__(self, paths: Iterable[Path], losses: Iterable[Loss], decoder: ViewDecoder) -> None:
        self._scans = [McapScan(path, self._wanted) for path in paths]
        self._losses = list(losses)
        self._decoder = decoder
        self._inputs: list[str] = []
        self._others: dict[str, str] = {}
        self._messages = 0
        self._rejected = 0
        self._last_time = 0
        self._is_sorted = True
        self.size = sum(scan.size for scan in self._scans)
        self.position = 0

    @property
    def report(self) -> BagReport:
        """What was read so far and what was lost; complete after the iteration."""
        losses = [*self._losses, *(loss for scan in self._scans for loss in scan.losses)]
        return BagReport(self._messages, self._rejected, tuple(losses), tuple(self._notes()))

    def __iter__(self) -> Iterator[Event]:
        for message in self._sorted():
            self._messages += 1
            events = self._events(message)
            yield from self._counted(_timed(event, message.log_time) for event in events)
        yield from self._counted(self._decoder.flush())
        if not self._inputs:
            raise BagError(self._nothing_found())

    def _counted(self, events: Iterable[Event]) -> Iterator[Event]:
        for event in events:
            self._rejected += isinstance(event, Rejected)
            yield event

    def _wanted(self, topic: str, type_name: str, encoding: str) -> bool:
        _, name = _split_topic(topic)
        if encoding == ENCODING and topic in TRANSFORMS:
            return self._decoder.uses_transforms and type_name == TRANSFORMS_TYPE
        if encoding == ENCODING and INPUTS.get(name) == type_name:
            if topic not in self._inputs and name not in SIDE_INPUTS:
                self._inputs.append(topic)
            return True
        if len(self._others) < LISTED_TOPICS:
            self._others[topic] = type_name or encoding
        return False

    def _events(self, message: RawMessage) -> tuple[Event, ...]:
        namespace, name = _split_topic(message.topic)
        if message.topic in TRANSFORMS:
            return self._decoder.transforms(message.data, is_static=TRANSFORMS[message.topic])
        if name == "contours":
            return self._decoder.marker_array(message.data)
        if name == "contour":
            return self._decoder.polygon(message.data, namespace)
        if name == "mask":
            return self._decoder.mask(message.data, namespace)
        if name == "camera_info":
            return self._decoder.camera_info(message.data, namespace)
        return self._decoder.camera_pose(message.data, namespace)

    def _sorted(self) -> Iterator[RawMessage]:
        """Hold messages back until the window is full, and release the earliest first."""
        waiting: list[tuple[int, int, int, RawMessage]] = []
        held = 0
        for number, message in enumerate(message for scan in self._scans for message in scan):
            read = sum(scan.position for scan in self._scans)
            heapq.heappush(waiting, (message.log_time, number, read, message))
            held += len(message.data) + MESSAGE_OVERHEAD
            while held > SORTING_WINDOW:
                held -= len(waiting[0][-1].data) + MESSAGE_OVERHEAD
                yield self._released(*heapq.heappop(waiting)[2:])
        while waiting:
            yield self._released(*heapq.heappop(waiting)[2:])
        self.position = self.size

    def _released(self, read: int, message: RawMessage) -> RawMessage:
        self.position = max(self.position, read)
        self._is_sorted &= message.log_time >= self._last_time
        self._last_time = message.log_time
        return message

    def _notes(self) -> Iterator[str]:
        sources = [
            topic
            for name in SILHOUETTES
            for topic in sorted(self._inputs)
            if _split_topic(topic)[1] == name
        ]
        if len(sources) > 1:
            yield f"contours on {len(sources)} topics, all of them used: {', '.join(sources)}"
        if not self._is_sorted:
            yield (
                "messages farther out of order than can be sorted in "
                f"{SORTING_WINDOW} bytes; used in the order found"
            )

    def _nothing_found(self) -> str:
        topics = ", ".join(f"{topic} ({kind})" for topic, kind in self._others.items())
        lost = "".join(f"; {loss.reason}" for loss in self.report.losses[:1])
        return (
            f"Expected a topic named contours ({CONTOURS_TYPE}), or contour and camera_pose, or "
            f"mask, camera_info and camera_pose, in the bag, got {topics or 'no topics'}{lost}"
        )


def _timed(event: Event, log_time: int) -> Event:
    """Give what could not even be decoded the time of its recording."""
    if isinstance(event, Rejected) and event.stamp == 0:
        return replace(event, stamp=log_time)
    return event


def read_bag(
    path: str | Path,
    *,
    projection: str = "auto",
    world_frame: str = "",
    max_points: int = MAX_POINTS,
    rules: MaskRules | None = None,
    pose_source: str = PoseSource.TOPIC,
) -> BagReader:
    """Open a bag.

    Parameters
    ----------
    path : path-like
        A rosbag2 folder with mcap files, or one mcap file.
    projection : {"auto", "orthographic", "central"}
        As for `ViewDecoder`.
    world_frame : str
        As for `ViewDecoder`.
    max_points : int
        As for `ViewDecoder`.
    rules : MaskRules, optional
        As for `ViewDecoder`.
    pose_source : {"topic", "tf"}
        Whether masks' cameras are where ``camera_pose`` says, or ``/tf`` and ``/tf_static``.

    Returns
    -------
    reader : BagReader
        Yields `StampedView`, `Forget` and `Rejected`. Reads the topics of any namespace named
        ``contours`` (MarkerArray), pairs of ``contour`` and ``camera_pose``, and ``mask`` with
        ``camera_info`` and ``camera_pose``. Its iteration raises `BagError` at the end if there
        was no such topic.

    Raises
    ------
    BagError
        If there is no bag, it is of another kind, or none of its files can be read.
    MessageError
        As for `ViewDecoder`.
    """
    transforms = TransformBuffer() if pose_source == PoseSource.TF else None
    decoder = ViewDecoder(
        projection, world_frame, max_points=max_points, rules=rules, transforms=transforms
    )
    path = Path(path)
    if not path.is_dir():
        return BagReader([path], [], decoder)
    files, losses = _files_of_folder(path)
    return BagReader(files, losses, decoder)


def _files_of_folder(folder: Path) -> tuple[list[Path], list[Loss]]:
    """Return a folder's mcap files in their order, and what of them is missing or foreign."""
    try:
        named = [_inside(folder, name) for name in _relative_paths(folder / METADATA_FILE)]
        losses = []
    except _MetadataError as error:
        named = sorted(folder.glob("*.mcap"), key=_natural_order)
        losses = [Loss(0, f"{METADATA_FILE} {error}; read {len(named)} mcap files beside it")]
    if not named:
        raise BagError(
            f"Expected a rosbag2 folder with mcap files, got {folder} ({losses[0].reason})"
        )
    readable = []
    for file in named:
        try:
            McapScan(file, lambda *_: False)
        except BagError as error:
            losses.append(Loss(0, str(error)))
        else:
            readable.append(file)
    if not readable:
        raise BagError(
            f"Expected a readable file in the bag {folder}, got none: {losses[0].reason}"
        )
    return readable, losses


class _MetadataError(Exception):
    """A metadata.yaml that is missing or damaged: the bag may still be read without it."""


def _relative_paths(path: Path) -> list[str]:
    information = _load_metadata(path)
    storage = information.get("storage_identifier")
    mode = information.get("compression_mode") or "none"
    names = information.get("relative_file_paths")
    # Only text is ever printed: other values may be aliases that unfold to gigabytes.
    if not isinstance(storage, str) or not isinstance(mode, str):
        raise _MetadataError("does not name the bag's storage")
    if storage != "mcap":
        raise BagError(f"Expected a bag stored as mcap, got {storage!r:.80} in {path.parent}")
    if mode.lower() != "none":
        raise BagError(
            f"Expected a bag compressed by chunks or not at all, got mode {mode!r:.80} in "
            f"{path.parent}: convert it with `ros2 bag convert`"
        )
    if not isinstance(names, list) or not 0 < len(names) <= MANY_FILES:
        raise _MetadataError("does not list the bag's files")
    if not all(isinstance(name, str) for name in names):
        raise _MetadataError("lists files that are no names")
    return list(dict.fromkeys(names))


def _load_metadata(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_METADATA)
        document = yaml.safe_load(content)
    except OSError as error:
        raise _MetadataError(f"cannot be read ({error.strerror})") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise _MetadataError("is damaged") from error
    key = "rosbag2_bagfile_information"
    information = document.get(key) if isinstance(document, dict) else None
    if not isinstance(information, dict):
        raise _MetadataError(f"has no {key}")
    return information


def _inside(folder: Path, name: str) -> Path:
    path = folder / name
    try:
        is_inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # names too long, with NUL, links in a circle
        is_inside = False
    if not is_inside:
        raise BagError(f"Expected the bag's files inside {folder}, got {name!r:.200}")
    return path


def _natural_order(path: Path) -> tuple[int, str]:
    """Sort ``bag_10.mcap`` after ``bag_9.mcap``."""
    return len(path.name), path.name
