"""A picture of the classes that a model may take for each other."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from momrec_ros.confusions import TELLING_SHARE
from momrec_ros.drawing import (
    BLUE,
    FAINT,
    INK,
    VERMILION,
    blank_figure,
    canonical_viewpoint,
    save_figure,
    show_mesh,
)

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import trimesh

    from momrec_ros.confusions import Confusions, Pair

__all__ = ["draw_confusions"]

PAIRS = 12  # that are drawn side by side, at most
ROW = 0.17  # inches of a class in the matrix, at least: its name is to be read
LEAST_MATRIX = 5.0  # inches
NUMBERED = 30  # classes: with more there is no room for numbers in the matrix
NAMES = 1.9  # inches for the longest names
TILE, TILE_PIXELS = 1.25, 150  # inches and pixels of a shape
LONGEST_NAME = 24  # letters
LEAST_PERCENT = 100 * TELLING_SHARE  # what is drawn in the matrix
TITLE = 0.75  # inches


def draw_confusions(
    found: Confusions, shapes: Mapping[str, trimesh.Trimesh], path: str | Path
) -> None:
    """Draw the classes against each other, and the pairs that are most alike side by side.

    Parameters
    ----------
    found : Confusions
        Of `confusions`.
    shapes : mapping
        Label to the canonical mesh of an instance.
    path : path
        The PNG to write.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    side = max(LEAST_MATRIX, ROW * len(found.labels))
    pairs = found.alike()[:PAIRS]
    rows = max(3, math.floor(side / (TILE + 0.45)))
    columns = max(1, math.ceil(len(pairs) / rows))
    width = NAMES + side + 0.4 + columns * (2 * TILE + 0.5)
    height = TITLE + side + NAMES
    figure = blank_figure(width, height)
    axes = figure.add_axes((NAMES / width, NAMES / height, side / width, side / height))
    _matrix(axes, found)
    _head(figure, 0.15 / width, 1 - 0.32 / height, "what held-back instances are taken for")
    left = NAMES + side + 0.4
    _head(figure, left / width, 1 - 0.32 / height, "most alike" if pairs else "none are alike")
    for number, pair in enumerate(pairs):
        across, down = divmod(number, rows)
        x = left + across * (2 * TILE + 0.5)
        y = height - TITLE - (down + 1) * (TILE + 0.45) + 0.1
        for place, label in enumerate((pair.one, pair.other)):
            corner = ((x + place * TILE) / width, y / height, TILE / width, TILE / height)
            tile = figure.add_axes(corner)
            tile.set_axis_off()
            show_mesh(tile, shapes[label], canonical_viewpoint(shapes[label], 1.0), TILE_PIXELS)
        _pair_text(figure, pair, x / width, (y - 0.02) / height)
    save_figure(figure, path)


def _head(figure: Figure, x: float, y: float, text: str) -> None:
    figure.text(x, y, text, size=13, color=INK, weight="bold", ha="left")


def _pair_text(figure: Figure, pair: Pair, x: float, y: float) -> None:
    names = f"{_short(pair.one)} | {_short(pair.other)}"
    color = VERMILION if pair.mistaken else FAINT
    said = f"{100 * pair.share:.1f} % of the score" + (
        f", {pair.mistaken} mistaken" if pair.mistaken else ""
    )
    figure.text(x, y, names, size=7.5, color=INK, ha="left", va="top")
    figure.text(x, y - 0.13 / figure.get_figheight(), said, size=7.5, color=color, va="top")


def _matrix(axes: Axes, found: Confusions) -> None:
    """Draw the shares: blue on the diagonal, red beside it, darker for more."""
    count = len(found.labels)
    percent = 100 * found.shares
    right = np.eye(count, dtype=bool)
    shown = np.sqrt(percent / 100)
    for cells, color in ((right, BLUE), (~right, VERMILION)):
        colors = LinearSegmentedColormap.from_list("share", ["white", color])
        values = np.ma.masked_where(~cells | (percent < LEAST_PERCENT), shown)
        axes.imshow(values, cmap=colors, vmin=0.0, vmax=1.0, interpolation="nearest")
    if count <= NUMBERED:
        for row, column in np.argwhere(percent >= LEAST_PERCENT).tolist():
            dark = shown[row, column] > 0.6
            text = f"{percent[row, column]:.0f}"
            color = "white" if dark else INK
            axes.text(column, row, text, size=7, ha="center", va="center", color=color)
    size = 9.0 if count <= NUMBERED else 7.0
    names = [_short(label) for label in found.labels]
    axes.set_xticks(range(count), names, rotation=90, size=size, color=INK)
    axes.set_yticks(range(count), names, size=size, color=INK)
    axes.set_xticks(np.arange(count + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(count + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="#e4e7eb", linewidth=0.4)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_color("#cbd2d9")
    axes.set_title(
        "share of the score, %: rows the class, columns what it is taken for",
        size=8.5,
        color=FAINT,
        loc="left",
    )


def _short(label: str) -> str:
    """Return a label that fits; its ends tell more than its middle."""
    text = "".join(c if c.isprintable() and c != "$" else "?" for c in label)
    if len(text) <= LONGEST_NAME:
        return text
    half = (LONGEST_NAME - 1) // 2
    return f"{text[:half]}…{text[-half:]}"
