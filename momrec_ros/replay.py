"""A recording turned into results: events in log order in, finished objects and losses out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from momrec_core.errors import MomrecError
from momrec_core.recognizer import ObjectResult, Recognizer
from momrec_ros.messages import Forget, Rejected, StampedView

if TYPE_CHECKING:
    from momrec_core.model import RecognitionModel

__all__ = ["Finished", "Lost", "Replay"]

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class Finished:
    """An object that gets no further views.

    Attributes
    ----------
    result : ObjectResult
        What all its views say.
    stamp : int
        Of the last view used, nanoseconds.
    frame_id : str
        The world frame.
    """

    result: ObjectResult
    stamp: int
    frame_id: str


@dataclass(frozen=True)
class Lost:
    """Something of the recording that could not be used.

    Attributes
    ----------
    text : str
        What was lost and why, in one line.
    """

    text: str


class Replay:
    """Feeds events to a `Recognizer` and tells which objects are finished.

    An object is finished when it is forgotten, evicted, without a view for too long, or when
    the recording ends.

    Parameters
    ----------
    model : RecognitionModel or None
        Names the objects.
    slices, min_views, max_objects, max_views : int
        As for `Recognizer`.
    object_timeout : float
        Seconds of the recording without a view after which an object is finished; 0 for never.
    """

    def __init__(
        self,
        model: RecognitionModel | None,
        *,
        slices: int,
        min_views: int,
        max_objects: int,
        max_views: int,
        object_timeout: float,
    ) -> None:
        self._recognizer = Recognizer(
            model,
            slices=slices,
            min_views=min_views,
            max_objects=max_objects,
            max_views=max_views,
            on_evict=self._end,
        )
        self._timeout = round(object_timeout * NANOSECONDS)
        self._last_used: dict[str, tuple[int, str]] = {}
        self._outcomes: list[Finished | Lost] = []

    def feed(self, event: StampedView | Forget | Rejected) -> Iterator[Finished | Lost]:
        """Use one event.

        Parameters
        ----------
        event : StampedView, Forget or Rejected
            The next of the recording.

        Yields
        ------
        outcome : Finished or Lost
            What came of it, mostly nothing.
        """
        if isinstance(event, StampedView):
            self._end_overdue(event.stamp)
            self._use(event)
        elif isinstance(event, Rejected):
            self._recognizer.reject(event.object_id)
            self._lose(event.object_id, event.stamp, event.reason)
        else:
            named = event.object_id
            for object_id in self._recognizer.objects:
                if named in ("", object_id):
                    self._end(object_id)
            self._recognizer.forget(named)
        yield from self._told()

    def finish(self) -> Iterator[Finished | Lost]:
        """End the recording.

        Yields
        ------
        outcome : Finished or Lost
            The objects that were still gathering views, in the order of their first view.
        """
        for object_id in self._recognizer.objects:
            self._end(object_id)
            yield from self._told()

    def _use(self, event: StampedView) -> None:
        try:
            self._recognizer.add_view(event.object_id, event.view)
        except MomrecError as error:
            self._lose(event.object_id, event.stamp, str(error))
        else:
            self._last_used[event.object_id] = event.stamp, event.frame_id

    def _end_overdue(self, now: int) -> None:
        if self._timeout == 0:
            return
        for object_id in self._recognizer.objects:
            if now - self._last_used[object_id][0] > self._timeout:
                self._end(object_id)

    def _end(self, object_id: str) -> None:
        try:
            result = self._recognizer.result(object_id)
        except MomrecError as error:
            self._outcomes.append(Lost(f"object {object_id!r} has no result: {error}"))
        else:
            self._outcomes.append(Finished(result, *self._last_used[object_id]))
        self._recognizer.forget(object_id)
        self._last_used.pop(object_id, None)

    def _lose(self, object_id: str, stamp: int, reason: str) -> None:
        seconds = stamp / NANOSECONDS
        self._outcomes.append(
            Lost(f"view of object {object_id!r} at {seconds:.3f} s left out: {reason}")
        )

    def _told(self) -> Iterator[Finished | Lost]:
        outcomes, self._outcomes = self._outcomes, []
        yield from outcomes
