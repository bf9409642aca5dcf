"""What can be wrong with an input, one class per kind; every message says what came."""

__all__ = [
    "DegenerateShapeError",
    "EmptyHullError",
    "InvalidCameraError",
    "InvalidContourError",
    "ModelFormatError",
    "MomrecError",
    "NoCommonLineError",
]


class MomrecError(ValueError):
    """Base of all errors that momrec raises on purpose."""


class InvalidContourError(MomrecError):
    """A silhouette that bounds no region: NaN, too few vertices, a ring that crosses itself."""


class InvalidCameraError(MomrecError):
    """A pose that is no rigid motion, or an intrinsic matrix that is none."""


class NoCommonLineError(MomrecError):
    """No two views with different viewing directions yet, so no family of slicing planes."""


class EmptyHullError(MomrecError):
    """The viewing volumes have no point in common."""


class DegenerateShapeError(MomrecError):
    """A surface without area, or one whose moments are not finite."""


class ModelFormatError(MomrecError):
    """A model file that is not one, is damaged, or is of a version that is not understood."""
