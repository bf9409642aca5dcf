"""Results as vision_msgs/Detection3DArray: for consumers of object detections of any origin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momrec_ros.interfaces import (
    BoundingBox3D,
    Detection3D,
    Detection3DArray,
    Header,
    ObjectHypothesisWithPose,
    Pose,
)
from momrec_ros.messages import pose_from_matrix
from momrec_ros.outputs import UNKNOWN

if TYPE_CHECKING:
    from momrec_core.model import Recognition
    from momrec_core.recognizer import ObjectResult
    from momrec_ros.session import Result

__all__ = ["DETECTIONS_TYPE", "detection_array"]

DETECTIONS_TYPE = "vision_msgs/msg/Detection3DArray"


def detection_array(results: Sequence[Result], otherwise: Header | None = None) -> Detection3DArray:
    """Return all objects as one array of detections.

    The first hypothesis of a detection is the verdict: an object far from every class has
    `UNKNOWN` before the ranking of the classes, and one that was not compared (no model) only
    `UNKNOWN`, with score 0. Every hypothesis has the principal frame as its pose, of unknown
    (zero) covariance; the bounding box is the mesh's extent along the principal axes.

    Parameters
    ----------
    results : sequence of Result
        One an object.
    otherwise : Header, optional
        Of the array where there are no results.

    Returns
    -------
    array : Detection3DArray
        Stamped as the newest result; each detection is stamped as its own.
    """
    detections = tuple(_detection(item.result, _header(item)) for item in results)
    newest = max(results, key=lambda item: item.stamp, default=None)
    if newest is None:
        return Detection3DArray(otherwise or Header())
    return Detection3DArray(_header(newest), detections)


def _header(item: Result) -> Header:
    return Header(item.stamp, item.frame_id)


def _detection(result: ObjectResult, header: Header) -> Detection3D:
    pose = pose_from_matrix(result.canonical.principal_frame)
    hypotheses = tuple(
        ObjectHypothesisWithPose(label, score, pose)
        for label, score in _verdict_first(result.recognition)
    )
    return Detection3D(header, hypotheses, _principal_box(result, pose), result.object_id)


def _verdict_first(recognition: Recognition | None) -> list[tuple[str, float]]:
    if recognition is None:
        return [(UNKNOWN, 0.0)]
    classes = [(label, score) for label, _, score in recognition.ranking]
    return classes if recognition.known else [(UNKNOWN, recognition.score), *classes]


def _principal_box(result: ObjectResult, pose: Pose) -> BoundingBox3D:
    """Return the box about the mesh with edges along the principal axes, in the world, metres."""
    frame = result.canonical.principal_frame
    lower, upper = np.asarray(result.canonical.mesh.bounds) / result.canonical.scale
    x, y, z = (frame[:3, :3] @ (0.5 * (lower + upper)) + frame[:3, 3]).tolist()
    width, depth, height = (upper - lower).tolist()
    return BoundingBox3D(Pose((x, y, z), pose.orientation), (width, depth, height))
