"""The parameters of momrec, declared once for everything that offers them to a user."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Generic, TypeVar

__all__ = [
    "AUTOSTART",
    "DISTANCE",
    "IMAGE_SIZE",
    "INPUT_RELIABILITY",
    "INSTANCES",
    "INVARIANTS",
    "MARGIN",
    "MASK_QUEUE_DEPTH",
    "MAX_BAD_VIEWS",
    "MAX_FEATURES",
    "MAX_OBJECTS",
    "MAX_VIEWS",
    "MIN_VIEWS",
    "MODEL",
    "NODE_PARAMETERS",
    "NOISE",
    "OBJECT_TIMEOUT",
    "ORDER",
    "PAIR_TIMEOUT",
    "POSE_SOURCE",
    "PROJECTION",
    "PUBLISH_RATE",
    "PUBLISH_TF",
    "QUEUE_DEPTH",
    "RECTIFIED",
    "SEED",
    "SIMULATED_PROJECTION",
    "SIZED",
    "SLICES",
    "SPLITS",
    "TOLERANCE",
    "UNIT",
    "UPRIGHT",
    "VIEWS",
    "WORKERS",
    "WORLD_FRAME",
    "Parameter",
    "PoseSource",
    "Projection",
    "Reliability",
    "SimulatedProjection",
]


Value = TypeVar("Value", bool, int, float, str)


class Projection(StrEnum):
    """How the points of contours are to be read."""

    AUTO = "auto"
    ORTHOGRAPHIC = "orthographic"
    CENTRAL = "central"


class SimulatedProjection(StrEnum):
    """What kind of cameras are simulated."""

    ORTHOGRAPHIC = "orthographic"
    CENTRAL = "central"


class PoseSource(StrEnum):
    """What tells where the cameras of masks are."""

    TOPIC = "topic"
    TF = "tf"


class Reliability(StrEnum):
    """What the node asks of those who publish views."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


@dataclass(frozen=True)
class Parameter(Generic[Value]):
    """One parameter.

    Attributes
    ----------
    name : str
        With underscores; the command line writes hyphens.
    default : bool, int, float or str
        Its type is the parameter's type.
    description : str
        What it does, in one line, and its unit.
    minimum, maximum : int, float or None
        The allowed range, both ends included.
    choices : tuple of str
        The allowed values; empty where any value is.
    live : bool
        Whether a configured node takes a new value at once; otherwise it does when it is
        configured next.
    read_only : bool
        Whether the node takes it at its start only.
    """

    name: str
    default: Value
    description: str
    minimum: Value | None = None
    maximum: Value | None = None
    choices: tuple[str, ...] = ()
    live: bool = False
    read_only: bool = False

    @property
    def type_name(self) -> str:
        """The type as ROS and the README name it."""
        names = {bool: "bool", int: "integer", float: "double", str: "string"}
        return names[type(self.default)]

    @property
    def allowed(self) -> str:
        """The allowed values, for people; empty where any value of the type is."""
        if self.choices:
            return ", ".join(self.choices)
        return "" if self.minimum is None else f"{self.minimum:g} to {self.maximum:g}"

    def problem_with(self, value: object) -> str:
        """Return what is wrong with a value, as what was expected and what came; empty if nothing.

        Parameters
        ----------
        value : object
            For a double whole numbers will do.
        """
        if self._admits(value):
            return ""
        allowed = f" ({self.allowed})" if self.allowed else ""
        return f"expected {self.name} as {self.type_name}{allowed}, got {value!r:.80}"

    def _admits(self, value: Any) -> bool:
        kinds = (int, float) if isinstance(self.default, float) else type(self.default)
        if isinstance(value, bool) != isinstance(self.default, bool) or not isinstance(
            value, kinds
        ):
            return False
        if self.choices:
            return value in self.choices
        return (self.minimum is None or value >= self.minimum) and (
            self.maximum is None or value <= self.maximum
        )


SLICES = Parameter("slices", 64, "Number of slicing planes of each object.", 2, 2048)
MIN_VIEWS = Parameter("min_views", 2, "Views an object needs before it has a result.", 2, 10_000)
MAX_VIEWS = Parameter(
    "max_views", 1000, "Views kept of each object; further views are rejected.", 2, 10_000
)
MAX_BAD_VIEWS = Parameter(
    "max_bad_views",
    10,
    "Views of an object left out at most since they contradict its others (a wrong pose, a bad "
    "mask), never more than a quarter; 0 for none but those that would leave nothing.",
    0,
    10_000,
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
    live=True,
)
PROJECTION = Parameter(
    "projection",
    Projection.AUTO.value,
    "Parallel (z = 0) or central (z > 0) projection of the contours; auto tells by z.",
    choices=tuple(Projection),
)
WORLD_FRAME = Parameter(
    "world_frame",
    "",
    "The fixed frame that views must be in; empty for the frame of the first view.",
)
MODEL = Parameter(
    "model",
    "",
    "Path of the model that names the objects; empty: they are not named.",
)
PUBLISH_RATE = Parameter(
    "publish_rate",
    10.0,
    "Results published of each object that changes, at most, per second.",
    0.01,
    1000.0,
    live=True,
)
PAIR_TIMEOUT = Parameter(
    "pair_timeout",
    1.0,
    "Seconds that parts of a view, such as a contour and its camera_pose, wait for each other.",
    0.001,
    3600.0,
    live=True,
)
PUBLISH_TF = Parameter(
    "publish_tf",
    True,
    "Whether principal frames go to /tf as well, where tf2_ros is installed.",
    live=True,
)
INPUT_RELIABILITY = Parameter(
    "input_reliability",
    Reliability.RELIABLE.value,
    "What is asked of publishers of views; best_effort takes both kinds.",
    choices=tuple(Reliability),
)
QUEUE_DEPTH = Parameter(
    "queue_depth",
    200,
    "Messages of each input that wait for the node, at most.",
    1,
    100_000,
)
MASK_QUEUE_DEPTH = Parameter(
    "mask_queue_depth",
    50,
    "Masks that wait for the node, at most; of 640 x 480 pixels these are 15 MB.",
    1,
    10_000,
)
AUTOSTART = Parameter(
    "autostart",
    True,
    "Whether the node configures and activates itself at its start.",
    read_only=True,
)
POSE_SOURCE = Parameter(
    "pose_source",
    PoseSource.TOPIC.value,
    "Whether cameras of masks are where camera_pose says, or /tf (world_frame is needed then).",
    choices=tuple(PoseSource),
)
RECTIFIED = Parameter(
    "rectified",
    False,
    "Whether masks are of rectified images: camera_info's P holds then, without distortion.",
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
IMAGE_SIZE = Parameter(
    "image_size",
    "",
    "Pixels of simulated masks, 640x480 say, which contours are traced from; empty for exact ones.",
)
UPRIGHT = Parameter(
    "upright", False, "Turn objects before the rig about the vertical (z) only, not every way."
)
SIZED = Parameter(
    "size", False, "Tell classes apart by size as well; objects keep the size of their files."
)
INVARIANTS = Parameter(
    "invariants",
    False,
    "Look at what no frame changes as well: for many classes, round or nested ones.",
)
UNIT = Parameter(
    "unit", 1.0, "Metres of a unit of the mesh files: 0.001 for millimetres.", 1e-9, 1e9
)
WORKERS = Parameter("workers", 2, "Processes to reconstruct with, at most.", 1, 256)
SPLITS = Parameter("splits", 50, "Random splits into training and test set.", 1, 10_000)

NODE_PARAMETERS: tuple[Parameter[Any], ...] = (
    MODEL,
    SLICES,
    MIN_VIEWS,
    MAX_VIEWS,
    MAX_BAD_VIEWS,
    MAX_OBJECTS,
    OBJECT_TIMEOUT,
    PROJECTION,
    WORLD_FRAME,
    PUBLISH_RATE,
    PAIR_TIMEOUT,
    PUBLISH_TF,
    INPUT_RELIABILITY,
    QUEUE_DEPTH,
    MASK_QUEUE_DEPTH,
    POSE_SOURCE,
    RECTIFIED,
    TOLERANCE,
    MARGIN,
    AUTOSTART,
)
