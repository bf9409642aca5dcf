"""The experiment's tables: CSV files, and Table 1 beside the paper's for the terminal."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

from rich.table import Table
from rich.text import Text

from momrec_ros.bounds import Bound
from momrec_ros.experiment import Trial
from momrec_ros.paper_table import PAPER_TABLE

__all__ = ["bounds_table", "moment_name", "table_1", "write_first_split", "write_spread"]


def moment_name(index: tuple[int, int, int]) -> str:
    """Return the name of a moment in files and on the terminal."""
    return "eta_" + "".join(map(str, index))


def write_first_split(trials: Mapping[int, Trial], path: Path) -> None:
    """Write the rates of the first split in the layout of the paper's Table 1.

    Parameters
    ----------
    trials : mapping
        Order to trial.
    path : Path
        The CSV file to write: max_order, step, moment, train_percent, test_percent.
    """
    rows = [
        (order, step, moment_name(moment), _percent(train), _percent(test))
        for order, trial in trials.items()
        for step, (moment, train, test) in enumerate(
            zip(
                trial.names[0].selected,
                trial.train_rates()[0],
                trial.test_rates()[0],
                strict=False,
            ),
            start=1,
        )
    ]
    _write(path, ("max_order", "step", "moment", "train_percent", "test_percent"), rows)


def write_spread(trials: Mapping[int, Trial], path: Path) -> None:
    """Write mean and standard deviation of the rates over all splits, in percent.

    Parameters
    ----------
    trials : mapping
        Order to trial.
    path : Path
        The CSV file to write: max_order, step, train_mean, train_std, test_mean, test_std.
    """
    rows = []
    for order, trial in trials.items():
        found = trial.spread()
        columns = (found.train_mean, found.train_std, found.test_mean, found.test_std)
        rows += [
            (order, step, *map(_percent, rates))
            for step, rates in enumerate(zip(*columns, strict=True), start=1)
        ]
    _write(path, ("max_order", "step", "train_mean", "train_std", "test_mean", "test_std"), rows)


def table_1(ruled: Mapping[int, Trial], free: Mapping[int, Trial]) -> Table:
    """Show Table 1 beside the paper's, and the means over all splits.

    Parameters
    ----------
    ruled, free : mapping
        Order to trial, by A.1 to A.3 only and in all admissible frames.

    Returns
    -------
    table : rich Table
    """
    count = len(next(iter(ruled.values())).splits)
    table = Table(title=f"Success of classification, percent; means over {count} splits")
    table.add_column("order", justify="right")
    table.add_column("step", justify="right")
    headings = (
        "moment",
        "training",
        "test",
        "paper's moment",
        "training",
        "test",
        "mean training",
        "mean test",
        "spread",
        "with alternatives",
    )
    for heading in headings:
        table.add_column(heading, justify="right")
    for order, trial in ruled.items():
        for step, cells in enumerate(_rows(trial, free[order]), start=1):
            table.add_row(str(order) if step == 1 else "", str(step), *cells)
        table.add_section()
    return table


def bounds_table(bounds: Sequence[Bound]) -> Table:
    """Show what should be seen and what is.

    Parameters
    ----------
    bounds : sequence of Bound
        With the reason where one was missed.

    Returns
    -------
    table : rich Table
    """
    table = Table(title="What should be seen")
    table.add_column("figure", overflow="fold")
    for heading in ("bound", "found", ""):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("why", overflow="fold")
    for bound in bounds:
        verdict = Text("held", style="green") if bound.held else Text("missed", style="yellow")
        table.add_row(bound.what, bound.expected, bound.found, verdict, Text(bound.why))
    return table


def _rows(ruled: Trial, free: Trial) -> Iterable[tuple[str, ...]]:
    found, better = ruled.spread(), free.spread()
    ours = list(
        zip(
            map(moment_name, ruled.names[0].selected),
            map(_shown, ruled.train_rates()[0]),
            map(_shown, ruled.test_rates()[0]),
            strict=False,
        )
    )
    paper = [
        (moment_name(row.moment), f"{row.train:.1f}", f"{row.test:.1f}")
        for row in PAPER_TABLE[ruled.order]
    ]
    means = list(
        zip(
            map(_shown, found.train_mean),
            map(_shown, found.test_mean),
            map(_shown, found.test_std),
            strict=True,
        )
    )
    others = [(text,) for text in map(_shown, better.test_mean)]
    for parts in zip_longest(ours, paper, means, others):
        widths = (3, 3, 3, 1)
        yield tuple(
            cell
            for part, width in zip(parts, widths, strict=True)
            for cell in (part or ("",) * width)
        )


def _shown(rate: float) -> str:
    return f"{100 * rate:.1f}"


def _percent(rate: float) -> str:
    return f"{100 * rate:.2f}"


def _write(path: Path, headings: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(headings)
        writer.writerows(rows)
