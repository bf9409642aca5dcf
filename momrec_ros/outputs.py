"""Results as messages: what the node publishes and what a result bag carries.

The outputs of one result share its stamp and frame, and are listed in the order in which they
go out: recognition, principal frame, mesh, normalised mesh, label. The markers for people are
one message for all objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from momrec_ros.interfaces import (
    DiagnosticArray,
    DiagnosticStatus,
    Header,
    Level,
    Marker,
    MarkerAction,
    MarkerBlock,
    MarkerType,
    Pose,
    PoseStamped,
    encode_diagnostic_array,
    encode_marker,
    encode_marker_blocks,
    encode_mesh,
    encode_pose_stamped,
    encode_string,
    marker_block,
)
from momrec_ros.messages import pose_from_matrix, rings_in_camera

if TYPE_CHECKING:  # bags without results need no scikit-learn
    from momrec_core.recognizer import ObjectResult
    from momrec_core.view import View
    from momrec_ros.session import Result

__all__ = [
    "RESULT_TYPES",
    "UNKNOWN",
    "Output",
    "cleared_message",
    "markers_message",
    "object_markers",
    "removed_message",
    "result_diagnostics",
    "result_markers",
    "result_messages",
]

UNKNOWN = "unknown"

# Private names of the node `recognizer`, in the order in which one result goes out.
RESULT_TYPES = {
    "recognition": "diagnostic_msgs/msg/DiagnosticArray",
    "principal_frame": "geometry_msgs/msg/PoseStamped",
    "mesh": "visualization_msgs/msg/Marker",
    "normalized_mesh": "shape_msgs/msg/Mesh",
    "label": "std_msgs/msg/String",
    "markers": "visualization_msgs/msg/MarkerArray",
}
MESH_COLOR = (0.62, 0.74, 0.88, 1.0)
TEXT_COLOR = (1.0, 1.0, 1.0, 1.0)
CONTOUR_COLOR = (1.0, 0.6, 0.0, 0.6)
AXIS_COLORS = ((1.0, 0.0, 0.0, 1.0), (0.0, 0.8, 0.0, 1.0), (0.0, 0.3, 1.0, 1.0))
LINE_WIDTH = 0.01  # of the object's size, in displays
TEXT_HEIGHT = 0.12  # likewise
CONTRADICTORY = 0.9  # of a silhouette: noise and calibration leave more of it covered
MOST_CONTOURS = 50  # views of an object whose contours are shown


@dataclass(frozen=True)
class Output:
    """One message to go out.

    Attributes
    ----------
    name : str
        Private topic name, such as ``"label"`` for ``~/label``.
    type_name : str
        Such as ``"std_msgs/msg/String"``.
    data : bytes
        The serialised message.
    """

    name: str
    type_name: str
    data: bytes


def result_messages(
    result: ObjectResult, stamp: int, frame_id: str, *, cut_views: int = 0
) -> list[Output]:
    """Write everything that is known of an object as messages, but for `markers_message`.

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

    Returns
    -------
    outputs : list of Output
        In the order in which they are to go out.

    Raises
    ------
    CdrError
        If the stamp or a name fits no message.
    """
    header = Header(stamp, frame_id)
    pose = pose_from_matrix(result.canonical.principal_frame)
    canonical = result.canonical.mesh
    encoded = {
        "recognition": encode_diagnostic_array(
            result_diagnostics(result, header, cut_views=cut_views)
        ),
        "principal_frame": encode_pose_stamped(PoseStamped(header, pose)),
        "mesh": encode_marker(_mesh_marker(result, header, pose)),
        "normalized_mesh": encode_mesh(canonical.faces, canonical.vertices),
        "label": encode_string(_label(result)),
    }
    return [_output(name, data) for name, data in encoded.items()]


def object_markers(result: Result) -> MarkerBlock:
    """Write what people look at of one object, for `markers_message`.

    Parameters
    ----------
    result : Result
        Of one object.

    Returns
    -------
    block : MarkerBlock
        The markers of `result_markers`.

    Raises
    ------
    CdrError
        If the stamp or a name fits no message.
    """
    return marker_block(*result_markers(result.result, Header(result.stamp, result.frame_id)))


def markers_message(objects: Sequence[MarkerBlock], *, clear: Header | None = None) -> Output:
    """Write what people look at, of several objects, as one message.

    Parameters
    ----------
    objects : sequence of MarkerBlock
        Of each object, from `object_markers`; those of objects that did not change serve again.
    clear : Header, optional
        Of a first marker that tells displays to drop what they show; None for no such marker.

    Returns
    -------
    output : Output
        The markers, object by object.

    Raises
    ------
    CdrError
        If the header fits no message.
    """
    blocks = list(objects)
    if clear is not None:
        blocks.insert(0, marker_block(Marker(clear, action=MarkerAction.DELETEALL)))
    return _output("markers", encode_marker_blocks(blocks))


def removed_message(object_id: str, stamp: int, frame_id: str) -> Output:
    """Write that an object is no more, for the displays of ``~/mesh``.

    Parameters
    ----------
    object_id : str
        The object's.
    stamp : int
        Nanoseconds.
    frame_id : str
        Name of the world frame.

    Returns
    -------
    output : Output
        A marker that deletes the one of `result_messages`.

    Raises
    ------
    CdrError
        If the stamp or a name fits no message.
    """
    header = Header(stamp, frame_id)
    return _output("mesh", encode_marker(Marker(header, object_id, action=MarkerAction.DELETE)))


def cleared_message(header: Header) -> Output:
    """Write that there are no objects any more, for the displays of ``~/mesh``."""
    return _output("mesh", encode_marker(Marker(header, action=MarkerAction.DELETEALL)))


def _output(name: str, data: bytes) -> Output:
    return Output(name, RESULT_TYPES[name], data)


def _label(result: ObjectResult) -> str:
    recognition = result.recognition
    return recognition.label if recognition is not None and recognition.known else UNKNOWN


def _in_principal_frame(
    points_world: NDArray[np.float64], frame: NDArray[np.float64]
) -> NDArray[np.float64]:
    return (points_world - frame[:3, 3]) @ frame[:3, :3]


def _mesh_marker(result: ObjectResult, header: Header, pose: Pose) -> Marker:
    frame = result.canonical.principal_frame
    vertices = _in_principal_frame(np.asarray(result.mesh.vertices), frame)
    return Marker(
        header=header,
        ns=result.object_id,
        id=0,
        type=MarkerType.TRIANGLE_LIST,
        pose=pose,
        color=MESH_COLOR,
        points=np.take(vertices, np.ravel(result.mesh.faces), axis=0),
        text=_label(result),
    )


def _number(value: float) -> str:
    return f"{value:.9g}"


def _vector(values: Sequence[float]) -> str:
    return "[" + ", ".join(_number(value) for value in values) + "]"


def result_diagnostics(
    result: ObjectResult, header: Header, *, cut_views: int = 0
) -> DiagnosticArray:
    """Return the verdict on an object, then the hypotheses, best first.

    Parameters
    ----------
    result : ObjectResult
        Of one object.
    header : Header
        Stamp and world frame.
    cut_views : int
        Views used in which the border of the image cuts the object.

    Returns
    -------
    diagnostics : DiagnosticArray
        Every status carries the object's id as its hardware id.
    """
    ranking = () if result.recognition is None else result.recognition.ranking
    hypotheses = [
        DiagnosticStatus(
            Level.OK,
            label,
            f"hypothesis {place} of {len(ranking)}",
            result.object_id,
            (("score", _number(score)), ("distance", _number(distance))),
        )
        for place, (label, distance, score) in enumerate(ranking, start=1)
    ]
    return DiagnosticArray(header, (_verdict(result, cut_views), *hypotheses))


def _verdict(result: ObjectResult, cut_views: int) -> DiagnosticStatus:
    label = _label(result)
    unique = result.canonical.is_unique
    pose = pose_from_matrix(result.canonical.principal_frame)
    recognition = result.recognition
    measures = (
        ()
        if recognition is None
        else (
            ("score", _number(recognition.score)),
            ("distance", _number(recognition.distance)),
        )
    )
    values = (
        *measures,
        ("views", str(result.views)),
        ("rejected_views", str(result.rejected_views)),
        ("contradicting_views", str(len(result.left_out))),
        ("coverage_mean", _number(float(result.coverage.mean()))),
        ("coverage_worst", _number(float(result.coverage.min()))),
        ("cut_views", str(cut_views)),
        ("slices", str(result.slices)),
        ("area", _number(result.area)),
        ("volume", _number(result.volume)),
        ("scale", _number(result.canonical.scale)),
        ("position", _vector(pose.position)),
        ("orientation", _vector(pose.orientation)),
        ("unique_frame", "true" if unique else "false"),
    )
    fine = label != UNKNOWN and unique and result.coverage.min() >= CONTRADICTORY
    return DiagnosticStatus(
        Level.OK if fine else Level.WARN, label, _remarks(result), result.object_id, values
    )


def _remarks(result: ObjectResult) -> str:
    remarks = [_remark(result)]
    if result.left_out:
        remarks.append(f"views left out that contradict the others: {len(result.left_out)}")
    worst = result.coverage.min()
    if worst < CONTRADICTORY:
        remarks.append(f"views contradict one another: {worst:.0%} of one silhouette is explained")
    return "; ".join(remarks)


def _remark(result: ObjectResult) -> str:
    recognition = result.recognition
    if recognition is None:
        return "no model to recognise with"
    if not recognition.known:
        nearest = recognition.ranking[0][0] if recognition.ranking else "none"
        return f"unlike every class of the model; nearest: {nearest}"
    if not result.canonical.is_unique:
        others = len(result.canonical.alternatives)
        return f"recognised; the principal frame is one of {others + 1} admissible ones"
    return "recognised"


def result_markers(result: ObjectResult, header: Header) -> list[Marker]:
    """Return what people look at: mesh, axes, label with score, and the used contours.

    Parameters
    ----------
    result : ObjectResult
        Of one object.
    header : Header
        Stamp and world frame.

    Returns
    -------
    markers : list of Marker
        In namespaces of their own below the object's id.
    """
    columns = np.ascontiguousarray(result.mesh.vertices.T)  # so many rows are slow to compare
    size = float(np.linalg.norm(np.ptp(columns, axis=1)))
    mesh = _mesh_marker(result, header, pose_from_matrix(result.canonical.principal_frame))
    return [
        replace(mesh, ns=f"{result.object_id}/mesh"),
        _axes_marker(result, header, size),
        _label_marker(result, header, size),
        *_contour_markers(result, header, size),
    ]


def _axes_marker(result: ObjectResult, header: Header, size: float) -> Marker:
    points = np.zeros((6, 3))
    points[1::2] = np.eye(3) * 0.5 * size
    return Marker(
        header=header,
        ns=f"{result.object_id}/axes",
        type=MarkerType.LINE_LIST,
        pose=pose_from_matrix(result.canonical.principal_frame),
        scale=(LINE_WIDTH * size, 0.0, 0.0),
        points=points,
        colors=np.repeat(np.array(AXIS_COLORS, np.float32), 2, axis=0),
    )


def _label_marker(result: ObjectResult, header: Header, size: float) -> Marker:
    x, y, z = result.canonical.principal_frame[:3, 3].tolist()
    top = float(result.mesh.vertices[:, 2].max()) + TEXT_HEIGHT * size
    recognition = result.recognition
    score = "" if recognition is None else f" {recognition.score:.2f}"
    return Marker(
        header=header,
        ns=f"{result.object_id}/label",
        type=MarkerType.TEXT_VIEW_FACING,
        pose=Pose((x, y, max(z, top))),
        scale=(0.0, 0.0, TEXT_HEIGHT * size),
        color=TEXT_COLOR,
        text=_label(result) + score,
    )


def _evenly(views: Sequence[View]) -> list[View]:
    """Return all views, or evenly chosen ones where there are too many to look at."""
    step = max(1, -(-len(views) // MOST_CONTOURS))
    return list(views[::step])


def _contour_markers(result: ObjectResult, header: Header, size: float) -> list[Marker]:
    rings = [
        (pose_from_matrix(view.camera.pose), ring)
        for view in _evenly(result.hull.views)
        for ring in rings_in_camera(view)
    ]
    return [
        Marker(
            header=header,
            ns=f"{result.object_id}/contours",
            id=number,
            type=MarkerType.LINE_STRIP,
            pose=pose,
            scale=(LINE_WIDTH * size, 0.0, 0.0),
            color=CONTOUR_COLOR,
            points=ring,
        )
        for number, (pose, ring) in enumerate(rings)
    ]
