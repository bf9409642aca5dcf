"""How times grow with the numbers of views, slices and vertices.

    python benchmarks/growth.py [--figure benchmarks/growth.png]

prints times and fitted exponents (over the larger half of each range), and draws them. Contours
are those of the blob of `works.py`; for the number of vertices they are drawn with more detail.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import shapely
from rich.console import Console
from rich.table import Table
from speed_figure import Growth, draw_growth
from timing import medians
from works import blob_work

from momrec_core import View, reconstruct

VIEWS = (2, 3, 5, 10, 20, 36, 60, 100)
SLICES = (16, 32, 64, 128, 256, 512)
VERTICES = (50, 100, 200, 500, 1000, 2000, 5000)
PARTS = ("slicing", "meshing")
RIPPLE = 1e-3  # of the silhouette's size: what noise of contours may be


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    many, ten = blob_work(max(VIEWS)).views, blob_work(10).views
    grown = partial(growth, rounds=options.rounds)
    growths = [
        grown("views", "64 slices", VIEWS, lambda count: (many[:count], 64)),
        grown("slices", "10 views", SLICES, lambda count: (ten, count)),
        grown(
            "vertices",
            "10 views, 64 slices",
            VERTICES,
            lambda count: ([with_vertices(view, count) for view in ten], 64),
        ),
    ]
    table = Table("number", "of", *PARTS, title="growth, milliseconds and exponents")
    for one in growths:
        for index, count in enumerate(one.counts):
            times = [f"{one.times[part][index]:.1f}" for part in PARTS]
            table.add_row(one.name, f"{count:g}", *times)
        exponents = [f"{one.exponent(part):.2f}" for part in PARTS]
        table.add_row(one.name, "exponent", *exponents, style="bold", end_section=True)
    Console().print(table)
    if options.figure:
        draw_growth(growths, options.figure)


def growth(
    name: str,
    fixed: str,
    counts: Sequence[int],
    work: Callable[[int], tuple[Sequence[View], int]],
    rounds: int,
) -> Growth:
    """Measure slicing and meshing for each count."""
    times = np.array([_times(*work(count), rounds) for count in counts])
    return Growth(
        name, fixed, np.array(counts, dtype=float), dict(zip(PARTS, times.T, strict=True))
    )


def _times(views: Sequence[View], slices: int, rounds: int) -> list[float]:
    hull = reconstruct(views, slices)
    return medians([lambda: reconstruct(views, slices), hull.mesh], rounds)


def with_vertices(view: View, count: int) -> View:
    """Return a view with about so many vertices, fewer by simplification, more on its edges."""
    region = view.silhouette
    have = shapely.get_num_coordinates(region)
    if count < have:
        low, high = 0.0, np.sqrt(region.area)
        for _ in range(20):
            middle = (low + high) / 2
            few = shapely.get_num_coordinates(shapely.simplify(region, middle)) < count
            low, high = (low, middle) if few else (middle, high)
        return View(view.camera, shapely.simplify(region, low))
    return View(view.camera, rippled(region, count))


def rippled(region: shapely.MultiPolygon, count: int) -> shapely.MultiPolygon:
    """Return a region with vertices at even distances, in and out by a fifth of that at most.

    Vertices on straight edges alone would cost nothing, as they are left out.
    """
    spacing = region.length / count
    depth = min(RIPPLE * np.sqrt(region.area), 0.2 * spacing)
    dense = shapely.segmentize(region, spacing)
    return shapely.transform(
        dense, lambda points: points + depth * np.sin(points[:, ::-1] / (0.1 * spacing))
    )


if __name__ == "__main__":
    main()
