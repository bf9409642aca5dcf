"""What a replay costs: time for each view, and memory, for a short bag and for a long one."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from works import MaskedWork

from momrec_core import View
from momrec_ros.bag_writer import BagWriter
from momrec_ros.messages import StampedView
from momrec_ros.shared_data import shared_path

__all__ = ["ReplayCost", "replay_costs"]

SHORT_OBJECTS = 40
LONG_BYTES = 1_000_000_000
LONG_VERTICES = 5_000  # of a contour as it comes from a mask, not simplified: 120 kB a view
STEP = 100_000_000  # nanoseconds between views
MEGABYTE = 1e6


@dataclass(frozen=True)
class ReplayCost:
    """Of one replay, start of the process not counted in time.

    Attributes
    ----------
    size : int
        Of the bag, bytes.
    per_view : float
        Milliseconds, decoding, meshing and results included.
    memory : float
        Most resident memory, MB.
    """

    size: int
    per_view: float
    memory: float


def replay_costs(work: MaskedWork) -> tuple[ReplayCost, ReplayCost]:
    """Replay a short bag of the work's views and one of a gigabyte, of the same at high detail."""
    with tempfile.TemporaryDirectory() as folder:
        short, long, one = (Path(folder) / name for name in ("short", "long", "one"))
        dense = [View(view.camera, _dense(view.silhouette)) for view in work.views]
        size = 24 * LONG_VERTICES * len(dense)
        objects = {one: 1, short: SHORT_OBJECTS, long: LONG_BYTES // size + 1}
        _write(one, work.views, objects[one])
        _write(short, work.views, objects[short])
        _write(long, dense, objects[long])
        start, _ = _replay(one)
        costs = [_cost(path, objects[path] * len(dense), start) for path in (short, long)]
        return costs[0], costs[1]


def _dense(region: shapely.MultiPolygon) -> shapely.MultiPolygon:
    return shapely.segmentize(region, region.length / LONG_VERTICES)


def _write(path: Path, views: list[View], objects: int) -> None:
    stamps = iter(np.arange(1, 1 + objects * len(views)) * STEP)
    with BagWriter(path) as writer:
        for number in range(objects):
            for view in views:
                writer.write_view(StampedView(f"object {number}", int(next(stamps)), "world", view))


def _cost(path: Path, views: int, start: float) -> ReplayCost:
    size = sum(file.stat().st_size for file in path.rglob("*.mcap"))
    seconds, memory = _replay(path)
    return ReplayCost(size, 1e3 * (seconds - start) / views, memory)


def _replay(path: Path) -> tuple[float, float]:
    """Return the seconds and the most resident memory of `momrec replay`."""
    momrec = Path(sys.executable).with_name("momrec")
    command = [momrec, "replay", path, "--model", shared_path("models/ten_objects.json")]
    command += ["--max-objects", "4"]
    begin = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"Expected a replay without losses, got exit {process.returncode}")
    return time.perf_counter() - begin, usage.ru_maxrss * 1024 / MEGABYTE
