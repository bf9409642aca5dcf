"""What the messages mean: contours with camera poses to views, and views to messages.

The rules are those of the README's section on messages. Nothing here knows where the bytes come
from: the node and the bags use the same code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from momrec_core.camera import Camera
from momrec_core.errors import MomrecError
from momrec_core.view import View
from momrec_ros.errors import CdrError, MessageError
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
    reason : str
        What was expected and what came.
    stamp : int
        Nanoseconds; 0 where the message has none.
    kind : str
        One word that names the rule, for counting.
    """

    object_id: str
    reason: str
    stamp: int
    kind: str = "contour"


Event = StampedView | Forget | Rejected
Half = TypeVar("Half", PolygonStamped, PoseStamped)


def pose_from_matrix(matrix: NDArray[np.float64]) -> Pose:
    """Return the message form of a rigid motion of shape (4, 4); its quaternion has w >= 0."""
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat(canonical=True).tolist()
    tx, ty, tz = matrix[:3, 3].tolist()
    return Pose((tx, ty, tz), (x, y, z, w))


def _matrix_from_pose(pose: Pose) -> NDArray[np.float64]:
    numbers = np.array([*pose.position, *pose.orientation])
    if not np.isfinite(numbers).all():
        raise MessageError("pose", f"Expected a finite camera pose, got {pose}")
    norm = float(np.linalg.norm(numbers[3:]))
    if abs(norm - 1) > NORM_TOLERANCE:
        raise MessageError(
            "quaternion",
            f"Expected a quaternion of norm 1 within {NORM_TOLERANCE}, got {pose.orientation} "
            f"of norm {norm:.6g}",
        )
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(numbers[3:]).as_matrix()
    matrix[:3, 3] = numbers[:3]
    return matrix


def _is_central(depths: NDArray[np.float64], projection: str) -> bool:
    """Tell by the points' z whether rays (all z > 0) or plane points (all z = 0) came."""
    if not np.isfinite(depths).all():
        raise MessageError("points", "Expected finite points, got NaN or infinity as z")
    flat, central = bool((depths == 0).all()), bool((depths > 0).all())
    if not (flat or central):
        raise MessageError(
            "projection",
            "Expected all z = 0 (orthographic) or all z > 0 (central), got z from "
            f"{depths.min():.6g} to {depths.max():.6g}",
        )
    found = "central" if central else "orthographic"
    if projection not in ("auto", found):
        raise MessageError("projection", f"Expected {projection} projection, got {found} contours")
    return central


def _make_view(
    world_from_camera: NDArray[np.float64], rings: Sequence[NDArray[np.floating]], projection: str
) -> View:
    points = np.concatenate([np.asarray(ring, np.float64) for ring in rings])
    if _is_central(points[:, 2], projection):
        with np.errstate(over="ignore", invalid="ignore"):
            points = points[:, :2] / points[:, 2:]
        camera = Camera.pinhole(world_from_camera, np.eye(3))
    else:
        camera = Camera.orthographic(world_from_camera)
    ends = np.cumsum([len(ring) for ring in rings])[:-1]
    return View.from_rings(camera, np.split(points[:, :2], ends))


def _agree(values: Sequence[object], kind: str) -> None:
    for value in values[1:]:
        if value != values[0]:
            raise MessageError(
                kind,
                f"Expected one {kind} in all markers of a message, got {values[0]} and {value}",
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
                "projection", f"Expected one of {', '.join(PROJECTIONS)}, got {projection!r}"
            )
        self._projection = projection
        self._world_frame = world_frame
        self._max_points = max_points
        self._max_pending = max_pending
        self._polygons: dict[tuple[str, int], PolygonStamped] = {}
        self._poses: dict[tuple[str, int], PoseStamped] = {}

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
            return (Rejected("", str(error), 0, "encoding"),)
        rings = [marker for marker in markers if marker.action == MarkerAction.ADD]
        first = next(iter(rings or markers), Marker())
        try:
            if any(marker.action not in tuple(MarkerAction) for marker in markers):
                actions = sorted({marker.action for marker in markers})
                raise MessageError("action", f"Expected ADD, DELETE or DELETEALL, got {actions}")
            if rings:
                return (self._view(rings),)
            if not markers:
                raise MessageError("empty", "Expected at least one marker, got an empty array")
        except MomrecError as error:
            return (_rejected(first.ns, error, first.header.stamp),)
        forgotten = (marker.ns for marker in markers if marker.action == MarkerAction.DELETEALL)
        return tuple(Forget(ns) for ns in dict.fromkeys(forgotten))

    def _view(self, markers: Sequence[Marker]) -> StampedView:
        _agree([marker.header for marker in markers], "header")
        _agree([marker.ns for marker in markers], "ns")
        _agree([marker.pose for marker in markers], "pose")
        kinds = {marker.type for marker in markers}
        if kinds != {MarkerType.LINE_STRIP}:
            raise MessageError(
                "type", f"Expected markers of type LINE_STRIP (4) only, got {sorted(kinds)}"
            )
        return self._stamped(
            markers[0].ns,
            markers[0].header,
            markers[0].pose,
            [marker.points for marker in markers],
        )

    def polygon(self, data: bytes, source: str = "") -> tuple[Event, ...]:
        """Read one geometry_msgs/PolygonStamped and pair it with its camera pose.

        Parameters
        ----------
        data : bytes
            The serialised message.
        source : str
            Name of the camera; halves pair within a source.

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
        pose = self._poses.pop(key, None)
        if pose is not None:
            return (self._paired(polygon, pose),)
        repeated = self._polygons.pop(key, None)
        # A copy, because the points are a view of the whole message.
        self._polygons[key] = PolygonStamped(polygon.header, polygon.points.copy())
        return self._dropped(repeated, self._polygons, "contour")

    def camera_pose(self, data: bytes, source: str = "") -> tuple[Event, ...]:
        """Read one geometry_msgs/PoseStamped and pair it with its polygon; see `polygon`."""
        try:
            pose = decode_pose_stamped(data)
        except CdrError as error:
            return (_rejected("", error),)
        key = source, pose.header.stamp
        polygon = self._polygons.pop(key, None)
        if polygon is not None:
            return (self._paired(polygon, pose),)
        repeated = self._poses.pop(key, None)
        self._poses[key] = pose
        return self._dropped(repeated, self._poses, "camera_pose")

    def flush(self) -> tuple[Rejected, ...]:
        """Reject what still waits for its other half, and forget it."""
        rejected = [_unpaired(stamp, "contour") for _, stamp in self._polygons]
        rejected += [_unpaired(stamp, "camera_pose") for _, stamp in self._poses]
        self._polygons.clear()
        self._poses.clear()
        return tuple(sorted(rejected, key=lambda event: event.stamp))

    def _dropped(
        self, repeated: Half | None, waiting: dict[tuple[str, int], Half], name: str
    ) -> tuple[Rejected, ...]:
        if repeated is not None:
            return (_unpaired(repeated.header.stamp, name),)
        if len(waiting) <= self._max_pending:
            return ()
        oldest = next(iter(waiting))
        del waiting[oldest]
        return (_unpaired(oldest[1], name),)

    def _paired(self, polygon: PolygonStamped, pose: PoseStamped) -> Event:
        try:
            return self._stamped("", pose.header, pose.pose, [polygon.points])
        except MomrecError as error:
            return _rejected("", error, pose.header.stamp)

    def _check_size(self, rings: Sequence[NDArray[np.floating]]) -> None:
        total = sum(len(ring) for ring in rings)
        if total > self._max_points:
            raise MessageError(
                "size", f"Expected at most {self._max_points} points in a view, got {total}"
            )

    def _stamped(
        self, object_id: str, header: Header, pose: Pose, rings: Sequence[NDArray[np.floating]]
    ) -> StampedView:
        self._check_size(rings)
        if sum(len(ring) for ring in rings) == 0:
            raise MessageError("points", f"Expected points, got {len(rings)} rings without any")
        if not header.frame_id:
            raise MessageError("frame", "Expected the name of the world frame, got none")
        if header.frame_id != (self._world_frame or header.frame_id):
            raise MessageError(
                "frame",
                f"Expected the world frame {self._world_frame!r}, got {header.frame_id!r}",
            )
        view = _make_view(_matrix_from_pose(pose), rings, self._projection)
        self._world_frame = header.frame_id
        return StampedView(object_id, header.stamp, header.frame_id, view)


def _rejected(object_id: str, error: MomrecError, stamp: int = 0) -> Rejected:
    if isinstance(error, MessageError):
        kind = error.kind
    else:
        kind = "encoding" if isinstance(error, CdrError) else "contour"
    return Rejected(object_id, str(error), stamp, kind)


def _unpaired(stamp: int, name: str) -> Rejected:
    other = {"contour": "camera_pose", "camera_pose": "contour"}[name]
    return Rejected(
        "", f"Expected a {other} with the stamp of the {name} ({stamp} ns), got none", stamp, "pair"
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
        closed = np.concatenate([ring, ring[:1]])
        if view.camera.is_pinhole:
            rings.append(view.camera.rays_camera(closed))
        else:
            rings.append(np.column_stack([closed, np.zeros(len(closed))]))
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
