"""Pictures of results: an object's way from contours to canonical shape, overviews, coverage."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, cast

import numpy as np
import shapely
import trimesh
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as PlotPath
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon

from momrec_core import Coverage, View
from momrec_ros.mask_coverage import visible_projection
from momrec_ros.rendering import Rendering, Viewpoint, render

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from momrec_core.hull import VisualHull
    from momrec_core.recognizer import ObjectResult
    from momrec_ros.cameras_json import MaskedView

__all__ = ["draw_coverage", "draw_object", "draw_overview"]

DPI = 120
MAX_CONTOURS = 12  # views in the first panel
MAX_SLICES = 40  # in the second panel: more would hide each other
MAX_COVERAGE_VIEWS = 60
MESH_PIXELS, TILE_PIXELS = 480, 300
DEEP = "#0B3C5D"  # the lowest slice

INK, FAINT = "#1f2933", "#7b8794"
# Okabe and Ito's palette, told apart by all kinds of colour vision.
ORANGE, SKY, GREEN, BLUE, VERMILION = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00"
SURFACE = (0.70, 0.80, 0.93)
AXES = (("v1", VERMILION, 2), ("v2", GREEN, 0), ("v3", BLUE, 1))  # name, colour, canonical axis
AXIS_LENGTH = 1.30  # of the mesh's extent along the axis
AXIS_SAMPLES = 400
AZIMUTH, ELEVATION = np.deg2rad(30.0), np.deg2rad(24.0)  # beside and above the straight view
FRAME_MARGIN = 1.06  # air around what is drawn
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
    figure = _figure(16.0, 5.0)
    _title(figure, result)
    panels = cast("NDArray[np.object_]", figure.subfigures(1, 4))
    _draw_contours(panels[0], result.hull.views)
    _draw_slices(panels[1], result)
    _draw_mesh(panels[2], result)
    _draw_canonical(panels[3], result)
    _save(figure, path)


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
    figure = _figure(2.6 * columns, 2.95 * rows)
    for axes, result in zip(_grid(figure, rows, columns), results, strict=False):
        _show_mesh(
            axes,
            result.canonical.mesh,
            _canonical_viewpoint(result.canonical.mesh, 1.0),
            TILE_PIXELS,
        )
        _text_below(axes, 0.06, _label(result), size=13, color=INK, weight="bold")
        _text_below(axes, 0.16, _verdict(result), size=10, color=FAINT)
    _save(figure, path)


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
    shown = _evenly(len(views), MAX_COVERAGE_VIEWS)
    columns = min(len(shown), max(3, math.ceil(math.sqrt(1.8 * len(shown)))))
    rows = math.ceil(len(shown) / columns)
    figure = _figure(1.9 * columns, 1.0 + 2.05 * rows)
    half = _half_extent([views[index].seen for index in shown])
    agreement = []
    for axes, index in zip(_grid(figure, rows, columns, footer=0.9), shown, strict=False):
        seen = views[index].seen
        projected = visible_projection(views[index], mesh)
        found = Coverage.of_regions(seen, projected)
        agreement.append(found)
        _fill(axes, shapely.intersection(seen, projected), SKY, alpha=0.45)
        _fill(axes, shapely.difference(seen, projected), VERMILION)
        _fill(axes, shapely.difference(projected, seen), ORANGE)
        _outline(axes, seen)
        _frame_image(axes, seen, half)
        _text_below(axes, 0.06, f"{index + 1}: {100 * found.covered:.1f} %", size=9, color=INK)
    _coverage_legend(figure, agreement)
    _save(figure, path)


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
    shown = _evenly(len(views), MAX_CONTOURS)
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
    half = _half_extent([views[index].silhouette for index in shown])
    for axes, index in zip(grid.flat, shown, strict=False):
        region = views[index].silhouette
        _fill(axes, region, SKY, alpha=0.30)
        _outline(axes, region)
        _frame_image(axes, region, half)
        axes.text(
            0.02, 0.98, str(index + 1), transform=axes.transAxes, fontsize=8, color=FAINT, va="top"
        )
    caption = "occluding contours"
    if len(shown) < len(views):
        caption += f" ({len(shown)} of {len(views)})"
    _caption(panel, caption)


def _draw_slices(panel: SubFigure, result: ObjectResult) -> None:
    """Draw cross-sections from the farthest to the nearest: parallel ones never interleave."""
    axes = _panel_axes(panel)
    hull, viewpoint = result.hull, _world_viewpoint(result)
    upwards = float(hull.plane_frame[:3, 2] @ viewpoint.axes[2])
    sections = hull.sections
    filled = [index for index, region in enumerate(sections) if not region.is_empty]
    shown = [filled[index] for index in _evenly(len(filled), MAX_SLICES)]
    for place, index in enumerate(shown if upwards > 0 else shown[::-1]):
        region = _seen_section(hull, index, sections[index], viewpoint)
        color = _blend(DEEP, SKY, place / max(1, len(shown) - 1))
        _fill(axes, region, color, edge="white", width=0.7)
    caption = f"{len(hull.offsets)} cross-sections of the visual hull"
    if len(shown) < len(filled):
        caption += f" ({len(shown)} shown)"
    _caption(panel, caption)


def _draw_mesh(panel: SubFigure, result: ObjectResult) -> None:
    _show_mesh(_panel_axes(panel), result.mesh, _world_viewpoint(result), MESH_PIXELS)
    _caption(panel, f"closed mesh, {len(result.mesh.faces):,} triangles")


def _draw_canonical(panel: SubFigure, result: ObjectResult) -> None:
    axes = _panel_axes(panel)
    mesh = result.canonical.mesh
    viewpoint = _canonical_viewpoint(mesh, AXIS_LENGTH)
    rendering = _show_mesh(axes, mesh, viewpoint, MESH_PIXELS)
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
    axes = _turned(up, backward / np.linalg.norm(backward))
    return _framing(np.asarray(result.mesh.vertices), axes)


def _canonical_viewpoint(mesh: trimesh.Trimesh, axis_length: float) -> Viewpoint:
    """Look at a canonical mesh so that v1 is upright and all three axes are seen."""
    axes = _turned(np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0]))
    ends = [axis_length * end * np.eye(3) for end in mesh.bounds]
    return _framing(np.vstack([mesh.vertices, *ends]), axes)


def _turned(up: NDArray[np.float64], backward: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return right, up, towards the viewer, for one who has walked aside and climbed."""
    right = np.cross(up, backward)
    level = np.cos(AZIMUTH) * backward + np.sin(AZIMUTH) * right
    towards = np.cos(ELEVATION) * level + np.sin(ELEVATION) * up
    rightwards = np.cross(up, level)
    return np.array([rightwards, np.cross(towards, rightwards), towards])


def _framing(points: NDArray[np.float64], axes: NDArray[np.float64]) -> Viewpoint:
    """Return the viewpoint whose picture just holds the points."""
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    half_width = FRAME_MARGIN * float((high - low)[:2].max()) / 2
    return Viewpoint(axes, axes.T @ ((low + high) / 2), half_width)


# --- parts ----------------------------------------------------------------------------------


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: str | Path) -> None:
    figure.savefig(path, format="png", dpi=DPI, metadata={"Software": None})


def _grid(figure: Figure, rows: int, columns: int, footer: float = 0.0) -> list[Axes]:
    """Return axes row by row, all of them blank; footer: inches to leave free below."""
    grid = figure.subplots(rows, columns, squeeze=False)
    below = footer / figure.get_figheight()
    figure.subplots_adjust(
        left=0.02, right=0.98, top=0.98, bottom=below + 0.20 / rows * (1 - below), hspace=0.28
    )
    cells = list(grid.flat)
    for axes in cells:
        axes.set_axis_off()
    return cells


def _panel_axes(panel: SubFigure) -> Axes:
    axes = panel.add_axes((0.03, 0.11, 0.94, 0.78))
    axes.set_axis_off()
    axes.set(xlim=(-1, 1), ylim=(-1, 1), aspect="equal")
    return axes


def _text_below(
    axes: Axes, distance: float, text: str, *, size: float, color: str, weight: str = "normal"
) -> None:
    """Write centred under axes; distance: in heights of the axes."""
    axes.text(
        0.5,
        -distance,
        text,
        transform=axes.transAxes,
        fontsize=size,
        fontweight=weight,
        color=color,
        ha="center",
        va="center",
    )


def _caption(panel: SubFigure, text: str) -> None:
    panel.text(0.5, 0.055, text, fontsize=11.5, color=INK, ha="center", va="center")


def _show_mesh(axes: Axes, mesh: trimesh.Trimesh, viewpoint: Viewpoint, pixels: int) -> Rendering:
    rendering = render(mesh, viewpoint, SURFACE, pixels)
    axes.imshow(rendering.image, extent=(-1, 1, -1, 1), interpolation="antialiased")
    return rendering


def _seen_section(
    hull: VisualHull, index: int, section: MultiPolygon, viewpoint: Viewpoint
) -> MultiPolygon:
    frame, offset = hull.plane_frame, hull.offsets[index]

    def seen(points: NDArray[np.float64]) -> NDArray[np.float64]:
        in_frame = np.column_stack([points, np.full(len(points), offset)])
        return viewpoint.project(in_frame @ frame[:3, :3].T + frame[:3, 3])[:, :2]

    lifted: MultiPolygon = shapely.transform(section, seen)
    return lifted


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


def _region_path(region: shapely.Geometry) -> PlotPath | None:
    """Return a region's rings as one path, of which matplotlib leaves the holes empty."""
    rings = [
        shapely.get_coordinates(ring)
        for part in shapely.get_parts(region)
        if isinstance(part, Polygon)
        for ring in shapely.get_rings(shapely.geometry.polygon.orient(part))
    ]
    paths = [PlotPath(ring, closed=True) for ring in rings]
    return PlotPath.make_compound_path(*paths) if paths else None


def _fill(
    axes: Axes,
    region: shapely.Geometry,
    color: str,
    *,
    alpha: float = 1.0,
    edge: str = "none",
    width: float = 0.0,
) -> None:
    path = _region_path(region)
    if path is not None:
        axes.add_patch(PathPatch(path, facecolor=color, alpha=alpha, edgecolor=edge, lw=width))


def _outline(axes: Axes, region: shapely.Geometry, width: float = 1.2) -> None:
    path = _region_path(region)
    if path is not None:
        axes.add_patch(PathPatch(path, facecolor="none", edgecolor=BLUE, lw=width))


def _frame_image(axes: Axes, region: shapely.Geometry, half: float) -> None:
    """Show a square of an image about a region, its y axis downwards as in the image."""
    left, top, right, bottom = region.bounds
    x, y = (left + right) / 2, (top + bottom) / 2
    axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half), aspect="equal")


def _half_extent(regions: Sequence[MultiPolygon]) -> float:
    """Return half the side of a square that holds each of the regions, with some air."""
    bounds = np.array([region.bounds for region in regions])
    return 0.54 * float((bounds[:, 2:] - bounds[:, :2]).max())


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


def _evenly(count: int, limit: int) -> list[int]:
    """Return at most `limit` indices spread over `count`."""
    if count == 0:
        return []
    return [int(index) for index in np.linspace(0, count - 1, min(count, limit)).round()]


def _blend(first: str, second: str, share: float) -> str:
    mixed = (1 - share) * np.array(to_rgb(first)) + share * np.array(to_rgb(second))
    red, green, blue = mixed
    return str(to_hex((red, green, blue)))


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
