"""Parts of views that wait for each other, matched by source and stamp."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from momrec_ros.calibration import Calibration
from momrec_ros.errors import MessageError, Reason
from momrec_ros.interfaces import PolygonStamped, PoseStamped
from momrec_ros.mask_messages import PackedMask

__all__ = ["Key", "Parts", "Rejected", "Waiting", "repeated", "unmatched"]

MAX_BYTES = 1 << 27  # of what waits: 3000 masks of 640 x 480, or 16 of the largest
ENTRY = 2000  # bytes of a calibration, and of a mask beside its pixels
Key: TypeAlias = tuple[str, int]  # source, that is the camera's name, and stamp


@dataclass(frozen=True)
class Rejected:
    """A message that is no view.

    Attributes
    ----------
    object_id : str
        The object where the message names one, else empty.
    text : str
        What was expected and what came.
    stamp : int
        Nanoseconds; 0 where the message has none.
    reason : Reason
        The rule, for counting.
    """

    object_id: str
    text: str
    stamp: int
    reason: Reason


@dataclass(eq=False)
class Parts:
    """What came of one source and stamp, and was not used yet.

    Attributes
    ----------
    arrived : int
        When the last part came, nanoseconds.
    polygon : PolygonStamped or None
        A contour.
    pose : PoseStamped or None
        Of the camera.
    masks : dict
        By optical frame; None for a mask that was rejected, so that what belongs to it is not
        missed.
    calibrations : dict
        By optical frame, or why there is none.
    """

    arrived: int = 0
    polygon: PolygonStamped | None = None
    pose: PoseStamped | None = None
    masks: dict[str, PackedMask | None] = field(default_factory=dict)
    calibrations: dict[str, Calibration | MessageError] = field(default_factory=dict)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is left."""
        return not (self.polygon or self.pose or self.masks or self.calibrations)

    @property
    def size(self) -> int:
        """Bytes, of what may be large."""
        points = 0 if self.polygon is None else self.polygon.points.nbytes
        bits = sum(mask.bits.nbytes for mask in self.masks.values() if mask is not None)
        return points + bits + ENTRY * (len(self.masks) + len(self.calibrations))


class Waiting:
    """Parts by source and stamp, bounded in number and bytes: the oldest are driven out.

    Parameters
    ----------
    most : int
        Stamps, at most.
    explain : callable
        Takes key and parts; yields what could not be used of them, and why.
    """

    def __init__(self, most: int, explain: Callable[[Key, Parts], Iterator[Rejected]]) -> None:
        self._most, self._explain = most, explain
        self._parts: dict[Key, Parts] = {}
        self._sizes: dict[Key, int] = {}
        self._size = 0

    def __len__(self) -> int:
        return len(self._parts)

    def open(self, key: Key, now: int) -> Parts:
        """Return the parts of a key, one of which came now; end with `settle`."""
        parts = self._parts.setdefault(key, Parts())
        parts.arrived = now
        return parts

    def get(self, key: Key) -> Parts | None:
        """Return the parts of a key, None if there are none."""
        return self._parts.get(key)

    def settle(self, key: Key) -> tuple[Rejected, ...]:
        """Take note of changed parts; return what is driven out for want of room."""
        parts = self._parts[key]
        self._size += parts.size - self._sizes.get(key, 0)
        self._sizes[key] = parts.size
        if parts.is_empty:
            self._remove(key)
        rejected: list[Rejected] = []
        while len(self._parts) > self._most or self._size > MAX_BYTES:
            rejected += self._remove(next(iter(self._parts)))
        return tuple(rejected)

    def expire(self, now: int, timeout: int) -> tuple[Rejected, ...]:
        """Drive out what arrived longer ago than a timeout, nanoseconds.

        Should the clock have been set back, or not have been set (0), parts count as arrived now.
        """
        for parts in self._parts.values():
            parts.arrived = min(parts.arrived or now, now)
        late = [key for key, parts in self._parts.items() if now - parts.arrived > timeout]
        return tuple(event for key in late for event in self._remove(key))

    def flush(self) -> tuple[Rejected, ...]:
        """Drive out everything."""
        return tuple(event for key in tuple(self._parts) for event in self._remove(key))

    def _remove(self, key: Key) -> list[Rejected]:
        rejected = list(self._explain(key, self._parts[key]))
        del self._parts[key]
        self._size -= self._sizes.pop(key, 0)
        return rejected


def unmatched(parts: Parts, stamp: int, *, needs_pose: bool) -> Iterator[Rejected]:
    """Tell of parts without their others what is missing.

    Calibrations alone are no loss: cameras publish them with every image. Nor is a camera pose
    beside something that is told of.

    Parameters
    ----------
    parts : Parts
        That will not be used.
    stamp : int
        Theirs, nanoseconds.
    needs_pose : bool
        Whether masks need a camera_pose.
    """
    if parts.polygon is not None:
        yield _missing("a camera_pose", "contour", stamp)
    for frame, mask in parts.masks.items():
        lacks = ["camera_info"] * (frame not in parts.calibrations)
        lacks += ["camera_pose"] * (needs_pose and parts.pose is None)
        if mask is not None and lacks:
            where = f", frame {frame!r:.200}"
            yield _missing(" and ".join(f"a {name}" for name in lacks), "mask", stamp, where)
    if parts.pose is not None and parts.polygon is None and not parts.masks:
        yield _missing("a contour or mask", "camera_pose", stamp)


def _missing(what: str, of: str, stamp: int, where: str = "") -> Rejected:
    text = f"Expected {what} with the stamp of the {of} ({stamp} ns{where}), got none"
    return Rejected("", text, stamp, Reason.PAIR)


def repeated(name: str, stamp: int) -> Rejected:
    """Tell of a part that came again before it was used."""
    text = f"Expected one {name} with the stamp {stamp} ns, got another: the later one is used"
    return Rejected("", text, stamp, Reason.PAIR)
