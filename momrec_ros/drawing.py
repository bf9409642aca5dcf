"""What all pictures share: palette, blank figures, regions, shaded meshes, viewpoints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import shapely
import trimesh
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as PlotPath
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon

from momrec_ros.rendering import Rendering, Viewpoint, render

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = [
    "BLUE",
    "FAINT",
    "GREEN",
    "INK",
    "ORANGE",
    "SKY",
    "VERMILION",
    "blank_figure",
    "blank_grid",
    "canonical_viewpoint",
    "draw_sections",
    "evenly",
    "fill",
    "frame_image",
    "framing",
    "half_extent",
    "outline",
    "panel_axes",
    "save_figure",
    "show_mesh",
    "text_below",
    "turned_axes",
]

DPI = 120
DEEP = "#0B3C5D"  # the lowest slice
INK, FAINT = "#1f2933", "#7b8794"
# Okabe and Ito's palette, told apart by all kinds of colour vision.
ORANGE, SKY, GREEN, BLUE, VERMILION = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00"
SURFACE = (0.70, 0.80, 0.93)
AZIMUTH, ELEVATION = np.deg2rad(30.0), np.deg2rad(24.0)  # beside and above the straight view
FRAME_MARGIN = 1.06  # air around what is drawn


def turned_axes(up: NDArray[np.float64], backward: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return right, up, towards the viewer, for one who has walked aside and climbed."""
    right = np.cross(up, backward)
    level = np.cos(AZIMUTH) * backward + np.sin(AZIMUTH) * right
    towards = np.cos(ELEVATION) * level + np.sin(ELEVATION) * up
    rightwards = np.cross(up, level)
    return np.array([rightwards, np.cross(towards, rightwards), towards])


def framing(points: NDArray[np.float64], axes: NDArray[np.float64]) -> Viewpoint:
    """Return the viewpoint whose picture just holds the points."""
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    half_width = FRAME_MARGIN * float((high - low)[:2].max()) / 2
    return Viewpoint(axes, axes.T @ ((low + high) / 2), half_width)


def canonical_viewpoint(mesh: trimesh.Trimesh, axis_length: float) -> Viewpoint:
    """Look at a canonical mesh so that v1 is upright and all three axes are seen."""
    axes = turned_axes(np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0]))
    ends = [axis_length * end * np.eye(3) for end in mesh.bounds]
    return framing(np.vstack([mesh.vertices, *ends]), axes)


def blank_figure(width: float, height: float) -> Figure:
    """Return an empty white figure; width and height in inches."""
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a PNG whose bytes depend on the figure alone."""
    figure.savefig(path, format="png", dpi=DPI, metadata={"Software": None})


def blank_grid(figure: Figure, rows: int, columns: int, footer: float = 0.0) -> list[Axes]:
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


def panel_axes(panel: SubFigure) -> Axes:
    """Return blank axes from -1 to 1 that leave room for a caption."""
    axes = panel.add_axes((0.03, 0.11, 0.94, 0.78))
    axes.set_axis_off()
    axes.set(xlim=(-1, 1), ylim=(-1, 1), aspect="equal")
    return axes


def text_below(
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
        parse_math=False,
    )


def show_mesh(axes: Axes, mesh: trimesh.Trimesh, viewpoint: Viewpoint, pixels: int) -> Rendering:
    """Draw a shaded mesh over axes from -1 to 1; pixels: side of the picture."""
    rendering = render(mesh, viewpoint, SURFACE, pixels)
    axes.imshow(rendering.image, extent=(-1, 1, -1, 1), interpolation="antialiased")
    return rendering


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


def fill(
    axes: Axes,
    region: shapely.Geometry,
    color: str,
    *,
    alpha: float = 1.0,
    edge: str = "none",
    width: float = 0.0,
) -> None:
    """Fill a region of the plane, its holes left empty."""
    path = _region_path(region)
    if path is not None:
        axes.add_patch(PathPatch(path, facecolor=color, alpha=alpha, edgecolor=edge, lw=width))


def outline(axes: Axes, region: shapely.Geometry, width: float = 1.2) -> None:
    """Draw the rings of a region of the plane."""
    path = _region_path(region)
    if path is not None:
        axes.add_patch(PathPatch(path, facecolor="none", edgecolor=BLUE, lw=width))


def frame_image(axes: Axes, region: shapely.Geometry, half: float) -> None:
    """Show a square of an image about a region, its y axis downwards as in the image."""
    left, top, right, bottom = region.bounds
    x, y = (left + right) / 2, (top + bottom) / 2
    axes.set(xlim=(x - half, x + half), ylim=(y + half, y - half), aspect="equal")


def half_extent(regions: Sequence[MultiPolygon]) -> float:
    """Return half the side of a square that holds each of the regions, with some air."""
    bounds = np.array([region.bounds for region in regions])
    return 0.54 * float((bounds[:, 2:] - bounds[:, :2]).max())


def evenly(count: int, limit: int) -> list[int]:
    """Return at most `limit` indices spread over `count`."""
    if count == 0:
        return []
    return [int(index) for index in np.linspace(0, count - 1, min(count, limit)).round()]


def _blend(first: str, second: str, share: float) -> str:
    mixed = (1 - share) * np.array(to_rgb(first)) + share * np.array(to_rgb(second))
    red, green, blue = mixed
    return str(to_hex((red, green, blue)))


def draw_sections(
    axes: Axes,
    sections: Sequence[MultiPolygon],
    offsets: NDArray[np.float64],
    frame: NDArray[np.float64],
    viewpoint: Viewpoint,
) -> None:
    """Draw cross-sections from the farthest to the nearest: parallel ones never interleave.

    Parameters
    ----------
    axes : Axes
        That show -1 to 1 in both directions.
    sections : sequence of MultiPolygon
        In the x and y of the planes' frame, metres, by increasing offset.
    offsets : array, shape (n,)
        Of their planes along the z of the frame, metres.
    frame : array, shape (4, 4)
        Pose of the planes' frame in the world.
    viewpoint : Viewpoint
        From where they are seen.
    """
    upwards = float(frame[:3, 2] @ viewpoint.axes[2])
    shown = range(len(sections)) if upwards > 0 else range(len(sections))[::-1]
    for place, index in enumerate(shown):
        color = _blend(DEEP, SKY, place / max(1, len(sections) - 1))
        region = _seen_section(sections[index], float(offsets[index]), frame, viewpoint)
        fill(axes, region, color, edge="white", width=0.7)


def _seen_section(
    section: MultiPolygon, offset: float, frame: NDArray[np.float64], viewpoint: Viewpoint
) -> MultiPolygon:
    def seen(points: NDArray[np.float64]) -> NDArray[np.float64]:
        in_frame = np.column_stack([points, np.full(len(points), offset)])
        return viewpoint.project(in_frame @ frame[:3, :3].T + frame[:3, 3])[:, :2]

    lifted: MultiPolygon = shapely.transform(section, seen)
    return lifted
