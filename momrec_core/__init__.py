"""momrec_core: from silhouettes and camera poses to meshes, canonical shapes and classes.

The library knows geometry and nothing else: no ROS, no bag, no plotting, no command line. A name's
module is imported when the name is first used, so that a program pays for what it needs only:
trimesh takes most of a second, scikit-learn another.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from momrec_core.agreement import contradicting_views
    from momrec_core.camera import Camera
    from momrec_core.canonical import CanonicalShape, normalize
    from momrec_core.covering import Coverage, coverage, covered_shares
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
    from momrec_core.lens import Lens
    from momrec_core.model import Recognition, RecognitionModel, load_model
    from momrec_core.moments import surface_moments
    from momrec_core.recognizer import ObjectResult, Recognizer
    from momrec_core.silhouette import silhouette_of_mesh
    from momrec_core.view import View
else:
    from importlib import import_module

    MODULES = {
        "Camera": "camera",
        "CanonicalShape": "canonical",
        "Coverage": "covering",
        "DegenerateShapeError": "errors",
        "EmptyHullError": "errors",
        "InvalidCameraError": "errors",
        "InvalidContourError": "errors",
        "Lens": "lens",
        "MinimumDistanceClassifier": "estimators",
        "ModelFormatError": "errors",
        "MomrecError": "errors",
        "NoCommonLineError": "errors",
        "ObjectResult": "recognizer",
        "Recognition": "model",
        "RecognitionModel": "model",
        "Recognizer": "recognizer",
        "StepwiseSelector": "estimators",
        "View": "view",
        "VisualHull": "hull",
        "contradicting_views": "agreement",
        "coverage": "covering",
        "covered_shares": "covering",
        "load_model": "model",
        "normalize": "canonical",
        "reconstruct": "hull",
        "silhouette_of_mesh": "silhouette",
        "surface_moments": "moments",
    }

    def __getattr__(name: str) -> object:
        if name not in MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{__name__}.{MODULES[name]}"), name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})


__all__ = [
    "Camera",
    "CanonicalShape",
    "Coverage",
    "DegenerateShapeError",
    "EmptyHullError",
    "InvalidCameraError",
    "InvalidContourError",
    "Lens",
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
    "contradicting_views",
    "coverage",
    "covered_shares",
    "load_model",
    "normalize",
    "reconstruct",
    "silhouette_of_mesh",
    "surface_moments",
]
