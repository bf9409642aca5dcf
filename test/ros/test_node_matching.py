"""Whom the node `recognizer` hears and whom not, and that it says so, in a real graph."""

from importlib.util import find_spec

import pytest
from graph import box_views, view_message
from rclpy.topic_endpoint_info import TopicEndpointInfo

from momrec_ros.node import owner_of

VIEWS = box_views(3)
OTHER = "std_msgs/msg/String"


@pytest.fixture(scope="module")
def reliable(lasting_graph):
    lasting_graph.start(slices=8)
    return lasting_graph


def test_a_publisher_of_less_reliability_is_told_with_both_profiles(reliable):
    publisher = reliable.start_publisher()
    publisher.publish(None, reliability="best_effort", listeners=None)
    expected = (
        "nothing comes from the publisher of /contours in /publisher: expected reliable, volatile "
        r"\(input_reliability\), got best_effort, volatile"
    )
    node, *_ = reliable.programs
    reliable.await_line(node, expected)
    publisher.close()


def test_a_publisher_of_another_type_is_told(reliable):
    publisher = reliable.start_publisher()
    publisher.publish(None, kind=OTHER, listeners=None)
    expected = (
        "nothing comes from the publisher of /contours in /publisher: expected type "
        "visualization_msgs/msg/MarkerArray, got std_msgs/msg/String"
    )
    node, *_ = reliable.programs
    reliable.await_line(node, expected)


@pytest.mark.parametrize(("part", "package"), [("tf", "tf2_ros"), ("detections", "vision_msgs")])
def test_a_line_says_which_optional_outputs_are_on(reliable, part, package):
    is_on = find_spec({"tf": "tf2_msgs", "detections": "vision_msgs"}[part]) is not None
    expected = f"{part} is on" if is_on else f"{part} is off: {package} is not installed"
    node, *_ = reliable.programs
    reliable.await_line(node, expected)


@pytest.mark.parametrize("reliability", ["best_effort", "reliable"])
def test_a_node_that_asks_for_best_effort_hears_both_kinds(graph, reliability):
    node = graph.start(slices=8, input_reliability="best_effort")
    health = graph.listen_health()
    publisher = graph.start_publisher()

    def has_heard():
        publisher.publish(view_message(VIEWS[0]), reliability=reliability)
        return health and int(health[-1]["views_used"])

    graph.until(has_heard, "a view used")
    assert not node.logged("nothing comes from the publisher")


@pytest.mark.parametrize(
    ("namespace", "name", "expected"),
    [
        ("/", "camera", "/camera"),
        ("/left", "camera", "/left/camera"),
        (
            "_NODE_NAMESPACE_UNKNOWN_",
            "_NODE_NAME_UNKNOWN_",
            "a node whose name is not known",
        ),
    ],
)
def test_a_publisher_is_told_by_its_node_once_that_is_discovered(namespace, name, expected):
    assert owner_of(TopicEndpointInfo(node_name=name, node_namespace=namespace)) == expected
