"""Which views contradict the others.

A point on the outline of a silhouette is seen along a ray that touches the object, so that some
point of the ray lies in every viewing volume. Where none does, either this silhouette says too
much there, or the views that refuse the ray's best point say too little. A view that lies is one
of these on many rays, whatever is wrong with it: its pose, its size, what it shows. Every other
view is one of them on few.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from momrec_core.sightlines import Sightlines
from momrec_core.view import View

__all__ = ["contradicting_views"]

MOST_RAYS = 32  # of each view: shares of its outline are known to a few hundredths
ALL_RAYS = 1536  # of all views together, which bounds the time; but
LEAST_RAYS = 16  # of each, and
MOST_OUTLINES = 64  # evenly chosen views whose outlines are looked at
QUORUM = 4  # views for each one that may be left out: of three, any may be the one that lies
# A ray that misses a silhouette by less than a tolerance, relative to the silhouette's diagonal,
# is a contradiction by half: such grades tell a liar from noise better than a single tolerance.
FINE = (0.0014, 0.0028)  # one and two pixels of a common mask
COARSE = (0.0042, 0.0084)  # where calibration and segmentation leave little to be refused
NOISY = 0.5  # suspicion of the middle view at the fine ones, from which on they tell nothing
# Suspicions below are what calibration and noise leave: each further view adds to all of them.
HARMLESS, HARMLESS_PER_VIEW = 0.2, 0.015
MARGIN = 1.35  # of a liar's suspicion over all views that stay, beside it and without it
OUTLYING = 3.0  # times the middle view's suspicion at the coarse ones: noise alone stays below


def contradicting_views(views: Sequence[View], most: int) -> tuple[int, ...]:
    """Find the views that contradict the others.

    The view under the strongest suspicion is taken away first, and the others are judged anew
    without it. Views taken away are named if they stand out from all others and if these agree
    without them. Where that can't be told, as among three views or when two accuse one another,
    none is named.

    Parameters
    ----------
    views : sequence of View
        Of one object, in any order.
    most : int
        Views that may be named at the most; never more than a quarter of all.

    Returns
    -------
    indices : tuple of int
        Of the views that contradict the others, increasing; mostly none.
    """
    most = min(most, len(views) // QUORUM)
    if most < 1:
        return ()
    lines, coarse = _sightlines(views, FINE), None
    everyone = np.ones(len(views), dtype=np.bool_)
    suspicions = _suspicions(lines, everyone)
    if np.median(suspicions) > NOISY:
        lines = coarse = _sightlines(views, COARSE)
        suspicions = _suspicions(lines, everyone)
    suspects, rounds = _accused(lines, suspicions, most)
    for count in range(len(suspects), 0, -1):
        if _stand_out(suspects[:count], rounds):
            coarse = coarse or _sightlines(views, COARSE)
            if _is_confirmed(coarse, len(views), suspects[:count]):
                return tuple(sorted(suspects[:count]))
    return ()


def _accused(
    lines: Sequence[Sightlines], suspicions: NDArray[np.float64], most: int
) -> tuple[list[int], list[NDArray[np.float64]]]:
    """Return views under suspicion, the worst first, and the suspicions before and after each.

    The first suspicions are those with all views in use.
    """
    harmless = HARMLESS + HARMLESS_PER_VIEW * min(len(suspicions), MOST_OUTLINES)
    used = np.ones(len(suspicions), dtype=np.bool_)
    suspects: list[int] = []
    rounds = [suspicions]
    while len(suspects) < most and rounds[-1].max() > harmless:
        suspects.append(int(rounds[-1].argmax()))
        used[suspects[-1]] = False
        rounds.append(_suspicions(lines, used))
    return suspects, rounds


def _is_confirmed(lines: Sequence[Sightlines], count: int, suspects: Sequence[int]) -> bool:
    """Tell whether views stand out at other tolerances as well, and are no mere noise there."""
    used = np.ones(count, dtype=np.bool_)
    rounds = [_suspicions(lines, used)]
    for suspect in suspects:
        if rounds[-1][suspect] < OUTLYING * np.median(rounds[-1]):
            return False
        used[suspect] = False
        rounds.append(_suspicions(lines, used))
    return _stand_out(suspects, rounds)


def _sightlines(views: Sequence[View], tolerances: Sequence[float]) -> list[Sightlines]:
    """Return rays along the outlines, the same for each tolerance."""
    owners = np.unique(np.linspace(0, len(views) - 1, MOST_OUTLINES).astype(np.int64))
    count = int(np.clip(ALL_RAYS // len(owners), LEAST_RAYS, MOST_RAYS))
    return [Sightlines(views, owners, count, tolerance) for tolerance in tolerances]


def _suspicions(lines: Sequence[Sightlines], used: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return, for each view, the outlines' shares that cannot be right if it is.

    In units of whole outlines, the mean over the tolerances; where several views refuse a ray
    they share the blame.
    """
    return np.asarray(np.mean([_suspicions_at(those, used) for those in lines], axis=0))


def _suspicions_at(lines: Sightlines, used: NDArray[np.bool_]) -> NDArray[np.float64]:
    refused = lines.refusals(used)
    refusers = refused.sum(axis=1)
    uncovered = refusers > 0
    own = np.bincount(lines.owners[uncovered], minlength=len(used))
    blame = (refused[uncovered] / refusers[uncovered, None]).sum(axis=0)
    return np.asarray((own + blame) / lines.count)


def _stand_out(suspects: Sequence[int], rounds: Sequence[NDArray[np.float64]]) -> bool:
    """Tell whether each suspect was above all views that stay, with it and without all of them."""
    left = rounds[len(suspects)].max()
    for suspect, suspicions in zip(suspects, rounds, strict=False):
        others = np.delete(suspicions, suspects).max()
        if suspicions[suspect] < MARGIN * max(others, left):
            return False
    return True
