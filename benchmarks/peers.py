"""Other ways from silhouettes to a solid, as their documentation tells to do it.

Each takes the work's views or masks and returns what it has: a surface's volume and area.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d
import trimesh
from reference import exact_hull
from skimage.measure import marching_cubes
from works import IMAGE, MaskedWork

from momrec_core import View

__all__ = ["Solid", "by_manifold", "by_open3d", "by_voxels"]

CELLS = 128  # voxels along the longest side of the box
FAR = 1000.0  # object sizes: where a pinhole stands for parallel projection
REACH = 10.0  # metres that exact viewing volumes extend to either side


@dataclass(frozen=True)
class Solid:
    """Volume in cubic metres; area in square metres, NaN where there is no surface."""

    volume: float
    area: float


def by_manifold(views: Sequence[View]) -> Solid:
    """Intersect extruded silhouettes exactly."""
    hull = exact_hull(views, REACH)
    return Solid(hull.volume(), hull.surface_area())


def by_voxels(work: MaskedWork) -> Solid:
    """Look every voxel's centre up in every mask; marching cubes of what is left."""
    step = work.size / CELLS
    axis = (np.arange(CELLS) + 0.5) * step
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (grid + work.low).astype(np.float32)
    inside = np.ones(len(points), dtype=bool)
    middle = (np.array(IMAGE, np.float32) - 1) / 2
    for view, mask in zip(work.views, work.masks, strict=True):
        camera = view.camera
        axes = camera.rotation[:, :2].astype(np.float32)
        offset = (camera.position @ camera.rotation[:, :2]).astype(np.float32)
        left = np.flatnonzero(inside)
        image = (points[left] @ axes - offset) / np.float32(work.pixel) + middle
        columns, rows = np.rint(image).astype(np.int32).T
        shown = (columns >= 0) & (columns < IMAGE[0]) & (rows >= 0) & (rows < IMAGE[1])
        seen = np.zeros(len(left), dtype=bool)
        seen[shown] = mask[rows[shown], columns[shown]]
        inside[left] = seen
    cells = np.pad(inside.reshape(CELLS, CELLS, CELLS), 1).astype(np.float32)
    vertices, faces, _, _ = marching_cubes(cells, 0.5, spacing=(step, step, step))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return Solid(abs(float(mesh.volume)), float(mesh.area))


def by_open3d(work: MaskedWork) -> Solid:
    """Carve a dense voxel grid by every mask."""
    step = work.size / CELLS
    grid = open3d.geometry.VoxelGrid.create_dense(work.low, (1.0, 1.0, 1.0), step, *3 * [work.size])
    away = FAR * work.size
    focal = away / work.pixel
    middle = (np.array(IMAGE) - 1) / 2
    parameters = open3d.camera.PinholeCameraParameters()
    parameters.intrinsic = open3d.camera.PinholeCameraIntrinsic(*IMAGE, focal, focal, *middle)
    centre = work.low + work.size / 2
    for view, mask in zip(work.views, work.masks, strict=True):
        camera = view.camera
        pose = camera.pose.copy()
        depth = (centre - camera.position) @ camera.rotation[:, 2]
        pose[:3, 3] += (depth - away) * camera.rotation[:, 2]
        parameters.extrinsic = np.linalg.inv(pose)
        image = open3d.geometry.Image(mask.astype(np.float32))
        grid.carve_silhouette(image, parameters, keep_voxels_outside_image=False)
    return Solid(len(grid.get_voxels()) * step**3, float("nan"))
