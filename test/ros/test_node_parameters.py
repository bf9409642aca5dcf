"""Parameters of the node `recognizer` and the models it is given, in a real graph."""

import json
import os
import re
from pathlib import Path
from types import SimpleNamespace

import graph as graphs
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from graph import box_views, view_message
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.parameter import parameter_value_to_python

from momrec_ros.node_parameters import OF_EVERY_NODE
from momrec_ros.parameters import NODE_PARAMETERS

MODEL = graphs.ROOT / "models/ten_objects.json"
TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}
WRONG = {"slices": 1, "min_views": "two", "projection": "fisheye", "publish_rate": -1.0}
REFUSAL = r"\[ERROR\].*cannot be configured: "


@pytest.fixture(scope="module")
def started(lasting_graph):
    node = lasting_graph.start(autostart=False)
    return SimpleNamespace(graph=lasting_graph, node=node, health=lasting_graph.listen_health())


@pytest.fixture
def unconfigured(started):
    yield started
    writable = (parameter for parameter in NODE_PARAMETERS if not parameter.read_only)
    reasons = started.graph.set(**{parameter.name: parameter.default for parameter in writable})
    assert not any(reasons)


@pytest.fixture
def configured(unconfigured):
    assert unconfigured.graph.change("configure")
    yield unconfigured
    assert unconfigured.graph.change("cleanup")


def test_every_parameter_is_declared_with_type_range_and_description(unconfigured):
    graph = unconfigured.graph
    listed = set(
        graph.call("list_parameters", ListParameters, ListParameters.Request()).result.names
    )
    names = [parameter.name for parameter in NODE_PARAMETERS]
    assert {name for name in listed if not name.startswith(OF_EVERY_NODE)} == set(names)
    request = DescribeParameters.Request(names=names)
    described = graph.call("describe_parameters", DescribeParameters, request).descriptors
    request = GetParameters.Request(names=names)
    values = graph.call("get_parameters", GetParameters, request).values
    for parameter, descriptor, value in zip(NODE_PARAMETERS, described, values, strict=True):
        assert descriptor.type == TYPES[type(parameter.default)]
        assert descriptor.description == parameter.description
        assert descriptor.read_only == (parameter.name == "autostart")
        assert not descriptor.dynamic_typing
        ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
        bounds = [(bound.from_value, bound.to_value) for bound in ranges]
        has_range = (
            isinstance(parameter.default, int | float) and type(parameter.default) is not bool
        )
        assert bounds == ([(parameter.minimum, parameter.maximum)] if has_range else [])
        assert all(choice in descriptor.additional_constraints for choice in parameter.choices)
        if parameter.name != "autostart":
            assert parameter_value_to_python(value) == parameter.default


def test_wrong_values_of_the_command_line_refuse_configure_until_they_are_set_right(graph):
    node = graph.start(**WRONG)
    graph.await_line(node, REFUSAL)
    assert graph.state() == "unconfigured"
    (line,) = graph.await_line(node, REFUSAL)
    for name, value in WRONG.items():
        assert f"expected {name} as " in line
        assert f"got {value!r}" in line
    graph.await_remark(graph.listen_health(), "expected slices as integer (2 to 2048)")
    assert not graph.change("configure")
    right = {"slices": 8, "min_views": 2, "projection": "auto", "publish_rate": 5.0}
    assert graph.set(**right) == [""] * 4
    assert graph.change("configure")
    assert graph.change("activate")


def test_wrong_values_of_a_params_file_refuse_configure(graph, tmp_path):
    path = tmp_path / "params.yaml"
    right = {"autostart": False, "max_objects": 5, "object_timeout": 3}
    given = WRONG | right | {"speed": 1, "world_frame": []}
    path.write_text(yaml.safe_dump({"recognizer": {"ros__parameters": given}}))
    node = graph.start("--params-file", str(path))
    assert not graph.change("configure")
    (line,) = graph.await_line(node, REFUSAL)
    assert all(f"expected {name} as " in line for name in (*WRONG, "world_frame"))
    graph.await_line(node, "unknown parameters are ignored: .* got speed")
    request = GetParameters.Request(names=["max_objects", "object_timeout", "slices"])
    values = graph.call("get_parameters", GetParameters, request).values
    assert [parameter_value_to_python(value) for value in values] == [5, 3.0, 64]


@pytest.mark.parametrize("value", [3, []])
def test_a_wrong_use_sim_time_ends_the_node_in_one_line(graph, value):
    node = graph.start(use_sim_time=value)
    assert node.process.wait(graphs.LIMIT) == 1
    node.close()
    (line,) = node.lines
    assert "use_sim_time" in line


def broken_models(folder):
    """Return paths of models that none can be loaded from, and what is said of them."""
    shipped = json.loads(MODEL.read_text())
    contents = {
        "cut.json": MODEL.read_text()[:1000],
        "other_version.json": json.dumps(shipped | {"version": 99}),
        "other_format.json": json.dumps(shipped | {"format": "shopping list"}),
        "no_means.json": json.dumps({key: shipped[key] for key in shipped if key != "means"}),
        "empty.json": "",
        "binary.json": "\0\1\2",
    }
    for name, content in contents.items():
        (folder / name).write_text(content)
    os.mkfifo(folder / "pipe.json")
    devices = (Path("/dev/zero"), Path("~nobody_of_this_name/model.json"))
    return [
        *(folder / name for name in contents),
        folder / "pipe.json",
        folder / "missing.json",
        folder,
        *devices,
    ]


def test_a_model_that_cannot_be_loaded_refuses_configure_in_one_line_until_it_is_another(
    unconfigured, tmp_path
):
    unconfigured.graph.await_line(unconfigured.node, "waits to be configured")
    for path in broken_models(tmp_path):
        before = len(unconfigured.node.lines)
        assert unconfigured.graph.set(model=str(path)) == [""]
        assert not unconfigured.graph.change("configure")
        unconfigured.graph.until(lambda before=before: unconfigured.node.lines[before:], "a line")
        assert unconfigured.graph.state() == "unconfigured"
        (line,) = unconfigured.node.lines[before:]
        assert "cannot be configured: " in line
        assert str(path) in line
    unconfigured.graph.await_remark(unconfigured.health, line.partition(": ")[2])
    assert unconfigured.graph.set(model=str(MODEL)) == [""]
    assert unconfigured.graph.change("configure")
    unconfigured.graph.await_remark(unconfigured.health, "inactive")
    assert unconfigured.graph.change("cleanup")


def test_limits_that_contradict_each_other_refuse_configure(unconfigured):
    assert unconfigured.graph.set(min_views=10, max_views=5) == ["", ""]
    assert not unconfigured.graph.change("configure")
    pattern = "cannot be configured: expected max_views of at least 10, got 5"
    unconfigured.graph.await_line(unconfigured.node, pattern)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("slices", 1),
        ("slices", 2049),
        ("slices", 8.5),
        ("slices", "8"),
        ("slices", True),
        ("publish_rate", 0.0),
        ("publish_rate", float("nan")),
        ("object_timeout", float("inf")),
        ("object_timeout", -1.0),
        ("pair_timeout", "soon"),
        ("projection", "fisheye"),
        ("input_reliability", "mostly"),
        ("publish_tf", 1),
        ("autostart", True),
        ("autostart", False),
        ("model", 3),
    ],
)
def test_a_wrong_value_is_refused_with_a_reason(unconfigured, name, value):
    (reason,) = unconfigured.graph.set(**{name: value})
    assert name in reason or re.match("Wrong parameter type|.*read-only", reason)


def test_what_is_taken_when_configured_cannot_be_set_afterwards(configured):
    for parameter in NODE_PARAMETERS:
        if not parameter.live and not parameter.read_only:
            (reason,) = configured.graph.set(**{parameter.name: parameter.default})
            assert reason == (
                f"{parameter.name} is taken when the node is configured: expected an unconfigured "
                "node, got one that is inactive"
            )


def test_what_is_live_can_be_set_in_every_state(configured):
    live = {parameter.name: parameter.default for parameter in NODE_PARAMETERS if parameter.live}
    assert set(live) == {"publish_rate", "object_timeout", "pair_timeout", "publish_tf"}
    assert configured.graph.set(**live) == [""] * len(live)
    assert configured.graph.change("activate")
    assert configured.graph.set(**live) == [""] * len(live)
    assert configured.graph.change("deactivate")


def test_a_new_publish_rate_counts_at_once(graph):
    graph.start(slices=8, publish_rate=0.01)
    results = graph.listen("recognition", DiagnosticArray)
    publisher = graph.start_publisher()
    for number, view in enumerate(box_views(5), start=1):
        publisher.publish(view_message(view))
        if number == 2:
            graph.until(lambda: results.messages, "a first result")
    assert graph.set(publish_rate=1000.0) == [""]
    graph.until(lambda: len(results.messages) == 2, "a second result")
