"""Reconstruct from photographs' silhouettes and measure how much of them the mesh covers again.

With `--node` the masks are written as a bag, which `momrec replay` reads, and whose messages are
played to the node's executable in a ROS graph of its own; the meshes of both are measured as well.

    . install/setup.sh
    python benchmarks/photographs.py FOLDER [--slices 128] [--margin 0.25] [--figure PNG] [--node]

FOLDER has a cameras.json and masks.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from momrec_core.hull import reconstruct
from momrec_ros.bag_writer import BagWriter
from momrec_ros.cameras_json import MaskedView, read_cameras_json, read_mask
from momrec_ros.figures import draw_coverage
from momrec_ros.interfaces import Pose, decode_diagnostic_array
from momrec_ros.mask_coverage import mask_coverage
from momrec_ros.mask_messages import MaskRules, PackedMask
from momrec_ros.mcap_scan import McapScan, RawMessage
from momrec_ros.parameters import MARGIN
from momrec_ros.poses import matrix_from_pose

EXECUTABLE = Path("install/momrec_ros/lib/momrec_ros/recognizer")
BOUND = 0.98  # mean share of a silhouette that the mesh covers again
RATE = 10.0  # views a second
STEP = 100_000_000  # nanoseconds between views
PATIENCE = 300.0  # seconds for the node's last result
MEGABYTE = 1e6


def report(name: str, views: Sequence[MaskedView], mesh: trimesh.Trimesh) -> bool:
    """Print how much a mesh covers of all masks; return whether that is enough."""
    agreement = [mask_coverage(masked, mesh) for masked in views]
    covered = np.array([share.covered for share in agreement])
    worst = int(covered.argmin())
    print(f"{name:<14} {len(mesh.faces)} triangles, closed: {mesh.is_watertight}")
    print(
        f"  covered      mean {covered.mean():.4f} (bound {BOUND}), worst {covered[worst]:.4f} "
        f"({views[worst].name}), IoU mean {np.mean([share.iou for share in agreement]):.4f}"
    )
    return bool(covered.mean() >= BOUND)


def library(views: Sequence[MaskedView], slices: int) -> trimesh.Trimesh:
    """Return the library's mesh, and print how long it took."""
    start = time.perf_counter()
    hull = reconstruct([masked.view for masked in views], slices)
    cut = time.perf_counter()
    mesh = hull.mesh()
    print(f"seconds        slices {cut - start:.2f}, mesh {time.perf_counter() - cut:.2f}")
    return mesh


def write_bag(views: Sequence[MaskedView], bag: Path) -> None:
    """Write the masks as a bag."""
    with BagWriter(bag) as writer:
        for masked, stamp in zip(views, count(STEP, STEP), strict=False):
            writer.write_mask(read_mask(masked), masked.view.camera, stamp, "world")


def messages_of(bag: Path, *topics: str) -> Iterator[RawMessage]:
    """Yield a bag's messages of some topics, of all without any."""
    (path,) = bag.glob("*.mcap")
    yield from McapScan(path, lambda topic, *_: not topics or topic in topics)


def mesh_of_marker(data: bytes) -> trimesh.Trimesh:
    """Return the mesh of a serialised marker, in the world."""
    from rclpy.serialization import deserialize_message  # noqa: PLC0415
    from visualization_msgs.msg import Marker  # noqa: PLC0415

    marker = deserialize_message(data, Marker)
    points = np.array([(point.x, point.y, point.z) for point in marker.points])
    position, turn = marker.pose.position, marker.pose.orientation
    pose = matrix_from_pose(
        Pose((position.x, position.y, position.z), (turn.x, turn.y, turn.z, turn.w))
    )
    mesh = trimesh.Trimesh(points, np.arange(len(points)).reshape(-1, 3), process=False)
    mesh.merge_vertices()
    return mesh.apply_transform(pose)


def replayed(bag: Path, slices: int, margin: float) -> trimesh.Trimesh:
    """Return the mesh that `momrec replay` makes of a bag."""
    output = bag.with_name("results")
    momrec = Path(sys.executable).with_name("momrec")
    options = ["--slices", str(slices), "--margin", str(margin), "--output", str(output)]
    subprocess.run([momrec, "replay", str(bag), *options], check=True, capture_output=True)
    (message,) = messages_of(output, "/recognizer/mesh")
    return mesh_of_marker(message.data)


@contextmanager
def running_node(**parameters: float) -> Iterator[int]:
    """Hold the node's executable; yields its process id."""
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    with subprocess.Popen([str(EXECUTABLE), "--ros-args", *given]) as process:
        try:
            yield process.pid
        finally:
            process.send_signal(signal.SIGINT)


def played(bag: Path, views: int, slices: int, margin: float) -> trimesh.Trimesh:
    """Return the last mesh of the node that hears a bag's masks; print its delay and memory."""
    import rclpy  # noqa: PLC0415

    with running_node(slices=slices, margin=margin) as pid:
        rclpy.init()
        try:
            return _drive(rclpy, bag, views, pid)
        finally:
            rclpy.try_shutdown()


def _drive(rclpy: Any, bag: Path, views: int, pid: int) -> trimesh.Trimesh:
    from diagnostic_msgs.msg import DiagnosticArray  # noqa: PLC0415
    from geometry_msgs.msg import PoseStamped  # noqa: PLC0415
    from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: PLC0415
    from sensor_msgs.msg import CameraInfo, Image  # noqa: PLC0415
    from visualization_msgs.msg import Marker  # noqa: PLC0415

    node = rclpy.create_node("photographs")
    kinds = {"/mask": Image, "/camera_info": CameraInfo, "/camera_pose": PoseStamped}
    publishers = {
        topic: node.create_publisher(kind, topic, QoSProfile(depth=100))
        for topic, kind in kinds.items()
    }
    durable = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    verdicts: list[bytes] = []
    meshes: dict[int, bytes] = {}  # by the number of the verdict before
    node.create_subscription(
        DiagnosticArray, "recognizer/recognition", verdicts.append, durable, raw=True
    )

    def take_mesh(data: bytes) -> None:
        meshes[len(verdicts)] = data

    node.create_subscription(Marker, "recognizer/mesh", take_mesh, durable, raw=True)

    def until(condition: Callable[[], object], seconds: float = PATIENCE) -> None:
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            rclpy.spin_once(node, timeout_sec=0.02)

    until(lambda: all(each.get_subscription_count() for each in publishers.values()))
    for message in messages_of(bag):
        publishers[message.topic].publish(message.data)
        if message.topic == "/camera_pose":
            until(lambda: False, 1 / RATE)
    last = time.monotonic()
    until(lambda: _views_told(verdicts) >= views and len(verdicts) in meshes)
    values = dict(decode_diagnostic_array(verdicts[-1]).status[0].values)
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    print(
        f"node           {values['views']} views used, {values['rejected_views']} left out, "
        f"{values['cut_views']} cut by the border; last view to result "
        f"{time.monotonic() - last:.1f} s; {pages * os.sysconf('SC_PAGE_SIZE') / MEGABYTE:.0f} MB"
    )
    return mesh_of_marker(meshes[max(meshes)])


def _views_told(verdicts: Sequence[bytes]) -> int:
    if not verdicts:
        return 0
    values = dict(decode_diagnostic_array(verdicts[-1]).status[0].values)
    return int(values["views"]) + int(values["rejected_views"])


def trace(views: Sequence[MaskedView]) -> None:
    """Print how long a mask takes from its message's pixels to a contour."""
    from momrec_ros.interfaces import Header  # noqa: PLC0415
    from momrec_ros.mask_messages import image_of_mask  # noqa: PLC0415
    from momrec_ros.masks import contours_of_mask, hull_silhouette  # noqa: PLC0415

    images = [image_of_mask(read_mask(masked), Header()) for masked in views]
    start = time.process_time()
    for image in images:
        hull_silhouette(contours_of_mask(PackedMask.of_image(image).pixels))
    spent = 1e3 * (time.process_time() - start) / len(images)
    size = f"{images[0].width} x {images[0].height}"
    print(f"tracing        {spent:.1f} ms a mask of {size} pixels (processor time)")


def main() -> int:
    """Print the shares and the times; the exit code tells whether all bounds are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--slices", type=int, default=128)
    parser.add_argument("--margin", type=float, default=MARGIN.default)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--node", action="store_true", help="also through a bag and the live node")
    arguments = parser.parse_args()
    rules = MaskRules(margin=arguments.margin)
    found = read_cameras_json(arguments.folder, margin=rules.margin)
    for rejected in found.rejected:
        print(f"rejected {rejected.name}: {rejected.reason}", file=sys.stderr)
    bordering = sum(masked.touches_border for masked in found.views)
    print(f"views          {len(found.views)}, {bordering} cut by the image's border")
    trace(found.views)
    meshes = {"library": library(found.views, arguments.slices)}
    if arguments.node:
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "masks"
            write_bag(found.views, bag)
            meshes["momrec replay"] = replayed(bag, arguments.slices, rules.margin)
            total = len(found.views)
            meshes["node"] = played(bag, total, arguments.slices, rules.margin)
    if arguments.figure:
        draw_coverage(found.views, meshes["library"], arguments.figure)
    met = [report(name, found.views, mesh) for name, mesh in meshes.items()]
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
