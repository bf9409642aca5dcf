"""Objects of the node `recognizer` from their first view to their end, in a real graph."""

import re
from functools import partial
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import NANOSECONDS, box_views, view_message
from visualization_msgs.msg import Marker

from momrec_ros.interfaces import Header, MarkerAction, encode_marker_array
from momrec_ros.interfaces import Marker as PlainMarker

VIEWS = box_views(4)
MOST = 3
NEVER = 0.01  # results a second: after an object's first, none within a test
CLOCK = "rosgraph_msgs/msg/Clock"


@pytest.fixture(scope="module")
def started(lasting_graph):
    lasting_graph.start(slices=8, max_objects=MOST)
    return SimpleNamespace(
        graph=lasting_graph,
        node=lasting_graph.programs[0],
        publisher=lasting_graph.start_publisher(),
        health=lasting_graph.listen_health(),
        sent=0,
        recognitions=lasting_graph.listen("recognition", DiagnosticArray).messages,
        meshes=lasting_graph.listen("mesh", Marker).messages,
    )


@pytest.fixture
def fresh(started, request):
    """Return the graph of this module without objects, and an id of the test's own."""
    started.graph.await_health(started.health, messages=started.sent, messages_waiting=0)
    started.graph.reset()
    started.graph.await_health(started.health, objects=0)
    started.graph.set(publish_rate=NEVER, object_timeout=0.0)
    started.recognitions.clear()
    started.meshes.clear()
    started.id = request.node.name
    return started


def forget(object_id):
    header = Header(NANOSECONDS, "map")
    return encode_marker_array([PlainMarker(header, object_id, action=MarkerAction.DELETEALL)])


def publish(fresh, data):
    fresh.publisher.publish(data)
    fresh.sent += 1


def show(fresh, object_id, views):
    for view in views:
        publish(fresh, view_message(view, object_id))


def gather(fresh, object_id):
    """Show an object in two views, await the result, and show a third for which none comes."""
    show(fresh, object_id, VIEWS[:2])
    fresh.graph.until(lambda: last_views(fresh, object_id) == 2, "a first result")
    show(fresh, object_id, VIEWS[2:3])


def last_views(fresh, object_id):
    statuses = [message.status[0] for message in fresh.recognitions]
    counts = [
        int(pair.value)
        for status in statuses
        if status.hardware_id == object_id
        for pair in status.values
        if pair.key == "views"
    ]
    return counts[-1] if counts else 0


def deleted(fresh):
    return [mesh.ns for mesh in fresh.meshes if mesh.action == Marker.DELETE]


def await_last_result_and_deletion(fresh, object_id):
    fresh.graph.until(lambda: object_id in deleted(fresh), "a deletion")
    fresh.graph.until(lambda: last_views(fresh, object_id) == 3, "a last result")
    actions = [mesh.action for mesh in fresh.meshes if mesh.ns == object_id]
    assert actions == [Marker.ADD, Marker.ADD, Marker.DELETE]


def test_a_forgotten_object_ends_with_its_last_result_and_the_others_stay(fresh):
    gather(fresh, fresh.id)
    gather(fresh, "other")
    publish(fresh, forget(fresh.id))
    await_last_result_and_deletion(fresh, fresh.id)
    fresh.graph.await_health(fresh.health, objects=1)
    assert deleted(fresh) == [fresh.id]
    gather(fresh, fresh.id)  # begins anew


def test_a_deletion_without_a_name_ends_all_objects(fresh):
    gather(fresh, fresh.id)
    gather(fresh, "other")
    publish(fresh, forget(""))
    for object_id in (fresh.id, "other"):
        await_last_result_and_deletion(fresh, object_id)
    fresh.graph.await_health(fresh.health, objects=0)


def test_a_reset_forgets_all_at_once_and_says_how_much(fresh):
    gather(fresh, fresh.id)
    gather(fresh, "other")
    fresh.graph.await_health(fresh.health, objects=2)
    response = fresh.graph.reset()
    assert response.success
    assert "2" in response.message
    fresh.graph.until(lambda: fresh.meshes[-1].action == Marker.DELETEALL, "a deletion")
    fresh.graph.await_health(fresh.health, objects=0, world_frame="")
    assert last_views(fresh, fresh.id) == 2
    gather(fresh, fresh.id)  # begins anew


def test_one_object_too_many_ends_the_one_without_a_view_for_longest(fresh):
    evicted = int(fresh.health[-1]["objects_evicted"])
    gather(fresh, fresh.id)
    for object_id in "abc"[:MOST]:
        show(fresh, object_id, VIEWS[:2])
    await_last_result_and_deletion(fresh, fresh.id)
    fresh.graph.await_health(fresh.health, objects=MOST, objects_evicted=evicted + 1)
    line = f"object '{re.escape(fresh.id)}' is evicted: expected at most max_objects"
    fresh.graph.await_line(fresh.node, line)


def test_an_object_without_views_ends_after_object_timeout(fresh):
    ended = int(fresh.health[-1]["objects_timed_out"])
    gather(fresh, fresh.id)
    fresh.graph.await_health(fresh.health, objects=1)
    fresh.graph.set(object_timeout=0.01)
    await_last_result_and_deletion(fresh, fresh.id)
    fresh.graph.await_health(fresh.health, objects=0, objects_timed_out=ended + 1)
    line = f"object '{re.escape(fresh.id)}' is ended: no view for object_timeout"
    fresh.graph.await_line(fresh.node, line)


def test_object_timeout_follows_simulated_time(graph):
    graph.start(slices=8, object_timeout=10.0, use_sim_time=True)
    health = graph.listen_health()
    publisher = graph.start_publisher()

    def has_the_time(second):  # once is not enough: /clock is not reliable
        publisher.publish(clock(second), "/clock", CLOCK)
        return health and health[-1]["stamp"] == str(second * NANOSECONDS)

    graph.until(partial(has_the_time, 100), "the first time")
    publisher.publish(view_message(VIEWS[0]))
    graph.await_health(health, objects=1)
    graph.until(partial(has_the_time, 109), "a time before object_timeout")
    graph.await_health(health, objects=1)
    graph.until(partial(has_the_time, 111), "a time after object_timeout")
    graph.await_health(health, objects=0, objects_timed_out=1)


def clock(second):
    """Return a serialised rosgraph_msgs/Clock."""
    return b"\0\1\0\0" + second.to_bytes(4, "little") + bytes(4)
