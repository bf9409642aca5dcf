"""The parameters of momrec, declared once for everything that offers them to a user."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

__all__ = [
    "DISTANCE",
    "INSTANCES",
    "MARGIN",
    "MAX_FEATURES",
    "MAX_OBJECTS",
    "MAX_VIEWS",
    "MIN_VIEWS",
    "NOISE",
    "OBJECT_TIMEOUT",
    "ORDER",
    "PROJECTION",
    "SEED",
    "SIMULATED_PROJECTION",
    "SLICES",
    "TOLERANCE",
    "VIEWS",
    "WORKERS",
    "WORLD_FRAME",
    "Parameter",
    "Projection",
    "SimulatedProjection",
]


Value = TypeVar("Value", int, float, str)


class Projection(StrEnum):
    """How the points of contours are to be read."""

    AUTO = "auto"
    ORTHOGRAPHIC = "orthographic"
    CENTRAL = "central"


class SimulatedProjection(StrEnum):
    """What kind of cameras are simulated."""

    ORTHOGRAPHIC = "orthographic"
    CENTRAL = "central"


@dataclass(frozen=True)
class Parameter(Generic[Value]):
    """One parameter.

    Attributes
    ----------
    name : str
        With underscores; the command line writes hyphens.
    default : int, float or str
        Its type is the parameter's type.
    description : str
        What it does, in one line, and its unit.
    minimum, maximum : int, float or None
        The allowed range, both ends included.
    """

    name: str
    default: Value
    description: str
    minimum: Value | None = None
    maximum: Value | None = None


SLICES = Parameter("slices", 64, "Number of slicing planes of each object.", 2, 2048)
MIN_VIEWS = Parameter("min_views", 2, "Views an object needs before it has a result.", 2, 10_000)
MAX_VIEWS = Parameter(
    "max_views", 1000, "Views kept of each object; further views are rejected.", 2, 10_000
)
MAX_OBJECTS = Parameter(
    "max_objects",
    16,
    "Objects gathered at a time; one more ends the one without a view for longest.",
    1,
    10_000,
)
OBJECT_TIMEOUT = Parameter(
    "object_timeout",
    0.0,
    "Seconds without a view after which an object is ended; 0 for never.",
    0.0,
    1e9,
)
PROJECTION = Parameter(
    "projection",
    Projection.AUTO.value,
    "Parallel (z = 0) or central (z > 0) projection of the contours; auto tells by z.",
)
WORLD_FRAME = Parameter(
    "world_frame",
    "",
    "The fixed frame that views must be in; empty for the frame of the first view.",
)
SIMULATED_PROJECTION = Parameter(
    "projection",
    SimulatedProjection.ORTHOGRAPHIC.value,
    "Simulated cameras: parallel projection, or pinholes.",
)
VIEWS = Parameter("views", 10, "Simulated views of each object.", 2, 10_000)
INSTANCES = Parameter(
    "instances", 20, "Simulated instances of each class, each at its own place and size.", 5, 10_000
)
NOISE = Parameter(
    "noise",
    0.0,
    "Standard deviation of simulated contours, as a share of the silhouette's diameter.",
    0.0,
    0.05,
)
DISTANCE = Parameter(
    "distance", 3.0, "Simulated cameras' distance from the object, in its diameters.", 0.6, 1000.0
)
TOLERANCE = Parameter(
    "tolerance", 0.5, "Pixels by which contours of masks may be off, to be simpler.", 0.0, 5.0
)
MARGIN = Parameter(
    "margin",
    0.25,
    "Pixels by which silhouettes grow first: many views take the innermost outline.",
    0.0,
    5.0,
)
SEED = Parameter("seed", 0, "Seed of all that is drawn at random.", 0, 2**32 - 1)
MAX_FEATURES = Parameter("max_features", 10, "Moments that the model uses at most.", 1, 49)
ORDER = Parameter("order", 5, "Highest order of the moments.", 2, 5)
WORKERS = Parameter("workers", 2, "Processes to train with, at most.", 1, 256)
