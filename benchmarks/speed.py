"""How fast momrec is, beside its peers in the same run.

    make bench
    python benchmarks/speed.py [--rounds 3] [--output benchmarks] [--only hull,parts]

prints a table with the figures and their bounds, and writes it with a picture into a folder.
Ratios to peers are the bound; milliseconds are budgets for a quiet machine of two cores. The node
is measured where `make colcon` has installed it, and replayed is a bag of a gigabyte.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import shapely
import trimesh
from moments import fresh, torus
from node_delay import node_delays
from peers import (
    Made,
    Solid,
    by_manifold,
    by_open3d,
    by_rejected_voxels,
    by_voxels,
    measured,
)
from replayed import replay_costs
from rich.console import Console
from rich.table import Table
from speed_figure import draw_times
from timing import Contest, contested, medians
from works import MaskedWork, blob_work, fine_mesh, polyhedra_works

from momrec_core import (
    Camera,
    View,
    VisualHull,
    load_model,
    normalize,
    reconstruct,
    surface_moments,
)
from momrec_core.layers import layers_of_sections, match_layers
from momrec_core.regions import Regions
from momrec_core.silhouette import silhouettes_of_mesh
from momrec_core.simulation import look_at, random_directions
from momrec_core.tiling import tile
from momrec_core.view import polygon_rings
from momrec_ros.shared_data import shared_path

SECTIONS = ("hull", "parts", "node", "replay", "start")
PERCENT = 100.0
OURS, EXACT, VOXELS, CARVED = "momrec", "manifold3d", "numpy voxels", "Open3D"
REJECTED = "numpy voxels, rejected early"
FASTER = {"A": {CARVED: 40.0, REJECTED: 12.0, EXACT: 20.0}, "B": {EXACT: 20.0}}
VOLUME_BOUND, AREA_BOUND = 0.2, 0.5  # percent
MEMORY_BOUND = 20.0  # MB: what two runs of one bag differ by, at the most
UNITS = 1000.0  # as the library counts lengths: thousandths of the object


@dataclass(frozen=True)
class Row:
    """A figure, as it is told.

    Attributes
    ----------
    figure, measured, bound : str
        What, how much, and how much it may be; an empty bound for orientation only.
    is_met : bool
        Whether the bound holds.
    """

    figure: str
    measured: str
    bound: str = ""
    is_met: bool = True


def budget(figure: str, measured: float, bound: float, unit: str = "ms") -> Row:
    """Return the row of a figure that may be at most its bound."""
    return Row(figure, f"{measured:.3g} {unit}", f"{bound:g} {unit}", measured <= bound)


# --- contours to a closed mesh --------------------------------------------------------------


def hull_rows(rounds: int, contests: dict[str, Contest]) -> Iterator[Row]:
    """Compare contours to closed mesh with the peers; `contests` takes the times, for a picture."""
    for name, work, slices in (("A", blob_work(10), 64), ("B", blob_work(36), 128)):
        ours = partial(_made, work.views, slices)
        peers = _peers(work, carves=name == "A")
        solids = {way: measured(do()) for way, do in {OURS: ours, **peers}.items()}
        contests[name] = contested(OURS, ours, peers, rounds)
        described = f"{len(work.views)} views, {slices} slices, {work.vertices:.0f} vertices"
        yield from _compared(name, described, contests[name], solids)
    works = polyhedra_works(10)
    exact = {EXACT: lambda: [by_manifold(w) for w in works]}
    contests["C"] = contested(OURS, lambda: [_made(w, 64) for w in works], exact, rounds)
    yield from _compared("C", "ten polyhedra, 10 views, 64 slices", contests["C"], {})


def _peers(work: MaskedWork, *, carves: bool) -> dict[str, Callable[[], Made]]:
    peers: dict[str, Callable[[], Made]] = {EXACT: lambda: by_manifold(work.views)}
    if carves:
        peers[VOXELS] = lambda: by_voxels(work)
        peers[REJECTED] = lambda: by_rejected_voxels(work)
        peers[CARVED] = lambda: by_open3d(work)
    return peers


def _made(views: Sequence[View], slices: int) -> trimesh.Trimesh:
    return reconstruct(views, slices).mesh()


def _compared(
    name: str, described: str, contest: Contest, solids: Mapping[str, Solid]
) -> Iterator[Row]:
    yield Row(f"{name}: contours to mesh ({described})", f"{contest.times[OURS]:.1f} ms")
    for peer, ratio in contest.ratios.items():
        bound = FASTER.get(name, {}).get(peer, 0.0)
        yield Row(
            f"{name}: faster than {peer} ({contest.times[peer]:.0f} ms)",
            f"{ratio:.1f} x",
            f"{bound:g} x" if bound else "",
            ratio >= bound,
        )
    for way, solid in solids.items():
        if way == EXACT:
            continue
        volume, area = (
            PERCENT * abs(ours / exact - 1)
            for ours, exact in (
                (solid.volume, solids[EXACT].volume),
                (solid.area, solids[EXACT].area),
            )
        )
        is_ours = way == OURS
        yield Row(
            f"{name}: error of {way}, volume and area",
            f"{volume:.3f} %, {area:.3f} %",
            f"{VOLUME_BOUND} %, {AREA_BOUND} %" if is_ours else "",
            not is_ours or (volume <= VOLUME_BOUND and area <= AREA_BOUND),
        )


# --- the parts ------------------------------------------------------------------------------


def part_rows(rounds: int) -> Iterator[Row]:
    """Measure one more view, tiling, moments, recognition, and simulated silhouettes."""
    work = blob_work(10)
    yield budget("one more view, 64 slices, median (A)", _added(work.views, 64, rounds), 3.0)
    yield from _tiled(work.views, rounds)
    large, small, fine = torus(sections=200), torus(sections=78), fine_mesh()
    model = load_model(shared_path("models/ten_objects.json"))
    cameras = _cameras(fine, 10)
    moments, integrals, recognised, seen = medians(
        [
            lambda: surface_moments(fresh(large)),
            lambda: fresh(large).mass_properties,
            lambda: model.recognize(normalize(fresh(small))),
            lambda: list(silhouettes_of_mesh(fine, cameras)),
        ],
        5 * rounds,
    )
    yield Row(
        f"56 moments, {len(large.faces):,} triangles: share of trimesh's time for 10 integrals",
        f"{moments / integrals:.2f} ({moments:.1f} of {integrals:.1f} ms)",
        "1",
        moments <= integrals,
    )
    yield budget(f"normalise and recognise, {len(small.faces):,} triangles", recognised, 15.0)
    figure = f"silhouette of {len(fine.faces):,} triangles, a view"
    yield budget(figure, seen / len(cameras), 60.0)


def _added(views: Sequence[View], slices: int, rounds: int) -> float:
    """Return the median time of `add` for the views after the second."""
    hull = reconstruct(views[:2], slices)
    steps: list[VisualHull] = []
    for view in views[2:]:
        steps.append(copy(hull))
        hull.add(view)
    works = [partial(_add, *pair) for pair in zip(steps, views[2:], strict=True)]
    return float(np.median(medians(works, 3 * rounds)))


def _add(hull: VisualHull, view: View) -> None:
    copy(hull).add(view)


def _tiled(views: Sequence[View], rounds: int) -> Iterator[Row]:
    """Join the sections of a hull, none between them, as the surface's first step does."""
    hull = reconstruct(views, 64)
    scale = UNITS / float(np.ptp(hull.offsets))
    sections = [
        [scale * ring for ring in polygon_rings(shapely.orient_polygons(section))]
        for section in hull.sections
    ]
    ends = np.array([1.5, -0.5]) @ hull.offsets[:2], np.array([-0.5, 1.5]) @ hull.offsets[-2:]
    offsets = scale * np.array([ends[0], *hull.offsets, ends[1]])
    layers = layers_of_sections(offsets, Regions.of_rings([[], *sections, []]))
    count = len(layers.pieces.rings.points) / np.count_nonzero(layers.counts)
    (time,) = medians([lambda: tile(match_layers(layers, layers.adjacent))], 3 * rounds)
    yield budget(f"tiling, 64 slices of {count:.0f} vertices", time, 20.0)


def _cameras(mesh: trimesh.Trimesh, count: int) -> list[Camera]:
    rng = np.random.default_rng(3)
    return [
        Camera.orthographic(look_at(mesh.centroid, direction, 3.0, rng.uniform(0, 6)))
        for direction in random_directions(count, rng)
    ]


# --- processes ------------------------------------------------------------------------------


def start_rows(rounds: int) -> Iterator[Row]:
    """Measure how long importing the library and asking for help take."""
    momrec = Path(sys.executable).with_name("momrec")
    bare, every, told = (
        time / 1e3
        for time in medians(
            [
                partial(subprocess.run, command, check=True, capture_output=True)
                for command in (
                    [sys.executable, "-c", "import momrec_core"],
                    [sys.executable, "-c", "from momrec_core import *"],
                    [momrec, "--help"],
                )
            ],
            rounds,
        )
    )
    yield budget("import of momrec_core", bare, 0.5, "s")
    yield Row("  all its names, with trimesh and scikit-learn", f"{every:.2f} s")
    yield budget("start of momrec --help", told, 0.4, "s")


def node_rows() -> Iterator[Row]:
    """Measure the installed node in a graph: from the last view of an object to its results."""
    delays, messages = node_delays(blob_work(10))
    yield budget("node: last view to all results, A, median", float(np.median(delays)), 80.0)
    yield budget("  of which messages, decoded and encoded", float(np.median(messages)), 15.0)


def replay_rows() -> Iterator[Row]:
    """Replay bags of contours and of masks, one of them of a gigabyte."""
    contours, few, many = replay_costs(blob_work(10))
    yield budget("replay, a view of A, decoding and results included", contours.per_view, 8.0)
    yield Row("  the same from masks, traced", f"{few.per_view:.1f} ms")
    growth = many.memory - few.memory
    yield Row(
        f"replay of {many.size / 1e9:.2f} GB: memory beyond that for {few.size / 1e6:.0f} MB",
        f"{growth:+.0f} MB",
        f"{MEMORY_BOUND:g} MB",
        growth <= MEMORY_BOUND,
    )
    yield Row("  the same bag, a view", f"{many.per_view:.1f} ms")


# --- the report -----------------------------------------------------------------------------


def main() -> int:
    """Measure and print; the exit code tells whether all bounds are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="of which the medians are told")
    parser.add_argument("--output", type=Path, help="folder for speed.md and speed.png")
    parser.add_argument("--only", default=",".join(SECTIONS), help="of " + ", ".join(SECTIONS))
    options = parser.parse_args()
    contests: dict[str, Contest] = {}
    sections: dict[str, Callable[[], Iterator[Row]]] = {
        "hull": lambda: hull_rows(options.rounds, contests),
        "parts": lambda: part_rows(options.rounds),
        "node": node_rows,
        "replay": replay_rows,
        "start": lambda: start_rows(options.rounds),
    }
    rows = []
    for name in options.only.split(","):
        for row in sections[name]():
            print(f"{row.figure}: {row.measured}", file=sys.stderr)
            rows.append(row)
    Console().print(_table(rows))
    if options.output:
        (options.output / "speed.md").write_text(_markdown(rows), encoding="utf-8")
        if contests:
            draw_times(contests, options.output / "speed.png")
    return 0 if all(row.is_met for row in rows) else 1


def _table(rows: Sequence[Row]) -> Table:
    table = Table("figure", "measured", "bound", title="speed")
    for row in rows:
        style = "" if not row.bound else "green" if row.is_met else "red"
        table.add_row(row.figure, row.measured, row.bound, style=style)
    return table


def _markdown(rows: Sequence[Row]) -> str:
    lines = ["| figure | measured | bound |", "|---|---|---|"]
    lines += [f"| {row.figure.strip()} | {row.measured} | {row.bound} |" for row in rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
