"""Launch files and viewers' configurations name what the node really has.

They are read here as data: ROS's launch is no package that Python's installers know.
"""

import ast
import json
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path

import pytest
import yaml
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)

from momrec_ros.outputs import RESULT_TYPES
from momrec_ros.parameters import MAX_OBJECTS, NODE_PARAMETERS
from momrec_ros.pipeline import Input

ROOT = Path(__file__).parents[2]
NODE = "/recognizer"
TYPES = {
    "/contours": "visualization_msgs/msg/MarkerArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
} | {f"{NODE}/{name}": type_name for name, type_name in RESULT_TYPES.items()}
DISPLAYED_TYPES = {
    "rviz_default_plugins/Marker": "visualization_msgs/msg/Marker",
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    "rviz_default_plugins/Pose": "geometry_msgs/msg/PoseStamped",
}
IMPORTS = {"launch", "launch_ros", "lifecycle_msgs", "pathlib"}


def tree(name):
    return ast.parse((ROOT / "launch" / name).read_text())


def calls(name, function):
    """Return the calls of a function in a launch file."""
    return [
        node
        for node in ast.walk(tree(name))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == function
    ]


def constants(nodes):
    return [node.value for node in nodes if isinstance(node, ast.Constant)]


def assigned(name, variable):
    """Return what a launch file assigns to a variable, as an expression."""
    (value,) = [
        node.value
        for node in tree(name).body
        if isinstance(node, ast.Assign) and node.targets[0].id == variable
    ]
    return value


def keyword(call, name):
    return next((item.value for item in call.keywords if item.arg == name), None)


def declared(name):
    """Return the arguments of a launch file."""
    arguments = calls(name, "DeclareLaunchArgument") + calls(name, "_switch")
    return {text for call in arguments for text in constants(call.args[:1])}


LAUNCH_FILES = [path.name for path in sorted((ROOT / "launch").glob("*.launch.py"))]


@pytest.mark.parametrize("name", LAUNCH_FILES)
def test_a_launch_file_compiles_and_offers_a_description(name):
    code = compile(tree(name), name, "exec")
    assert "generate_launch_description" in code.co_names
    imported = {
        node.module.split(".")[0]
        for node in ast.walk(tree(name))
        if isinstance(node, ast.ImportFrom)
    }
    assert imported <= IMPORTS


def test_every_argument_has_a_default_and_a_description():
    for name in LAUNCH_FILES:
        for call in calls(name, "DeclareLaunchArgument"):
            assert keyword(call, "default_value") is not None
            assert keyword(call, "description") is not None


def test_the_launch_file_takes_what_a_robot_needs_to_set():
    inputs = {source.value for source in Input if source not in (Input.TF, Input.TF_STATIC)}
    expected = {"params_file", "model", "namespace", "use_sim_time", "autostart", "log_level"}
    constant = declared("recognizer.launch.py")
    assert constant == expected
    assert set(ast.literal_eval(assigned("recognizer.launch.py", "INPUTS"))) == inputs


def test_parameters_that_are_arguments_are_the_nodes_and_of_its_types():
    given = assigned("recognizer.launch.py", "PARAMETER_TYPES")
    types = {key.value: value.id for key, value in zip(given.keys, given.values, strict=True)}
    assert types.pop("use_sim_time") == "bool"  # every node has it
    expected = {item.name: type(item.default).__name__ for item in NODE_PARAMETERS}
    assert types
    assert types.items() <= expected.items()


def test_the_executable_is_installed_with_the_package():
    (call,) = calls("recognizer.launch.py", "LifecycleNode")
    executable = keyword(call, "executable").value
    scripts = distribution("momrec_ros").entry_points.select(group="console_scripts")
    assert callable(scripts[executable].load())
    assert keyword(call, "name").value == NODE.strip("/")


def test_the_replay_gives_the_recognizer_arguments_that_it_has_and_waits_for_it():
    (call,) = [
        node
        for node in tree("replay.launch.py").body
        if isinstance(node, ast.FunctionDef) and node.name == "_recognizer"
    ]
    texts = set(constants(ast.walk(call)))
    passed_on = texts & (declared("recognizer.launch.py") | declared("replay.launch.py"))
    assert passed_on == {"model", "use_sim_time", "log_level", "namespace", "autostart"}
    assert passed_on <= declared("recognizer.launch.py")
    steps = [
        keyword(call, "goal_state").value for call in calls("replay.launch.py", "OnStateTransition")
    ]
    assert steps == ["inactive", "active"]


def test_every_shared_file_that_a_launch_file_names_is_there():
    paths = [constants(call.args) for call in calls("replay.launch.py", "_shared")]
    paths += [
        constants(call.args[0].elts)
        for call in calls("recognizer.launch.py", "PathJoinSubstitution")
    ]
    assert len(paths) == 5
    for path in paths:
        assert ROOT.joinpath(*path).exists(), path


def rviz_displays():
    config = yaml.safe_load((ROOT / "rviz" / "momrec.rviz").read_text())
    return [item for item in config["Visualization Manager"]["Displays"] if "Topic" in item]


def test_rviz_shows_contours_mesh_axes_and_labels_with_displays_of_their_types():
    shown = {display["Topic"]["Value"]: display["Class"] for display in rviz_displays()}
    assert shown.keys() == {
        "/contours",
        f"{NODE}/markers",
        f"{NODE}/mesh",
        f"{NODE}/principal_frame",
    }
    for topic, display in shown.items():
        assert DISPLAYED_TYPES[display] == TYPES[topic]


def profile(history, reliability, durability, depth=1):
    """Return what RViz's settings stand for."""
    return QoSProfile(
        history=HistoryPolicy.get_from_short_key(key(history)),
        reliability=ReliabilityPolicy.get_from_short_key(key(reliability)),
        durability=DurabilityPolicy.get_from_short_key(key(durability)),
        liveliness=LivelinessPolicy.AUTOMATIC,
        depth=depth,
    )


def key(words):
    return words.lower().replace(" ", "_")


def wanted(display):
    topic = display["Topic"]
    policies = (topic[f"{name} Policy"] for name in ("History", "Reliability", "Durability"))
    return profile(*policies, topic["Depth"])


def test_rviz_is_served_what_was_published_before_it_started():
    output = profile("Keep Last", "Reliable", "Transient Local")
    for display in rviz_displays():
        if display["Topic"]["Value"].startswith(NODE):
            compatibility, reason = qos_check_compatible(output, wanted(display))
            assert compatibility == QoSCompatibility.OK, reason
            assert wanted(display).durability == DurabilityPolicy.TRANSIENT_LOCAL
            assert wanted(display).reliability == ReliabilityPolicy.RELIABLE


@pytest.mark.parametrize("reliability", ["Best Effort", "Reliable"])
def test_rviz_takes_contours_of_either_reliability(reliability):
    (contours,) = [item for item in rviz_displays() if item["Topic"]["Value"] == "/contours"]
    offered = profile("Keep Last", reliability, "Volatile")
    compatibility, reason = qos_check_compatible(offered, wanted(contours))
    assert compatibility == QoSCompatibility.OK, reason


def test_rviz_keeps_the_meshes_of_all_objects():
    (mesh,) = [item for item in rviz_displays() if item["Class"].endswith("/Marker")]
    assert mesh["Topic"]["Depth"] >= MAX_OBJECTS.default
    assert mesh["Topic"]["Filter size"] >= MAX_OBJECTS.default


def foxglove():
    return json.loads((ROOT / "config" / "foxglove.json").read_text())


def leaves(layout):
    if isinstance(layout, str):
        return [layout]
    return leaves(layout["first"]) + leaves(layout["second"])


def test_every_panel_of_the_foxglove_layout_is_configured_and_placed():
    layout = foxglove()
    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])


def test_foxglove_shows_the_same_topics_as_rviz():
    topics = foxglove()["configById"]["3D!scene"]["topics"]
    assert topics.keys() == {display["Topic"]["Value"] for display in rviz_displays()}
    assert all(settings["visible"] for settings in topics.values())


def test_foxglove_reads_fields_that_the_messages_have():
    panels = foxglove()["configById"].values()
    paths = [panel["topicPath"] for panel in panels if "topicPath" in panel]
    paths += [panel["topicToRender"] for panel in panels if "topicToRender" in panel]
    topics = set()
    for path in paths:
        topic, *fields = path.split(".")
        package, _, name = TYPES[topic].split("/")
        message = getattr(import_module(f"{package}.msg"), name)
        assert message.get_fields_and_field_types().keys() >= set(fields)
        topics.add(topic)
    assert topics == {f"{NODE}/label", f"{NODE}/recognition", "/diagnostics"}
