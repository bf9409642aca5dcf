"""What the messages mean: contours with camera poses to views, and views to messages.

The rules are those of the README's section on messages. Nothing here knows where the bytes come
from: the node and the bags use the same code.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from momrec_core.camera import Camera
from momrec_core.errors import InvalidCameraError, MomrecError
from momrec_core.view import View
from momrec_ros.calibration import Calibration, calibration_of
from momrec_ros.errors import CdrError, MessageError, Reason, TransformError
from momrec_ros.interfaces import (
    Header,
    Marker,
    MarkerAction,
    MarkerType,
    PolygonStamped,
    Pose,
    PoseStamped,
    decode_camera_info,
    decode_image,
    decode_marker_array,
    decode_polygon_stamped,
    decode_pose_stamped,
    decode_transforms,
    encode_camera_info,
    encode_image,
    encode_marker_array,
    encode_pose_stamped,
)
from momrec_ros.mask_messages import (
    MaskRules,
    PackedMask,
    camera_info_of,
    image_of_mask,
    view_of_mask,
)
from momrec_ros.matching import Key, Parts, Rejected, Waiting, repeated, unmatched
from momrec_ros.poses import MAX_NAME, matrix_from_pose, pose_from_matrix
from momrec_ros.transform_buffer import TransformBuffer

__all__ = [
    "PROJECTIONS",
    "Event",
    "Forget",
    "Rejected",
    "StampedView",
    "ViewDecoder",
    "encode_mask",
    "encode_view",
    "pose_from_matrix",
    "rings_in_camera",
]

PROJECTIONS = ("auto", "orthographic", "central")
MAX_POINTS = 1_000_000  # a view: far above any contour, far below what fills the memory
MAX_RINGS = 10_000  # a view: likewise
MAX_PENDING = 1000  # stamps of which parts wait: half a minute of a camera at 30 Hz
RING_WIDTH = 0.002  # metres, of the drawn line
RING_COLOR = (1.0, 0.6, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class StampedView:
    """A view with its object and time.

    Attributes
    ----------
    object_id : str
        Which object was seen; empty where there is only one.
    stamp : int
        Time of exposure, nanoseconds.
    frame_id : str
        Name of the world frame.
    view : View
        Camera and silhouette.
    is_cut : bool
        Whether the border of the image cuts the object; the silhouette goes on beyond it then.
    camera : str
        Name of the camera's optical frame where it is known, else empty.
    """

    object_id: str
    stamp: int
    frame_id: str
    view: View
    is_cut: bool = False
    camera: str = ""


@dataclass(frozen=True)
class Forget:
    """A request to forget an object; an empty ``object_id`` stands for all objects."""

    object_id: str


Event = StampedView | Forget | Rejected


def _is_central(depths: NDArray[np.float64], projection: str) -> bool:
    """Tell by the points' z whether rays (all z > 0) or plane points (all z = 0) came."""
    flat, central = bool((depths == 0).all()), bool((depths > 0).all())
    if not (flat or central):
        raise MessageError(
            Reason.PROJECTION,
            "Expected all z = 0 (orthographic) or all z > 0 (central), got z from "
            f"{depths.min():.6g} to {depths.max():.6g}",
        )
    found = "central" if central else "orthographic"
    if projection not in ("auto", found):
        raise MessageError(
            Reason.PROJECTION, f"Expected {projection} projection, got {found} contours"
        )
    return central


def _make_view(
    world_from_camera: NDArray[np.float64], rings: Sequence[NDArray[np.floating]], projection: str
) -> View:
    points = np.concatenate([np.asarray(ring, np.float64) for ring in rings])
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise MessageError(
            Reason.POINTS,
            f"Expected finite points, got {points[~finite][0].tolist()} as point "
            f"{int(np.flatnonzero(~finite)[0])} of {len(points)}",
        )
    if _is_central(points[:, 2], projection):
        with np.errstate(over="ignore", invalid="ignore"):
            points = points[:, :2] / points[:, 2:]
        camera = Camera.pinhole(world_from_camera, np.eye(3))
    else:
        camera = Camera.orthographic(world_from_camera)
    ends = np.cumsum([len(ring) for ring in rings])[:-1]
    return View.from_rings(camera, np.split(points[:, :2], ends))


def _agree(values: Sequence[object], field: Reason) -> None:
    for value in values[1:]:
        if value != values[0]:
            raise MessageError(
                field,
                f"Expected one {field} in all markers of a message, got {values[0]!r:.200} and "
                f"{value!r:.200}",
            )


class ViewDecoder:
    """Turns serialised messages into events, and remembers what the next one must agree with.

    Parameters
    ----------
    projection : {"auto", "orthographic", "central"}
        What contours must be; ``"auto"`` tells by their z.
    world_frame : str
        The frame that camera poses must be in; empty for that of the first view.
    max_points : int
        Refuse a message with more points.
    max_pending : int
        Of how many stamps parts of views wait for their others.
    rules : MaskRules, optional
        How masks become silhouettes; by default half a pixel's tolerance, a quarter's margin.
    transforms : TransformBuffer, optional
        Tells where the masks' optical frames are, in place of camera poses.

    Raises
    ------
    MessageError
        If the projection is none of the three, or transforms come without a world frame.
    """

    def __init__(
        self,
        projection: str = "auto",
        world_frame: str = "",
        *,
        max_points: int = MAX_POINTS,
        max_pending: int = MAX_PENDING,
        rules: MaskRules | None = None,
        transforms: TransformBuffer | None = None,
    ) -> None:
        if projection not in PROJECTIONS:
            raise MessageError(
                Reason.PROJECTION, f"Expected one of {', '.join(PROJECTIONS)}, got {projection!r}"
            )
        if transforms is not None and not world_frame:
            raise MessageError(
                Reason.FRAME, "Expected a world_frame where poses come from transforms, got none"
            )
        self._projection = projection
        self._world_frame = world_frame
        self._max_points = max_points
        self._rules = MaskRules() if rules is None else rules
        self._transforms = transforms
        self._waiting = Waiting(max_pending, self._explained)
        self._unplaced: dict[Key, list[TransformError]] = {}  # why masks are not placed yet

    @property
    def world_frame(self) -> str:
        """Name of the world frame; empty before the first view."""
        return self._world_frame

    def marker_array(self, data: bytes) -> tuple[Event, ...]:
        """Read one message of contours.

        Parameters
        ----------
        data : bytes
            A serialised visualization_msgs/MarkerArray.

        Returns
        -------
        events : tuple of StampedView, Forget or Rejected
            Usually one; none where the message only deletes markers of a display.
        """
        try:
            markers = decode_marker_array(data, MAX_RINGS)
        except CdrError as error:
            return (_rejected("", error),)
        rings = [marker for marker in markers if marker.action == MarkerAction.ADD]
        first = next(iter(rings or markers), Marker())
        try:
            if any(marker.action not in tuple(MarkerAction) for marker in markers):
                actions = sorted({marker.action for marker in markers})
                raise MessageError(
                    Reason.ACTION, f"Expected ADD, DELETE or DELETEALL, got {actions}"
                )
            if rings:
                return (self._view(rings),)
            if not markers:
                raise MessageError(Reason.EMPTY, "Expected at least one marker, got an empty array")
        except MomrecError as error:
            return (_rejected(first.ns[:MAX_NAME], error, first.header.stamp),)
        forgotten = (marker.ns for marker in markers if marker.action == MarkerAction.DELETEALL)
        return tuple(Forget(ns) for ns in dict.fromkeys(forgotten))

    def _view(self, markers: Sequence[Marker]) -> StampedView:
        _agree([marker.header for marker in markers], Reason.HEADER)
        _agree([marker.ns for marker in markers], Reason.NS)
        _agree([marker.pose for marker in markers], Reason.POSE)
        kinds = {marker.type for marker in markers}
        if kinds != {MarkerType.LINE_STRIP}:
            raise MessageError(
                Reason.TYPE,
                f"Expected markers of type LINE_STRIP ({MarkerType.LINE_STRIP:d}) only, got type "
                f"{' and '.join(map(str, sorted(kinds)))}",
            )
        return self._stamped(
            markers[0].ns,
            markers[0].header,
            markers[0].pose,
            [marker.points for marker in markers],
        )

    def polygon(self, data: bytes, source: str = "", now: int = 0) -> tuple[Event, ...]:
        """Read one geometry_msgs/PolygonStamped and pair it with its camera pose.

        Parameters
        ----------
        data : bytes
            The serialised message.
        source : str
            Name of the camera; halves pair within a source.
        now : int
            Time of arrival, nanoseconds, for `expire`.

        Returns
        -------
        events : tuple of StampedView or Rejected
            Empty while the other half is missing; a half that waited too long is rejected.
        """
        try:
            polygon = decode_polygon_stamped(data)
            self._check_size([polygon.points])
        except MomrecError as error:
            return (_rejected("", error),)
        key = source, polygon.header.stamp
        parts = self._waiting.open(key, now)
        again = parts.polygon is not None
        # A copy, because the points are a view of the whole message.
        parts.polygon = PolygonStamped(polygon.header, polygon.points.copy())
        return self._matched(key, repeated("contour", key[1]) if again else None)

    def camera_pose(self, data: bytes, source: str = "", now: int = 0) -> tuple[Event, ...]:
        """Read one geometry_msgs/PoseStamped and match it with what it is the pose of.

        See `polygon` and `mask`.
        """
        try:
            pose = decode_pose_stamped(data)
        except CdrError as error:
            return (_rejected("", error),)
        key = source, pose.header.stamp
        parts = self._waiting.open(key, now)
        again = parts.pose is not None
        parts.pose = pose
        return self._matched(key, repeated("camera_pose", key[1]) if again else None)

    def mask(self, data: bytes, source: str = "", now: int = 0) -> tuple[Event, ...]:
        """Read one sensor_msgs/Image and match it with its camera_info and its camera's pose.

        Its calibration has its stamp and optical frame; the pose is that of a camera_pose with
        its stamp or, where there are transforms, that of its optical frame at its stamp.

        Parameters
        ----------
        data, source, now
            As for `polygon`.

        Returns
        -------
        events : tuple of StampedView or Rejected
            Empty while something is missing.
        """
        try:
            image = decode_image(data)
            _check_name(Reason.FRAME, image.header.frame_id)
        except MomrecError as error:
            return (_rejected("", error),)
        key = source, image.header.stamp
        masks = self._waiting.open(key, now).masks
        again = masks.get(image.header.frame_id) is not None
        lost = repeated("mask", key[1]) if again else None
        try:
            masks[image.header.frame_id] = PackedMask.of_image(image)
        except MomrecError as error:
            masks[image.header.frame_id] = None
            lost = _rejected("", error, key[1])
        return self._matched(key, lost)

    def camera_info(self, data: bytes, source: str = "", now: int = 0) -> tuple[Event, ...]:
        """Read one sensor_msgs/CameraInfo and match it with its mask; see `mask`."""
        try:
            info = decode_camera_info(data)
            _check_name(Reason.FRAME, info.header.frame_id)
        except MomrecError as error:
            return (_rejected("", error),)
        key = source, info.header.stamp
        calibrations = self._waiting.open(key, now).calibrations
        try:
            calibrations[info.header.frame_id] = calibration_of(
                info, rectified=self._rules.rectified
            )
        except MessageError as error:  # told when its mask comes
            calibrations[info.header.frame_id] = error
        return self._matched(key)

    def transforms(self, data: bytes, *, is_static: bool) -> tuple[Event, ...]:
        """Read one tf2_msgs/TFMessage, and place the masks that waited for it.

        Parameters
        ----------
        data : bytes
            The serialised message.
        is_static : bool
            Whether it came by /tf_static.

        Returns
        -------
        events : tuple of StampedView or Rejected
            Mostly empty.
        """
        if self._transforms is None:
            return ()
        try:
            self._transforms.add(decode_transforms(data), is_static=is_static)
        except CdrError as error:
            return (_rejected("", error),)
        known = self._transforms.knows
        ready = [
            key
            for key, errors in self._unplaced.items()
            if any(known(frame, key[1]) for error in errors for frame in error.ends)
        ]
        return tuple(event for key in ready for event in self._matched(key))

    @property
    def uses_transforms(self) -> bool:
        """Whether poses of masks' cameras come from transforms."""
        return self._transforms is not None

    @property
    def waiting(self) -> int:
        """Of how many stamps parts wait for their others."""
        return len(self._waiting)

    def expire(self, now: int, timeout: int) -> tuple[Rejected, ...]:
        """Reject the parts of views that arrived longer ago than a timeout, and forget them.

        Parameters
        ----------
        now, timeout : int
            Nanoseconds. Should the clock have been set back, or not have been set (0), parts
            count as arrived now.
        """
        return self._waiting.expire(now, timeout)

    def flush(self) -> tuple[Rejected, ...]:
        """Reject what still waits for its others, and forget it."""
        return tuple(sorted(self._waiting.flush(), key=lambda event: event.stamp))

    def _matched(self, key: Key, lost: Rejected | None = None) -> tuple[Event, ...]:
        """Return what a part that came makes, after what it made useless."""
        parts = self._waiting.get(key)
        events: list[Event] = [] if lost is None else [lost]
        if parts is None:
            return tuple(events)
        self._unplaced.pop(key, None)
        if parts.polygon is not None and parts.pose is not None:
            events.append(self._paired(parts.polygon, parts.pose))
            parts.polygon = parts.pose = None
        for frame in [frame for frame in parts.masks if frame in parts.calibrations]:
            events += self._placed(key, parts, frame)
        return (*events, *self._waiting.settle(key))

    def _placed(self, key: Key, parts: Parts, frame: str) -> Iterator[Event]:
        """Use a mask with its calibration, once its camera's pose is known."""
        try:
            pose = self._pose_of(parts, frame, key[1])
        except TransformError as error:
            self._unplaced.setdefault(key, []).append(error)
            return
        if pose is not None:
            mask, calibration = parts.masks.pop(frame), parts.calibrations.pop(frame)
            if mask is not None:
                yield self._seen(mask, calibration, pose, frame)

    def _pose_of(self, parts: Parts, frame: str, stamp: int) -> PoseStamped | None:
        if self._transforms is None:
            pose, parts.pose = parts.pose, None
            return pose
        world_from_camera = self._transforms.lookup(self._world_frame, frame, stamp)
        return PoseStamped(Header(stamp, self._world_frame), pose_from_matrix(world_from_camera))

    def _seen(
        self,
        mask: PackedMask,
        calibration: Calibration | MessageError,
        pose: PoseStamped,
        camera: str,
    ) -> Event:
        header = pose.header
        try:
            if isinstance(calibration, MessageError):
                raise calibration
            if self._projection == "orthographic":
                raise MessageError(
                    Reason.PROJECTION, "Expected orthographic projection, got a mask of a pinhole"
                )
            self._check_names("", header)
            matrix = matrix_from_pose(pose.pose)
            view, is_cut = view_of_mask(mask, calibration, matrix, self._rules)
        except MomrecError as error:
            return _rejected("", error, header.stamp)
        self._world_frame = header.frame_id
        return StampedView("", header.stamp, header.frame_id, view, is_cut, camera)

    def _explained(self, key: Key, parts: Parts) -> Iterator[Rejected]:
        """Tell of parts that are given up what was missing."""
        yield from unmatched(parts, key[1], needs_pose=self._transforms is None)
        for error in self._unplaced.pop(key, []):
            yield _rejected("", error, key[1])

    def _paired(self, polygon: PolygonStamped, pose: PoseStamped) -> Event:
        try:
            return self._stamped("", pose.header, pose.pose, [polygon.points])
        except MomrecError as error:
            return _rejected("", error, pose.header.stamp)

    def _check_size(self, rings: Sequence[NDArray[np.floating]]) -> None:
        total = sum(len(ring) for ring in rings)
        if total > self._max_points:
            raise MessageError(
                Reason.SIZE, f"Expected at most {self._max_points} points in a view, got {total}"
            )

    def _stamped(
        self, object_id: str, header: Header, pose: Pose, rings: Sequence[NDArray[np.floating]]
    ) -> StampedView:
        self._check_size(rings)
        if sum(len(ring) for ring in rings) == 0:
            raise MessageError(
                Reason.POINTS, f"Expected points, got {len(rings)} rings without any"
            )
        self._check_names(object_id, header)
        view = _make_view(matrix_from_pose(pose), rings, self._projection)
        self._world_frame = header.frame_id
        return StampedView(object_id, header.stamp, header.frame_id, view)

    def _check_names(self, object_id: str, header: Header) -> None:
        _check_name(Reason.NS, object_id)
        _check_name(Reason.FRAME, header.frame_id)
        if not header.frame_id:
            raise MessageError(Reason.FRAME, "Expected the name of the world frame, got none")
        if header.frame_id != (self._world_frame or header.frame_id):
            raise MessageError(
                Reason.FRAME,
                f"Expected the world frame {self._world_frame!r}, got {header.frame_id!r}",
            )


def _check_name(reason: Reason, name: str) -> None:
    if len(name) > MAX_NAME:
        raise MessageError(
            reason, f"Expected a name of at most {MAX_NAME} characters, got {len(name)}"
        )


def _rejected(object_id: str, error: MomrecError, stamp: int = 0) -> Rejected:
    if isinstance(error, MessageError):
        return Rejected(object_id, str(error), stamp, error.reason)
    kinds = {CdrError: Reason.ENCODING, InvalidCameraError: Reason.CALIBRATION}
    return Rejected(object_id, str(error), stamp, kinds.get(type(error), Reason.CONTOUR))


def encode_mask(
    inside: NDArray[np.bool_], camera: Camera, stamp: int, frame_id: str, camera_frame: str
) -> tuple[bytes, bytes, bytes]:
    """Write what a camera saw as sensor_msgs/Image, CameraInfo and geometry_msgs/PoseStamped.

    Parameters
    ----------
    inside : array of bool, shape (height, width)
        Which pixels are object.
    camera : Camera
        A pinhole without distortion.
    stamp : int
        Time of exposure, nanoseconds.
    frame_id, camera_frame : str
        Names of the world frame and of the optical frame.

    Returns
    -------
    mask, camera_info, camera_pose : bytes
        Serialised.

    Raises
    ------
    CdrError
        If the stamp or a name fits no message.
    InvalidCameraError
        If the projection is parallel, which no camera_info tells of.
    """
    if camera.K is None:
        raise InvalidCameraError("Expected a pinhole camera for a mask, got parallel projection")
    header = Header(stamp, camera_frame)
    height, width = inside.shape
    pose = PoseStamped(Header(stamp, frame_id), pose_from_matrix(camera.pose))
    return (
        encode_image(image_of_mask(inside, header)),
        encode_camera_info(camera_info_of(camera.K, (width, height), header)),
        encode_pose_stamped(pose),
    )


def rings_in_camera(view: View) -> list[NDArray[np.float64]]:
    """Return a view's rings in the camera frame, closed.

    Parameters
    ----------
    view : View
        Any.

    Returns
    -------
    rings : list of array, shape (n_i, 3)
        The last point repeats the first; metres on z = 0 for parallel projection, rays on the
        plane z = 1 for a pinhole.
    """
    rings = []
    for ring in view.rings:
        closed = np.zeros((len(ring) + 1, 3))
        closed[:-1, :2], closed[-1, :2] = ring, ring[0]
        if view.camera.is_pinhole:
            closed = view.camera.rays_camera(closed[:, :2])
        rings.append(closed)
    return rings


def encode_view(stamped: StampedView) -> bytes:
    """Write a view as a visualization_msgs/MarkerArray that any viewer shows.

    Parameters
    ----------
    stamped : StampedView
        One marker is written for each ring, holes included.

    Raises
    ------
    CdrError
        If the stamp or a name fits no message.
    """
    header = Header(stamped.stamp, stamped.frame_id)
    pose = pose_from_matrix(stamped.view.camera.pose)
    return encode_marker_array(
        [
            Marker(
                header=header,
                ns=stamped.object_id,
                id=number,
                type=MarkerType.LINE_STRIP,
                pose=pose,
                scale=(RING_WIDTH, 0.0, 0.0),
                color=RING_COLOR,
                points=ring,
            )
            for number, ring in enumerate(rings_in_camera(stamped.view))
        ]
    )
