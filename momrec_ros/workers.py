"""Processes that share the work where one core would keep a user waiting."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from momrec_core.recognizer import ObjectResult
from momrec_ros.figures import draw_object

__all__ = ["FigureDrawer", "Map", "shared_map", "worker_pool"]

Map = Callable[..., Iterator[Any]]  # what ``map`` is, or does in other processes

MOST_WAITING = 2  # pictures that the other process has to draw; more are drawn in this one


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Run worker processes; on leaving, what was not begun is given up.

    Parameters
    ----------
    workers : int
        Number of processes.

    Yields
    ------
    pool : ProcessPoolExecutor
    """
    context = get_context("spawn")  # a fork would take over threads in any state
    pool = ProcessPoolExecutor(workers, context)
    try:
        _start(pool, workers)
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _start(pool: ProcessPoolExecutor, workers: int) -> None:
    """Start the workers deaf to Ctrl-C, which they inherit; their parent ends them."""
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        for _ in range(workers):
            pool.submit(_nothing)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _nothing() -> None:
    """Be the first task of a worker."""


@contextmanager
def shared_map(workers: int) -> Iterator[Map]:
    """Give what maps a function over arguments, in processes if there may be several.

    Parameters
    ----------
    workers : int
        Number of processes; for one the work is done in this one.

    Yields
    ------
    apply : callable
        Takes a function and iterables of its arguments, returns the results in order.
    """
    if workers < 2:
        yield map
        return
    with worker_pool(workers) as pool:
        yield pool.map


class FigureDrawer:
    """Draws pictures of results beside other work; a context manager.

    A second process is started for the second picture: one alone is drawn sooner without.
    """

    def __init__(self) -> None:
        self._first: tuple[ObjectResult, Path] | None = None
        self._pool_context = worker_pool(1)
        self._pool: ProcessPoolExecutor | None = None
        self._waiting: list[Future[None]] = []

    def __enter__(self) -> Self:
        return self

    def draw(self, result: ObjectResult, path: Path) -> None:
        """Draw a result, now or soon.

        Parameters
        ----------
        result : ObjectResult
            Of one object.
        path : Path
            The PNG to write.

        Raises
        ------
        OSError
            If an earlier picture could not be written.
        """
        if self._first is None:
            self._first = result, path
            return
        if self._pool is None:
            self._pool = self._pool_context.__enter__()
            self._waiting.append(self._pool.submit(draw_object, *self._first))
        while self._waiting and self._waiting[0].done():
            self._waiting.pop(0).result()
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append(self._pool.submit(draw_object, result, path))
        else:
            draw_object(result, path)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._pool is None:
            if error is None and self._first is not None:
                draw_object(*self._first)
            return
        try:
            if error is None:
                for future in self._waiting:
                    future.result()
        finally:
            self._pool_context.__exit__(kind, error, traceback)
