"""Views of several objects to results: who changed, who is finished when, and what was lost.

The same rules for recordings and for the live node: only their clocks differ.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from momrec_core.errors import EmptyHullError, MomrecError
from momrec_core.recognizer import ObjectResult, Recognizer
from momrec_ros.errors import Reason
from momrec_ros.messages import Forget, Rejected, StampedView
from momrec_ros.parameters import MAX_BAD_VIEWS

if TYPE_CHECKING:
    from momrec_core.model import RecognitionModel
    from momrec_core.view import View

__all__ = [
    "CONTRADICTS",
    "NANOSECONDS",
    "Cause",
    "Ended",
    "Lost",
    "Outcome",
    "Result",
    "Session",
    "Tally",
]

NANOSECONDS = 1_000_000_000
CONTRADICTS = "it contradicts the other views: its pose or its silhouette is wrong"


@dataclass(frozen=True, eq=False)
class Result:
    """What is known of an object, and as of when.

    Attributes
    ----------
    result : ObjectResult
        What its views say.
    stamp : int
        Of the last view used, nanoseconds.
    frame_id : str
        The world frame.
    cut_views : int
        Views used in which the border of the image cuts the object.
    """

    result: ObjectResult
    stamp: int
    frame_id: str
    cut_views: int = 0


class Cause(StrEnum):
    """Why an object gets no further views."""

    FORGOTTEN = "forgotten"
    EVICTED = "evicted"
    TIMED_OUT = "timed_out"
    FINISHED = "finished"


@dataclass(frozen=True)
class Ended:
    """An object that gets no further views; its last result went before."""

    object_id: str
    cause: Cause


@dataclass(frozen=True)
class Lost:
    """Something that could not be used.

    Attributes
    ----------
    text : str
        What was lost and why, in one line.
    reason : Reason or None
        Of a view left out; None where no view but an object's result is lost.
    """

    text: str
    reason: Reason | None = None


Outcome = Result | Ended | Lost


@dataclass
class Tally:
    """Counts of what came of the views.

    Attributes
    ----------
    used : int
        Views that refined an object.
    cut : int
        Of these, views in which the border of the image cuts the object.
    repeated : int
        Views that had come before, with equal stamp and pose.
    rejected : Counter of Reason
        Views left out.
    ended : Counter of Cause
        Objects that get no further views.
    """

    used: int = 0
    cut: int = 0
    repeated: int = 0
    rejected: Counter[Reason] = field(default_factory=Counter)
    ended: Counter[Cause] = field(default_factory=Counter)


@dataclass(eq=False)
class _Tracked:
    """When an object was seen, and by which views."""

    seen_at: int
    stamp: int
    frame_id: str
    views: dict[tuple[int, bytes], None] = field(default_factory=dict)
    events: dict[View, StampedView] = field(default_factory=dict)
    told: set[View] = field(default_factory=set)  # that they are left out
    cut: set[View] = field(default_factory=set)  # by the border of the image


class Session:
    """Feeds events to a `Recognizer` and tells which objects changed and which are finished.

    An object is finished when it is forgotten, evicted, without a view for too long, or when
    all is over; its last result is told then, unless it was taken before.

    Parameters
    ----------
    model : RecognitionModel or None
        Names the objects.
    slices, min_views, max_objects, max_views, max_bad_views : int
        As for `Recognizer`.
    tally : Tally, optional
        Goes on counting.
    """

    def __init__(
        self,
        model: RecognitionModel | None,
        *,
        slices: int,
        min_views: int,
        max_objects: int,
        max_views: int,
        max_bad_views: int = MAX_BAD_VIEWS.default,
        tally: Tally | None = None,
    ) -> None:
        self._recognizer = Recognizer(
            model,
            slices=slices,
            min_views=min_views,
            max_objects=max_objects,
            max_views=max_views,
            max_bad_views=max_bad_views,
            on_evict=lambda object_id: self._end(object_id, Cause.EVICTED),
        )
        self._max_views = max_views
        self._tally = Tally() if tally is None else tally
        self._tracked: dict[str, _Tracked] = {}
        self._changed: dict[str, None] = {}
        self._outcomes: list[Outcome] = []

    @property
    def objects(self) -> tuple[str, ...]:
        """Ids of the live objects, in the order of their first view."""
        return tuple(self._tracked)

    @property
    def changed(self) -> tuple[str, ...]:
        """Ids of objects with a result to take, the one that waits for longest first."""
        return tuple(self._changed)

    def feed(self, event: StampedView | Forget | Rejected, now: int) -> list[Outcome]:
        """Use one event.

        Parameters
        ----------
        event : StampedView, Forget or Rejected
            The next.
        now : int
            Nanoseconds, of the clock that objects time out by.

        Returns
        -------
        outcomes : list of Result, Ended and Lost
            What came of it, mostly nothing.
        """
        if isinstance(event, StampedView):
            self._use(event, now)
        elif isinstance(event, Rejected):
            self._recognizer.reject(event.object_id)
            self._lose(event.object_id, event.stamp, event.text, event.reason)
        else:
            for object_id in self.objects:
                if event.object_id in ("", object_id):
                    self._end(object_id, Cause.FORGOTTEN)
            self._recognizer.forget(event.object_id)
        return self.told()

    def end_overdue(self, now: int, timeout: float) -> list[Outcome]:
        """End the objects without a view for longer than a timeout.

        Parameters
        ----------
        now : int
            Nanoseconds, of the same clock as for `feed`. Should it have been set back, or not
            have been set (0), objects count as seen now.
        timeout : float
            Seconds; 0 for never.

        Returns
        -------
        outcomes : list of Result, Ended and Lost
            Of the objects that are finished.
        """
        for object_id, tracked in tuple(self._tracked.items()):
            tracked.seen_at = min(tracked.seen_at or now, now)
            if 0 < timeout * NANOSECONDS < now - tracked.seen_at:
                self._end(object_id, Cause.TIMED_OUT)
        return self.told()

    def touch(self, now: int) -> None:
        """Let all objects count as seen at a time, as after a time without inputs."""
        for tracked in self._tracked.values():
            tracked.seen_at = now

    def finish(self) -> Iterator[Outcome]:
        """End all objects.

        Yields
        ------
        outcome : Result, Ended or Lost
            Object by object, in the order of their first view.
        """
        for object_id in self.objects:
            self._end(object_id, Cause.FINISHED)
            yield from self.told()

    def take(self, object_id: str) -> Result:
        """Return the result of a changed object, which counts as unchanged from now on.

        Parameters
        ----------
        object_id : str
            One of `changed`.

        Raises
        ------
        MomrecError
            If its views give no result, for instance since they are too few yet.
        """
        del self._changed[object_id]
        tracked = self._tracked[object_id]
        result = self._recognizer.result(object_id)
        self._tell_left_out(tracked, result)
        cut = tracked.cut.intersection(result.hull.views)
        return Result(result, tracked.stamp, tracked.frame_id, len(cut))

    def told(self) -> list[Outcome]:
        """Return what came up since the last call, such as views that `take` left out."""
        outcomes, self._outcomes = self._outcomes, []
        return outcomes

    def _use(self, event: StampedView, now: int) -> None:
        if self._is_repeated(event, now):
            self._tally.repeated += 1
            return
        object_id = event.object_id
        tracked = self._tracked[object_id]
        tracked.events[event.view] = event
        if event.is_cut:
            tracked.cut.add(event.view)
        try:
            self._recognizer.add_view(object_id, event.view)
        except EmptyHullError as error:
            self._changed[object_id] = None  # such views may have become the majority
            tracked.told.add(event.view)
            self._lose_view(event, str(error), Reason.CONTRADICTION)
        except MomrecError as error:
            self._lose_view(event, str(error), Reason.EXCESS)
        else:
            self._tally.used += 1
            self._tally.cut += event.is_cut
            self._changed[object_id] = None
            tracked.stamp, tracked.frame_id = event.stamp, event.frame_id

    def _is_repeated(self, event: StampedView, now: int) -> bool:
        """Track an object by one more view; tell whether it is one that came before."""
        tracked = self._tracked.setdefault(
            event.object_id, _Tracked(now, event.stamp, event.frame_id)
        )
        tracked.seen_at = now
        key = event.stamp, event.view.camera.pose.tobytes()
        if key in tracked.views:
            return True
        tracked.views[key] = None
        if len(tracked.views) > self._max_views:
            del tracked.views[next(iter(tracked.views))]
        return False

    def _tell_left_out(self, tracked: _Tracked, result: ObjectResult) -> None:
        """Tell, and count, which views a result leaves out or uses again."""
        left_out = set(result.left_out)
        again = tracked.told.intersection(result.hull.views)
        for view in result.left_out:
            if view not in tracked.told:
                self._lose_view(tracked.events[view], CONTRADICTS, Reason.CONTRADICTION)
                self._tally.used -= 1
        if again:
            self._tally.used += len(again)
            self._tally.rejected[Reason.CONTRADICTION] -= len(again)
        tracked.told = left_out
        live = left_out.union(result.hull.views)
        tracked.cut &= live
        tracked.events = {view: event for view, event in tracked.events.items() if view in live}

    def _end(self, object_id: str, cause: Cause) -> None:
        if object_id in self._changed:
            try:
                self._outcomes.append(self.take(object_id))
            except MomrecError as error:
                self._outcomes.append(Lost(f"object {object_id!r} has no result: {error}"))
        self._recognizer.forget(object_id)
        del self._tracked[object_id]
        self._tally.ended[cause] += 1
        self._outcomes.append(Ended(object_id, cause))

    def _lose(self, object_id: str, stamp: int, why: str, reason: Reason) -> None:
        what = _seen_at(object_id, stamp)
        if reason is Reason.PAIR:
            what = "half a view"
        elif not (object_id or stamp):
            what = "message"
        self._leave_out(what, why, reason)

    def _lose_view(self, event: StampedView, why: str, reason: Reason) -> None:
        by_whom = f" by {event.camera!r}" if event.camera else ""
        self._leave_out(_seen_at(event.object_id, event.stamp) + by_whom, why, reason)

    def _leave_out(self, what: str, why: str, reason: Reason) -> None:
        self._tally.rejected[reason] += 1
        self._outcomes.append(Lost(f"{what} left out: {why}", reason))


def _seen_at(object_id: str, stamp: int) -> str:
    return f"view of object {object_id!r} at {stamp / NANOSECONDS:.3f} s"
