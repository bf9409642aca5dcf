"""A real graph for the tests of the node: its executable, a publisher and a listener.

The executable and the publisher are processes of their own; the listener is the test's process.
Every graph has a domain of its own, which no other graph of this machine has at the same time.
Whatever is awaited is an event with a time limit; nothing sleeps.
"""

import fcntl
import filecmp
import itertools
import json
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import rclpy
import trimesh
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

from momrec_core.simulation import simulate_views
from momrec_ros.messages import StampedView, encode_view

with warnings.catch_warnings():  # a dependency of rclpy's type support warns when it is loaded
    warnings.simplefilter("ignore", DeprecationWarning)
    import rosidl_generator_py  # noqa: F401

ROOT = Path(__file__).parents[2]
EXECUTABLE = ROOT / "install/momrec_ros/lib/momrec_ros/recognizer"
PACKAGES = ("momrec_core", "momrec_ros")
LIMIT = 40.0  # seconds until an event that was awaited counts as missing, on a busy machine
PATIENCE = 5.0  # seconds for a process to end by itself
LOOK = 0.02  # seconds between looks at what no executor tells
STEAL = 7  # column of a core's times in /proc/stat
DOMAINS = (*range(1, 51), *range(61, 101))  # people take those between by hand
NANOSECONDS = 1_000_000_000
CONTOURS = "visualization_msgs/msg/MarkerArray"
NODE = "/recognizer"

_next_domain = itertools.cycle(DOMAINS[os.getpid() % len(DOMAINS) :] + DOMAINS)
stamps = itertools.count(NANOSECONDS, NANOSECONDS // 10)


@contextmanager
def leased_domain():
    """Hold a domain that no other process holds; its end, however it comes, gives it back."""
    folder = Path(tempfile.gettempdir()) / f"momrec_test_domains_{os.getuid()}"
    folder.mkdir(exist_ok=True)
    for domain in itertools.islice(_next_domain, len(DOMAINS)):
        with (folder / str(domain)).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain
            return
    pytest.fail("expected a free ROS domain, got all of them taken")


@cache
def installed_environment():
    """Return the environment that a user has after `. install/setup.sh`."""
    if not EXECUTABLE.exists():
        pytest.fail("the node is not installed: run `colcon build` first", pytrace=False)
    installed = next((ROOT / "install/momrec_ros/lib").glob("python*/site-packages"))
    for path in (path for name in PACKAGES for path in (ROOT / name).glob("*.py")):
        if not filecmp.cmp(path, installed / path.relative_to(ROOT)):
            message = f"the node is installed from another {path.name}: run `colcon build` first"
            pytest.fail(message, pytrace=False)
    listing = subprocess.run(
        ["sh", "-c", '. "$0" && env -0', ROOT / "install/setup.sh"],
        check=True,
        capture_output=True,
        text=True,
    )
    return dict(pair.split("=", 1) for pair in listing.stdout.split("\0") if "=" in pair)


def stolen():
    """Return for how long a host has kept each core of this machine from it, in seconds.

    See proc_stat(5), steal: of a core with work to do; one that is idle loses nothing.
    """
    cores = re.findall(r"^cpu\d+ (.*)$", Path("/proc/stat").read_text(), re.MULTILINE)
    return np.array([int(core.split()[STEAL]) for core in cores]) / os.sysconf("SC_CLK_TCK")


class Program:
    """A process of the graph; what it writes to stderr is kept line by line."""

    def __init__(self, arguments, environment, **streams):
        self.process = subprocess.Popen(
            arguments, env=environment, stderr=subprocess.PIPE, **streams
        )
        self.lines = []
        self._is_to_end = False
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self):
        for line in self.process.stderr:
            self.lines.append(line.decode(errors="replace").rstrip("\n"))

    def logged(self, pattern):
        """Return the lines that match so far."""
        return [line for line in self.lines if re.search(pattern, line)]

    @property
    def has_died(self):
        return not self._is_to_end and self.process.poll() is not None

    def end(self, number, limit=LIMIT):
        """Send a signal; return the exit code, None if the process outlives the time limit.

        The limit is on the time that this machine runs: what a host takes of its cores meanwhile
        says nothing about the process.
        """
        self._is_to_end = True
        began, stolen_before = time.monotonic(), stolen()
        self.process.send_signal(number)
        left = limit
        while left > 0:
            try:
                code = self.process.wait(left)
            except subprocess.TimeoutExpired:
                taken = float((stolen() - stolen_before).max())
                left = limit - (time.monotonic() - began - taken)
            else:
                self._reader.join()
                return code
        return None

    def close(self):
        """End the process, by force where a signal does not: force leaves shared memory behind."""
        self.process.send_signal(signal.SIGCONT)
        if self.end(signal.SIGINT, PATIENCE) is None:
            self.process.kill()
            self.process.wait()
            self._reader.join()
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()


class Publisher(Program):
    """`graph_publisher.py`, at work in a graph."""

    def __init__(self, environment):
        super().__init__(
            [sys.executable, Path(__file__).with_name("graph_publisher.py")],
            environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def publish(
        self, data, topic="contours", kind=CONTOURS, *, reliability="reliable", listeners=1
    ):
        """Publish a serialised message once the listeners are there; None only awaits them."""
        size = -1 if data is None else len(data)
        command = {"topic": topic, "type": kind, "reliability": reliability}
        command |= {"listeners": listeners, "size": size}
        self.process.stdin.write(json.dumps(command).encode() + b"\n" + (data or b""))
        self.process.stdin.flush()
        ready, _, _ = select.select([self.process.stdout], [], [], LIMIT)
        answer = self.process.stdout.readline() if ready else b"nothing in time"
        assert answer == b"done\n", (answer, self.lines)


def nanoseconds(stamp):
    return stamp.sec * NANOSECONDS + stamp.nanosec


class Inbox:
    """Messages that came, and when each was sent (nanoseconds)."""

    def __init__(self):
        self.messages = []
        self.sent = []

    def take(self, message, info):
        self.messages.append(message)
        self.sent.append(info["source_timestamp"])


class Graph:
    """A domain with a listener in this process; starts the other processes and ends them."""

    def __init__(self, domain, folder):
        self.domain = domain
        self.programs = []
        self._stack = ExitStack()
        self._folder = folder
        self._context = Context()
        self._clients = {}
        rclpy.init(context=self._context, domain_id=domain)
        self._stack.callback(rclpy.try_shutdown, context=self._context)
        self.node = rclpy.create_node(
            "listener", context=self._context, enable_rosout=False, start_parameter_services=False
        )
        self._stack.callback(self.node.destroy_node)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._stack.callback(self._executor.shutdown)
        self._executor.add_node(self.node)

    def close(self):
        self._stack.close()

    @property
    def environment(self):
        own = {
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_LOG_DIR": str(self._folder),
            "RCUTILS_COLORIZED_OUTPUT": "0",
        }
        return installed_environment() | own

    def start(self, *arguments, **parameters):
        """Start the node's executable with arguments and parameters."""
        given = itertools.chain.from_iterable(
            ("-p", f"{name}:={_yaml(value)}") for name, value in parameters.items()
        )
        return self.add(
            Program(
                [EXECUTABLE, "--ros-args", *arguments, *given],
                self.environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        )

    def start_publisher(self):
        return self.add(Publisher(self.environment))

    def add(self, program):
        """Watch a process, and end it at the end."""
        self.programs.append(program)
        self._stack.callback(program.close)
        return program

    def until(self, condition, what, limit=LIMIT):
        """Take in messages until a condition holds; return its value."""
        end = time.monotonic() + limit
        while not (value := condition()):
            has_died = any(program.has_died for program in self.programs)
            if has_died or time.monotonic() > end:
                written = "\n".join(line for program in self.programs for line in program.lines)
                expected = what() if callable(what) else what
                pytest.fail(f"expected {expected} in time, got none of it\n{written}")
            self._executor.spin_once(timeout_sec=LOOK)
        return value

    def listen(self, name, kind, *, raw=False, durability="transient_local"):
        """Subscribe to an output of the node; return where its messages come to."""
        qos = QoSProfile(depth=1000, durability=DurabilityPolicy[durability.upper()])
        inbox = Inbox()
        topic = name if name.startswith("/") else f"{NODE}/{name}"
        self.node.create_subscription(kind, topic, inbox.take, qos, raw=raw)
        return inbox

    def await_line(self, program, pattern):
        """Take in messages until a process has written such lines; return them."""
        return self.until(lambda: program.logged(pattern), f"a line like {pattern}")

    def await_health(self, received, **expected):
        """Take in messages until the newest diagnostics have the expected counts."""
        words = {key: str(count) for key, count in expected.items()}
        self.until(
            lambda: received and words.items() <= received[-1].items(),
            lambda: f"{words} in {received[-1:]}",
        )

    def await_remark(self, received, remark):
        """Take in messages until the newest diagnostics say something."""
        self.until(lambda: received and remark in received[-1]["message"], remark)

    def listen_health(self):
        """Return the list that the node's own diagnostics come to, values by their keys."""
        received = []

        def take(message):
            (status,) = message.status
            values = {pair.key: pair.value for pair in status.values}
            stamp = nanoseconds(message.header.stamp)
            received.append(values | {"message": status.message, "stamp": str(stamp)})

        self.node.create_subscription(DiagnosticArray, "/diagnostics", take, 100)
        return received

    def call(self, name, kind, request, *, again=False):
        """Call a service of the node; return the response.

        The middleware drops a response whose reader the node has not found yet; with ``again``
        the request is repeated then, which only those may that change nothing by it.
        """
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f"{NODE}/{name}")
        client = self._clients[name]
        self.until(client.service_is_ready, f"the service {name}")
        futures = [client.call_async(request)]
        asked_at = time.monotonic()

        def answered():
            nonlocal asked_at
            if again and time.monotonic() - asked_at > PATIENCE:
                futures.append(client.call_async(request))
                asked_at = time.monotonic()
            return next((future for future in futures if future.done()), None)

        return self.until(answered, f"an answer of {name}").result()

    def state(self):
        response = self.call("get_state", GetState, GetState.Request(), again=True)
        return response.current_state.label

    def await_state(self, label):
        self.until(lambda: self.state() == label, f"the state {label}")

    def change(self, transition):
        """Ask for a transition, by its name; return whether it was made."""
        number = {
            "configure": Transition.TRANSITION_CONFIGURE,
            "activate": Transition.TRANSITION_ACTIVATE,
            "deactivate": Transition.TRANSITION_DEACTIVATE,
            "cleanup": Transition.TRANSITION_CLEANUP,
        }
        shutdown = {
            "unconfigured": Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
            "inactive": Transition.TRANSITION_INACTIVE_SHUTDOWN,
            "active": Transition.TRANSITION_ACTIVE_SHUTDOWN,
        }
        chosen = number[transition] if transition in number else shutdown[self.state()]
        request = ChangeState.Request(transition=Transition(id=chosen))
        return self.call("change_state", ChangeState, request).success

    def reset(self):
        return self.call("reset", Trigger, Trigger.Request())

    def set(self, **values):
        """Set parameters, each by itself; return the reasons of refusals, empty for none."""
        request = SetParameters.Request(
            parameters=[
                Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
            ]
        )
        results = self.call("set_parameters", SetParameters, request, again=True).results
        return [("" if result.successful else result.reason or "refused") for result in results]


def _yaml(value):
    return str(value).lower() if isinstance(value, bool) else str(value)


@contextmanager
def open_graph(folder):
    """Hold a graph; its processes are ended with it."""
    with leased_domain() as domain:
        graph = Graph(domain, folder)
        try:
            yield graph
        finally:
            graph.close()


@cache
def box_views(count, size=(1.0, 2.0, 3.0), seed=1):
    """Return views of a box."""
    return simulate_views(trimesh.creation.box(size), count, np.random.default_rng(seed))


def view_message(view, object_id="box", stamp=None, frame_id="map"):
    """Return a serialised view, by default with a stamp of its own."""
    stamp = next(stamps) if stamp is None else stamp
    return encode_view(StampedView(object_id, stamp, frame_id, view))
