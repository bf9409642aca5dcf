"""Other ways from silhouettes to a solid, as their documentation tells to do it.

Each takes the work's views or masks and returns what it makes of them; `measured` looks at that,
which takes no part in the comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d
import trimesh
from manifold3d import Mesh64
from numpy.typing import NDArray
from reference import exact_hull
from skimage.measure import marching_cubes
from works import IMAGE, MaskedWork

from momrec_core import View

__all__ = [
    "Made",
    "Solid",
    "by_manifold",
    "by_open3d",
    "by_rejected_voxels",
    "by_voxels",
    "measured",
]

CELLS = 128  # voxels along the longest side of the box
FAR = 1000.0  # object sizes: where a pinhole stands for parallel projection
REACH = 10.0  # metres that exact viewing volumes extend to either side
Made = trimesh.Trimesh | Mesh64 | open3d.geometry.VoxelGrid


@dataclass(frozen=True)
class Solid:
    """Volume in cubic metres; area in square metres, NaN where there is no surface."""

    volume: float
    area: float


def measured(made: Made) -> Solid:
    """Measure what was made."""
    if isinstance(made, open3d.geometry.VoxelGrid):
        return Solid(len(made.get_voxels()) * made.voxel_size**3, float("nan"))
    if isinstance(made, Mesh64):
        made = trimesh.Trimesh(made.vert_properties[:, :3], made.tri_verts, process=False)
    return Solid(abs(float(made.volume)), float(made.area))


def by_manifold(views: Sequence[View]) -> Mesh64:
    """Intersect extruded silhouettes exactly."""
    return exact_hull(views, REACH).to_mesh64()


def by_voxels(work: MaskedWork) -> trimesh.Trimesh:
    """Look every voxel's centre up in every mask; marching cubes of what all show.

    What is outside of an image counts as its border, which is background.
    """
    points = _centres(work)
    inside = np.ones(len(points), dtype=bool)
    for view, mask in zip(work.views, work.masks, strict=True):
        inside &= _seen(points, view, mask, work.pixel)
    return _surface(work, inside)


def by_rejected_voxels(work: MaskedWork) -> trimesh.Trimesh:
    """Look a voxel's centre up in the masks until one rejects it; marching cubes of the rest."""
    points = _centres(work)
    left = np.arange(len(points))
    for view, mask in zip(work.views, work.masks, strict=True):
        seen = _seen(points, view, mask, work.pixel)
        points, left = points[seen], left[seen]
    inside = np.zeros(CELLS**3, dtype=bool)
    inside[left] = True
    return _surface(work, inside)


def _centres(work: MaskedWork) -> NDArray[np.float32]:
    step = work.size / CELLS
    axes = [(low + (np.arange(CELLS) + 0.5) * step).astype(np.float32) for low in work.low]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _seen(
    points: NDArray[np.float32], view: View, mask: NDArray[np.bool_], pixel: float
) -> NDArray[np.bool_]:
    in_pixels = view.camera.rotation[:, :2] / pixel
    offset = (np.array(IMAGE) - 1) / 2 - view.camera.position @ in_pixels
    image = points @ in_pixels.astype(np.float32) + offset.astype(np.float32)
    columns, rows = np.clip(np.rint(image).astype(np.int32), 0, np.array(IMAGE) - 1).T
    return mask[rows, columns]


def _surface(work: MaskedWork, inside: NDArray[np.bool_]) -> trimesh.Trimesh:
    step = work.size / CELLS
    cells = np.pad(inside.reshape(CELLS, CELLS, CELLS).astype(np.float32), 1)
    vertices, faces, _, _ = marching_cubes(cells, 0.5, spacing=(step, step, step))
    return trimesh.Trimesh(vertices, faces, process=False)


def by_open3d(work: MaskedWork) -> open3d.geometry.VoxelGrid:
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
    return grid
