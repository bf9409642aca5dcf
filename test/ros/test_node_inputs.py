"""What the node `recognizer` makes of its inputs, good and bad, in a real graph."""

from collections import Counter
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import box_views, nanoseconds, stamps, view_message
from shapely import box

from momrec_core import View, reconstruct
from momrec_ros.interfaces import (
    Header,
    MarkerType,
    PolygonStamped,
    PoseStamped,
    decode_marker_array,
    encode_marker_array,
    encode_polygon_stamped,
    encode_pose_stamped,
)
from momrec_ros.messages import pose_from_matrix, rings_in_camera

VIEWS = box_views(4)
(GOOD,) = decode_marker_array(view_message(VIEWS[0]))
SHIFTED = replace(GOOD.pose, position=(9.0, 9.0, 9.0))
POLYGON, POSE = "geometry_msgs/msg/PolygonStamped", "geometry_msgs/msg/PoseStamped"
MANY = 10_000_000


@pytest.fixture(scope="module")
def active(lasting_graph):
    """Return a graph with an active node that knows its world frame, `map`."""
    lasting_graph.start(slices=8)
    health = lasting_graph.listen_health()
    publisher = lasting_graph.start_publisher()
    publisher.publish(view_message(VIEWS[0], "first"))
    lasting_graph.await_health(health, world_frame="map")
    return SimpleNamespace(graph=lasting_graph, publisher=publisher, health=health)


def polygon(view, stamp):
    (ring,) = rings_in_camera(view)
    return encode_polygon_stamped(PolygonStamped(Header(stamp, "camera"), ring.astype(np.float32)))


def camera_pose(view, stamp):
    header = Header(stamp, "map")
    return encode_pose_stamped(PoseStamped(header, pose_from_matrix(view.camera.pose)))


def array(*markers):
    return encode_marker_array(markers)


def with_point(index, value):
    points = GOOD.points.copy()
    points[:, index] = np.where(np.arange(len(points)) == 1, value, points[:, index])
    return array(replace(GOOD, points=points))


BAD = {
    "an empty array": (array(), "empty"),
    "one point": (array(replace(GOOD, points=GOOD.points[:1])), "contour"),
    "no point": (array(replace(GOOD, points=GOOD.points[:0])), "points"),
    "a NaN": (with_point(0, np.nan), "points"),
    "an infinite point": (with_point(1, np.inf), "points"),
    "a pose of NaN": (
        array(replace(GOOD, pose=replace(GOOD.pose, position=(0, 0, np.nan)))),
        "pose",
    ),
    "another type of marker": (array(replace(GOOD, type=MarkerType.TRIANGLE_LIST)), "type"),
    "a quaternion that is none": (
        array(replace(GOOD, pose=replace(GOOD.pose, orientation=(0, 0, 0, 0.5)))),
        "quaternion",
    ),
    "differing poses": (array(GOOD, replace(GOOD, pose=SHIFTED)), "pose"),
    "differing stamps": (array(GOOD, replace(GOOD, header=Header(1, "map"))), "header"),
    "differing objects": (array(GOOD, replace(GOOD, ns="other")), "ns"),
    "an unknown frame": (array(replace(GOOD, header=Header(1, "odom"))), "frame"),
    "no frame": (array(replace(GOOD, header=Header(1, ""))), "frame"),
    "mixed projections": (with_point(2, 1.0), "projection"),
    "points behind the camera": (with_point(2, -1.0), "projection"),
    "an unknown action": (array(replace(GOOD, action=1)), "action"),
    "garbage": (bytes(range(256)), "encoding"),
    "a truncated message": (array(GOOD)[:-20], "encoding"),
    "a message that goes on": (array(GOOD) + bytes(20), "encoding"),
}


def await_more(active, **more):
    """Return a function that awaits diagnostics with so many more of the counts."""
    before = active.health[-1]
    expected = {key: int(before[key]) + count for key, count in more.items()}
    return partial(active.graph.await_health, active.health, **expected)


def test_bad_messages_are_counted_under_their_reasons_and_the_next_good_ones_work(active):
    reasons = Counter(f"rejected_{reason}" for _, reason in BAD.values())
    await_counts = await_more(active, views_rejected=len(BAD), views_used=len(BAD), **reasons)
    for data, _ in BAD.values():
        active.publisher.publish(data)
        active.publisher.publish(view_message(VIEWS[0]))
    await_counts()


def test_ten_million_points_are_counted_as_too_many_and_the_next_view_works(active):
    await_counts = await_more(active, rejected_size=1, views_used=1)
    active.publisher.publish(array(replace(GOOD, points=np.resize(GOOD.points, (MANY, 3)))))
    active.publisher.publish(view_message(VIEWS[0]))
    await_counts()


def test_a_view_beside_the_object_is_counted_as_a_contradiction(active):
    first, second = VIEWS[:2]
    await_counts = await_more(active, rejected_contradiction=1, views_used=2)
    (marker,) = decode_marker_array(view_message(second, "contradicted"))
    active.publisher.publish(view_message(first, "contradicted"))
    active.publisher.publish(array(replace(marker, pose=SHIFTED)))
    active.publisher.publish(view_message(second, "contradicted"))
    await_counts()


def test_a_bad_mask_is_named_by_its_stamp_and_the_result_is_right_without_it(active):
    active.graph.reset()
    results = active.graph.listen("recognition", DiagnosticArray, durability="volatile")
    views = box_views(8)
    left, low, right, high = views[3].silhouette.bounds
    half = views[3].silhouette.intersection(box(left, low, (left + right) / 2, high))
    shown = [*views[:3], View(views[3].camera, half), *views[4:]]
    given = [next(stamps) for _ in shown]
    await_counts = await_more(active, rejected_contradiction=1, views_used=7)
    for view, stamp in zip(shown, given, strict=True):
        active.publisher.publish(view_message(view, "spoiled", stamp))
    await_counts()

    def last():
        return {pair.key: pair.value for pair in results.messages[-1].status[0].values}

    active.graph.until(
        lambda: results.messages and (last()["views"], last()["contradicting_views"]) == ("7", "1"),
        "a result without the bad mask",
    )
    expected = reconstruct([*views[:3], *views[4:]], 8).mesh().volume
    assert float(last()["volume"]) == pytest.approx(expected, rel=1e-3)
    assert float(last()["coverage_worst"]) > 0.98
    named = f"view of object 'spoiled' at {given[3] / 1e9:.3f} s left out: it contradicts"
    active.graph.until(
        lambda: any(named in status["last_loss"] for status in active.health),
        "the bad view's name",
    )


@pytest.mark.parametrize("order", [(0, 1), (1, 0)], ids=["contour first", "camera_pose first"])
def test_contours_and_camera_poses_pair_by_stamp_in_either_order(active, order):
    active.graph.reset()
    results = active.graph.listen("recognition", DiagnosticArray, durability="volatile")
    for view in VIEWS:
        stamp = next(stamps)
        halves = (
            (polygon(view, stamp), "contour", POLYGON),
            (
                camera_pose(view, stamp),
                "camera_pose",
                POSE,
            ),
        )
        for place in order:
            active.publisher.publish(*halves[place])

    def verdict():
        statuses = [message.status[0] for message in results.messages]
        return statuses and {pair.key: pair.value for pair in statuses[-1].values}

    active.graph.until(lambda: (verdict() or {}).get("views") == str(len(VIEWS)), "a result")
    assert results.messages[-1].status[0].hardware_id == ""
    assert nanoseconds(results.messages[-1].header.stamp) == stamp


@pytest.mark.parametrize(
    ("topic", "kind", "half"),
    [("contour", POLYGON, polygon), ("camera_pose", POSE, camera_pose)],
    ids=["contour", "camera_pose"],
)
def test_a_lone_half_waits_until_pair_timeout_and_is_counted(active, topic, kind, half):
    await_counts = await_more(active, rejected_pair=1, halves_waiting=0)
    active.graph.set(pair_timeout=3600.0)
    active.publisher.publish(half(VIEWS[0], next(stamps)), topic, kind)
    active.graph.await_health(active.health, halves_waiting=1)
    active.graph.set(pair_timeout=0.01)
    await_counts()
    active.graph.set(pair_timeout=1.0)


def test_the_same_view_twice_counts_once(active):
    data = view_message(VIEWS[0], "twice")
    await_counts = await_more(active, views_used=1, views_repeated=1)
    active.publisher.publish(data)
    active.publisher.publish(data)
    await_counts()


def test_views_while_the_node_is_inactive_are_none_of_its_own(active):
    await_counts = await_more(active, messages=2)
    active.publisher.publish(view_message(VIEWS[0]))
    assert active.graph.change("deactivate")
    active.publisher.publish(view_message(VIEWS[0]), listeners=0)
    assert active.graph.change("activate")
    active.publisher.publish(view_message(VIEWS[0]))
    await_counts()
