"""What the messages mean: contours with camera poses to views, and views to messages.

The rules are those of the README's section on messages. Nothing here knows where the bytes come
from: the node and the bags use the same code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from momrec_core.camera import Camera
from momrec_core.errors import MomrecError
from momrec_core.view import View
from momrec_ros.errors import CdrError, MessageError, Reason
from momrec_ros.interfaces import (
    Header,
    Marker,
    MarkerAction,
    MarkerType,
    PolygonStamped,
    Pose,
    PoseStamped,
    decode_marker_array,
    decode_polygon_stamped,
    decode_pose_stamped,
    encode_marker_array,
)

__all__ = [
    "PROJECTIONS",
    "Event",
    "Forget",
    "Rejected",
    "StampedView",
    "ViewDecoder",
    "encode_view",
    "pose_from_matrix",
    "rings_in_camera",
]

PROJECTIONS = ("auto", "orthographic", "central")
NORM_TOLERANCE = 1e-2  # of a quaternion: what publishers that print few digits are off
MAX_POINTS = 1_000_000  # a view: far above any contour, far below what fills the memory
MAX_RINGS = 10_000  # a view: likewise
MAX_NAME = 1000  # characters of an object or frame: outputs repeat both, for every contour
MAX_PENDING = 64  # halves of pairs that wait: seconds of a fast camera
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
    """

    object_id: str
    stamp: int
    frame_id: str
    view: View


@dataclass(frozen=True)
class Forget:
    """A request to forget an object; an empty ``object_id`` stands for all objects."""

    object_id: str


@dataclass(frozen=True)
class Rejected:
    """A message that is no view.

    Attributes
    ----------
    object_id : str
        The object where the message names one, else empty.
    text : str
        What was expected and what came.
    stamp : int
        Nanoseconds; 0 where the message has none.
    reason : Reason
        The rule, for counting.
    """

    object_id: str
    text: str
    stamp: int
    reason: Reason


Event = StampedView | Forget | Rejected
Half = TypeVar("Half", PolygonStamped, PoseStamped)


def pose_from_matrix(matrix: NDArray[np.float64]) -> Pose:
    """Return the message form of a rigid motion of shape (4, 4).

    Of the two quaternions it has the one whose first number of w, x, y, z that is not zero is
    positive. Scipy's takes thirty times as long for a single matrix.

    References
    ----------
    Shepperd, S. W. (1978). Quaternion from rotation matrix. Journal of Guidance and Control 1(3).
    """
    (xx, xy, xz, tx), (yx, yy, yz, ty), (zx, zy, zz, tz), _ = matrix.tolist()
    products = (  # 4 q q^T for q = (x, y, z, w): each row is q, times four times one of its numbers
        (1 + xx - yy - zz, xy + yx, xz + zx, zy - yz),
        (xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx),
        (xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy),
        (zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz),
    )
    x, y, z, w = products[max(range(4), key=lambda row: products[row][row])]
    norm = math.copysign(math.hypot(x, y, z, w), next(number for number in (w, x, y, z) if number))
    return Pose((tx, ty, tz), (x / norm, y / norm, z / norm, w / norm))


def _matrix_from_pose(pose: Pose) -> NDArray[np.float64]:
    numbers = np.array([*pose.position, *pose.orientation])
    if not np.isfinite(numbers).all():
        raise MessageError(Reason.POSE, f"Expected a finite camera pose, got {pose}")
    norm = float(np.linalg.norm(numbers[3:]))
    if abs(norm - 1) > NORM_TOLERANCE:
        raise MessageError(
            Reason.QUATERNION,
            f"Expected a quaternion of norm 1 within {NORM_TOLERANCE}, got {pose.orientation} "
            f"of norm {norm:.6g}",
        )
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(numbers[3:]).as_matrix()
    matrix[:3, 3] = numbers[:3]
    return matrix


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


class _Waiting(Generic[Half]):
    """Halves of views that wait for the other half, by source and stamp."""

    def __init__(self, name: str, other: str, most: int) -> None:
        self._name, self._other, self._most = name, other, most
        self._halves: dict[tuple[str, int], tuple[int, Half]] = {}

    def __len__(self) -> int:
        return len(self._halves)

    def take(self, key: tuple[str, int]) -> Half | None:
        _, half = self._halves.pop(key, (0, None))
        return half

    def put(self, key: tuple[str, int], half: Half, now: int) -> tuple[Rejected, ...]:
        """Let a half wait; return those that it drives out."""
        repeated = self._halves.pop(key, None)
        self._halves[key] = now, half
        if repeated is not None:
            return (self._unpaired(key),)
        if len(self._halves) <= self._most:
            return ()
        oldest = next(iter(self._halves))
        del self._halves[oldest]
        return (self._unpaired(oldest),)

    def expire(self, now: int, timeout: int) -> tuple[Rejected, ...]:
        for key, (arrived, half) in self._halves.items():
            self._halves[key] = min(arrived or now, now), half
        late = [key for key, (arrived, _) in self._halves.items() if now - arrived > timeout]
        for key in late:
            del self._halves[key]
        return tuple(map(self._unpaired, late))

    def flush(self) -> tuple[Rejected, ...]:
        keys = tuple(self._halves)
        self._halves.clear()
        return tuple(map(self._unpaired, keys))

    def _unpaired(self, key: tuple[str, int]) -> Rejected:
        _, stamp = key
        text = f"Expected a {self._other} with the stamp of the {self._name} ({stamp} ns), got none"
        return Rejected("", text, stamp, Reason.PAIR)


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
        How many polygons, and how many camera poses, wait for their other half.

    Raises
    ------
    MessageError
        If the projection is none of the three.
    """

    def __init__(
        self,
        projection: str = "auto",
        world_frame: str = "",
        *,
        max_points: int = MAX_POINTS,
        max_pending: int = MAX_PENDING,
    ) -> None:
        if projection not in PROJECTIONS:
            raise MessageError(
                Reason.PROJECTION, f"Expected one of {', '.join(PROJECTIONS)}, got {projection!r}"
            )
        self._projection = projection
        self._world_frame = world_frame
        self._max_points = max_points
        self._polygons = _Waiting[PolygonStamped]("contour", "camera_pose", max_pending)
        self._poses = _Waiting[PoseStamped]("camera_pose", "contour", max_pending)

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
        pose = self._poses.take(key)
        if pose is not None:
            return (self._paired(polygon, pose),)
        # A copy, because the points are a view of the whole message.
        own = PolygonStamped(polygon.header, polygon.points.copy())
        return self._polygons.put(key, own, now)

    def camera_pose(self, data: bytes, source: str = "", now: int = 0) -> tuple[Event, ...]:
        """Read one geometry_msgs/PoseStamped and pair it with its polygon; see `polygon`."""
        try:
            pose = decode_pose_stamped(data)
        except CdrError as error:
            return (_rejected("", error),)
        key = source, pose.header.stamp
        polygon = self._polygons.take(key)
        if polygon is not None:
            return (self._paired(polygon, pose),)
        return self._poses.put(key, pose, now)

    @property
    def waiting(self) -> int:
        """How many halves wait for their other half."""
        return len(self._polygons) + len(self._poses)

    def expire(self, now: int, timeout: int) -> tuple[Rejected, ...]:
        """Reject the halves that arrived longer ago than a timeout, and forget them.

        Parameters
        ----------
        now, timeout : int
            Nanoseconds. Should the clock have been set back, or not have been set (0), halves
            count as arrived now.
        """
        return self._polygons.expire(now, timeout) + self._poses.expire(now, timeout)

    def flush(self) -> tuple[Rejected, ...]:
        """Reject what still waits for its other half, and forget it."""
        rejected = self._polygons.flush() + self._poses.flush()
        return tuple(sorted(rejected, key=lambda event: event.stamp))

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
        for reason, name in ((Reason.NS, object_id), (Reason.FRAME, header.frame_id)):
            if len(name) > MAX_NAME:
                raise MessageError(
                    reason, f"Expected a name of at most {MAX_NAME} characters, got {len(name)}"
                )
        if not header.frame_id:
            raise MessageError(Reason.FRAME, "Expected the name of the world frame, got none")
        if header.frame_id != (self._world_frame or header.frame_id):
            raise MessageError(
                Reason.FRAME,
                f"Expected the world frame {self._world_frame!r}, got {header.frame_id!r}",
            )
        view = _make_view(_matrix_from_pose(pose), rings, self._projection)
        self._world_frame = header.frame_id
        return StampedView(object_id, header.stamp, header.frame_id, view)


def _rejected(object_id: str, error: MomrecError, stamp: int = 0) -> Rejected:
    if isinstance(error, MessageError):
        reason = error.reason
    else:
        reason = Reason.ENCODING if isinstance(error, CdrError) else Reason.CONTOUR
    return Rejected(object_id, str(error), stamp, reason)


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
