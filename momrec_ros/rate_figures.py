"""Plots of how often shapes are named rightly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from momrec_ros.drawing import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    VERMILION,
    blank_figure,
    save_figure,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from momrec_core.stepwise import Instances
    from momrec_core.trust import Curve, Reliability
    from momrec_ros.experiment import Trial
    from momrec_ros.paper_table import PaperRow

__all__ = [
    "RateCurve",
    "RatePanel",
    "draw_curves",
    "draw_ellipsoids",
    "draw_rates",
    "draw_trust",
]

ORDINALS = {2: "second", 3: "third", 4: "fourth", 5: "fifth"}
LOWEST_RATE = 50.0  # percent, at the bottom of the plots
CURVES = ("o-", "s--", "D:")
MARKERS = "osD^vP*Xph<>d"  # of classes
CLASS_COLORS = (BLUE, VERMILION, GREEN, "#CC79A7", INK)


def draw_rates(
    ruled: Mapping[int, Trial],
    free: Mapping[int, Trial],
    published: Mapping[int, Sequence[PaperRow]],
    path: str | Path,
) -> None:
    """Draw test rates over the steps of the selection, a panel for each order.

    Parameters
    ----------
    ruled, free : mapping
        Order to trial, by A.1 to A.3 only and in all admissible frames.
    published : mapping
        Order to the paper's rates, where they are to be compared.
    path : path
        The PNG to write.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    width = max(3.6 * len(ruled), 9.0)
    figure = blank_figure(width, 4.4)
    panels = figure.subplots(1, len(ruled), sharey=True, squeeze=False)[0]
    figure.subplots_adjust(left=0.8 / width, right=0.985, top=0.90, bottom=0.25, wspace=0.08)
    for axes, (order, trial) in zip(panels, ruled.items(), strict=True):
        _plot_trial(axes, trial, BLUE, "mean of the splits, by A.1 to A.3, and its spread")
        _plot_alternatives(axes, free[order])
        _plot_published(axes, published.get(order, ()))
        axes.set_title(f"up to {ORDINALS[order]} order", fontsize=12, color=INK)
        axes.set(xlim=(0.5, 10.5), ylim=(LOWEST_RATE, 101.5), xticks=range(1, 11))
        axes.set_xlabel("step: number of moments", color=INK)
        _plain(axes)
    panels[0].set_ylabel("test set named rightly, %", color=INK)
    _legend_below(figure, panels[0])
    save_figure(figure, path)


def _plot_trial(axes: Axes, trial: Trial, color: str, label: str) -> None:
    found = trial.spread()
    steps, mean, spread = _steps(trial.steps), 100 * found.test_mean, 100 * found.test_std
    axes.fill_between(
        steps, mean - spread, np.minimum(mean + spread, 100.0), color=color, alpha=0.18, lw=0
    )
    axes.plot(steps, mean, "o-", color=color, ms=4, lw=1.8, label=label)


def _plot_alternatives(axes: Axes, trial: Trial) -> None:
    mean = 100 * trial.spread().test_mean
    axes.plot(
        _steps(trial.steps),
        mean,
        "--",
        color=ORANGE,
        lw=1.8,
        label="mean, with admissible alternatives",
    )


def _plot_published(axes: Axes, rows: Sequence[PaperRow]) -> None:
    rates = [row.test for row in rows]
    if rates:
        axes.plot(
            _steps(len(rates)),
            rates,
            "x",
            color=VERMILION,
            ms=7,
            mew=1.8,
            label="the paper, one split",
        )


@dataclass(frozen=True)
class RateCurve:
    """Rates in percent under a name."""

    name: str
    rates: tuple[float, ...]


@dataclass(frozen=True)
class RatePanel:
    """Curves over the same positions, and what these are."""

    title: str
    positions: tuple[float, ...]
    curves: tuple[RateCurve, ...]


def draw_curves(panels: Sequence[RatePanel], path: str | Path) -> None:
    """Draw rates over what they depend on, side by side.

    Parameters
    ----------
    panels : sequence of RatePanel
        The first names the curves in the legend; others use some of its names.
    path : path
        The PNG to write.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    width = max(4.6 * len(panels), 8.0)
    figure = blank_figure(width, 4.6)
    grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    figure.subplots_adjust(left=0.8 / width, right=0.985, top=0.95, bottom=0.26, wspace=0.08)
    for axes, panel in zip(grid, panels, strict=True):
        places = np.arange(len(panel.positions))
        for curve, color, style in zip(panel.curves, (BLUE, ORANGE, GREEN), CURVES, strict=False):
            axes.plot(places, curve.rates, style, color=color, ms=6, lw=1.8, label=curve.name)
        axes.set_xticks(places, [f"{position:g}" for position in panel.positions])
        axes.set_xlabel(panel.title, color=INK)
        _plain(axes)
    lowest = min(min(curve.rates) for panel in panels for curve in panel.curves)
    grid[0].set_ylim(10 * np.floor(lowest / 10), 101.5)
    grid[0].set_ylabel("named rightly, %", color=INK)
    _legend_below(figure, grid[0])
    save_figure(figure, path)


def _steps(count: int) -> NDArray[np.int64]:
    return np.arange(1, count + 1)


def draw_trust(curve: Curve, parts: Mapping[str, Reliability], path: str | Path) -> None:
    """Draw how strangers are rejected, and how often labels of about the same score are right.

    Parameters
    ----------
    curve : Curve
        Of strangers among known objects.
    parts : mapping
        What was asked to the reliability of the scores; two at the most.
    path : path
        The PNG to write.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    figure = blank_figure(11.0, 5.2)
    left, right = cast("NDArray[np.object_]", figure.subplots(1, 2))
    figure.subplots_adjust(left=0.07, right=0.97, top=0.90, bottom=0.13, wspace=0.24)
    for axes in (left, right):
        axes.plot([0, 1], [0, 1], ":", color=FAINT, lw=1.2)
        axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal")
        _plain(axes)
    left.plot(curve.known_rejected, curve.strangers_rejected, color=BLUE, lw=2.0)
    left.set_title(f"strangers rejected, area {curve.area:.3f}", fontsize=12, color=INK)
    left.set_xlabel("known objects rejected, share", color=INK)
    left.set_ylabel("strangers rejected, share", color=INK)
    for (name, part), color, marker in zip(parts.items(), (BLUE, ORANGE), "os", strict=False):
        filled = part.counts > 0
        sizes = 20 + 200 * part.counts[filled] / part.counts.sum()
        label = f"{name}, calibration error {part.error:.3f}"
        right.plot(part.scores[filled], part.rates[filled], color=color, lw=1.0, alpha=0.6)
        right.scatter(
            part.scores[filled],
            part.rates[filled],
            s=sizes,
            c=color,
            marker=marker,
            label=label,
            alpha=0.8,
        )
    right.set_title("reliability of the score", fontsize=12, color=INK)
    right.set_xlabel("mean score", color=INK)
    right.set_ylabel("labels that are right, share", color=INK)
    right.legend(loc="lower right", frameon=False, fontsize=9, labelcolor=INK)
    save_figure(figure, path)


def draw_ellipsoids(instances: Instances, models: Instances, path: str | Path) -> None:
    """Draw the second moments of instances by class, and those of the objects as modelled.

    Parameters
    ----------
    instances : Instances
        Reconstructed.
    models : Instances
        One of each class.
    path : path
        The PNG to write.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    figure = blank_figure(12.0, 5.4)
    panels = cast("NDArray[np.object_]", figure.subplots(1, 2))
    figure.subplots_adjust(left=0.06, right=0.80, top=0.97, bottom=0.12, wspace=0.20)
    for axes, (across, up) in zip(
        panels, (((2, 0, 0), (0, 0, 2)), ((0, 2, 0), (0, 0, 2))), strict=True
    ):
        _plot_moments(axes, instances, models, across, up)
    _legend_beside(figure, panels[0])
    save_figure(figure, path)


def _plot_moments(
    axes: Axes,
    instances: Instances,
    models: Instances,
    across: tuple[int, int, int],
    up: tuple[int, int, int],
) -> None:
    points, exact = (
        np.array(
            [
                vectors[0, [found.indices.index(across), found.indices.index(up)]]
                for vectors in found.candidates
            ]
        )
        for found in (instances, models)
    )
    for number, label in enumerate(np.unique(instances.labels)):
        color, marker = CLASS_COLORS[number % len(CLASS_COLORS)], MARKERS[number % len(MARKERS)]
        of_class = points[instances.labels == label]
        axes.plot(
            *of_class.T,
            marker,
            color=color,
            ms=5,
            alpha=0.55,
            mew=0,
            label=str(label).replace("_", " ").replace("$", r"\$"),
        )
        axes.plot(*exact[models.labels == label].T, marker, color=color, ms=11, mfc="none", mew=1.6)
    axes.set_xlabel(_moment(across), color=INK)
    axes.set_ylabel(_moment(up), color=INK)
    _plain(axes)


def _moment(index: tuple[int, int, int]) -> str:
    return "$\\eta_{" + "".join(map(str, index)) + "}$"


def _plain(axes: Axes) -> None:
    axes.grid(color="#e4e7eb", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors=FAINT, labelcolor=INK, labelsize=9)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(FAINT)


def _legend_below(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="lower center",
        ncols=len(labels),
        frameon=False,
        fontsize=10,
        labelcolor=INK,
    )


def _legend_beside(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="center right",
        frameon=False,
        fontsize=10,
        labelcolor=INK,
        title="small: reconstructed\nlarge: as modelled",
    )
