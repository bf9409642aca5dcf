"""The life cycle node `recognizer`: a shell that connects a `Pipeline` with a ROS 2 graph."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray as DiagnosticArrayMessage
from geometry_msgs.msg import PolygonStamped, PoseStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import (
    LifecycleNode,
    LifecyclePublisher,
    LifecycleState,
    TransitionCallbackReturn,
)
from rclpy.parameter import Parameter
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from momrec_core.errors import MomrecError
from momrec_core.model import RecognitionModel, load_model
from momrec_ros import parameters
from momrec_ros.detections import DETECTIONS_TYPE
from momrec_ros.health import health_status
from momrec_ros.interfaces import DiagnosticArray, Header, encode_diagnostic_array
from momrec_ros.mask_messages import MaskRules
from momrec_ros.messages import ViewDecoder
from momrec_ros.node_parameters import declare_parameters
from momrec_ros.outputs import RESULT_TYPES, Output
from momrec_ros.parameters import NODE_PARAMETERS, PoseSource, Reliability
from momrec_ros.pipeline import JOINT_OUTPUTS, Activity, Input, Pace, Pipeline
from momrec_ros.session import Session, Tally
from momrec_ros.transform_buffer import TransformBuffer
from momrec_ros.transforms import TRANSFORMS_TYPE

__all__ = ["RecognizerNode", "run"]

NAME = "recognizer"
INPUT_TYPES = {
    Input.CONTOURS: MarkerArray,
    Input.CONTOUR: PolygonStamped,
    Input.CAMERA_POSE: PoseStamped,
    Input.MASK: Image,
    Input.CAMERA_INFO: CameraInfo,
}
TF_INPUTS = {  # only where poses come from there: what others publish, and how
    Input.TF: QoSProfile(depth=100),
    Input.TF_STATIC: QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL),
}
OPTIONAL_TYPES = {
    "tf": (TRANSFORMS_TYPE, "tf2_ros"),
    "detections": (DETECTIONS_TYPE, "vision_msgs"),
}
# Results kept for who comes late or lost one on the way: no more than the shortest usual queues.
HISTORY = 5
TF_QUEUE = 100  # as of every broadcaster of transforms
DIAGNOSTICS_PERIOD = 1.0  # seconds
PATIENCE = 0.1  # seconds that a computation gets to end before it is left alone
UNDISCOVERED = "_NODE_NAME_UNKNOWN_"  # rmw's name of a node of which only an endpoint is known
FAILED = 1


class RecognizerNode(LifecycleNode):
    """Contours or masks with camera poses in; meshes, principal frames and class labels out.

    Configuring checks the parameters and loads the model, activating subscribes, deactivating
    keeps what was gathered, cleaning up frees it. The README lists topics, services and parameters;
    what happens to views and results is told by `Pipeline`.
    """

    def __init__(self) -> None:
        super().__init__(NAME, enable_logger_service=True)
        given = {name: given.value for name, given in self._parameter_overrides.items()}
        self._problems, unknown = declare_parameters(self, NODE_PARAMETERS, given)
        if unknown:
            known = ", ".join(parameter.name for parameter in NODE_PARAMETERS)
            self.get_logger().warning(
                f"unknown parameters are ignored: expected some of {known}, got "
                f"{', '.join(unknown)}"
            )
        self._state = "unconfigured"
        self._refusal = ""
        self._pipeline: Pipeline | None = None
        self._outputs: dict[str, LifecyclePublisher] = {}
        self._inputs: dict[Input, Subscription] = {}
        self._unreceived = 0
        self._reported = Activity()
        self._told_publishers: set[tuple[tuple[int, ...], str]] = set()
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        self.create_service(Trigger, "~/reset", self._reset)
        change_state = self._service_change_state.callback
        self._service_change_state.callback = partial(self._change_state, change_state)
        self._diagnostics = self.create_publisher(DiagnosticArrayMessage, "/diagnostics", 10)
        self.create_timer(
            DIAGNOSTICS_PERIOD, self._look_around, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def start(self) -> None:
        """Configure and activate, if the parameter `autostart` says so."""
        if not self._value(parameters.AUTOSTART):
            self.get_logger().info("unconfigured: waits to be configured and activated")
        elif self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    def close(self) -> None:
        """Publish no more."""
        if self._pipeline is not None:
            self._pipeline.stop(PATIENCE)

    def destroy_node(self) -> None:
        """Leave the graph, and give back the shared memory."""
        super().destroy_node()
        # rclpy leaves it to the garbage collector; until then others go on seeing the node.
        self._state_machine.destroy_when_not_in_use()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check the parameters, load the model, and start to listen for listeners."""
        try:
            if self._problems:
                raise MomrecError("; ".join(self._problems.values()))
            pipeline = self._make_pipeline()
        except (ValueError, OSError) as error:
            reason = " ".join(str(error).split())
            self._refusal = f"cannot be configured: {reason[:1].lower()}{reason[1:]}"
            self.get_logger().error(self._refusal)
            return TransitionCallbackReturn.FAILURE
        self._refusal = ""
        self._create_outputs()
        self._pipeline = pipeline
        self._state = "inactive"
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish and subscribe."""
        result = super().on_activate(state)
        self._running.activate()
        self._create_inputs()
        self._state = "active"
        topics = {source: subscription.topic_name for source, subscription in self._inputs.items()}
        mask_pose = ", ".join(topics[source] for source in self._pose_inputs)
        self.get_logger().info(
            f"active: listens to {topics[Input.CONTOURS]}, to {topics[Input.CONTOUR]} with "
            f"{topics[Input.CAMERA_POSE]}, and to {topics[Input.MASK]} with "
            f"{topics[Input.CAMERA_INFO]} and {mask_pose}"
        )
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Neither publish nor subscribe; what was gathered stays."""
        self._destroy_inputs()
        self._running.deactivate()
        self._state = "inactive"
        kept = self._running.activity().objects
        self.get_logger().info(f"inactive: objects kept: {kept}")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Free all that configuring made and that was gathered since."""
        self._release()
        self._state = "unconfigured"
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Free everything."""
        self._release()
        self._state = "finalized"
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Free everything; the node can be configured again."""
        self.get_logger().error(f"a transition from {state.label} failed")
        self._release()
        self._state = "unconfigured"
        return super().on_error(state)

    @property
    def _running(self) -> Pipeline:
        if self._pipeline is None:
            raise MomrecError("Expected a configured node, got one without a pipeline")
        return self._pipeline

    def _value(self, parameter: parameters.Parameter[Any]) -> Any:
        return self.get_parameter(parameter.name).value

    def _pace(self) -> Pace:
        return Pace(**{field.name: self.get_parameter(field.name).value for field in fields(Pace)})

    def _make_pipeline(self) -> Pipeline:
        make_session = partial(
            _make_session,
            self._load_model(),
            slices=self._value(parameters.SLICES),
            min_views=self._value(parameters.MIN_VIEWS),
            max_objects=self._value(parameters.MAX_OBJECTS),
            max_views=self._value(parameters.MAX_VIEWS),
            max_bad_views=self._value(parameters.MAX_BAD_VIEWS),
        )
        make_decoder = partial(
            ViewDecoder,
            self._value(parameters.PROJECTION),
            self._value(parameters.WORLD_FRAME),
            rules=MaskRules(
                **{field.name: self.get_parameter(field.name).value for field in fields(MaskRules)}
            ),
            transforms=self._make_transforms(),
        )
        return Pipeline(
            make_session,
            make_decoder,
            publish=self._publish,
            is_wanted=self._is_wanted,
            is_over=lambda: not self.context.ok(),  # a signal has ended it
            log=self.get_logger(),
            pace=self._pace(),
            clock=lambda: self.get_clock().now().nanoseconds,
            frame_prefix=self.get_fully_qualified_name().lstrip("/"),
        )

    def _make_transforms(self) -> TransformBuffer | None:
        """Return what remembers transforms, also over a reset: those of /tf_static come once."""
        if not self._uses_tf:
            return None
        try:
            _message_type(TRANSFORMS_TYPE)
        except ImportError as error:
            raise MomrecError(
                f"Expected tf2_msgs for {parameters.POSE_SOURCE.name} {PoseSource.TF}, got a "
                "system without it"
            ) from error
        return TransformBuffer()

    @property
    def _uses_tf(self) -> bool:
        return bool(self._value(parameters.POSE_SOURCE) == PoseSource.TF)

    @property
    def _pose_inputs(self) -> Sequence[Input]:
        return tuple(TF_INPUTS) if self._uses_tf else (Input.CAMERA_POSE,)

    def _load_model(self) -> RecognitionModel | None:
        path = self._value(parameters.MODEL)
        if path:
            model = load_model(_model_file(path))
            self.get_logger().info(f"model {path}: {len(model.classes)} classes")
            return model
        self.get_logger().info("no model: objects are reconstructed and normalised, but not named")
        return None

    def _create_outputs(self) -> None:
        types = {name: _message_type(type_name) for name, type_name in RESULT_TYPES.items()}
        for name, (type_name, package) in OPTIONAL_TYPES.items():
            try:
                types[name] = _message_type(type_name)
            except ImportError:
                self.get_logger().info(f"{_topic(name)} is off: {package} is not installed")
            else:
                self.get_logger().info(f"{_topic(name)} is on")
        for name, kind in types.items():
            durability = DurabilityPolicy.TRANSIENT_LOCAL
            depth = 1 if name in JOINT_OUTPUTS else HISTORY
            if name == "tf":  # as all listeners to transforms expect
                durability, depth = DurabilityPolicy.VOLATILE, TF_QUEUE
            self._outputs[name] = self.create_lifecycle_publisher(
                kind,
                _topic(name),
                QoSProfile(
                    depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
                ),
                event_callbacks=PublisherEventCallbacks(matched=partial(self._serve, name)),
            )

    def _create_inputs(self) -> None:
        for source, kind in INPUT_TYPES.items():
            self._create_input(source, kind, self._input_profile(source))
        if self._uses_tf:
            for source, qos in TF_INPUTS.items():
                self._create_input(source, _message_type(TRANSFORMS_TYPE), qos)

    def _input_profile(self, source: Input) -> QoSProfile:
        is_reliable = self._value(parameters.INPUT_RELIABILITY) == Reliability.RELIABLE
        depth = parameters.MASK_QUEUE_DEPTH if source is Input.MASK else parameters.QUEUE_DEPTH
        return QoSProfile(
            depth=self._value(depth),
            reliability=(
                ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
            ),
        )

    def _create_input(self, source: Input, kind: Any, qos: QoSProfile) -> None:
        # Publishers that do not match are told by `_tell_mismatches`, in full.
        events = SubscriptionEventCallbacks(
            message_lost=self._count_unreceived, use_default_callbacks=False
        )
        self._inputs[source] = self.create_subscription(
            kind,
            source.value,
            partial(self._running.receive, source),
            qos,
            raw=True,
            event_callbacks=events,
        )

    def _destroy_inputs(self) -> None:
        for subscription in self._inputs.values():
            self.destroy_subscription(subscription)
        self._inputs.clear()
        self._told_publishers.clear()

    def _release(self) -> None:
        self._destroy_inputs()
        if self._pipeline is not None:
            self._pipeline.stop(PATIENCE)
            self._pipeline = None
        for publisher in self._outputs.values():
            self.destroy_lifecycle_publisher(publisher)
        self._outputs.clear()
        self._reported = Activity()

    def _publish(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if output.name == "tf" and not self._value(parameters.PUBLISH_TF):
                continue
            if output.name in self._outputs:
                self._outputs[output.name].publish(output.data)

    def _is_wanted(self, name: str) -> bool:
        return name in self._outputs and self._outputs[name].get_subscription_count() > 0

    def _serve(self, name: str, matched: Any) -> None:
        if matched.current_count_change > 0 and self._pipeline is not None:
            self._pipeline.serve(name)

    def _change_state(self, change: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        """Refuse a transition that the state does not have: rclpy raises, and nobody answers."""
        try:
            return change(request, response)
        except RuntimeError:  # as rcl's errors are
            self.get_logger().warning(
                f"a transition is refused: expected one of a node that is {self._state}, got "
                f"{(request.transition.label or request.transition.id)!r}"
            )
        response.success = False
        return response

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._pipeline is not None
        if self._pipeline is None:
            response.message = f"nothing to forget: the node is {self._state}"
        else:
            response.message = f"objects forgotten: {self._pipeline.reset()}"
            self.get_logger().info(f"reset: {response.message}")
        return response

    def _check_parameters(self, given: Sequence[Parameter]) -> SetParametersResult:
        known = {parameter.name: parameter for parameter in NODE_PARAMETERS}
        for new in given:
            parameter = known.get(new.name)
            if parameter is None:
                continue
            problem = parameter.problem_with(new.value)
            if not problem and not parameter.live and self._pipeline is not None:
                problem = (
                    f"{new.name} is taken when the node is configured: expected an unconfigured "
                    f"node, got one that is {self._state}"
                )
            if problem:
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True)

    def _take_parameters(self, given: Sequence[Parameter]) -> None:
        for new in given:
            self._problems.pop(new.name, None)
        if self._pipeline is not None:
            self._pipeline.change_pace(self._pace())

    def _count_unreceived(self, lost: Any) -> None:
        self._unreceived += lost.total_count_change
        self.get_logger().warning(f"{lost.total_count_change} messages were lost on their way")

    def _look_around(self) -> None:
        self._tell_mismatches()
        activity = Activity() if self._pipeline is None else self._pipeline.activity()
        name = self.get_fully_qualified_name()
        status = health_status(
            name,
            self._state,
            self._refusal,
            activity,
            self._reported,
            unreceived=self._unreceived,
        )
        self._reported = activity
        header = Header(self.get_clock().now().nanoseconds, activity.world_frame)
        self._diagnostics.publish(encode_diagnostic_array(DiagnosticArray(header, (status,))))

    def _tell_mismatches(self) -> None:
        """Tell, once each, of publishers from which no message can come.

        An endpoint is often discovered before the node that it belongs to: it is told again when
        that is known.
        """
        for subscription in self._inputs.values():
            for other in self.get_publishers_info_by_topic(subscription.topic_name):
                mismatch = _mismatch(other, subscription.qos_profile, subscription.msg_type)
                owner = owner_of(other)
                told = (tuple(other.endpoint_gid), owner)
                if mismatch and told not in self._told_publishers:
                    self._told_publishers.add(told)
                    self.get_logger().warning(
                        f"nothing comes from the publisher of {subscription.topic_name} in "
                        f"{owner}: {mismatch}"
                    )


def _make_session(model: RecognitionModel | None, tally: Tally, **limits: int) -> Session:
    return Session(model, tally=tally, **limits)


def _model_file(given: str) -> Path:
    """Return a path that can be read without waiting for whoever is to write."""
    try:
        path = Path(given).expanduser()
    except RuntimeError as error:
        raise MomrecError(f"Expected a model file, got {given!r}: {error}") from error
    if path.is_fifo() or path.is_char_device():
        raise MomrecError(f"Expected a model file, got the device or pipe {path}")
    return path


def _topic(output: str) -> str:
    return "/tf" if output == "tf" else f"~/{output}"


def _message_type(name: str) -> Any:
    package, _, kind = name.split("/")
    return getattr(import_module(f"{package}.msg"), kind)


def owner_of(endpoint: TopicEndpointInfo) -> str:
    """Return the full name of the node that a discovered endpoint belongs to, as far as known."""
    if endpoint.node_name == UNDISCOVERED:
        return "a node whose name is not known"
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _mismatch(publisher: TopicEndpointInfo, wanted: QoSProfile, kind: Any) -> str:
    """Return why nothing comes from a publisher; empty if something does."""
    package, *_ = kind.__module__.split(".")
    type_name = f"{package}/msg/{kind.__name__}"
    if publisher.topic_type != type_name:
        return f"expected type {type_name}, got {publisher.topic_type}"
    compatibility, _reason = qos_check_compatible(publisher.qos_profile, wanted)
    if compatibility != QoSCompatibility.ERROR:
        return ""
    return f"expected {_profile(wanted)} (input_reliability), got {_profile(publisher.qos_profile)}"


def _profile(qos: QoSProfile) -> str:
    return f"{qos.reliability.name.lower()}, {qos.durability.name.lower()}"


def _failed(error: Exception) -> int:
    """Tell in one line why the node cannot be; return the exit code."""
    sys.stderr.write(f"{NAME}: {' '.join(str(error).split())}\n")
    return FAILED


def run() -> int:
    """Run the node until a signal comes; return the exit code."""
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _frame: signals.append(number))
    try:
        rclpy.init(args=sys.argv)  # its handlers end the context, and call the ones before
    except Exception as error:  # noqa: BLE001 - rcl's own errors, of several kinds
        return _failed(error)
    nodes: list[RecognizerNode] = []
    try:
        nodes.append(RecognizerNode())
        nodes[0].start()
        gc.collect()
        gc.freeze()  # what modules and model hold: not to be gone through time and again
        executor = SingleThreadedExecutor()
        executor.add_node(nodes[0])
        executor.spin()
    except ExternalShutdownException:
        pass
    except ParameterException as error:  # of use_sim_time, which is not declared here
        return _failed(error)
    except Exception:
        if not signals:  # without a context whatever was under way fails
            raise
    finally:
        for node in nodes:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
