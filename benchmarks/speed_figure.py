"""Pictures of the measurements of speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from timing import Contest

from momrec_ros.drawing import BLUE, FAINT, INK, ORANGE, blank_figure, save_figure

__all__ = ["Growth", "draw_growth", "draw_times"]

ROW = 0.36  # inches
TITLES = {
    "A": "A: 10 views, 64 slices",
    "B": "B: 36 views, 128 slices",
    "C": "C: ten polyhedra, 10 views",
}


def draw_times(contests: Mapping[str, Contest], path: Path) -> None:
    """Draw how long each way takes from contours to a solid, a panel for each work.

    Parameters
    ----------
    contests : mapping
        Work to the times of each way.
    path : Path
        The PNG to write.
    """
    counts = [len(contest.times) for contest in contests.values()]
    height = ROW * sum(counts) + 0.55 * len(counts) + 0.75
    figure = blank_figure(8.0, height)
    panels = figure.subplots(len(counts), 1, sharex=True, height_ratios=counts, squeeze=False)
    figure.subplots_adjust(left=0.3, right=0.96, top=1 - 0.4 / height, bottom=0.6 / height)
    figure.subplots_adjust(hspace=0.55)
    longest = max(max(contest.times.values()) for contest in contests.values())
    for axes, (name, contest) in zip(panels[:, 0], contests.items(), strict=True):
        ways = sorted(contest.times, key=lambda way: -contest.times[way])
        colors = [FAINT if way in contest.ratios else BLUE for way in ways]
        bars = axes.barh(ways, [contest.times[way] for way in ways], color=colors)
        labels = [
            f"{contest.times[way]:.0f} ms"
            + (f"   {contest.ratios[way]:.2g} x" if way in contest.ratios else "")
            for way in ways
        ]
        axes.bar_label(bars, labels, padding=4, color=INK, fontsize=10)
        axes.set_title(TITLES[name], loc="left", fontsize=11, color=INK)
        axes.set_xscale("log")
        axes.set_xlim(10, 6 * longest)
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1, 0].set_xlabel("milliseconds from silhouettes to a solid, median")
    save_figure(figure, path)


@dataclass(frozen=True, eq=False)
class Growth:
    """How a time grows with one number, the others fixed.

    Attributes
    ----------
    name : str
        What the number counts.
    fixed : str
        The others.
    counts : array, shape (n,)
        The numbers, increasing.
    times : mapping
        Of each part, array of shape (n,), milliseconds.
    """

    name: str
    fixed: str
    counts: NDArray[np.float64]
    times: Mapping[str, NDArray[np.float64]]

    def exponent(self, part: str) -> float:
        """Return the slope of the logarithms over the larger half of the counts."""
        half = len(self.counts) // 2
        x, y = np.log(self.counts[half:]), np.log(self.times[part][half:])
        return float(np.polyfit(x, y, 1)[0])


def draw_growth(growths: Sequence[Growth], path: Path) -> None:
    """Draw times over numbers with the fitted exponents, a panel for each number."""
    figure = blank_figure(4.2 * len(growths), 4.2)
    panels = figure.subplots(1, len(growths), sharey=True, squeeze=False)[0]
    figure.subplots_adjust(left=0.07, right=0.985, top=0.9, bottom=0.14, wspace=0.08)
    for axes, growth in zip(panels, growths, strict=True):
        for (part, times), color, marker in zip(
            growth.times.items(), (BLUE, ORANGE, INK), "osD", strict=False
        ):
            label = f"{part}: exponent {growth.exponent(part):.2f}"
            axes.loglog(growth.counts, times, marker=marker, color=color, label=label)
        axes.set_title(f"{growth.name} ({growth.fixed})", fontsize=11, color=INK)
        axes.set_xlabel(growth.name)
        axes.set_xticks(growth.counts, [f"{count:g}" for count in growth.counts])
        axes.minorticks_off()
        axes.legend(frameon=False, fontsize=10)
        axes.grid(color=FAINT, alpha=0.4)
    panels[0].set_ylabel("milliseconds, median")
    save_figure(figure, path)
