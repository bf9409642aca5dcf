"""The live node under a steady load: views lost, delay of results, growth of memory.

Starts the node's executable, publishes the views of ten objects in turn, forgets each object
after its ten views and begins again, and listens to the results, all in one ROS graph of its own.
The delay is the time from the publication of an object's last view to the arrival of the result
that counts all its views, both seen from this process.

    . install/setup.sh
    python benchmarks/node_soak.py [--minutes 5] [--rate 10]
"""

from __future__ import annotations

import argparse
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import MarkerArray

from momrec_ros.bag import read_bag
from momrec_ros.interfaces import (
    Marker,
    MarkerAction,
    decode_diagnostic_array,
    encode_marker_array,
)
from momrec_ros.messages import StampedView, encode_view
from momrec_ros.shared_data import shared_path

EXECUTABLE = Path("install/momrec_ros/lib/momrec_ros/recognizer")
OBJECTS = 10
SETTLED = 60.0  # seconds, after which memory should stay
LEAST_VIEWS = 2  # for a result
PATIENCE = 10.0  # seconds for what is under way at the end
BOUNDS = {"lost": 0, "p99": 250.0, "growth": 5.0}


@dataclass
class Observed:
    """What was seen of the node."""

    published: dict[tuple[str, int], float] = field(default_factory=dict)
    sent: int = 0
    delays: list[float] = field(default_factory=list)
    memory: list[tuple[float, float]] = field(default_factory=list)
    results: int = 0
    counts: dict[str, str] = field(default_factory=dict)


def rounds(views: Sequence[StampedView]) -> Iterator[tuple[StampedView, bool]]:
    """Yield views of ten objects in turn for ever, and whether each is its object's last."""
    by_object: dict[str, list[StampedView]] = {}
    for view in views:
        by_object.setdefault(view.object_id, []).append(view)
    chosen = list(by_object.values())[:OBJECTS]
    length = min(map(len, chosen))
    # Each object is at another place in its ten views, so that their last views are spread.
    for turn in itertools.count():
        for number, own in enumerate(chosen):
            place = (turn + number) % length
            yield own[place], place == length - 1


def resident(pid: int) -> float:
    """Return the resident memory of a process, MB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Driver(Node):
    """Publishes views and listens to results."""

    def __init__(self, views: Sequence[StampedView], rate: float, pid: int) -> None:
        super().__init__("soak")
        self.observed = Observed()
        self._views = rounds(views)
        self._pid = pid
        self._start = time.monotonic()
        self._shown: dict[str, int] = {}
        self._contours = self.create_publisher(MarkerArray, "contours", QoSProfile(depth=100))
        durable = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(
            DiagnosticArray, "recognizer/recognition", self._take_result, durable, raw=True
        )
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_counts, 10, raw=True)
        while not self._contours.get_subscription_count():
            rclpy.spin_once(self, timeout_sec=0.1)
        self._showing = self.create_timer(1 / rate, self._show)
        self.create_timer(1.0, self._weigh)

    def finish(self) -> None:
        """Publish no more, and await what is under way."""
        self._showing.cancel()
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and self._is_waiting():
            rclpy.spin_once(self, timeout_sec=0.1)

    def _is_waiting(self) -> bool:
        used = int(self.observed.counts.get("views_used", 0))
        return bool(self.observed.published) or used < self.observed.sent

    def _show(self) -> None:
        view, is_last = next(self._views)
        stamp = self.get_clock().now().nanoseconds
        self._contours.publish(encode_view(replace(view, stamp=stamp)))
        self.observed.sent += 1
        shown = self._shown[view.object_id] = self._shown.get(view.object_id, 0) + 1
        if is_last:
            if shown >= LEAST_VIEWS:  # the first round of an object may be its last view alone
                self.observed.published[view.object_id, stamp] = time.monotonic()
            self._shown[view.object_id] = 0
            forget = Marker(ns=view.object_id, action=MarkerAction.DELETEALL)
            self._contours.publish(encode_marker_array([forget]))

    def _take_result(self, data: bytes) -> None:
        now = time.monotonic()
        array = decode_diagnostic_array(data)
        self.observed.results += 1
        key = array.status[0].hardware_id, array.header.stamp
        if key in self.observed.published:
            self.observed.delays.append(now - self.observed.published.pop(key))

    def _take_counts(self, data: bytes) -> None:
        self.observed.counts = dict(decode_diagnostic_array(data).status[0].values)

    def _weigh(self) -> None:
        self.observed.memory.append((time.monotonic() - self._start, resident(self._pid)))


def soak(minutes: float, rate: float) -> Observed:
    """Run the node under load."""
    views = list(read_bag(shared_path("bags/ten_objects")))
    model = shared_path("models/ten_objects.json")
    command = [str(EXECUTABLE), "--ros-args", "-p", f"model:={model}"]
    with subprocess.Popen(command) as process:
        rclpy.init()
        try:
            driver = Driver(views, rate, process.pid)
            end = time.monotonic() + 60 * minutes
            while time.monotonic() < end:
                rclpy.spin_once(driver, timeout_sec=0.1)
            driver.finish()
        finally:
            process.send_signal(signal.SIGINT)
            rclpy.try_shutdown()
    return driver.observed


def report(observed: Observed, seconds: float) -> bool:
    """Print the figures beside their bounds; return whether all are met."""
    delays = 1e3 * np.array(observed.delays)
    settled = [(at, size) for at, size in observed.memory if at >= SETTLED]
    growth = max(size for _, size in settled) - settled[0][1] if settled else float("nan")
    used = int(observed.counts["views_used"])
    figures = {
        "lost": observed.sent - used,
        "p99": float(np.percentile(delays, 99)),
        "growth": growth,
    }
    print(f"{observed.sent} views in {seconds:.0f} s, {used} used, {observed.results} results")
    print(f"last views without a result       {len(observed.published)}")
    print(f"views lost                        {figures['lost']} (bound {BOUNDS['lost']})")
    print(
        f"last view to result, {len(delays)} objects  median {np.median(delays):.0f} ms, "
        f"p99 {figures['p99']:.0f} ms, worst {delays.max():.0f} ms (bound p99 {BOUNDS['p99']:.0f})"
    )
    print(f"memory after the first minute     +{growth:.1f} MB (bound {BOUNDS['growth']})")
    print(f"  {observed.memory[0][1]:.0f} MB at first, {observed.memory[-1][1]:.0f} MB at last")
    return all(figures[name] <= bound for name, bound in BOUNDS.items())


def main() -> int:
    """Run the benchmark; the exit code tells whether all bounds are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--rate", type=float, default=10.0, help="views a second, in total")
    arguments = parser.parse_args()
    observed = soak(arguments.minutes, arguments.rate)
    return 0 if report(observed, 60 * arguments.minutes) else 1


if __name__ == "__main__":
    sys.exit(main())
