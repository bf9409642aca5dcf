"""Masks with calibrations and poses, by topic or by transforms, to the node in a real graph."""

from functools import partial
from importlib.util import find_spec
from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import stamps
from mask_scenes import (
    BARREL,
    FRAME,
    WORLD,
    camera_info,
    cameras,
    encoded,
    image,
    mask,
    transforms,
    view_messages,
)

from momrec_core import Camera, reconstruct
from momrec_ros.mask_messages import MaskRules
from momrec_ros.messages import ViewDecoder

KINDS = {
    "mask": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "camera_pose": "geometry_msgs/msg/PoseStamped",
}
TF = "tf2_msgs/msg/TFMessage"
RULES = MaskRules(tolerance=0.8, margin=0.5)


@pytest.fixture(scope="module")
def active(lasting_graph):
    """Return a graph with an active node."""
    lasting_graph.start(slices=24, tolerance=RULES.tolerance, margin=RULES.margin)
    health = lasting_graph.listen_health()
    results = lasting_graph.listen("recognition", DiagnosticArray, durability="volatile")
    publisher = lasting_graph.start_publisher()
    return SimpleNamespace(graph=lasting_graph, publisher=publisher, health=health, results=results)


@pytest.fixture
def fresh(active):
    """Return the same without objects, and the counts as of now."""
    assert active.graph.reset().success
    active.results.messages.clear()
    active.health.clear()  # those of before the reset may not count all yet
    active.graph.until(lambda: active.health, "diagnostics")
    return active


def publish(active, messages, order=tuple(KINDS)):
    for name in order:
        if name in messages:
            active.publisher.publish(messages[name], name, KINDS[name])


def await_values(active, views):
    """Await a result of so many views; return its values."""

    def values():
        statuses = [message.status[0] for message in active.results.messages]
        found = {pair.key: pair.value for pair in statuses[-1].values} if statuses else {}
        return found if found.get("views") == str(views) else None

    return active.graph.until(values, f"a result of {views} views")


def await_more(active, **more):
    before = active.health[-1]
    expected = {key: int(before[key]) + count for key, count in more.items()}
    return partial(active.graph.await_health, active.health, **expected)


def test_masks_through_a_lens_become_the_mesh_that_the_library_makes(fresh):
    decoder, views = ViewDecoder(rules=RULES), []
    orders = list(permutations(KINDS))
    for camera, order in zip(cameras(), orders, strict=True):
        messages = view_messages(camera, next(stamps), BARREL)
        publish(fresh, messages, order)
        views += [event.view for name in KINDS for event in getattr(decoder, name)(messages[name])]
    values = await_values(fresh, len(views))
    expected = reconstruct(views, 24).mesh()
    assert len(views) == len(orders)
    # Topics have no order among them, so views may come in another, and be sliced otherwise.
    assert float(values["volume"]) == pytest.approx(expected.volume, rel=5e-3)
    assert float(values["area"]) == pytest.approx(expected.area, rel=2e-2)
    assert (values["rejected_views"], values["cut_views"]) == ("0", "0")


def test_bad_masks_are_counted_under_their_reasons_and_the_next_good_one_works(fresh):
    camera = cameras()[0]
    changes = {
        "image": {"mask": {"encoding": "rgb8"}},
        "calibration": {"camera_info": {"k": (0.0,) * 9}},
        "lens": {"camera_info": {"distortion_model": "equidistant"}},
        "contour": {"mask": {"data": bytes(mask(camera).size)}},
    }
    reasons = {f"rejected_{reason}": 1 for reason in changes}
    await_counts = await_more(fresh, views_used=1, views_rejected=len(changes), **reasons)
    for changed in changes.values():
        stamp = next(stamps)
        messages = view_messages(camera, stamp)
        if "mask" in changed:
            messages["mask"] = encoded(image(mask(camera), stamp, **changed["mask"]))
        else:
            info = camera_info(camera, stamp, BARREL)
            messages["camera_info"] = encoded(replaced(info, changed["camera_info"]))
        publish(fresh, messages)
    publish(fresh, view_messages(camera, next(stamps)))
    await_counts()


def replaced(info, changes):
    return type(info)(**vars(info) | changes)


def test_a_mask_that_the_border_cuts_is_used_and_counted(fresh):
    aside = Camera.pinhole(cameras()[1].pose, np.array([[420.0, 0, 20], [0, 410, 121], [0, 0, 1]]))
    await_counts = await_more(fresh, views_used=2, views_cut=1)
    for camera in (cameras()[0], aside):
        publish(fresh, view_messages(camera, next(stamps)))
    await_counts()
    assert await_values(fresh, 2)["cut_views"] == "1"


def test_what_a_mask_lacks_is_told_after_pair_timeout(fresh):
    messages = view_messages(cameras()[0], next(stamps))
    await_counts = await_more(fresh, rejected_pair=1, halves_waiting=0)
    fresh.graph.set(pair_timeout=3600.0)
    publish(fresh, messages, ("mask", "camera_pose"))
    fresh.graph.await_health(fresh.health, halves_waiting=1)
    fresh.graph.set(pair_timeout=0.01)
    await_counts()
    assert "Expected a camera_info with the stamp of the mask" in fresh.health[-1]["last_loss"]
    fresh.graph.set(pair_timeout=1.0)


def test_a_camera_info_alone_is_no_loss(fresh):
    await_counts = await_more(fresh, messages=1, views_rejected=0, halves_waiting=0)
    fresh.graph.set(pair_timeout=0.01)
    publish(fresh, view_messages(cameras()[0], next(stamps)), ("camera_info",))
    await_counts()
    fresh.graph.set(pair_timeout=1.0)


def test_transforms_want_a_world_frame(graph):
    node = graph.start(pose_source="tf")
    pattern = "cannot be configured: expected (a world_frame|tf2_msgs for pose_source tf)"
    graph.await_line(node, pattern)
    graph.await_state("unconfigured")


def test_cameras_are_where_transforms_say_or_the_node_says_what_is_not_installed(graph):
    node = graph.start(slices=16, pose_source="tf", world_frame=WORLD)
    if find_spec("tf2_msgs") is None:
        graph.await_line(node, "cannot be configured: expected tf2_msgs for pose_source tf, got a")
        return
    results = graph.listen("recognition", DiagnosticArray)
    active = SimpleNamespace(graph=graph, results=results, publisher=graph.start_publisher())
    for camera in cameras():
        stamp = next(stamps)
        messages = view_messages(camera, stamp)
        publish(active, messages, ("mask", "camera_info"))
        moved = transforms((WORLD, FRAME, stamp, camera.pose))
        active.publisher.publish(moved, "/tf", TF)
    await_values(active, len(cameras()))
