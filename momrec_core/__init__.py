"""momrec_core: from silhouettes and camera poses to meshes, canonical shapes and classes.

The library knows geometry and nothing else: no ROS, no bag, no plotting, no command line.
"""

from momrec_core.camera import Camera
from momrec_core.canonical import CanonicalShape, normalize
from momrec_core.coverage import Coverage, coverage
from momrec_core.errors import (
    DegenerateShapeError,
    EmptyHullError,
    InvalidCameraError,
    InvalidContourError,
    ModelFormatError,
    MomrecError,
    NoCommonLineError,
)
from momrec_core.estimators import MinimumDistanceClassifier, StepwiseSelector
from momrec_core.hull import VisualHull, reconstruct
from momrec_core.model import Recognition, RecognitionModel, load_model
from momrec_core.moments import surface_moments
from momrec_core.recognizer import ObjectResult, Recognizer
from momrec_core.silhouette import silhouette_of_mesh
from momrec_core.view import View

__all__ = [
    "Camera",
    "CanonicalShape",
    "Coverage",
    "DegenerateShapeError",
    "EmptyHullError",
    "InvalidCameraError",
    "InvalidContourError",
    "MinimumDistanceClassifier",
    "ModelFormatError",
    "MomrecError",
    "NoCommonLineError",
    "ObjectResult",
    "Recognition",
    "RecognitionModel",
    "Recognizer",
    "StepwiseSelector",
    "View",
    "VisualHull",
    "coverage",
    "load_model",
    "normalize",
    "reconstruct",
    "silhouette_of_mesh",
    "surface_moments",
]
