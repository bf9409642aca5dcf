"""Masks in bags: folders as bags, several cameras, transforms; against the folder itself."""

import json

import numpy as np
import pytest
import trimesh
from mask_scenes import FRAME, SIZE, WORLD, cameras, mask, transforms, view_messages
from mcap.writer import CompressionType, Writer
from PIL import Image
from rosbags.highlevel import AnyReader

from momrec_core import reconstruct
from momrec_ros.bag import BagError, Rejected, read_bag
from momrec_ros.cameras_json import CamerasError, read_cameras_json, read_mask
from momrec_ros.definitions import message_definition
from momrec_ros.mask_messages import MaskRules

KINDS = {
    "mask": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "camera_pose": "geometry_msgs/msg/PoseStamped",
    "tf": "tf2_msgs/msg/TFMessage",
    "tf_static": "tf2_msgs/msg/TFMessage",
}
MIRRORED = ((-420.0, 6.0, 158.0), (0.0, 410.0, 121.0), (0.0, 0.0, 1.0))
OPTIONS = ("--slices", "20", "--tolerance", "0.8", "--margin", "0.4")


def write_folder(folder, intrinsics=MIRRORED, count=6, change=lambda P: P):
    """Write masks of the body and a cameras.json with projections of either sign."""
    (folder / "masks").mkdir(parents=True)
    views = []
    for number, camera in enumerate(cameras(count, intrinsics=intrinsics)):
        name = f"masks/{number}.png"
        Image.fromarray(mask(camera)).save(folder / name)
        P = (-1) ** number * (camera.K @ np.linalg.inv(camera.pose)[:3])
        views.append({"mask": name, "P": change(P).tolist()})
    (folder / "cameras.json").write_text(json.dumps({"views": views}))
    return folder


def write_mcap(path, messages):
    """Write (topic, log time, data); the last part of a topic tells its type."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2", "test")
        channels = {}
        for topic, log_time, data in messages:
            if topic not in channels:
                kind = KINDS[topic.rpartition("/")[2]]
                definition = message_definition(kind).encode()
                schema = writer.register_schema(kind, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()
    return path


@pytest.mark.parametrize("intrinsics", [MIRRORED, None])
def test_replaying_a_folders_mask_bag_is_reconstructing_the_folder(momrec, tmp_path, intrinsics):
    folder = write_folder(tmp_path / "body", intrinsics)
    mesh, bag = tmp_path / "mesh.stl", tmp_path / "bag"
    assert momrec("reconstruct", folder, "--output", mesh, "--mask-bag", bag, *OPTIONS).code == 0
    ended = momrec("replay", bag, "--json", *OPTIONS)
    assert ended.code == 0
    result = json.loads(ended.out)
    assert (result["views"], result["rejected_views"], result["object"]) == (6, 0, "")
    expected = trimesh.load(mesh)  # of float32, vertices merged
    assert result["volume"] == pytest.approx(expected.volume, rel=1e-6)
    assert result["area"] == pytest.approx(expected.area, rel=1e-6)
    views = [view.view for view in read_cameras_json(folder, tolerance=0.8, margin=0.4).views]
    assert result["volume"] == pytest.approx(reconstruct(views, 20).mesh().volume, rel=1e-7)
    others = json.loads(momrec("replay", bag, "--json", "--slices", "20", "--margin", "3").out)
    assert others["volume"] > 1.01 * result["volume"]


def test_a_mask_bag_holds_the_masks_and_is_read_by_another_implementation(momrec, tmp_path):
    folder = write_folder(tmp_path / "body", count=3)
    bag = tmp_path / "bag"
    ended = momrec(
        *("reconstruct", folder, "--output", tmp_path / "mesh.ply"),
        *("--mask-bag", bag, "--slices", 8),
    )
    assert ended.code == 0
    assert f"wrote {bag}" in ended.err
    read = {}
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            read.setdefault(connection.topic, []).append(message)
    assert {topic: len(messages) for topic, messages in read.items()} == {
        "/mask": 3,
        "/camera_info": 3,
        "/camera_pose": 3,
    }
    for number, camera in enumerate(cameras(3, intrinsics=MIRRORED)):
        image, info = read["/mask"][number], read["/camera_info"][number]
        pixels = np.reshape(image.data, (image.height, image.step))
        np.testing.assert_array_equal(pixels == 255, mask(camera))
        np.testing.assert_allclose(np.reshape(info.k, (3, 3)), camera.K, rtol=1e-9, atol=1e-7)
        position = read["/camera_pose"][number].pose.position
        found = [position.x, position.y, position.z]
        np.testing.assert_allclose(found, camera.position, atol=1e-12)


def test_a_parallel_projection_cannot_be_a_mask_bag(momrec, tmp_path):
    def parallel(P):
        return np.vstack([P[:2] / 1.3, [0.0, 0.0, 0.0, 1.0]]) * np.sign(P[2] @ [0, 0, 0, 1])

    folder = write_folder(tmp_path / "body", None, change=parallel)
    bag = tmp_path / "bag"
    ended = momrec(
        *("reconstruct", folder, "--output", tmp_path / "mesh.ply"),
        *("--mask-bag", bag, "--slices", 8),
    )
    assert ended.code == 1
    assert "pinhole camera for a mask, got parallel projection" in ended.err
    assert not bag.exists()


def test_a_mask_that_vanished_is_told_by_its_name(tmp_path):
    folder = write_folder(tmp_path / "body", count=2)
    first, _ = read_cameras_json(folder).views
    np.testing.assert_array_equal(read_mask(first), mask(cameras(2, intrinsics=MIRRORED)[0]))
    first.path.unlink()
    with pytest.raises(CamerasError, match=r"masks/0\.png: "):
        read_mask(first)


def recorded(names, count=4, start=10**9):
    """Return messages of cameras with a namespace each."""
    return [
        (f"{names[number % len(names)]}/{part}", start + number, data)
        for number, camera in enumerate(cameras(count))
        for part, data in view_messages(camera, start + number).items()
    ]


def test_two_cameras_with_a_namespace_each_are_matched_within_it(tmp_path):
    messages = recorded(["/left", "/right"])
    reader = read_bag(write_mcap(tmp_path / "a.mcap", messages))
    events = list(reader)
    for event, camera in zip(events, cameras(4), strict=True):
        np.testing.assert_allclose(event.view.camera.pose, camera.pose, atol=1e-12)
    assert reader.report.notes == (
        "contours on 2 topics, all of them used: /left/mask, /right/mask",
    )
    crossed = [
        (topic.replace("right/camera_info", "left/camera_info"), *rest) for topic, *rest in messages
    ]
    events = list(read_bag(write_mcap(tmp_path / "b.mcap", crossed)))
    assert [isinstance(event, Rejected) for event in events].count(True) == 2
    assert "a camera_info with the stamp of the mask" in events[-1].text


def test_recorded_transforms_place_masks(tmp_path):
    start = 10**9
    tracks = [("/tf_static", start - 5, transforms(("hand", FRAME, 0, np.eye(4))))]
    tracks += [
        ("/tf", start + number, transforms((WORLD, "hand", start + number, camera.pose)))
        for number, camera in enumerate(cameras(4))
    ]
    masks = [item for item in recorded([""], start=start) if "camera_pose" not in item[0]]
    path = write_mcap(tmp_path / "a.mcap", masks + tracks)
    events = list(read_bag(path, pose_source="tf", world_frame=WORLD))
    for event, camera in zip(events, cameras(4), strict=True):
        np.testing.assert_allclose(event.view.camera.pose, camera.pose, atol=1e-9)
    assert {event.reason for event in read_bag(path)} == {"pair"}
    lost = list(read_bag(path, pose_source="tf", world_frame="odom"))
    assert {event.reason for event in lost} == {"transform"}
    with pytest.raises(ValueError, match="Expected a world_frame"):
        read_bag(path, pose_source="tf")


def test_the_command_line_places_masks_by_transforms(momrec, tmp_path):
    poses = [
        ("/tf", 10**9 + number, transforms((WORLD, FRAME, 10**9 + number, camera.pose)))
        for number, camera in enumerate(cameras(5))
    ]
    masks = [item for item in recorded([""], 5) if "camera_pose" not in item[0]]
    path = write_mcap(tmp_path / "a.mcap", masks + poses)
    options = ("--slices", 16, "--json", "--pose-source", "tf", "--world-frame", WORLD)
    ended = momrec("replay", path, *options)
    assert ended.code == 0
    views = [event.view for event in read_bag(path, pose_source="tf", world_frame=WORLD)]
    expected = reconstruct(views, 16).mesh().volume
    assert json.loads(ended.out)["volume"] == pytest.approx(expected, rel=1e-6)
    refused = momrec("replay", path, *options[:-2])
    assert (refused.code, "Expected a world_frame" in refused.err) == (1, True)


def test_rectified_masks_are_read_by_p(momrec, tmp_path):
    path = write_mcap(tmp_path / "a.mcap", recorded([""], 3))
    ordinary = momrec("replay", path, "--slices", 8, "--json")
    rectified = momrec("replay", path, "--slices", 8, "--json", "--rectified")
    assert json.loads(rectified.out)["volume"] == json.loads(ordinary.out)["volume"]
    events = list(read_bag(path, rules=MaskRules(margin=2.0)))
    assert all(
        event.view.silhouette.area > mask(camera).sum() + 300
        for event, camera in zip(events, cameras(3), strict=True)
    )


def test_camera_infos_alone_are_no_input(tmp_path):
    infos = [item for item in recorded([""]) if "camera_info" in item[0]]
    with pytest.raises(BagError, match="or mask, camera_info and camera_pose, in the bag, got no"):
        list(read_bag(write_mcap(tmp_path / "a.mcap", infos)))


def test_the_scene_is_seen_whole():
    for camera in cameras():
        inside = mask(camera)
        assert inside.shape == SIZE[::-1]
        assert inside[[0, -1]].sum() + inside[:, [0, -1]].sum() == 0
        assert inside.sum() > 2000
