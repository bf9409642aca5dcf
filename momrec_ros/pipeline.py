"""The live node's work, in a thread of its own: messages in at any time, results out in time.

Nothing here knows of ROS: inputs are serialised messages, outputs too. Whoever receives and
publishes never waits for geometry, and geometry never waits for who listens.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from typing import Protocol

from momrec_core.errors import MomrecError, NoCommonLineError
from momrec_ros.detections import DETECTIONS_TYPE, detection_array
from momrec_ros.errors import Reason
from momrec_ros.interfaces import Header, MarkerBlock, encode_detection_array
from momrec_ros.messages import Event, StampedView, ViewDecoder
from momrec_ros.outputs import (
    Output,
    cleared_message,
    markers_message,
    object_markers,
    removed_message,
    result_messages,
)
from momrec_ros.session import NANOSECONDS, Cause, Ended, Outcome, Result, Session, Tally
from momrec_ros.transforms import transform_message

__all__ = ["JOINT_OUTPUTS", "Activity", "Input", "Log", "Pace", "Pipeline"]

MAX_WAITING_BYTES = 1 << 29  # of messages that wait to be read: seconds of any rig's contours
POLL = 0.1  # seconds between looks at what may be overdue
QUIET = 5.0  # seconds between log lines of one kind, so that a bad camera does not fill the disk
BATCH = 1.0  # seconds of reading views, in a flood of them, after which a result is due
SERVING = 0.05  # seconds between results for who came late, whose queue may be short
# Outputs whose messages tell of all objects, and seconds between two of them at least: markers
# are many and for people.
JOINT_OUTPUTS = {"detections": 0.0, "markers": 0.5}


class Input(StrEnum):
    """The inputs, by their topics' names."""

    CONTOURS = "contours"
    CONTOUR = "contour"
    CAMERA_POSE = "camera_pose"
    MASK = "mask"
    CAMERA_INFO = "camera_info"
    TF = "/tf"
    TF_STATIC = "/tf_static"


class Log(Protocol):
    """Where lines for people go; what rclpy's loggers and those of `logging` have in common."""

    def info(self, message: str, /) -> object:
        """Tell what happened."""

    def warning(self, message: str, /) -> object:
        """Tell what was lost."""

    def error(self, message: str, /) -> object:
        """Tell what went wrong."""


@dataclass(frozen=True)
class Pace:
    """How fast things go; may be changed at any time.

    Attributes
    ----------
    publish_rate : float
        Results of each object, at most, per second.
    object_timeout : float
        Seconds without a view after which an object is ended; 0 for never.
    pair_timeout : float
        Seconds that parts of a view wait for their others.
    """

    publish_rate: float
    object_timeout: float
    pair_timeout: float


@dataclass
class Activity:
    """What a pipeline did so far, and what it has before it.

    Attributes
    ----------
    received : int
        Messages.
    waiting : int
        Messages not yet read.
    halves : int
        Stamps of which parts of views wait for their others.
    objects : int
        Live objects.
    tally : Tally
        What came of the views.
    published : int
        Results.
    delay, longest_delay : float
        Seconds from the arrival of a result's newest view to its publication: of the last
        result, and the longest.
    world_frame : str
        Empty before the first view.
    last_loss : str
        What could not be used last, and why.
    """

    received: int = 0
    waiting: int = 0
    halves: int = 0
    objects: int = 0
    tally: Tally = field(default_factory=Tally)
    published: int = 0
    delay: float = 0.0
    longest_delay: float = 0.0
    world_frame: str = ""
    last_loss: str = ""


@dataclass(frozen=True, eq=False)
class _Message:
    source: Input
    data: bytes
    arrived: float  # seconds, steady


@dataclass(eq=False)
class _Live:
    """What was published of an object, and when."""

    viewed: float = 0.0  # arrival of its newest view; seconds, steady
    published: float = -math.inf  # when its last result was begun; seconds, steady
    result: Result | None = None
    outputs: Sequence[Output] = ()
    markers: MarkerBlock | None = None  # of the result, once asked for


class Pipeline:
    """A thread that refines objects by messages and publishes their results.

    Views go before results: every message that has arrived is used before the next result is
    computed. Of the objects that changed, the one that waits for longest comes first. Nothing is
    published before `activate`, after `deactivate`, and after `stop`.

    Parameters
    ----------
    make_session : callable
        Takes the tally; called at the start and for each reset.
    make_decoder : callable
        Likewise, without arguments.
    publish : callable
        Takes the outputs of one result in their order. Called by this thread only.
    is_wanted : callable
        Takes the name of an output about all objects; tells whether anyone listens.
    is_over : callable
        Tells whether publishing has come to an end for good: what fails then is no fault.
    log : Log
        For people.
    pace : Pace
        Until `change_pace`.
    clock : callable
        The time that objects and pairs time out by, nanoseconds.
    frame_prefix : str
        Of the principal frames' names among the transforms; the object's id follows.
    """

    def __init__(
        self,
        make_session: Callable[[Tally], Session],
        make_decoder: Callable[[], ViewDecoder],
        *,
        publish: Callable[[Sequence[Output]], None],
        is_wanted: Callable[[str], bool],
        is_over: Callable[[], bool],
        log: Log,
        pace: Pace,
        clock: Callable[[], int],
        frame_prefix: str,
    ) -> None:
        self._pace = pace
        self._make_session = make_session
        self._make_decoder = make_decoder
        self._publish = publish
        self._is_wanted = is_wanted
        self._is_over = is_over
        self._log = log
        self._clock = clock
        self._frame_prefix = frame_prefix
        self._activity = Activity()
        self._told: dict[object, tuple[float, int]] = {}
        # Shared between threads, under the condition's lock:
        self._news = threading.Condition()
        self._inbox: deque[_Message] = deque()
        self._inbox_bytes = 0
        self._requests: deque[Callable[[], None]] = deque()
        self._is_stopped = False
        # Shared between threads, under the gate's lock, which is held while publishing:
        self._gate = threading.Lock()
        self._is_active = False
        self._resets = 0
        # Of the thread alone:
        self._session = make_session(self._activity.tally)
        self._decoder = make_decoder()
        self._starts = 0
        self._live: dict[str, _Live] = {}
        self._unsent: list[Sequence[Output]] = []
        self._removals: list[Sequence[Output]] = []  # unsent, too
        self._owed: dict[str, set[str]] = {}  # object to outputs, for who came late
        self._serve_at = 0.0
        self._header: Header | None = None  # of the newest result
        self._stale: set[str] = set()  # of `JOINT_OUTPUTS`
        self._joint_published: dict[str, float] = {}
        self._joint_from = 0.0
        self._thread = threading.Thread(target=self._run, name="momrec pipeline", daemon=True)
        self._thread.start()

    def receive(self, source: Input, data: bytes) -> None:
        """Take a message; returns at once.

        Parameters
        ----------
        source : Input
            The topic that it came by.
        data : bytes
            The serialised message.
        """
        with self._news:
            self._activity.received += 1
            if self._inbox_bytes + len(data) > MAX_WAITING_BYTES:
                self._requests.append(self._tell_overload)
            else:
                self._inbox.append(_Message(source, data, time.monotonic()))
                self._inbox_bytes += len(data)
            self._news.notify()

    def activate(self) -> None:
        """Use and publish from now on, first what could not be published before."""
        with self._news, self._gate:
            self._is_active = True
            self._requests.append(self._go_on)
            self._news.notify()

    def deactivate(self) -> None:
        """Publish nothing from now on; messages that have arrived wait for `activate`."""
        with self._gate:
            self._is_active = False

    def serve(self, name: str) -> None:
        """Publish the last result of every live object again on one output, for who came late."""
        self._request(partial(self._serve, name))

    def change_pace(self, pace: Pace) -> None:
        """Go at another pace from now on."""
        self._request(partial(self._take_pace, pace))

    def reset(self) -> int:
        """Forget all objects and what waits; return how many objects there were."""
        with self._gate:
            self._resets += 1
        with self._news:
            self._inbox.clear()
            self._inbox_bytes = 0
            objects = self._activity.objects
        self._request(self._start_anew)
        return objects

    def stop(self, timeout: float) -> bool:
        """Publish nothing from now on and end the thread.

        Parameters
        ----------
        timeout : float
            Seconds to wait for it.

        Returns
        -------
        ended : bool
            False where it is still computing; it ends when it is done.
        """
        self.deactivate()
        with self._news:
            self._is_stopped = True
            self._news.notify()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def activity(self) -> Activity:
        """Return a snapshot of what was done so far."""
        with self._news:
            tally = self._activity.tally
            return replace(
                self._activity,
                waiting=len(self._inbox),
                tally=replace(tally, rejected=tally.rejected.copy(), ended=tally.ended.copy()),
            )

    def _request(self, task: Callable[[], None]) -> None:
        """Let the thread do something before anything else."""
        with self._news:
            self._requests.append(task)
            self._news.notify()

    # All that follows runs in the thread.

    def _run(self) -> None:
        while self._await_news():
            try:
                self._step()
            except Exception as error:  # noqa: BLE001 - whatever a library raises, the node lives on
                if self._is_stopped or self._is_over():
                    return
                self._activity.tally.rejected[Reason.FAULT] += 1
                self._tell(Reason.FAULT, f"a fault: {type(error).__name__}: {error}")
            with self._news:
                self._activity.objects = len(self._session.objects)
                self._activity.halves = self._decoder.waiting
                self._activity.world_frame = self._decoder.world_frame

    def _await_news(self) -> bool:
        """Wait for something to do; return False if that is to stop."""
        with self._news:
            if not (self._requests or self._is_stopped):
                self._news.wait_for(
                    lambda: self._requests or self._is_stopped or (self._inbox and self._is_active),
                    self._idle_time(),
                )
            return not self._is_stopped

    def _idle_time(self) -> float | None:
        """Return the seconds until something is to be done without news; None for never."""
        if not self._is_active:
            return None
        times = [self._live[changed].published for changed in self._session.changed]
        times = [self._next_after(published) for published in times]
        times += [self._joint_at(name) for name in self._stale]
        if self._owed:
            times.append(self._serve_at)
        until = [at - time.monotonic() for at in times]
        if self._decoder.waiting or (self._session.objects and self._pace.object_timeout):
            until.append(POLL)
        return max(0.0, min(until)) if until else None

    def _step(self) -> None:
        while self._requests:
            self._requests.popleft()()
        until = time.monotonic() + BATCH
        for _ in range(len(self._inbox)):  # those that come meanwhile wait for one result
            message = self._next_message()
            if message is None:
                break
            self._use(message)
            if time.monotonic() > until:
                break
        if self._is_active:
            self._expire()
            self._publish_next()
            self._publish_joint()
            self._serve_next()

    def _next_message(self) -> _Message | None:
        with self._news:
            if self._starts != self._resets or not (self._inbox and self._is_active):
                return None  # what came after a reset is for the session after it
            message = self._inbox.popleft()
            self._inbox_bytes -= len(message.data)
            return message

    def _use(self, message: _Message) -> None:
        now = self._clock()
        for event in self._decoded(message, now):
            if isinstance(event, StampedView):
                self._live.setdefault(event.object_id, _Live()).viewed = message.arrived
            self._tell_all(self._session.feed(event, now))

    def _decoded(self, message: _Message, now: int) -> tuple[Event, ...]:
        decoder, data = self._decoder, message.data
        if message.source is Input.CONTOURS:
            return decoder.marker_array(data)
        if message.source in (Input.TF, Input.TF_STATIC):
            return decoder.transforms(data, is_static=message.source is Input.TF_STATIC)
        decode = {
            Input.CONTOUR: decoder.polygon,
            Input.CAMERA_POSE: decoder.camera_pose,
            Input.MASK: decoder.mask,
            Input.CAMERA_INFO: decoder.camera_info,
        }[message.source]
        return decode(data, now=now)

    def _expire(self) -> None:
        now = self._clock()
        for event in self._decoder.expire(now, round(self._pace.pair_timeout * NANOSECONDS)):
            self._tell_all(self._session.feed(event, now))
        self._tell_all(self._session.end_overdue(now, self._pace.object_timeout))

    def _tell_all(self, outcomes: Iterable[Outcome]) -> None:
        for outcome in outcomes:
            if isinstance(outcome, Result):
                self._publish_result(outcome)
            elif isinstance(outcome, Ended):
                self._remove(outcome)
            else:
                self._tell(outcome.reason, outcome.text)

    def _next_after(self, published: float) -> float:
        return published + 1 / self._pace.publish_rate

    def _publish_next(self) -> None:
        """Publish a result of the object that changed and waits for longest, if one may be."""
        now = time.monotonic()
        due = (
            changed
            for changed in self._session.changed
            if self._next_after(self._live[changed].published) <= now
        )
        object_id = next(due, None)
        if object_id is None:
            return
        try:
            result = self._session.take(object_id)
        except NoCommonLineError:
            return  # too few views yet
        except MomrecError as error:
            self._tell("no result", f"object {object_id!r} has no result: {error}")
        else:
            self._publish_result(result)
            self._tell_all(self._session.told())
        self._live[object_id].published = now

    def _publish_result(self, result: Result) -> None:
        live = self._live[result.result.object_id]
        live.outputs = [
            *result_messages(
                result.result, result.stamp, result.frame_id, cut_views=result.cut_views
            ),
            transform_message(result, self._frame_prefix),
        ]
        live.result, live.markers = result, None
        self._header = Header(result.stamp, result.frame_id)
        self._stale.update(JOINT_OUTPUTS)
        self._owed.pop(result.result.object_id, None)
        self._send(live.outputs)
        delay = time.monotonic() - live.viewed
        self._activity.published += 1
        self._activity.delay = delay
        self._activity.longest_delay = max(delay, self._activity.longest_delay)

    def _publish_joint(self) -> None:
        """Publish what tells of all objects, if something changed and it may be."""
        now = time.monotonic()
        due = [
            name for name in JOINT_OUTPUTS if name in self._stale and self._joint_at(name) <= now
        ]
        for name in due:
            self._stale.remove(name)
            self._joint_published[name] = now
        if self._header is not None:
            self._send([self._joint(name) for name in due if self._is_wanted(name)])

    def _joint_at(self, name: str) -> float:
        """Return when an output about all objects may be published next."""
        least = self._joint_published.get(name, 0.0) + JOINT_OUTPUTS[name]
        return max(least, self._next_after(self._joint_published.get(name, 0.0)), self._joint_from)

    def _joint(self, name: str) -> Output:
        if name == "markers":
            return self._markers()
        results = [live.result for live in self._live.values() if live.result is not None]
        array = detection_array(results, self._header)
        return Output(name, DETECTIONS_TYPE, encode_detection_array(array))

    def _markers(self) -> Output:
        blocks = []
        for live in self._live.values():
            if live.markers is None and live.result is not None:
                live.markers = object_markers(live.result)
            if live.markers is not None:
                blocks.append(live.markers)
        return markers_message(blocks, clear=self._header)

    def _remove(self, ended: Ended) -> None:
        object_id = ended.object_id
        live = self._live.pop(object_id)
        self._owed.pop(object_id, None)
        if live.result is not None:
            self._send_removal(live.result)
            self._stale.update(JOINT_OUTPUTS)
        if ended.cause is Cause.EVICTED:
            self._tell(
                ended.cause,
                f"object {object_id!r} is evicted: expected at most max_objects at a time, "
                "got a view of one more",
            )
        elif ended.cause is Cause.TIMED_OUT:
            self._log.info(f"object {object_id!r} is ended: no view for object_timeout")

    def _serve(self, name: str) -> None:
        """Owe a newcomer the last results, a little later: it may not be ready for them yet."""
        now = time.monotonic()
        if name in JOINT_OUTPUTS:
            self._stale.add(name)
            self._joint_from = now + SERVING
            return
        if not self._owed:
            self._serve_at = now + SERVING
        for object_id in self._live:
            self._owed.setdefault(object_id, set()).add(name)

    def _serve_next(self) -> None:
        """Publish the last result of one object again, where it is owed."""
        now = time.monotonic()
        if not self._owed or now < self._serve_at:
            return
        self._serve_at = now + SERVING
        object_id = next(iter(self._owed))
        names = self._owed.pop(object_id)
        self._send([output for output in self._live[object_id].outputs if output.name in names])

    def _send(self, outputs: Sequence[Output], *, is_removal: bool = False) -> None:
        """Publish, or keep for later; a reset overtakes all but removals."""
        with self._gate:
            if self._starts != self._resets and not is_removal:
                return
            if self._is_active:
                self._publish(outputs)
            else:
                (self._removals if is_removal else self._unsent).append(outputs)

    def _send_removal(self, result: Result) -> None:
        object_id = result.result.object_id
        removed = removed_message(object_id, result.stamp, result.frame_id)
        self._send([removed], is_removal=True)

    def _take_pace(self, pace: Pace) -> None:
        self._pace = pace

    def _go_on(self) -> None:
        unsent, self._unsent = self._unsent, []
        removals, self._removals = self._removals, []
        for outputs in unsent:
            self._send(outputs)
        for outputs in removals:
            self._send(outputs, is_removal=True)
        self._session.touch(self._clock())

    def _start_anew(self) -> None:
        with self._gate:
            self._starts = self._resets
        self._activity.tally.ended[Cause.FORGOTTEN] += len(self._session.objects)
        self._session = self._make_session(self._activity.tally)
        self._decoder = self._make_decoder()
        self._live = {}
        self._unsent = []
        self._owed = {}
        self._stale.update(JOINT_OUTPUTS)
        if self._header is not None:
            self._send([cleared_message(self._header)], is_removal=True)

    def _tell_overload(self) -> None:
        self._activity.tally.rejected[Reason.OVERLOAD] += 1
        self._tell(
            Reason.OVERLOAD,
            f"a message is left out: expected at most {MAX_WAITING_BYTES} bytes waiting, got more",
        )

    def _tell(self, kind: object, text: str) -> None:
        """Log a line, but not one of a kind every time."""
        self._activity.last_loss = text
        now = time.monotonic()
        told_at, hushed = self._told.get(kind, (-QUIET, 0))
        if now - told_at < QUIET:
            self._told[kind] = told_at, hushed + 1
            return
        self._told[kind] = now, 0
        self._log.warning(f"{text} ({hushed} more of the kind before)" if hushed else text)
