"""Results of the node `recognizer`, in a real graph: what comes out, when, and to whom."""

import signal
import sys
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import graph as graphs
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from graph import NANOSECONDS, Program, box_views, nanoseconds, view_message
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message
from shape_msgs.msg import Mesh
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from momrec_core.model import load_model
from momrec_ros.bag import read_bag
from momrec_ros.session import Result, Session

BAG = graphs.ROOT / "bags/ten_objects"
MODEL = graphs.ROOT / "models/ten_objects.json"
LIMITS = {"slices": 64, "min_views": 10, "max_objects": 16, "max_views": 1000}  # ten views each
TYPES = {
    "recognition": DiagnosticArray,
    "principal_frame": PoseStamped,
    "mesh": Marker,
    "normalized_mesh": Mesh,
    "label": String,
}
EXACT = {"rtol": 1e-9, "atol": 1e-9}
OBJECTS = {"small": 0.5, "": 1.0, "large one": 2.0}  # ids and sizes
RATE = 4.0


def replayed():
    """Return the result of each object of the shipped bag, without ROS."""
    session = Session(load_model(MODEL), **LIMITS)
    for event in read_bag(BAG):
        assert not session.feed(event, now=0)
    return {item.result.object_id: item for item in session.finish() if isinstance(item, Result)}


def recorded():
    (path,) = BAG.glob("*.mcap")
    with path.open("rb") as file:
        return [message.data for _, _, message in make_reader(file).iter_messages()]


def matrix(pose):
    """Return the pose of a message as a matrix, by Rodrigues' formula for quaternions."""
    x, y, z, w = pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    frame = np.eye(4)
    frame[:3, :3] += 2 * w * cross + 2 * cross @ cross
    frame[:3, 3] = pose.position.x, pose.position.y, pose.position.z
    return frame


def points(message_points):
    return np.array([(point.x, point.y, point.z) for point in message_points])


def assert_same(result, received):
    frame = result.canonical.principal_frame
    assert received.recognition.status[0].name == received.mesh.text == result.recognition.label
    np.testing.assert_allclose(matrix(received.principal_frame.pose), frame, **EXACT)
    vertices = points(received.normalized_mesh.vertices)
    np.testing.assert_allclose(vertices, result.canonical.mesh.vertices, **EXACT)
    faces = [triangle.vertex_indices for triangle in received.normalized_mesh.triangles]
    np.testing.assert_array_equal(faces, result.canonical.mesh.faces)
    corners = points(received.mesh.points) @ frame[:3, :3].T + frame[:3, 3]
    world = result.mesh.vertices[np.ravel(result.mesh.faces)]
    np.testing.assert_allclose(corners, world, **EXACT)


def test_the_shipped_bag_gives_in_the_graph_what_its_replay_gives(graph):
    graph.start(model=MODEL, min_views=LIMITS["min_views"])
    inboxes = {name: graph.listen(name, kind, raw=True) for name, kind in TYPES.items()}
    health = graph.listen_health()
    publisher = graph.start_publisher()
    graph.until(
        lambda: all(graph.node.count_publishers(f"/recognizer/{name}") for name in TYPES),
        "the outputs, so that no listener comes late",
    )
    for data in recorded():
        publisher.publish(data)
    expected = replayed()
    recognitions = inboxes["recognition"].messages

    def count_once_all_is_done():
        stamps = last_stamps(deserialize_message(data, DiagnosticArray) for data in recognitions)
        is_done = stamps == {object_id: item.stamp for object_id, item in expected.items()}
        return len(recognitions) if is_done else 0

    count = graph.until(count_once_all_is_done, "the last results")
    for name, inbox in inboxes.items():
        graph.until(lambda inbox=inbox: len(inbox.messages) == count, name)
    graph.await_health(health, views_rejected=0)
    meshes = [deserialize_message(data, Marker) for data in inboxes["mesh"].messages]
    last = {mesh.ns: number for number, mesh in enumerate(meshes)}
    assert sorted(last) == sorted(expected)
    for object_id, number in last.items():
        received = SimpleNamespace(
            **{
                name: deserialize_message(inboxes[name].messages[number], kind)
                for name, kind in TYPES.items()
            }
        )
        assert received.label.data == received.mesh.text
        assert_same(expected[object_id].result, received)


@pytest.fixture(scope="module")
def gathered(lasting_graph):
    """Return a graph whose node has gathered three objects, and the stamps of their results."""
    lasting_graph.start(model=MODEL, slices=8, publish_rate=1000.0)
    recognitions = lasting_graph.listen("recognition", DiagnosticArray)
    publisher = lasting_graph.start_publisher()
    stamps = {}
    for second, (object_id, size) in enumerate(OBJECTS.items(), start=1):
        for number, view in enumerate(box_views(3, (size, 2 * size, 3 * size))):
            stamps[object_id] = second * NANOSECONDS + number
            publisher.publish(view_message(view, object_id, stamps[object_id]))
    lasting_graph.until(
        lambda: last_stamps(recognitions.messages) == stamps, "results of all objects"
    )
    return SimpleNamespace(graph=lasting_graph, publisher=publisher, stamps=stamps)


def last_stamps(recognitions):
    return {
        message.status[0].hardware_id: nanoseconds(message.header.stamp) for message in recognitions
    }


@pytest.mark.parametrize("durability", ["volatile", "transient_local"])
def test_a_late_subscriber_sees_every_live_object_on_every_output(gathered, durability):
    inboxes = {
        name: gathered.graph.listen(name, kind, durability=durability)
        for name, kind in (TYPES | {"markers": MarkerArray}).items()
    }
    stamps = set(gathered.stamps.values())

    def have_all_come():
        names = [message.ns for message in inboxes["mesh"].messages]
        poses = inboxes["principal_frame"].messages
        shown = [marker.ns for array in inboxes["markers"].messages for marker in array.markers]
        return (
            last_stamps(inboxes["recognition"].messages) == gathered.stamps
            and set(names) == set(OBJECTS)
            and {nanoseconds(pose.header.stamp) for pose in poses} >= stamps
            and {f"{object_id}/axes" for object_id in OBJECTS} <= set(shown)
            and len(inboxes["normalized_mesh"].messages) >= len(OBJECTS)
            and len(inboxes["label"].messages) >= len(OBJECTS)
        )

    gathered.graph.until(have_all_come, "all objects on all outputs")


def test_every_message_with_a_header_is_stamped_and_framed(gathered):
    listen = gathered.graph.listen
    recognitions, poses = (
        listen("recognition", DiagnosticArray),
        listen("principal_frame", PoseStamped),
    )
    meshes, arrays = listen("mesh", Marker), listen("markers", MarkerArray)
    health = listen("/diagnostics", DiagnosticArray, durability="volatile")
    for inbox in (recognitions, poses, meshes, arrays, health):
        gathered.graph.until(lambda inbox=inbox: inbox.messages, "a message")
    markers = arrays.messages[-1].markers
    assert markers[0].action == Marker.DELETEALL
    of_results = [*recognitions.messages, *poses.messages, *meshes.messages, *markers]
    assert min(nanoseconds(item.header.stamp) for item in of_results) >= NANOSECONDS
    assert {item.header.frame_id for item in of_results} == {"map"}
    assert health.messages[-1].header.frame_id == "map"
    assert health.messages[-1].header.stamp.sec > 0


def test_the_outputs_of_one_result_share_their_stamp_and_go_out_in_order(graph):
    graph.start(slices=8, publish_rate=1000.0)
    inboxes = {name: graph.listen(name, kind) for name, kind in TYPES.items()}
    publisher = graph.start_publisher()
    shown = {}
    for view in box_views(6):
        for object_id in "abc":
            shown[object_id] = next(graphs.stamps)
            publisher.publish(view_message(view, object_id, shown[object_id]))
    recognitions = inboxes["recognition"].messages
    graph.until(lambda: last_stamps(recognitions) == shown, "the last results")
    for inbox in inboxes.values():
        graph.until(lambda inbox=inbox: len(inbox.messages) == len(recognitions), "all outputs")
    headers = [
        [message.header for message in inboxes[name].messages]
        for name in ("recognition", "principal_frame", "mesh")
    ]
    assert headers[0] == headers[1] == headers[2]
    sent = np.array([inbox.sent for inbox in inboxes.values()])
    assert (np.diff(sent.ravel(order="F")) > 0).all()


def test_a_stalled_listener_costs_no_view(graph):
    graph.start(slices=8, publish_rate=1000.0)
    health = graph.listen_health()
    publisher = graph.start_publisher()
    listener = graph.add(
        Program([sys.executable, Path(__file__).with_name("graph_listener.py")], graph.environment)
    )
    first, second, *others = box_views(300)
    publisher.publish(view_message(first))
    publisher.publish(view_message(second))
    graph.await_line(listener, "got a result")
    listener.process.send_signal(signal.SIGSTOP)
    for view in others[:98]:
        publisher.publish(view_message(view))
    graph.await_health(health, views_used=100, messages_waiting=0)
    assert health[-1]["messages_lost"] == "0"


def test_results_come_at_the_publish_rate_and_the_last_view_always_has_one(graph):
    graph.start(slices=8, publish_rate=RATE)
    recognitions = graph.listen("recognition", DiagnosticArray)
    publisher = graph.start_publisher()
    stamps = range(NANOSECONDS, NANOSECONDS + 30)
    views = zip(box_views(30), stamps, strict=True)
    sent = []
    for count in range(6):
        graph.until(lambda count=count: len(recognitions.messages) >= count, f"{count} results")
        for view, stamp in islice(views, 5):
            publisher.publish(view_message(view, stamp=stamp))
            sent.append(stamp)
    graph.until(
        lambda: last_stamps(recognitions.messages)["box"] == sent[-1], "a result of the last view"
    )
    count = len(recognitions.messages)
    seconds = (recognitions.sent[-1] - recognitions.sent[0]) / NANOSECONDS
    assert count < len(sent)
    assert count - 1 <= RATE * seconds + 1  # the last may be computed faster than the first was
