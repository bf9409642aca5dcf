"""Principal frames as tf2_msgs/TFMessage: for consumers that ask tf2 where things are."""

from __future__ import annotations

from typing import TYPE_CHECKING

from momrec_ros.interfaces import Header, Transform, encode_transforms
from momrec_ros.messages import pose_from_matrix
from momrec_ros.outputs import Output

if TYPE_CHECKING:
    from momrec_ros.session import Result

__all__ = ["TRANSFORMS_TYPE", "transform_message"]

TRANSFORMS_TYPE = "tf2_msgs/msg/TFMessage"
NAMELESS = "object"  # stands for an empty id


def transform_message(item: Result, prefix: str) -> Output:
    """Write the principal frame of an object as a transform from the world.

    Parameters
    ----------
    item : Result
        Of one object.
    prefix : str
        The child frame is named by it, a slash, and the object's id.

    Returns
    -------
    output : Output
        Named ``"tf"``.

    Raises
    ------
    CdrError
        If the stamp or a name fits no message.
    """
    child = f"{prefix}/{item.result.object_id or NAMELESS}"
    pose = pose_from_matrix(item.result.canonical.principal_frame)
    transform = Transform(Header(item.stamp, item.frame_id), child, pose)
    return Output("tf", TRANSFORMS_TYPE, encode_transforms((transform,)))
