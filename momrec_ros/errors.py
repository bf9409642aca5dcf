"""What can be wrong with messages and bags; every message says what was expected and what came."""

from enum import StrEnum

from momrec_core.errors import MomrecError

__all__ = ["BagError", "CdrError", "MessageError", "Reason", "TransformError"]


class Reason(StrEnum):
    """Why a view is left out, for counting; the README lists what each is about."""

    ENCODING = "encoding"
    EMPTY = "empty"
    ACTION = "action"
    TYPE = "type"
    HEADER = "header"
    NS = "ns"
    POSE = "pose"
    QUATERNION = "quaternion"
    FRAME = "frame"
    POINTS = "points"
    PROJECTION = "projection"
    CONTOUR = "contour"
    IMAGE = "image"
    CALIBRATION = "calibration"
    LENS = "lens"
    TRANSFORM = "transform"
    SIZE = "size"
    PAIR = "pair"
    CONTRADICTION = "contradiction"
    EXCESS = "excess"
    OVERLOAD = "overload"
    FAULT = "fault"


class CdrError(MomrecError):
    """Bytes that are no message of the expected type, or values that no message can hold."""


class MessageError(MomrecError):
    """A well-formed message that is no view by the rules of the inputs.

    Attributes
    ----------
    reason : Reason
        The rule, for counting.
    """

    def __init__(self, reason: Reason, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class TransformError(MessageError):
    """A transform between two frames that is not known, or is none.

    Attributes
    ----------
    ends : tuple of str
        The frames above which nothing is known: with one of them it may be.
    """

    def __init__(self, message: str, ends: tuple[str, ...] = ()) -> None:
        super().__init__(Reason.TRANSFORM, message)
        self.ends = ends


class BagError(MomrecError):
    """A bag that cannot be read at all, or an output that must not be written."""
