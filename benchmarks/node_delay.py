"""The installed node in a graph of its own: from the last view of an object to its results."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from shape_msgs.msg import Mesh
from std_msgs.msg import String
from timing import medians
from visualization_msgs.msg import Marker as MarkerMessage
from visualization_msgs.msg import MarkerArray
from works import MaskedWork

from momrec_core import Recognizer, load_model
from momrec_ros.interfaces import Marker, MarkerAction, encode_marker_array
from momrec_ros.messages import StampedView, ViewDecoder, encode_view
from momrec_ros.outputs import result_messages
from momrec_ros.shared_data import shared_path

__all__ = ["node_delays"]

EXECUTABLE = Path("install/momrec_ros/lib/momrec_ros/recognizer")
OUTPUTS = {
    "recognition": DiagnosticArray,
    "principal_frame": PoseStamped,
    "mesh": MarkerMessage,
    "normalized_mesh": Mesh,
}
ROUNDS = 15
STEP = 0.1  # seconds between views, as of a camera
QUIET = 0.5  # seconds without a label, after which none is under way
PATIENCE = 30.0  # seconds
ALONE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": "54"}


def node_delays(work: MaskedWork) -> tuple[list[float], list[float]]:
    """Show an object to the node again and again.

    Returns
    -------
    delays : list of float
        Milliseconds from the publication of an object's last view to the arrival of the last
        output of its result, both seen from this process.
    messages : list of float
        Milliseconds that decoding a view and encoding a result take of it.
    """
    os.environ |= ALONE
    model = shared_path("models/ten_objects.json")
    command = [str(EXECUTABLE), "--ros-args", "-p", f"model:={model}"]
    with subprocess.Popen(command) as process:
        rclpy.init()
        try:
            shower = _Shower(work)
            delays = [1e3 * shower.show(turn) for turn in range(ROUNDS + 1)][1:]
        finally:
            process.send_signal(signal.SIGINT)
            rclpy.try_shutdown()
    return delays, _message_times(work)


class _Shower(Node):
    """Publishes the views of an object, and awaits the label, the last output of a result.

    It listens to the others too, so that they are sent.
    """

    def __init__(self, work: MaskedWork) -> None:
        super().__init__("shower")
        self._views = work.views
        self._labels: list[float] = []  # arrivals
        self._contours = self.create_publisher(MarkerArray, "contours", QoSProfile(depth=100))
        durable = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for name, kind in OUTPUTS.items():
            self.create_subscription(kind, f"recognizer/{name}", lambda _: None, durable, raw=True)
        self.create_subscription(String, "recognizer/label", self._take, durable, raw=True)
        while not self._contours.get_subscription_count():
            rclpy.spin_once(self, timeout_sec=0.1)

    def show(self, turn: int) -> float:
        """Show the object once; return the seconds after its last view."""
        object_id, stamp = f"blob {turn}", self.get_clock().now().nanoseconds
        for number, view in enumerate(self._views[:-1]):
            self._publish(StampedView(object_id, stamp + number, "world", view))
            self._spin(STEP)
        self._await(lambda: self._labels and self._labels[-1] < time.monotonic() - QUIET)
        known = len(self._labels)
        begin = time.monotonic()
        self._publish(StampedView(object_id, stamp + len(self._views), "world", self._views[-1]))
        self._await(lambda: len(self._labels) > known)
        self._contours.publish(
            encode_marker_array([Marker(ns=object_id, action=MarkerAction.DELETEALL)])
        )
        return self._labels[known] - begin

    def _publish(self, view: StampedView) -> None:
        self._contours.publish(encode_view(view))

    def _await(self, condition: Callable[[], object]) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"Expected a label within {PATIENCE} s, got none")
            rclpy.spin_once(self, timeout_sec=STEP)

    def _spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            rclpy.spin_once(self, timeout_sec=left)

    def _take(self, _data: bytes) -> None:
        self._labels.append(time.monotonic())


def _message_times(work: MaskedWork) -> list[float]:
    """Return how long decoding a view and encoding a result take, in milliseconds."""
    recognizer = Recognizer(load_model(shared_path("models/ten_objects.json")))
    for view in work.views:
        recognizer.add_view("blob", view)
    result = recognizer.result("blob")
    message = encode_view(StampedView("blob", 1, "world", work.views[-1]))
    decode, encode = medians(
        [
            lambda: ViewDecoder().marker_array(message),
            lambda: result_messages(result, 1, "world"),
        ],
        ROUNDS,
    )
    return [decode + encode]
