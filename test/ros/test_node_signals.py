"""SIGINT and SIGTERM end the node `recognizer` in every state, soon and in silence."""

import re
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from graph import view_message

from momrec_core.camera import Camera
from momrec_core.view import View

SIGNALS = (signal.SIGINT, signal.SIGTERM)
BOUND = 1.0  # seconds
SOON = 5.0  # seconds: others forget a node that vanishes without a word after twenty
HEAVY = 2048  # slices: seconds of computation for a star

each_signal = pytest.mark.parametrize("number", SIGNALS)


def star_view(angle):
    """Return a horizontal view of many folds; meshes of such views take long."""
    pose = np.eye(4)
    pose[:3, 0] = np.sin(angle), -np.cos(angle), 0
    pose[:3, 1] = 0, 0, -1
    pose[:3, 2] = np.cos(angle), np.sin(angle), 0
    turn = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    radius = 1 + 0.3 * np.cos(40 * turn)
    ring = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    return View.from_rings(Camera.orthographic(pose), [ring])


def assert_ends(program, number):
    assert program.end(number, BOUND) == 0
    assert not program.logged("Traceback|Error|exception|terminate")


@each_signal
@pytest.mark.parametrize(
    "transitions",
    [(), ("configure",), ("configure", "activate"), ("configure", "activate", "shutdown")],
    ids=["unconfigured", "inactive", "active", "finalized"],
)
def test_a_signal_ends_the_node_in_every_state(graph, transitions, number):
    node = graph.start(autostart=False)
    for transition in transitions:
        assert graph.change(transition)
    graph.state()
    assert_ends(node, number)


def is_in(graph):
    return "recognizer" in graph.node.get_node_names()


def segments(process):
    """Return the shared memory that a process and others map; ports belong to no one."""
    maps = Path(f"/proc/{process}/maps").read_text().splitlines()
    paths = {Path(line.split()[-1]) for line in maps if "fastrtps_" in line}
    return {path for path in paths if re.match("fastrtps_(?!port)", path.name)}


def test_a_node_that_has_ended_leaves_the_graph_and_no_shared_memory(graph):
    of_the_listener = segments("self")
    node = graph.start()
    graph.until(lambda: is_in(graph), "the node")
    graph.state()
    of_the_node = segments(node.process.pid) - of_the_listener
    assert of_the_node
    assert_ends(node, signal.SIGINT)
    graph.until(lambda: not is_in(graph), "the end of the node", SOON)
    assert not any(path.exists() for path in of_the_node)


@each_signal
def test_a_signal_ends_the_node_while_it_computes(graph, number):
    node = graph.start(slices=HEAVY)
    health = graph.listen_health()
    publisher = graph.start_publisher()
    for angle in (0.0, 0.4):
        publisher.publish(view_message(star_view(angle)))
    graph.await_health(health, views_used=2, results=0)
    assert_ends(node, number)


def catches(program, number):
    """Tell whether a process has a handler of its own for a signal."""
    status = Path(f"/proc/{program.process.pid}/status").read_text()
    (mask,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigCgt"))
    return int(mask, 16) >> (number - 1) & 1


def has_loaded(program, library):
    return library in Path(f"/proc/{program.process.pid}/maps").read_text()


@each_signal
@pytest.mark.parametrize(
    "library",
    ["", "_rclpy_pybind11", "_arpack", "librmw_fastrtps"],
    ids=lambda name: name or "none",
)
def test_a_signal_ends_the_node_while_it_starts(graph, library, number):
    node = graph.start()
    graph.until(partial(catches, node, signal.SIGTERM), "a handler of SIGTERM")
    graph.until(partial(has_loaded, node, library), library)
    assert_ends(node, number)


@each_signal
def test_a_signal_ends_the_node_while_it_configures_itself(graph, number):
    node = graph.start()
    graph.await_line(node, "no model")
    assert_ends(node, number)
