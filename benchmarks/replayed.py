"""What a replay costs: time for each view, and memory, for a short bag and for a long one."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from works import MaskedWork, PinholeMask, pinhole_masks

from momrec_core import View
from momrec_ros.bag_writer import BagWriter
from momrec_ros.messages import StampedView
from momrec_ros.shared_data import shared_path

__all__ = ["ReplayCost", "replay_costs"]

OBJECTS = 40  # of a short bag
LONG_BYTES = 1_000_000_000
STEP = 100_000_000  # nanoseconds between views
PAUSE = 10_000_000_000  # nanoseconds between objects of masks, which have no names
TIMEOUT = 5.0  # seconds without a view after which an object is ended
MEGABYTE = 1e6


@dataclass(frozen=True)
class ReplayCost:
    """Of one replay, start of the process and the first object not counted in time.

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


def replay_costs(work: MaskedWork) -> tuple[ReplayCost, ReplayCost, ReplayCost]:
    """Replay the work's contours, masks of its object, and a gigabyte of such masks."""
    with tempfile.TemporaryDirectory() as folder:
        one, contours, few, many = (
            Path(folder) / name for name in ("one", "contours", "few", "many")
        )
        masks = pinhole_masks(len(work.views))
        objects = {
            contours: OBJECTS,
            few: OBJECTS,
            many: LONG_BYTES // sum(mask.size for _, mask in masks) + 1,
        }
        _write_contours(one, work.views, 1)
        _write_contours(contours, work.views, OBJECTS)
        for path in (few, many):
            _write_masks(path, masks, objects[path])
        start, _ = _replay(one)
        views = {path: (number - 1) * len(masks) for path, number in objects.items()}
        return (
            _cost(contours, views[contours], start),
            _cost(few, views[few], start),
            _cost(many, views[many], start),
        )


def _write_contours(path: Path, views: list[View], objects: int) -> None:
    stamps = count(STEP, STEP)
    with BagWriter(path) as writer:
        for number in range(objects):
            for view in views:
                writer.write_view(StampedView(f"object {number}", next(stamps), "world", view))


def _write_masks(path: Path, masks: Sequence[PinholeMask], objects: int) -> None:
    stamps = count(STEP, STEP)
    with BagWriter(path) as writer:
        for number in range(objects):
            for camera, mask in masks:
                writer.write_mask(mask, camera, next(stamps) + number * PAUSE, "world")


def _cost(path: Path, views: int, start: float) -> ReplayCost:
    size = sum(file.stat().st_size for file in path.rglob("*.mcap"))
    seconds, memory = _replay(path)
    return ReplayCost(size, 1e3 * (seconds - start) / views, memory)


def _replay(path: Path) -> tuple[float, float]:
    """Return the seconds and the most resident memory of `momrec replay`."""
    momrec = Path(sys.executable).with_name("momrec")
    command = [momrec, "replay", path, "--model", shared_path("models/ten_objects.json")]
    command += ["--max-objects", "4", "--object-timeout", str(TIMEOUT)]
    begin = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"Expected a replay without losses, got exit {process.returncode}")
    return time.perf_counter() - begin, usage.ru_maxrss * 1024 / MEGABYTE
