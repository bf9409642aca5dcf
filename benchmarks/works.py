"""Reference works: objects, and the silhouettes that everyone is to make a mesh of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from momrec_core import Camera, View, silhouette_of_mesh
from momrec_core.simulation import look_at, random_directions, simulate_views
from momrec_ros.files import read_mesh
from momrec_ros.masks import contours_of_mask
from momrec_ros.shared_data import shared_path

__all__ = [
    "IMAGE",
    "MaskedWork",
    "PinholeMask",
    "blob",
    "blob_work",
    "fine_mesh",
    "pinhole_masks",
    "polyhedra_works",
]

PinholeMask = tuple[Camera, NDArray[np.bool_]]

IMAGE = (640, 480)  # width, height
FILLED = 0.7  # of the image's height, the object's diameter: contours of about 200 vertices
AWAY = 3.0  # object sizes: where pinholes stand
BOX = 1.1  # of the object's longest side: the voxels' cube
GRID = 96  # fine enough that facets are far below a pixel
FINE_GRID = 153  # for 50,000 triangles
# Centres and radii of the balls that the blob is melted from: four lobes, three necks.
LOBES = (
    (-0.62, 0.05, 0.00, 0.30),
    (-0.10, -0.05, 0.12, 0.20),
    (0.40, 0.12, 0.05, 0.34),
    (0.48, 0.55, -0.30, 0.22),
    (-0.45, -0.30, 0.48, 0.22),
    (-0.30, -0.12, 0.28, 0.15),
)
SOFTNESS = 3.5  # of the melting: the larger, the thinner the necks


@dataclass(frozen=True, eq=False)
class MaskedWork:
    """Views of one object, as masks and as the contours that were traced of them.

    Attributes
    ----------
    views : list of View
        Contours in metres, simplified within half a pixel.
    masks : list of array of bool, shape (480, 640)
        What the contours were traced from.
    pixel : float
        Size of a pixel, metres; the optical axis goes through the image's middle.
    low : array, shape (3,)
        Corner of a cube that holds the object with little to spare: what voxels are laid in.
    size : float
        The cube's side, metres.
    """

    views: list[View]
    masks: list[NDArray[np.bool_]]
    pixel: float
    low: NDArray[np.float64]
    size: float

    @property
    def vertices(self) -> float:
        """Mean number of vertices of a view's contours."""
        return float(np.mean([sum(map(len, view.rings)) for view in self.views]))


def blob(grid: int = GRID) -> trimesh.Trimesh:
    """Return a smooth closed surface with lobes and necks, about 1.5 m long.

    Parameters
    ----------
    grid : int
        Points across the field that the surface is a level of.
    """
    axes = np.linspace(-1.2, 1.2, grid)
    points = np.stack(np.meshgrid(axes, axes, axes, indexing="ij"), axis=-1)
    field = np.zeros((grid, grid, grid))
    for *centre, radius in LOBES:
        squared = np.sum((points - centre) ** 2, axis=-1) / radius**2
        field += np.exp(SOFTNESS * (1 - squared) / 2)
    vertices, faces, _, _ = marching_cubes(np.log(field), 0.0)
    mesh = trimesh.Trimesh(axes[0] + vertices * (axes[1] - axes[0]), faces)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def blob_work(count: int, tolerance: float = 0.5) -> MaskedWork:
    """Look at the blob from well spread directions, by parallel projection."""
    mesh = blob()
    low, high = mesh.bounds
    size = float(np.linalg.norm(high - low))
    pixel = size / (FILLED * IMAGE[1])
    rng = np.random.default_rng(count)
    views, masks = [], []
    for direction in random_directions(count, rng):
        camera = Camera.orthographic(look_at((low + high) / 2, direction, size, rng.uniform(0, 6)))
        mask = rasterised(silhouette_of_mesh(mesh, camera).silhouette, pixel)
        region = contours_of_mask(mask, tolerance=tolerance).region
        in_metres = shapely.transform(region, lambda points: (points - _middle()) * pixel)
        masks.append(mask)
        views.append(View(camera, in_metres))
    side = BOX * float(np.max(high - low))
    return MaskedWork(views, masks, pixel, (low + high - side) / 2, side)


def pinhole_masks(count: int) -> list[PinholeMask]:
    """Look at the blob from well spread directions, with pinholes."""
    mesh = blob()
    low, high = mesh.bounds
    size = float(np.linalg.norm(high - low))
    focal = AWAY * FILLED * IMAGE[1]
    intrinsics = np.array([[focal, 0, _middle()[0]], [0, focal, _middle()[1]], [0, 0, 1]])
    cameras = [
        Camera.pinhole(look_at((low + high) / 2, direction, AWAY * size, 0.0), intrinsics)
        for direction in random_directions(count, np.random.default_rng(count))
    ]
    views = [silhouette_of_mesh(mesh, camera) for camera in cameras]
    in_pixels = [shapely.transform(v.silhouette, lambda points: points - _middle()) for v in views]
    return [
        (camera, rasterised(region, 1.0)) for camera, region in zip(cameras, in_pixels, strict=True)
    ]


def rasterised(region: shapely.MultiPolygon, pixel: float) -> NDArray[np.bool_]:
    """Return the mask of a region about the image's middle: the pixels whose centres it holds."""
    columns, rows = np.meshgrid(*map(np.arange, IMAGE))
    x, y = ((np.stack([columns, rows], axis=-1) - _middle()) * pixel).reshape(-1, 2).T
    shapely.prepare(region)
    inside: NDArray[np.bool_] = shapely.contains_xy(region, x, y)
    return inside.reshape(IMAGE[::-1])


def _middle() -> NDArray[np.float64]:
    return (np.array(IMAGE) - 1) / 2


def fine_mesh() -> trimesh.Trimesh:
    """Return the blob with about 50,000 triangles."""
    return blob(FINE_GRID)


def polyhedra_works(count: int) -> list[list[View]]:
    """Look at the ten shipped polyhedra; the silhouettes are exact."""
    files = sorted(shared_path("meshes/ten_objects").glob("*.ply"))
    return [
        simulate_views(read_mesh(file), count, np.random.default_rng(number))
        for number, file in enumerate(files)
    ]
