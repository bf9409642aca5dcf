"""Pictures of results: an object's way from contours to canonical shape, overviews, coverage."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, cast

import numpy as np
import shapely
import trimesh
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from momrec_core import Coverage, View
from momrec_ros.drawing import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    SKY,
    VERMILION,
    blank_figure,
    blank_grid,
    canonical_viewpoint,
    draw_sections,
    evenly,
    fill,
    frame_image,
    framing,
    half_extent,
    outline,
    panel_axes,
    save_figure,
    show_mesh,
    text_below,
    turned_axes,
)
from momrec_ros.mask_coverage import visible_projection
from momrec_ros.rendering import Viewpoint

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from momrec_core.recognizer import ObjectResult
    from momrec_ros.cameras_json import MaskedView

__all__ = ["draw_coverage", "draw_object", "draw_overview"]

MAX_CONTOURS = 12  # views in the first panel
MAX_SLICES = 40  # in the second panel: more would hide each other
MAX_COVERAGE_VIEWS = 60
MESH_PIXELS, TILE_PIXELS = 480, 300

AXES = (("v1", VERMILION, 2), ("v2", GREEN, 0), ("v3", BLUE, 1))  # name, colour, canonical axis
AXIS_LENGTH = 1.30  # of the mesh's extent along the axis
AXIS_SAMPLES = 400
MIN_SIDEWAYS = 0.1  # a camera that looks along the planes' normal gives no direction in them
LEGIBLE = 0.3  # of the picture: an axis that points at the viewer carries its name close by
DEPTH_BIAS = 1e-3  # of the picture: an axis that lies in the surface counts as seen


def draw_object(result: ObjectResult, path: str | Path) -> None:
    """Draw how an object came about: contours, slices, mesh, canonical mesh with its axes.

    Parameters
    ----------
    result : ObjectResult
        One object of a `Recognizer`.
    path : path
        The PNG to write.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    figure = blank_figure(16.0, 5.0)
    _title(figure, result)
    panels = cast("NDArray[np.object_]", figure.subfigures(1, 4))
    _draw_contours(panels[0], result.hull.views)
    _draw_slices(panels[1], result)
    _draw_mesh(panels[2], result)
    _draw_canonical(panels[3], result)
    save_figure(figure, path)


def draw_overview(results: Sequence[ObjectResult], path: str | Path) -> None:
    """Draw the canonical meshes of several objects with their labels, in one grid.

    Parameters
    ----------
    results : sequence of ObjectResult
        At least one, drawn in this order.
    path : path
        The PNG to write.

    Raises
    ------
    ValueError
        If there is no result.
    OSError
        If the file cannot be written.
    """
    if not results:
        raise ValueError("Expected at least one result, got none")
    columns = min(len(results), max(3, math.ceil(math.sqrt(2 * len(results)))))
    rows = math.ceil(len(results) / columns)
    figure = blank_figure(2.6 * columns, 2.95 * rows)
    for axes, result in zip(blank_grid(figure, rows, columns), results, strict=False):
        show_mesh(
            axes,
            result.canonical.mesh,
            canonical_viewpoint(result.canonical.mesh, 1.0),
            TILE_PIXELS,
        )
        text_below(axes, 0.06, _label(result), size=13, color=INK, weight="bold")
        text_below(axes, 0.16, _verdict(result), size=10, color=FAINT)
    save_figure(figure, path)


def draw_coverage(views: Sequence[MaskedView], mesh: trimesh.Trimesh, path: str | Path) -> None:
    """Draw the masks' regions against the mesh's projections, with the covered shares.

    Parameters
    ----------
    views : sequence of MaskedView
        At least one; evenly spaced ones are drawn if there are more than 60.
    mesh : Trimesh
        World, metres; before every pinhole.
    path : path
        The PNG to write.

    Raises
    ------
    ValueError
        If there is no view.
    MomrecError
        As for `silhouette_of_mesh`.
    OSError
        If the file cannot be written.
    """
    if not views:
        raise ValueError("Expected at least one view, got none")
    shown = evenly(len(views), MAX_COVERAGE_VIEWS)
    columns = min(len(shown), max(3, math.ceil(math.sqrt(1.8 * len(shown)))))
    rows = math.ceil(len(shown) / columns)
    figure = blank_figure(1.9 * columns, 1.0 + 2.05 * rows)
    half = half_extent([views[index].seen for index in shown])
    agreement = []
    for axes, index in zip(blank_grid(figure, rows, columns, footer=0.9), shown, strict=False):
        seen = views[index].seen
        projected = visible_projection(views[index], mesh)
        found = Coverage.of_regions(seen, projected)
        agreement.append(found)
        fill(axes, shapely.intersection(seen, projected), SKY, alpha=0.45)
        fill(axes, shapely.difference(seen, projected), VERMILION)
        fill(axes, shapely.difference(projected, seen), ORANGE)
        outline(axes, seen)
        frame_image(axes, seen, half)
        text_below(axes, 0.06, f"{index + 1}: {100 * found.covered:.1f} %", size=9, color=INK)
    _coverage_legend(figure, agreement)
    save_figure(figure, path)


# --- panels ---------------------------------------------------------------------------------


def _title(figure: Figure, result: ObjectResult) -> None:
    name = _label(result)
    if result.object_id and result.object_id != name:
        name = f"{result.object_id}: {name}" if result.recognition else result.object_id
    facts = [
        _verdict(result),
        f"{result.views} views",
        f"{result.slices} slices",
        f"area {_quantity(result.area, 2)}",
        f"volume {_quantity(result.volume, 3)}",
    ]
    figure.text(0.012, 0.945, name, fontsize=19, fontweight="bold", color=INK, va="center")
    text = "   \N{MIDDLE DOT}   ".join(fact for fact in facts if fact)
    figure.text(0.985, 0.945, text, fontsize=13, color=INK, va="center", ha="right")


def _draw_contours(panel: SubFigure, views: Sequence[View]) -> None:
    shown = evenly(len(views), MAX_CONTOURS)
    columns = math.ceil(math.sqrt(len(shown)))
    rows = math.ceil(len(shown) / columns)
    grid = panel.subplots(
        rows,
        columns,
        squeeze=False,
        gridspec_kw={
            "left": 0.04,
            "right": 0.96,
            "bottom": 0.13,
            "top": 0.90,
            "wspace": 0.05,
            "hspace": 0.05,
        },
    )
    for axes in grid.flat:
        axes.set_axis_off()
    half = half_extent([views[index].silhouette for index in shown])
    for axes, index in zip(grid.flat, shown, strict=False):
        region = views[index].silhouette
        fill(axes, region, SKY, alpha=0.30)
        outline(axes, region)
        frame_image(axes, region, half)
        axes.text(
            0.02, 0.98, str(index + 1), transform=axes.transAxes, fontsize=8, color=FAINT, va="top"
        )
    caption = "occluding contours"
    if len(shown) < len(views):
        caption += f" ({len(shown)} of {len(views)})"
    _caption(panel, caption)


def _draw_slices(panel: SubFigure, result: ObjectResult) -> None:
    axes = panel_axes(panel)
    hull, viewpoint = result.hull, _world_viewpoint(result)
    sections = hull.sections
    filled = [index for index, region in enumerate(sections) if not region.is_empty]
    shown = [filled[index] for index in evenly(len(filled), MAX_SLICES)]
    draw_sections(
        axes,
        [sections[index] for index in shown],
        hull.offsets[shown],
        hull.plane_frame,
        viewpoint,
    )
    caption = f"{len(hull.offsets)} cross-sections of the visual hull"
    if len(shown) < len(filled):
        caption += f" ({len(shown)} shown)"
    _caption(panel, caption)


def _draw_mesh(panel: SubFigure, result: ObjectResult) -> None:
    show_mesh(panel_axes(panel), result.mesh, _world_viewpoint(result), MESH_PIXELS)
    _caption(panel, f"closed mesh, {len(result.mesh.faces):,} triangles")


def _draw_canonical(panel: SubFigure, result: ObjectResult) -> None:
    axes = panel_axes(panel)
    mesh = result.canonical.mesh
    viewpoint = canonical_viewpoint(mesh, AXIS_LENGTH)
    rendering = show_mesh(axes, mesh, viewpoint, MESH_PIXELS)
    for name, color, axis in AXES:
        low, high = AXIS_LENGTH * mesh.bounds[:, axis]
        along = np.zeros((AXIS_SAMPLES, 3))
        along[:, axis] = np.linspace(low, high, AXIS_SAMPLES)
        seen = viewpoint.project(along)
        hidden = rendering.hides(seen + DEPTH_BIAS * np.eye(3)[2])
        _draw_axis(axes, seen, hidden, color)
        _name_axis(axes, seen, name, color)
    axes.set(xlim=(-1.08, 1.08), ylim=(-1.08, 1.08))
    kind = "unique frame" if result.canonical.is_unique else "frame not unique"
    _caption(panel, f"canonical mesh, area {mesh.area:.0f}, {kind}")


# --- viewpoints -----------------------------------------------------------------------------


def _world_viewpoint(result: ObjectResult) -> Viewpoint:
    """Look at the object from beside and above its first camera, the planes' normal upright."""
    camera = result.hull.views[0].camera
    normal = result.hull.plane_frame[:3, 2]
    up = normal if normal @ camera.rotation[:, 1] <= 0 else -normal
    backward = -camera.rotation[:, 2]
    backward = backward - (backward @ up) * up
    if np.linalg.norm(backward) < MIN_SIDEWAYS:
        backward = result.hull.plane_frame[:3, 0]
    axes = turned_axes(up, backward / np.linalg.norm(backward))
    return framing(np.asarray(result.mesh.vertices), axes)


# --- parts ----------------------------------------------------------------------------------


def _caption(panel: SubFigure, text: str) -> None:
    panel.text(0.5, 0.055, text, fontsize=11.5, color=INK, ha="center", va="center")


def _draw_axis(
    axes: Axes, seen: NDArray[np.float64], hidden: NDArray[np.bool_], color: str
) -> None:
    """Draw an axis line, dashed where it is inside of or behind the mesh, with its arrow head."""
    axes.plot(*seen[:, :2].T, color=color, lw=1.2, alpha=0.6, dashes=(2, 2))
    in_front = np.where(hidden[:, None], np.nan, seen[:, :2])
    axes.plot(*in_front.T, color=color, lw=2.4, solid_capstyle="butt")
    axes.annotate(
        "",
        xy=tuple(seen[-1, :2]),
        xytext=tuple(seen[-AXIS_SAMPLES // 20, :2]),
        arrowprops={"arrowstyle": "-|>", "color": color, "lw": 2.4, "mutation_scale": 16},
    )


def _name_axis(axes: Axes, seen: NDArray[np.float64], name: str, color: str) -> None:
    direction = seen[-1, :2] - seen[0, :2]
    place = seen[-1, :2] + 0.09 * direction / max(float(np.linalg.norm(direction)), LEGIBLE)
    x, y = place
    axes.text(x, y, name, color=color, fontsize=13, fontweight="bold", ha="center", va="center")


def _coverage_legend(figure: Figure, agreement: Sequence[Coverage]) -> None:
    covered = [found.covered for found in agreement]
    summary = (
        f"covered again: mean {100 * np.mean(covered):.1f} %, worst {100 * min(covered):.1f} %   "
        f"\N{MIDDLE DOT}   intersection over union: mean "
        f"{100 * np.mean([found.iou for found in agreement]):.1f} %"
    )
    height = 0.30 / figure.get_figheight()
    figure.text(0.5, 2.0 * height, summary, fontsize=12, color=INK, ha="center", va="center")
    entries = [
        Patch(facecolor=SKY, alpha=0.45, label="silhouette, covered"),
        Patch(facecolor=VERMILION, label="silhouette, not covered"),
        Patch(facecolor=ORANGE, label="mesh beyond the silhouette"),
    ]
    figure.legend(
        handles=entries,
        loc="center",
        bbox_to_anchor=(0.5, 0.9 * height),
        ncols=3,
        frameon=False,
        fontsize=10,
        labelcolor=INK,
    )


def _label(result: ObjectResult) -> str:
    if result.recognition is None:
        return result.object_id or "object"
    return result.recognition.label


def _verdict(result: ObjectResult) -> str:
    return "" if result.recognition is None else f"score {result.recognition.score:.2f}"


def _quantity(value: float, power: int) -> str:
    """Write an area or a volume in the unit of length that keeps its digits readable."""
    lengths = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
    unit = next((unit for unit, length in lengths.items() if value >= 0.01 * length**power), "mm")
    rounded = float(f"{value / lengths[unit] ** power:.3g}")
    return f"{rounded:,g} {unit}$^{power}$"
