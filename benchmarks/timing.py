"""Times that can be compared: the works take turns, so that a busy machine slows them alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import TypeVar

import numpy as np

__all__ = ["interleaved", "medians", "seconds"]

MILLISECONDS = 1000.0
Name = TypeVar("Name")


def interleaved(works: Mapping[Name, Callable[[], object]], rounds: int) -> dict[Name, float]:
    """Return the median time of each work in milliseconds, after one round to warm up."""
    return dict(zip(works, medians(list(works.values()), rounds), strict=True))


def medians(works: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Return the median times of works in milliseconds, after one round to warm up."""
    times = np.array([[seconds(work) for work in works] for _ in range(rounds + 1)])
    return list(MILLISECONDS * np.median(times[1:], axis=0))


def seconds(work: Callable[[], object]) -> float:
    """Return how long a work takes."""
    start = perf_counter()
    work()
    return perf_counter() - start
