"""Views of meshes as a camera would see them: for training, for demonstrations, for tests."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from momrec_core.camera import Camera
from momrec_core.errors import DegenerateShapeError
from momrec_core.silhouette import silhouettes_of_mesh
from momrec_core.view import View

__all__ = [
    "SCALES",
    "Instance",
    "Projection",
    "look_at",
    "noisy_view",
    "random_directions",
    "random_rotation",
    "random_similarity",
    "simulate_cameras",
    "simulate_instance",
    "simulate_views",
]

Projection = Literal["orthographic", "central"]

SCALES = (0.5, 2.0)  # of a random similarity: objects come half to twice their modelled size
SHIFT = 3.0  # object diameters: apart enough that no two instances share their place by chance
CANDIDATES = 16  # per direction: near-even coverage after a few views, and still random
IMAGE_SIZE = 1024  # pixels across the simulated pinhole image
IMAGE_COVERAGE = 0.9  # of the image that the object's bounding sphere fills
NOISE_SPACING = 4.0  # standard deviations between noisy vertices, so that rings rarely cross
FINEST_SPACING = 0.01  # of the silhouette's diameter between vertices that get noise


@dataclass(frozen=True, eq=False)
class Instance:
    """An object at its own place, orientation and size, and the views of it.

    Attributes
    ----------
    mesh : Trimesh
        The object in the world, metres.
    views : tuple of View
        What the cameras saw.
    """

    mesh: trimesh.Trimesh
    views: tuple[View, ...]


def random_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw a rotation uniformly.

    Parameters
    ----------
    rng : numpy Generator
        Source of randomness.

    Returns
    -------
    R : array, shape (3, 3)
        Uniform with respect to the Haar measure: a normally distributed quaternion, normalised.
    """
    matrix: NDArray[np.float64] = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    return matrix


def random_similarity(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    scales: tuple[float, float] = SCALES,
    shift: float = SHIFT,
) -> trimesh.Trimesh:
    """Bring a mesh to a random position, orientation and size.

    Parameters
    ----------
    mesh : Trimesh
        In the world, metres; left as it is.
    rng : numpy Generator
        Source of randomness.
    scales : (smallest, largest)
        Range of the scale factor, drawn evenly in its logarithm.
    shift : float
        The centre is moved by up to this many diameters of the mesh, in each coordinate.

    Returns
    -------
    moved : Trimesh
        The mesh after scaling and turning about its centre, and the shift.

    Raises
    ------
    DegenerateShapeError
        If the mesh has no extent.
    """
    center, radius = _bounding_sphere(mesh)
    scale = np.exp(rng.uniform(*np.log(scales)))
    matrix = np.eye(4)
    matrix[:3, :3] = scale * random_rotation(rng)
    offset = 2 * radius * rng.uniform(-shift, shift, 3)
    matrix[:3, 3] = center + offset - matrix[:3, :3] @ center
    return mesh.copy().apply_transform(matrix)


def random_directions(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw viewing directions that are well spread, whatever number of them is used.

    Opposite directions count as the same, as they show the same silhouette to parallel
    projection. Each direction is the best of a few uniform candidates: the one whose angle to
    all directions before it is largest (Mitchell's best-candidate sampling).

    Parameters
    ----------
    count : int
        Number of directions.
    rng : numpy Generator
        Source of randomness.

    Returns
    -------
    directions : array, shape (count, 3)
        Unit vectors.
    """
    directions = np.empty((count, 3))
    for index in range(count):
        candidates = rng.standard_normal((CANDIDATES, 3))
        candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
        closest = np.abs(candidates @ directions[:index].T).max(axis=1, initial=0.0)
        directions[index] = candidates[np.argmin(closest)]
    return directions


def look_at(
    target: NDArray[np.float64], direction: NDArray[np.float64], distance: float, roll: float
) -> NDArray[np.float64]:
    """Return the pose of an optical frame that looks at a point.

    Parameters
    ----------
    target : array, shape (3,)
        The point on the optical axis, world, metres.
    direction : array, shape (3,)
        Viewing direction (the frame's z axis) in the world, a unit vector.
    distance : float
        From the camera to the target, metres.
    roll : float
        Angle about the optical axis, radians.

    Returns
    -------
    world_from_camera : array, shape (4, 4)
        The optical frame in the world: x right, y down, z forward.
    """
    aside = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(aside, direction)
    x /= np.linalg.norm(x)
    y = np.cross(direction, x)
    pose = np.eye(4)
    pose[:3, 0] = np.cos(roll) * x + np.sin(roll) * y
    pose[:3, 1] = np.cos(roll) * y - np.sin(roll) * x
    pose[:3, 2] = direction
    pose[:3, 3] = target - distance * direction
    return pose


def simulate_views(
    mesh: trimesh.Trimesh,
    count: int,
    rng: np.random.Generator,
    *,
    projection: Projection = "orthographic",
    distance: float = 3.0,
    noise: float = 0.0,
) -> list[View]:
    """Look at a mesh from random, well spread directions with random roll.

    Parameters
    ----------
    mesh : Trimesh
        In the world, metres.
    count : int
        Number of views.
    rng : numpy Generator
        Source of randomness.
    projection : {"orthographic", "central"}
        Parallel projection, or pinholes whose images the object nearly fills.
    distance : float
        From each camera to the centre of the mesh, in diameters of the mesh; above 0.5.
    noise : float
        Standard deviation of the contour, relative to the diameter of each silhouette.

    Returns
    -------
    views : list of View
        In the order in which the directions were drawn.

    Raises
    ------
    DegenerateShapeError
        If the mesh has no extent or shows no area.
    """
    cameras = simulate_cameras(mesh, count, rng, projection=projection, distance=distance)
    return [
        noisy_view(view, noise, rng) if noise > 0 else view
        for view in silhouettes_of_mesh(mesh, cameras)
    ]


def simulate_cameras(
    mesh: trimesh.Trimesh,
    count: int,
    rng: np.random.Generator,
    *,
    projection: Projection = "orthographic",
    distance: float = 3.0,
) -> Iterator[Camera]:
    """Place cameras that look at a mesh from random, well spread directions with random roll.

    Parameters
    ----------
    mesh, count, rng, projection, distance
        As for `simulate_views`.

    Yields
    ------
    camera : Camera

    Raises
    ------
    DegenerateShapeError
        If the mesh has no extent.
    """
    center, radius = _bounding_sphere(mesh)
    away = 2 * radius * distance
    for direction in random_directions(count, rng):
        pose = look_at(center, direction, away, rng.uniform(0.0, 2 * np.pi))
        yield _camera(pose, projection, away / radius)


def simulate_instance(
    mesh: trimesh.Trimesh,
    count: int,
    rng: np.random.Generator,
    *,
    projection: Projection = "orthographic",
    distance: float = 3.0,
    noise: float = 0.0,
) -> Instance:
    """Bring a mesh to a random place and look at it there.

    Parameters
    ----------
    mesh : Trimesh
        The object as modelled, metres.
    count, rng, projection, distance, noise
        As for `simulate_views`.

    Returns
    -------
    instance : Instance
        The transformed mesh and its views.
    """
    moved = random_similarity(mesh, rng)
    views = simulate_views(moved, count, rng, projection=projection, distance=distance, noise=noise)
    return Instance(moved, tuple(views))


def noisy_view(view: View, noise: float, rng: np.random.Generator) -> View:
    """Disturb the contours of a view as an imperfect segmentation does.

    Parameters
    ----------
    view : View
        Left as it is.
    noise : float
        Standard deviation of the displacement in x and in y, relative to the diagonal of the
        silhouette's bounding box.
    rng : numpy Generator
        Source of randomness.

    Returns
    -------
    noisy : View
        With vertices at even spacing along the contours, each displaced on its own. Where a thin
        part makes a contour cross itself, the region is the one by the even-odd rule; parts and
        holes that the noise swallows are gone.

    Raises
    ------
    InvalidContourError
        If the noise is so strong that nothing is left.
    """
    low, high = np.reshape(view.silhouette.bounds, (2, 2))
    diagonal = float(np.linalg.norm(high - low))
    spacing = max(NOISE_SPACING * noise, FINEST_SPACING) * diagonal

    def disturbed(ring: shapely.LinearRing) -> shapely.Geometry:
        points = shapely.get_coordinates(shapely.segmentize(ring, spacing))[:-1]
        moved = shapely.Polygon(points + rng.normal(0.0, noise * diagonal, points.shape))
        return moved if moved.is_valid else shapely.make_valid(moved, method="linework")

    pieces = []
    for piece in view.silhouette.geoms:
        whole, *holes = [disturbed(ring) for ring in shapely.get_rings(piece)]
        pieces.append(shapely.difference(whole, shapely.union_all(holes)))
    parts = shapely.get_parts(shapely.get_parts(shapely.union_all(pieces)))
    kept = [part for part in parts if isinstance(part, shapely.Polygon)]
    return View(view.camera, shapely.MultiPolygon(kept))


def _bounding_sphere(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], float]:
    if len(mesh.faces) == 0:
        raise DegenerateShapeError("Expected a mesh with faces, got none")
    low, high = np.asarray(mesh.bounds, dtype=np.float64)
    radius = float(np.linalg.norm(high - low)) / 2
    if not np.isfinite(radius) or radius <= 0:
        raise DegenerateShapeError(f"Expected a mesh with an extent, got bounds {low} to {high}")
    return (low + high) / 2, radius


def _camera(pose: NDArray[np.float64], projection: Projection, distance_radii: float) -> Camera:
    """Return a camera whose image the sphere of radius 1 at that distance fills."""
    if projection == "orthographic":
        return Camera.orthographic(pose)
    focal = 0.5 * IMAGE_COVERAGE * IMAGE_SIZE * np.sqrt(distance_radii**2 - 1)
    middle = (IMAGE_SIZE - 1) / 2
    return Camera.pinhole(pose, [[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
