"""The paper's figures 5, 6, 9, 10 and 11, with our objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import shapely
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import SubFigure
from numpy.typing import NDArray
from shapely import MultiPolygon

from momrec_core.errors import NoCommonLineError
from momrec_core.hull import reconstruct
from momrec_core.slicing import Intersection, PlaneFamily, common_line, viewing_region
from momrec_ros.drawing import (
    BLUE,
    FAINT,
    INK,
    SKY,
    VERMILION,
    blank_figure,
    blank_grid,
    canonical_viewpoint,
    draw_sections,
    fill,
    frame_image,
    framing,
    half_extent,
    outline,
    save_figure,
    show_mesh,
    text_below,
    turned_axes,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from momrec_core.view import View
    from momrec_ros.rendering import Viewpoint

__all__ = ["draw_canonical_meshes", "draw_objects", "draw_orders", "draw_refinement"]

SLICES = 28  # in figures 5 and 6: enough to see the object, few enough to see each slice
MESH_PIXELS, TILE_PIXELS = 420, 300
COLUMNS = 5  # objects in a row
EDGE_SAMPLES = 16  # points along an edge at which it is asked whether it is hidden
EDGE_BIAS = 1.5e-2  # of the picture: an edge lies in the surface that might hide it
EDGE_COLOR = "#33475b"
UPRIGHT, TOWARDS = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])


# --- figure 5 -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Stage:
    """Cross-sections after some views, in the planes' frame, metres."""

    views: tuple[View, ...]
    sections: tuple[MultiPolygon, ...]


def draw_refinement(mesh: trimesh.Trimesh, views: Sequence[View], path: str | Path) -> None:
    """Draw how views refine a reconstruction: figure 5 of the paper, with figure 4's slice.

    Parameters
    ----------
    mesh : Trimesh
        The object, world, metres.
    views : sequence of View
        Parallel projections of it, at least two; the first two from different directions.
    path : path
        The PNG to write.

    Raises
    ------
    NoCommonLineError
        If the first two views are from the same or the opposite side.
    OSError
        If the file cannot be written.
    """
    family = _planes(views)
    stages = _stages(views, family)
    plane = int(np.argmax([len(section.geoms) for section in stages[0].sections]))
    offsets = family.offsets * family.unit
    viewpoint = _viewpoint_of_stage(stages[0], offsets, family.frame, views[0])
    half = half_extent([view.silhouette for view in views])
    figure = blank_figure(2.6 * (len(stages) + 1), 8.6)
    cells = cast("NDArray[np.object_]", figure.subfigures(3, len(stages) + 1))
    _explain(cells[0, 0], "contours", "the first two with\nscan lines, then\none more at a time")
    show_mesh(_square(cells[1, 0]), mesh, viewpoint, MESH_PIXELS)
    _say(cells[1, 0], "(a) the object")
    _explain(
        cells[2, 0], "one slice", "parallelograms of two views,\nclipped; red: the object's own"
    )
    for column, stage in enumerate(stages, start=1):
        new = stage.views if column == 1 else stage.views[-1:]
        _draw_new_contours(cells[0, column], new, family if column == 1 else None, half)
        draw_sections(_square(cells[1, column]), stage.sections, offsets, family.frame, viewpoint)
        _say(
            cells[1, column],
            f"({'abcdefghijklmnopqrstuvwxyz'[column % 26]}) {len(stage.views)} views",
        )
        axes = _square(cells[2, column])
        _draw_slice(axes, stages[0].sections[plane], stage.sections[plane])
        _draw_own_section(axes, mesh, family, plane)
        _say(cells[2, column], _pieces(stage.sections[plane]))
    save_figure(figure, path)


def _planes(views: Sequence[View]) -> PlaneFamily:
    first, second = views[:2]
    normal = common_line(first, second)
    if normal is None:
        raise NoCommonLineError(
            "Expected two views with different viewing directions first, got the same side twice"
        )
    return viewing_region(first, second, normal, SLICES)


def _stages(views: Sequence[View], family: PlaneFamily) -> list[_Stage]:
    """Return the reconstruction after two views, after three, and so on."""
    stages = []
    for count in range(2, len(views) + 1):
        sections = Intersection(views[:count], (0, 1), family).cut(family.offsets)
        regions = sections.polygons(family.unit)
        stages.append(_Stage(tuple(views[:count]), tuple(regions)))
    return stages


def _viewpoint_of_stage(
    stage: _Stage, offsets: NDArray[np.float64], frame: NDArray[np.float64], first: View
) -> Viewpoint:
    """Look at the cross-sections from beside and above, the planes' normal upright."""
    corners = [shapely.get_coordinates(section) for section in stage.sections]
    heights = np.repeat(offsets, [len(points) for points in corners])
    points = np.column_stack([np.concatenate(corners), heights]) @ frame[:3, :3].T + frame[:3, 3]
    up = frame[:3, 2] * (-1.0 if frame[:3, 2] @ first.camera.rotation[:, 1] > 0 else 1.0)
    return framing(points, turned_axes(up, -first.camera.rotation[:, 2]))


def _draw_new_contours(
    cell: SubFigure, views: Sequence[View], family: PlaneFamily | None, half: float
) -> None:
    """Draw contours one below the other, with the scan lines of a plane family if given."""
    grid = cell.subplots(len(views), 1, squeeze=False)
    cell.subplots_adjust(left=0.04, right=0.96, bottom=0.04, top=0.96, hspace=0.06)
    for axes, view in zip(grid.flat, views, strict=True):
        axes.set_axis_off()
        fill(axes, view.silhouette, SKY, alpha=0.30)
        if family is not None:
            lines = _scan_lines(view, family, half)
            axes.add_collection(LineCollection(lines, colors=BLUE, linewidths=0.5))
        outline(axes, view.silhouette)
        frame_image(axes, view.silhouette, half)


def _scan_lines(view: View, family: PlaneFamily, half: float) -> list[NDArray[np.float64]]:
    """Return the segments in which planes that a viewing direction lies in show in the view."""
    camera = view.camera
    normal = family.frame[:3, 2]
    heading = camera.rotation[:, :2].T @ normal
    heading /= np.linalg.norm(heading)
    heights = family.offsets * family.unit + normal @ (family.frame[:3, 3] - camera.position)
    left, low, right, high = view.silhouette.bounds
    along = np.array([-heading[1], heading[0]])
    middle = along * (along @ [(left + right) / 2, (low + high) / 2])
    through = middle + heights[:, None] * heading
    lines = shapely.linestrings(
        np.stack([through - 2 * half * along, through + 2 * half * along], axis=1)
    )
    inside = shapely.get_parts(shapely.intersection(lines, view.silhouette))
    return [shapely.get_coordinates(part) for part in inside if part.length > 0]


def _draw_slice(axes: Axes, initial: MultiPolygon, refined: MultiPolygon) -> None:
    fill(axes, refined, SKY, alpha=0.55, edge=BLUE, width=1.2)
    outline(axes, initial, 0.6)
    left, low, right, high = initial.bounds
    half = 0.54 * max(right - left, high - low)
    x, y = (left + right) / 2, (low + high) / 2
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))


def _draw_own_section(axes: Axes, mesh: trimesh.Trimesh, family: PlaneFamily, plane: int) -> None:
    """Draw where a mesh itself meets one of the planes."""
    frame = family.frame
    origin = frame[:3, 3] + family.offsets[plane] * family.unit * frame[:3, 2]
    segments = trimesh.intersections.mesh_plane(  # type: ignore[no-untyped-call]
        mesh, frame[:3, 2], origin
    )
    flat = (segments - frame[:3, 3]) @ frame[:3, :2]
    axes.add_collection(LineCollection(list(flat), colors=VERMILION, linewidths=1.6))


def _pieces(section: MultiPolygon) -> str:
    count = len(section.geoms)
    return f"{count} piece{'s' * (count != 1)}"


# --- figure 6 -------------------------------------------------------------------------------


def draw_orders(orders: Sequence[Sequence[View]], path: str | Path) -> None:
    """Draw what the same views give in several orders: figure 6 of the paper.

    Parameters
    ----------
    orders : sequence of sequences of View
        Each the same parallel projections in another order.
    path : path
        The PNG to write.

    Raises
    ------
    MomrecError
        If an order gives no mesh.
    OSError
        If the file cannot be written.
    """
    figure = blank_figure(3.4 * len(orders), 7.2)
    cells = cast("NDArray[np.object_]", figure.subfigures(2, len(orders), squeeze=False))
    hulls = [reconstruct(views, SLICES) for views in orders]
    meshes = [hull.mesh() for hull in hulls]
    first = orders[0]
    axes_of_view = turned_axes(-first[0].camera.rotation[:, 1], -first[0].camera.rotation[:, 2])
    viewpoint = framing(np.vstack([mesh.vertices for mesh in meshes]), axes_of_view)
    for column, (hull, mesh, views) in enumerate(zip(hulls, meshes, orders, strict=True)):
        top, bottom = cells[0, column], cells[1, column]
        draw_sections(_square(top), hull.sections, hull.offsets, hull.plane_frame, viewpoint)
        numbers = [1 + _place(view, first) for view in views]
        _say(top, f"(a) views {', '.join(map(str, numbers))}")
        _draw_triangles(_square(bottom), mesh, viewpoint)
        _say(bottom, f"(b) {len(mesh.faces):,} triangles")
    save_figure(figure, path)


def _place(view: View, views: Sequence[View]) -> int:
    return next(index for index, other in enumerate(views) if other is view)


def _draw_triangles(axes: Axes, mesh: trimesh.Trimesh, viewpoint: Viewpoint) -> None:
    """Draw a shaded mesh with the edges of its triangles where they are not hidden."""
    rendering = show_mesh(axes, mesh, viewpoint, MESH_PIXELS)
    ends = viewpoint.project(np.asarray(mesh.vertices))[mesh.edges_unique]
    share = np.linspace(0.0, 1.0, EDGE_SAMPLES)[:, None]
    points = ends[:, None, 0] * (1 - share) + ends[:, None, 1] * share
    lifted = points + EDGE_BIAS * np.array([0.0, 0.0, 1.0])
    hidden = rendering.hides(lifted.reshape(-1, 3)).reshape(points.shape[:2])
    visible = np.pad(~hidden[:, :-1] & ~hidden[:, 1:], ((0, 0), (1, 1)))
    starts = np.nonzero(visible[:, 1:] & ~visible[:, :-1])
    stops = np.nonzero(visible[:, :-1] & ~visible[:, 1:])
    pieces = np.stack([points[starts][:, :2], points[stops][:, :2]], axis=1)
    axes.add_collection(LineCollection(list(pieces), colors=EDGE_COLOR, linewidths=0.35))


# --- figures 9, 10, 11 ----------------------------------------------------------------------


def draw_objects(meshes: Mapping[str, trimesh.Trimesh], path: str | Path) -> None:
    """Draw objects as they are modelled: figure 9 of the paper.

    Parameters
    ----------
    meshes : mapping
        Name to mesh, z upwards; at least one.
    path : path
        The PNG to write.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    axes_of_view = turned_axes(UPRIGHT, TOWARDS)
    viewpoints = [framing(np.asarray(mesh.vertices), axes_of_view) for mesh in meshes.values()]
    _draw_gallery(meshes, viewpoints, path)


def draw_canonical_meshes(
    meshes: Mapping[str, trimesh.Trimesh], models: Mapping[str, trimesh.Trimesh], path: str | Path
) -> None:
    """Draw canonical meshes: figures 10 and 11 of the paper.

    Parameters
    ----------
    meshes : mapping
        Name to canonical mesh; at least one.
    models : mapping
        Name to the canonical mesh that it is to be compared with: both are seen alike.
    path : path
        The PNG to write.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    _draw_gallery(meshes, [canonical_viewpoint(models[name], 1.1) for name in meshes], path)


def _draw_gallery(
    meshes: Mapping[str, trimesh.Trimesh], viewpoints: Sequence[Viewpoint], path: str | Path
) -> None:
    columns = min(COLUMNS, len(meshes))
    rows = -(-len(meshes) // columns)
    figure = blank_figure(2.6 * columns, 2.8 * rows)
    cells = blank_grid(figure, rows, columns)
    for cell, (name, mesh), viewpoint in zip(cells, meshes.items(), viewpoints, strict=False):
        show_mesh(cell, mesh, viewpoint, TILE_PIXELS)
        text_below(cell, 0.07, name.replace("_", " "), size=12, color=INK)
    save_figure(figure, path)


# --- parts ----------------------------------------------------------------------------------


def _square(cell: SubFigure) -> Axes:
    axes = cell.add_axes((0.03, 0.13, 0.94, 0.84))
    axes.set_axis_off()
    axes.set(xlim=(-1, 1), ylim=(-1, 1), aspect="equal")
    return axes


def _say(cell: SubFigure, text: str) -> None:
    cell.text(0.5, 0.06, text, fontsize=11.5, color=INK, ha="center", va="center")


def _explain(cell: SubFigure, title: str, text: str) -> None:
    cell.text(0.5, 0.62, title, fontsize=14, weight="bold", color=INK, ha="center", va="bottom")
    cell.text(0.5, 0.57, text, fontsize=10.5, color=FAINT, ha="center", va="top")
