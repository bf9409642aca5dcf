"""Where the command line writes: results on stdout, everything else on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from momrec_ros.report import printable

__all__ = ["Terminal"]

Item = TypeVar("Item")

PIPE_WIDTH = 160  # columns of a table that goes to a file or another program


class Terminal:
    """Writes for people on stderr, and results on stdout.

    Parameters
    ----------
    json : bool
        Whether stdout is kept for JSON lines, so that tables go to stderr as well.
    """

    def __init__(self, *, json: bool = False) -> None:
        self._json = json
        self._messages = Console(stderr=True, highlight=False, soft_wrap=True)
        self._tables = Console(stderr=json)
        if not self._tables.is_terminal:
            self._tables.width = PIPE_WIDTH

    def say(self, text: str) -> None:
        """Write one line on stderr; control characters in it are escaped."""
        self._messages.print(printable(text), markup=False)

    def lost(self, text: str) -> None:
        """Tell in one line what could not be used."""
        self._messages.print(printable(f"lost: {text}"), markup=False, style="yellow")

    def wrote(self, *paths: Path | None) -> None:
        """Tell which outputs came into being."""
        for path in paths:
            if path is not None:
                self.say(f"wrote {path}")

    def table(self, table: Table) -> None:
        """Write a table."""
        self._tables.print(table)

    def json(self, line: str) -> None:
        """Write a JSON line at once, if stdout is for them."""
        if self._json:
            print(line, flush=True)  # noqa: T201  the product itself, which rich must not touch

    def progress(
        self,
        items: Iterable[Item],
        what: str,
        total: int,
        done: Callable[[], int] | None = None,
    ) -> Iterator[Item]:
        """Show a bar while items are worked on, where stderr is a terminal.

        Parameters
        ----------
        items : iterable
            Passed on one by one.
        what : str
            What is being done.
        total : int
            The work in all: number of items, unless `done` says otherwise.
        done : callable or None
            Returns how much of the work is done; None for the number of items.

        Yields
        ------
        item
        """
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
        )
        shown = self._messages.is_terminal
        with Progress(
            *columns, console=self._messages, transient=True, disable=not shown
        ) as progress:
            task = progress.add_task(what, total=total)
            for number, item in enumerate(items, start=1):
                yield item
                progress.update(task, completed=number if done is None else done())
