"""Times that can be compared: the works take turns, so that a busy machine slows them alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

__all__ = ["Contest", "contested", "medians", "seconds"]

MILLISECONDS = 1000.0


@dataclass(frozen=True)
class Contest:
    """Times of a work and of others that do the same.

    Attributes
    ----------
    times : dict
        Median time of each, milliseconds.
    ratios : dict
        Of each of the others: how many times as long it takes, the median of the rounds.
    """

    times: dict[str, float]
    ratios: dict[str, float]


def contested(
    name: str, work: Callable[[], object], others: Mapping[str, Callable[[], object]], rounds: int
) -> Contest:
    """Time a work between any two others, after one round to warm up.

    Each of the others is compared with the work right before and right after it: a processor
    changes its pace within seconds, and a work of milliseconds timed once a round would meet
    another pace than the others.
    """
    ours, theirs = [seconds(work)], []
    for _ in range(rounds + 1):
        for other in others.values():
            theirs.append(seconds(other))
            ours.append(seconds(work))
    between = (np.array(ours[:-1]) + ours[1:]) / 2
    shape = rounds + 1, len(others)
    taken = np.reshape(theirs, shape)[1:]
    ratios = np.median(taken / between.reshape(shape)[1:], axis=0)
    own_times = ours[1 + len(others) :]
    times = {name: MILLISECONDS * float(np.median(own_times))}
    times |= zip(others, (MILLISECONDS * np.median(taken, axis=0)).tolist(), strict=True)
    return Contest(times, dict(zip(others, ratios.tolist(), strict=True)))


def medians(works: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Return the median times of works in milliseconds, after one round to warm up."""
    times = np.array([[seconds(work) for work in works] for _ in range(rounds + 1)])
    return list(MILLISECONDS * np.median(times[1:], axis=0))


def seconds(work: Callable[[], object]) -> float:
    """Return how long a work takes."""
    start = perf_counter()
    work()
    return perf_counter() - start
