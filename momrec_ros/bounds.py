"""What the experiment should show, and whether it does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from momrec_core.trust import Curve, Reliability
from momrec_ros.experiment import Study, Trial
from momrec_ros.neighbours import Neighbour

__all__ = ["Bound", "few_views_bounds", "near_tie_bound", "paper_bounds", "trust_bounds"]

STEADY_STEP = 4  # from which on the third-order rates should be high
MOST_FEATURES = 8  # with alternatives
FEW_VIEWS = 5
LEAST_AREA = 0.97  # under the curve of strangers rejected over known objects rejected
LARGEST_ERROR = 0.05  # of calibration
CONFUSIONS = 3  # that are told
WELL_APART = 2.0  # times their stray: classes that far apart are rarely confused


@dataclass(frozen=True)
class Bound:
    """A figure that the experiment should reach.

    Attributes
    ----------
    what : str
        The figure.
    expected, found : str
        With units.
    held : bool
        Whether it was reached.
    why : str
        Where it was not, the reason; empty where there is nothing to say.
    """

    what: str
    expected: str
    found: str
    held: bool
    why: str = ""


def paper_bounds(
    studies: Mapping[int, Study], views: int, neighbours: Sequence[Neighbour]
) -> list[Bound]:
    """Compare a study of the paper's experiment with what it should show.

    Parameters
    ----------
    studies : mapping
        Number of views to study, with trials of orders 2 and 3.
    views : int
        Of the study in question; the others help to explain it.
    neighbours : sequence of Neighbour
        Of its classes by their second moments.

    Returns
    -------
    bounds : list of Bound
    """
    study = studies[views]
    splits = f"mean of {len(study.ruled[3].splits)} splits"
    third = 100 * study.ruled[3].spread().test_mean
    second = 100 * study.ruled[2].spread().test_mean
    free = 100 * study.free[3].spread().test_mean[:MOST_FEATURES]
    steady = third[STEADY_STEP - 1 :].min(initial=100.0)
    alike = _rate(f"second order, test set, {splits}, three moments", second[-1], 92.5)
    if not alike.held:
        why = [_why_second_order(study.ruled[2], neighbours)]
        why += [
            f"Seen in {count} views: {100 * other.ruled[2].spread().test_mean[-1]:.1f} %."
            for count, other in studies.items()
            if count > views
        ]
        alike = replace(alike, why=" ".join(why))
    return [
        _rate(f"third order, test set, {splits}, from step {STEADY_STEP} on", steady, 98.0),
        _rate(f"third order, test set, {splits}, {_best(third)}", third.max(), 99.5),
        alike,
        _rate(
            f"third order, test set, {splits}, with alternatives, at most {MOST_FEATURES} moments, "
            f"{_best(free)}",
            free.max(),
            99.9,
        ),
    ]


def near_tie_bound(study: Study) -> Bound:
    """Compare a study of objects with near ties with what it should show.

    Parameters
    ----------
    study : Study
        With trials of order 3.

    Returns
    -------
    bound : Bound
        Of recognition in all admissible frames; its reason tells what A.1 to A.3 alone give.
    """
    ruled = 100 * study.ruled[3].spread().test_mean
    free = 100 * study.free[3].spread().test_mean
    bound = _rate(
        f"objects with near ties, third order, test set, mean of {len(study.free[3].splits)} "
        f"splits, with alternatives, {_best(free)}",
        free.max(),
        98.0,
    )
    step = int(np.argmax(free))
    why = (
        f"By A.1 to A.3 alone: {ruled[step]:.2f} % at that step, {ruled.max():.2f} % at the best "
        f"({int(np.argmax(ruled)) + 1})."
    )
    return replace(bound, why=why)


def few_views_bounds(studies: Mapping[int, Study]) -> list[Bound]:
    """Compare what few views give with what they should.

    Parameters
    ----------
    studies : mapping
        Number of views to study, with trials of order 5, which models learn from.

    Returns
    -------
    bounds : list of Bound
        One, if there is a study of five views.
    """
    if FEW_VIEWS not in studies:
        return []
    trial = studies[FEW_VIEWS].free[5]
    rates = 100 * trial.spread().test_mean
    bound = _rate(
        f"{FEW_VIEWS} views, fifth order, test set, mean of {len(trial.splits)} splits, with "
        f"alternatives, {_best(rates)}",
        rates.max(),
        97.0,
    )
    if not bound.held:
        bound = replace(bound, why=_worst_names(trial, int(np.argmax(rates)) + 1))
    return [bound]


def trust_bounds(curve: Curve, known: Reliability) -> list[Bound]:
    """Compare rejection of strangers and calibration with what they should be.

    Parameters
    ----------
    curve : Curve
        Of classes left out in turn.
    known : Reliability
        Of instances held back.

    Returns
    -------
    bounds : list of Bound
    """
    filled = known.counts > 0
    score = float(np.average(known.scores[filled], weights=known.counts[filled]))
    rate = float(np.average(known.rates[filled], weights=known.counts[filled]))
    why = f"Labels are right in {100 * rate:.1f} % of the cases, and the mean score is {score:.3f}."
    held = known.error < LARGEST_ERROR
    return [
        Bound(
            "strangers against known objects, each class left out in turn, area under the curve",
            f"{LEAST_AREA:g}",
            f"{curve.area:.4f}",
            curve.area >= LEAST_AREA,
        ),
        Bound(
            "expected calibration error of the score, instances held back",
            f"under {LARGEST_ERROR:g}",
            f"{known.error:.3f}",
            held,
            "" if held else why,
        ),
    ]


def _rate(what: str, found: float, expected: float) -> Bound:
    held = bool(round(float(found), 6) >= expected)
    return Bound(what, f"{expected:g} %", f"{found:.2f} %", held)


def _best(rates: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    return f"best step ({int(np.argmax(rates)) + 1})"


def _why_second_order(trial: Trial, neighbours: Sequence[Neighbour]) -> str:
    """Say which classes are confused, and whether reconstruction or likeness is to blame."""
    (worst, _), *_ = trial.confusions(trial.steps)
    told = [_likeness(found) for found in neighbours if found.label == worst]
    return " ".join([_worst_names(trial, trial.steps), *told])


def _worst_names(trial: Trial, step: int) -> str:
    tested = sum(len(split.test) for split in trial.splits)
    confusions = trial.confusions(step)
    worst = list(confusions.items())[:CONFUSIONS]
    share = sum(count for _, count in worst) / max(1, sum(confusions.values()))
    named = ", ".join(f"{one} taken for {other} ({count})" for (one, other), count in worst)
    return (
        f"{sum(confusions.values())} of {tested} wrong; {100 * share:.0f} % of these are: {named}."
    )


def _likeness(found: Neighbour) -> str:
    told_apart = found.apart_as_modelled > WELL_APART * found.stray
    cause = (
        "The objects themselves would be told apart; silhouettes leave too much of what is hollow, "
        "and how much depends on where they are seen from"
        if told_apart
        else "The objects themselves are that alike"
    )
    return (
        f"In the metric T, reconstructions of {found.label} stray by {found.stray:.2f} from their "
        f"mean, which is {found.apart:.2f} from that of {found.nearest}; as modelled, the two are "
        f"{found.apart_as_modelled:.2f} apart. {cause}."
    )
