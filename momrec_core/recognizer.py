"""The accumulating pipeline: views of several objects in, meshes and class labels out."""

from __future__ import annotations

import copy
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray

from momrec_core.agreement import contradicting_views
from momrec_core.canonical import CanonicalShape, normalize
from momrec_core.covering import covered_shares
from momrec_core.errors import EmptyHullError, MomrecError, NoCommonLineError
from momrec_core.hull import VisualHull
from momrec_core.view import View

if TYPE_CHECKING:
    from momrec_core.model import Recognition, RecognitionModel

__all__ = ["ObjectResult", "Recognizer"]

CONSISTENT = 0.99  # of every silhouette: where as much is covered again, all views agree
FEW_VIEWS = 24  # as long as there are no more, every view makes its object judged anew
GROWTH = 1.1  # of many views, or so much less covered, before they are judged anew
LOSS = 0.001
KEPT_ASIDE = 2  # times `max_views`: all views of one object, with those left out


@dataclass(frozen=True, eq=False)
class ObjectResult:
    """What is known of one object after the views so far.

    Attributes
    ----------
    object_id : str
        The name under which the views came.
    mesh : Trimesh
        Closed surface of the visual hull, world, metres.
    canonical : CanonicalShape
        The mesh in its canonical frame.
    recognition : Recognition or None
        The verdict of the model; None without a model.
    hull : VisualHull
        The slices and the views that they were made of.
    rejected_views : int
        Views of this object that were left out.
    coverage : array, shape (views,)
        The share of each used silhouette that the mesh's projection covers again, 0 to 1, in
        the order of `hull.views`. Low shares tell of views that contradict one another.
    left_out : tuple of View
        The views that were gathered, but contradict those in use, in the order of arrival.
    """

    object_id: str
    mesh: trimesh.Trimesh
    canonical: CanonicalShape
    recognition: Recognition | None
    hull: VisualHull
    rejected_views: int
    coverage: NDArray[np.float64]
    left_out: tuple[View, ...]

    @property
    def views(self) -> int:
        """Number of views used."""
        return len(self.hull.views)

    @property
    def slices(self) -> int:
        """Number of slicing planes."""
        return len(self.hull.offsets)

    @property
    def area(self) -> float:
        """Area of the mesh, square metres."""
        return float(self.canonical.moments[0, 0, 0] / self.canonical.scale**2)

    @property
    def volume(self) -> float:
        """Volume within the mesh, cubic metres."""
        return self.canonical.volume / self.canonical.scale**3


class Recognizer:
    """Gathers views of several objects, refines each object view by view, and names it.

    A view that would empty the hull of its object contradicts the views before it: it is left
    out and counted. Should the views left out outnumber those in use, they take over, so that a
    bad first view costs no more than a bad last one.

    A wrong pose or a bad mask that leaves some of the hull shows in what the others are covered
    by. When a result does not cover its silhouettes, all views gathered are judged together, see
    `contradicting_views`, and those that contradict the others are left out. Every result judges
    anew: later views may bring an earlier one back.

    Parameters
    ----------
    model : RecognitionModel or None
        Names the objects; without it results carry no recognition.
    slices : int
        Number of slicing planes of each object.
    min_views : int
        Views that an object needs before it has a result; at least 2.
    max_objects : int
        Objects kept at a time. With one more, the one without a view for longest is evicted.
    max_views : int
        Views kept of one object; further views are rejected.
    max_bad_views : int
        Views of one object that may be left out since they contradict the others, at the most,
        and never more than a quarter; 0 to leave out only what would empty the hull.
    on_evict : callable or None
        Called with the id of an object about to be evicted, while its result can still be had.

    Raises
    ------
    ValueError
        If a number is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> import trimesh
    >>> from momrec_core import Recognizer
    >>> from momrec_core.simulation import simulate_views
    >>> recognizer = Recognizer(slices=32)
    >>> for view in simulate_views(trimesh.creation.box((1, 2, 3)), 8, np.random.default_rng(1)):
    ...     recognizer.add_view("box", view)
    >>> recognizer.result("box").mesh.is_watertight
    True
    """

    def __init__(
        self,
        model: RecognitionModel | None = None,
        *,
        slices: int = 64,
        min_views: int = 2,
        max_objects: int = 16,
        max_views: int = 1000,
        max_bad_views: int = 10,
        on_evict: Callable[[str], None] | None = None,
    ) -> None:
        smallest = {
            "min_views": 2,
            "max_objects": 1,
            "max_views": min_views,
            "max_bad_views": 0,
        }
        given = {
            "min_views": min_views,
            "max_objects": max_objects,
            "max_views": max_views,
            "max_bad_views": max_bad_views,
        }
        for name, value in given.items():
            if value < smallest[name]:
                raise ValueError(f"Expected {name} of at least {smallest[name]}, got {value}")
        self._model = model
        self._empty = VisualHull(slices)
        self._min_views = min_views
        self._max_objects = max_objects
        self._max_views = max_views
        self._max_bad_views = max_bad_views
        self._on_evict = on_evict
        self._gathered: dict[str, _Gathered] = {}
        self._unseen: OrderedDict[str, int] = OrderedDict()
        self._clock = 0

    @property
    def objects(self) -> tuple[str, ...]:
        """Ids of the objects with views, in the order of their first view."""
        return tuple(self._gathered)

    def add_view(self, object_id: str, view: View) -> None:
        """Refine an object by one view.

        Parameters
        ----------
        object_id : str
            The object's name; a new name starts a new object.
        view : View
            In the same world as the object's other views.

        Raises
        ------
        EmptyHullError
            If the view contradicts the views in use. It is counted and kept aside, and nothing
            else changes unless such views have become the majority.
        MomrecError
            If the object has its `max_views` already, or the hull cannot use the view.
        """
        gathered = self._started(object_id)
        gathered.offered += 1
        if len(gathered.hull.views) >= self._max_views:
            raise MomrecError(
                f"Expected at most {self._max_views} views of object {object_id!r}, got one more"
            )
        gathered.keep(view, KEPT_ASIDE * self._max_views)
        try:
            gathered.hull = _refined(gathered.hull, view)
        except EmptyHullError:
            self._contradict(gathered, view)
            raise
        gathered.result = None

    def reject(self, object_id: str) -> None:
        """Count a view that could not even be decoded.

        Parameters
        ----------
        object_id : str
            The object that it was meant for. An object without a view yet is remembered for its
            count only, which evicts nothing.
        """
        if object_id in self._gathered:
            self._gathered[object_id].offered += 1
            return
        self._unseen[object_id] = self._unseen.pop(object_id, 0) + 1
        if len(self._unseen) > self._max_objects:
            self._unseen.popitem(last=False)

    def forget(self, object_id: str) -> None:
        """Drop all that is known of an object; an unknown id is no error."""
        self._gathered.pop(object_id, None)
        self._unseen.pop(object_id, None)

    def result(self, object_id: str) -> ObjectResult:
        """Return what the views so far say about an object.

        Computed when asked for, and kept until the object's next view.

        Parameters
        ----------
        object_id : str
            One of `objects`.

        Returns
        -------
        result : ObjectResult
            Stays as it is when further views come.

        Raises
        ------
        KeyError
            If no view of the object came, or it was forgotten or evicted.
        NoCommonLineError
            If there are too few views yet, or all look in one direction.
        EmptyHullError
            If no slicing plane meets the hull.
        DegenerateShapeError
            If the mesh cannot be normalised.
        """
        gathered = self._gathered[object_id]
        if gathered.result is None:
            gathered.result = self._computed(object_id, gathered)
        return replace(
            gathered.result,
            rejected_views=gathered.rejected_views,
            left_out=gathered.left_out,
        )

    def _started(self, object_id: str) -> _Gathered:
        """Return the object's state, the object marked as the one used last."""
        if object_id not in self._gathered:
            if len(self._gathered) >= self._max_objects:
                self._evict()
            offered = self._unseen.pop(object_id, 0)
            self._gathered[object_id] = _Gathered(self._empty, self._empty, offered)
        self._clock += 1
        self._gathered[object_id].used_at = self._clock
        return self._gathered[object_id]

    def _evict(self) -> None:
        oldest = min(self._gathered, key=lambda object_id: self._gathered[object_id].used_at)
        if self._on_evict is not None:
            self._on_evict(oldest)
        self._gathered.pop(oldest, None)

    def _contradict(self, gathered: _Gathered, view: View) -> None:
        """Gather a contradicting view with its like, which take over once they are more."""
        with suppress(MomrecError):
            gathered.rival = _refined(gathered.rival, view)
        if len(gathered.rival.views) > len(gathered.hull.views):
            outnumbered = gathered.hull.views
            gathered.hull, gathered.rival = gathered.rival, self._empty
            gathered.result = None
            for former in outnumbered:
                with suppress(MomrecError):
                    gathered.hull = _refined(gathered.hull, former)

    def _computed(self, object_id: str, gathered: _Gathered) -> ObjectResult:
        mesh, shares = self._settled(object_id, gathered)
        canonical = normalize(mesh)
        recognition = None if self._model is None else self._model.recognize(canonical)
        return ObjectResult(
            object_id,
            mesh,
            canonical,
            recognition,
            gathered.hull,
            rejected_views=0,
            coverage=shares,
            left_out=(),
        )

    def _settled(
        self, object_id: str, gathered: _Gathered
    ) -> tuple[trimesh.Trimesh, NDArray[np.float64]]:
        """Return mesh and covered shares of the views in use, judged anew if it seems to pay."""
        try:
            surface = self._surface(object_id, gathered.hull)
        except MomrecError:
            if not self._judged_otherwise(gathered):
                raise
        else:
            if not (gathered.is_doubtful(surface[1]) and self._judged_otherwise(gathered)):
                return surface
        mesh, shares = self._surface(object_id, gathered.hull)
        gathered.judged_coverage = float(shares.mean())
        return mesh, shares

    def _surface(
        self, object_id: str, hull: VisualHull
    ) -> tuple[trimesh.Trimesh, NDArray[np.float64]]:
        if len(hull.views) < self._min_views:
            raise NoCommonLineError(
                f"Expected at least {self._min_views} views of object {object_id!r}, "
                f"got {len(hull.views)}"
            )
        mesh = hull.mesh()
        return mesh, covered_shares(hull.views, mesh)

    def _judged_otherwise(self, gathered: _Gathered) -> bool:
        """Judge all views; tell whether others than before are in use now."""
        views = gathered.views
        verdict = contradicting_views(views, self._max_bad_views)
        gathered.judged_views = len(views)
        bad = {views[index] for index in verdict}
        if bad == gathered.bad:
            return False
        gathered.bad = bad
        if bad == set(gathered.left_out):
            return False
        hull = self._empty
        for view in views:
            if view not in bad:
                with suppress(MomrecError):
                    hull = _refined(hull, view)
        gathered.hull, gathered.rival = hull, self._empty
        return True


@dataclass(eq=False)
class _Gathered:
    """The state of one object. Its hulls are never changed, but replaced by refined copies."""

    hull: VisualHull
    rival: VisualHull
    offered: int
    used_at: int = 0
    result: ObjectResult | None = None
    views: list[View] = field(default_factory=list)
    judged_views: int = 0
    judged_coverage: float = 1.0
    bad: set[View] = field(default_factory=set)  # those that contradict the others

    def keep(self, view: View, most: int) -> None:
        """Gather a view; of too many, the oldest that is not in use goes."""
        self.views.append(view)
        if len(self.views) > most:
            forgotten = next(iter(self.left_out), None)
            self.views = [kept for kept in self.views if kept is not forgotten]

    def is_doubtful(self, shares: NDArray[np.float64]) -> bool:
        """Tell by the covered shares whether the views are to be judged, which takes time."""
        count, mean = len(self.views), float(shares.mean())
        if shares.min() >= CONSISTENT and not self.left_out:
            return False
        is_due = count <= FEW_VIEWS or count > GROWTH * self.judged_views
        if is_due or mean < self.judged_coverage - LOSS:
            self.judged_coverage = mean
            return True
        return False

    @property
    def left_out(self) -> tuple[View, ...]:
        """The views gathered and not in use."""
        used = set(self.hull.views)
        return tuple(view for view in self.views if view not in used)

    @property
    def rejected_views(self) -> int:
        return self.offered - len(self.hull.views)


def _refined(hull: VisualHull, view: View) -> VisualHull:
    refined = copy.copy(hull)
    try:
        refined.add(view)
    except RuntimeError as error:  # manifold3d's: numbers out of its range
        raise EmptyHullError(
            f"Expected a view of the object's size and place, got one far off: {error}"
        ) from error
    if refined.emptied_by is not None:
        raise EmptyHullError(
            "Expected a view that meets the object as seen so far, got one that leaves nothing "
            f"of it after {len(hull.views)} views"
        )
    return refined
