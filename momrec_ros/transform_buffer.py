"""Transforms between frames over time, from tf2_msgs/TFMessage: what tf2 does, without ROS."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from momrec_ros.errors import MessageError, TransformError
from momrec_ros.interfaces import Pose, Transform
from momrec_ros.poses import MAX_NAME, matrix_from_pose

__all__ = ["TransformBuffer"]

HORIZON = 60_000_000_000  # nanoseconds that a moving frame is remembered for: a slow segmentation's
# Nanoseconds that a transform may come late: older ones tell that the clock was set back, as by a
# simulation that begins anew, and must not be mixed with what was before.
SET_BACK = 5_000_000_000
MAX_FRAMES = 1000  # far above any robot's
MAX_SAMPLES = 200_000  # in all: a minute of thirty frames at 100 Hz; about 100 MB


@dataclass(eq=False)
class _Moving:
    """A frame at times, ascending: the name of its parent, and its pose there."""

    stamps: list[int] = field(default_factory=list)
    samples: list[tuple[str, Pose]] = field(default_factory=list)


class TransformBuffer:
    """Remembers where frames were, and tells where one was in another.

    Between two samples position goes straight and orientation by the shortest turn; before the
    first and after the last nothing is known. Memory is bounded by frames, samples and time.

    Attributes
    ----------
    unusable : str
        What was wrong with the last transform that was left out; empty if none was.

    See Also
    --------
    momrec_ros.transforms : the principal frames, as transforms to go out.
    """

    def __init__(self) -> None:
        self._fixed: dict[str, tuple[str, Pose]] = {}
        self._moving: dict[str, _Moving] = {}  # the one that came last is last
        self.unusable = ""

    def add(self, transforms: Iterable[Transform], *, is_static: bool) -> None:
        """Remember transforms; what is no rigid motion between two frames is left out.

        Parameters
        ----------
        transforms : iterable of Transform
            Of one message.
        is_static : bool
            Whether they hold for ever, as those of /tf_static.
        """
        for transform in transforms:
            try:
                self._add(transform, is_static=is_static)
            except MessageError as error:
                self.unusable = f"{_name(transform.child_frame_id)!r:.200}: {error}"

    def _add(self, transform: Transform, *, is_static: bool) -> None:
        parent, child = _name(transform.header.frame_id), _name(transform.child_frame_id)
        if not (parent and child) or parent == child or max(len(parent), len(child)) > MAX_NAME:
            raise TransformError(
                f"Expected two frames with names of at most {MAX_NAME} characters, got "
                f"{parent!r:.200} and {child!r:.200}"
            )
        matrix_from_pose(transform.pose)
        sample = parent, transform.pose
        if is_static:
            self._moving.pop(child, None)
            self._fixed[child] = sample
        else:
            self._fixed.pop(child, None)
            frame = self._moving.pop(child, _Moving())
            _insert(frame, transform.header.stamp, sample)
            self._moving[child] = frame
            self._forget_old(frame)
        if len(self._fixed) + len(self._moving) > MAX_FRAMES:
            oldest = self._moving or self._fixed
            del oldest[next(iter(oldest))]

    def _forget_old(self, frame: _Moving) -> None:
        most = MAX_SAMPLES // len(self._moving)
        old = bisect_left(frame.stamps, frame.stamps[-1] - HORIZON)
        old = max(old, len(frame.stamps) - most)
        del frame.stamps[:old], frame.samples[:old]

    def lookup(self, target: str, source: str, stamp: int) -> NDArray[np.float64]:
        """Return the pose of a frame in another.

        Parameters
        ----------
        target, source : str
            Names; a leading slash does not count.
        stamp : int
            Nanoseconds.

        Returns
        -------
        target_from_source : array, shape (4, 4)
            A rigid motion, metres.

        Raises
        ------
        TransformError
            If it is not known, or not yet.
        """
        above_source = list(self._upwards(_name(source), stamp))
        above_target = list(self._upwards(_name(target), stamp))
        of_target = dict(above_target)
        for ancestor, ancestor_from_source in above_source:
            if ancestor in of_target:
                return np.asarray(np.linalg.solve(of_target[ancestor], ancestor_from_source))
        ends = tuple(dict.fromkeys(frames[-1][0] for frames in (above_source, above_target)))
        why = " and ".join(self._why_not(name, stamp) for name in ends)
        hint = f"; left out: {self.unusable}" if self.unusable else ""
        raise TransformError(
            f"Expected a transform from {_name(source)!r:.200} to {_name(target)!r:.200} at "
            f"{stamp} ns, got none: {why}{hint}",
            ends,
        )

    def knows(self, name: str, stamp: int) -> bool:
        """Tell whether a frame's samples reach over a time."""
        frame = self._moving.get(name)
        if frame is None:
            return name in self._fixed
        return frame.stamps[0] <= stamp <= frame.stamps[-1]

    def _upwards(self, name: str, stamp: int) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Yield a frame and those above it, with the pose of the first in each."""
        pose = np.eye(4)
        seen = {name}
        yield name, pose
        while (step := self._parent(name, stamp)) is not None and step[0] not in seen:
            name, pose = step[0], step[1] @ pose
            seen.add(name)
            yield name, pose

    def _parent(self, name: str, stamp: int) -> tuple[str, NDArray[np.float64]] | None:
        """Return a frame's parent at a time and the pose in it; None where that is not known."""
        if name in self._fixed:
            parent, pose = self._fixed[name]
            return parent, matrix_from_pose(pose)
        frame = self._moving.get(name)
        if frame is None or not frame.stamps[0] <= stamp <= frame.stamps[-1]:
            return None
        after = bisect_left(frame.stamps, stamp)
        if frame.stamps[after] == stamp:
            parent, pose = frame.samples[after]
            return parent, matrix_from_pose(pose)
        (parent, before), (later_parent, later) = frame.samples[after - 1 : after + 1]
        if parent != later_parent:
            return None
        start, end = frame.stamps[after - 1 : after + 1]
        share = (stamp - start) / (end - start)
        return parent, _between(matrix_from_pose(before), matrix_from_pose(later), share)

    def _why_not(self, name: str, stamp: int) -> str:
        """Return why nothing above a frame is known."""
        if name in self._fixed:
            return f"{name!r:.200} is in a circle of frames"
        frame = self._moving.get(name)
        if frame is None:
            return f"nothing is known above {name!r:.200}"
        if stamp > frame.stamps[-1]:
            return f"{name!r:.200} is known until {frame.stamps[-1]} ns only"
        if stamp < frame.stamps[0]:
            return f"{name!r:.200} is known from {frame.stamps[0]} ns on only"
        return f"{name!r:.200} changes its parent then, or is in a circle of frames"


def _name(frame_id: str) -> str:
    return frame_id.removeprefix("/")  # as of ROS 1


def _insert(frame: _Moving, stamp: int, sample: tuple[str, Pose]) -> None:
    if frame.stamps and stamp < frame.stamps[-1] - SET_BACK:
        frame.stamps.clear()
        frame.samples.clear()
    place = bisect_left(frame.stamps, stamp)
    if place < len(frame.stamps) and frame.stamps[place] == stamp:
        frame.samples[place] = sample
    else:
        frame.stamps.insert(place, stamp)
        frame.samples.insert(place, sample)


def _between(
    earlier: NDArray[np.float64], later: NDArray[np.float64], share: float
) -> NDArray[np.float64]:
    pose = np.eye(4)
    turns = Rotation.from_matrix([earlier[:3, :3], later[:3, :3]])
    pose[:3, :3] = Slerp([0.0, 1.0], turns)(share).as_matrix()
    pose[:3, 3] = (1 - share) * earlier[:3, 3] + share * later[:3, 3]
    return pose
