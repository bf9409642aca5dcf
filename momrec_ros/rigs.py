"""Simulated cameras with images: the user's own rig, or one around each object."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from momrec_core.camera import Camera
from momrec_core.errors import InvalidCameraError, InvalidContourError, MomrecError
from momrec_core.lines import nearest_point_equations
from momrec_core.silhouette import silhouettes_of_mesh
from momrec_core.simulation import noisy_view, random_rotation
from momrec_core.view import View
from momrec_ros.bag import read_bag
from momrec_ros.cameras_json import FILE_NAME, read_cameras
from momrec_ros.masks import MAX_PIXELS, contours_of_mask, hull_silhouette
from momrec_ros.messages import StampedView
from momrec_ros.parameters import MARGIN, TOLERANCE
from momrec_ros.raster import mask_of_region

__all__ = ["Imager", "Rig", "fitted_imager", "image_size", "placed", "read_rig", "views_by"]

CAMERA_FILE = ".json"
COVERAGE = 0.9  # of the image's smaller side: what an object takes of an image made to fit it
PARALLEL = 1e-6  # of the number of cameras: rays that are more alike meet nowhere in particular


@dataclass(frozen=True, eq=False)
class Imager:
    """A camera with the pixels of its image.

    Attributes
    ----------
    camera : Camera
        Of any kind.
    size : tuple of int, or None
        Width and height of its masks, pixels; None for contours that no pixels limit.
    pixels_from_image : array, shape (2, 3)
        Affine map from the camera's image coordinates to pixels, centres at integers.
    """

    camera: Camera
    size: tuple[int, int] | None = None
    pixels_from_image: NDArray[np.float64] = field(default_factory=lambda: np.eye(2, 3))

    def to_pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map image coordinates, shape (n, 2), to pixels."""
        return points @ self.pixels_from_image[:, :2].T + self.pixels_from_image[:, 2]

    def from_pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map pixels, shape (n, 2), to image coordinates."""
        offset = points - self.pixels_from_image[:, 2]
        return np.asarray(np.linalg.solve(self.pixels_from_image[:, :2], offset.T).T)


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras that stand still around a place.

    Attributes
    ----------
    imagers : tuple of Imager
        Two at least.
    target : array, shape (3,)
        The point nearest to the central rays of all cameras: where objects stand; world, metres.
    """

    imagers: tuple[Imager, ...]
    target: NDArray[np.float64]


def image_size(text: str) -> tuple[int, int] | None:
    """Read the size of an image, such as 640x480; None for an empty text.

    Raises
    ------
    MomrecError
        If it is no size, or one of too many pixels.
    """
    if not text:
        return None
    found = re.fullmatch(r"([1-9]\d{0,7})x([1-9]\d{0,7})", text)
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 0 < size[0] * size[1] <= MAX_PIXELS:
        raise MomrecError(
            f"Expected width and height of an image of at most {MAX_PIXELS} pixels, as in "
            f"640x480, got {text!r:.40}"
        )
    return size


def read_rig(path: Path, image_size: tuple[int, int] | None = None) -> Rig:
    """Read the cameras of a rig.

    Parameters
    ----------
    path : Path
        A camera file as of `momrec reconstruct`, or a folder with a cameras.json, where masks are
        not needed; or a recorded bag, whose first object tells the cameras.
    image_size : tuple of int, or None
        Width and height of masks, pixels, where the source does not tell them. A bag of contours
        tells no pixels; its images are taken to be just large enough for the recorded contours. A
        bag of masks does; unless told otherwise, its principal points are taken for the middles.

    Returns
    -------
    rig : Rig

    Raises
    ------
    MomrecError
        If there are fewer than two cameras, or they look nowhere in common.
    CamerasError
        If a camera file is not as described.
    """
    file = path / FILE_NAME if (path / FILE_NAME).is_file() else path
    if file.suffix.lower() == CAMERA_FILE:
        cameras = read_cameras(file)
        imagers = [
            Imager(found.camera, found.size or image_size, found.pixels_from_image)
            for found in cameras
        ]
    else:
        imagers = _recorded(file, image_size)
    if len(imagers) < 2:
        raise MomrecError(f"Expected two cameras or more in {path}, got {len(imagers)}")
    return Rig(tuple(imagers), _target(imagers))


def _recorded(bag: Path, image_size: tuple[int, int] | None) -> list[Imager]:
    """Return the cameras that saw the first object of a bag."""
    views: list[View] = []
    first = None
    for event in read_bag(bag):
        if isinstance(event, StampedView) and first in (None, event.object_id):
            first = event.object_id
            views.append(event.view)
    reach = max((_reach(view) for view in views if not _has_pixels(view.camera)), default=1.0)
    return [_imager_of(view, image_size, reach) for view in views]


def _imager_of(view: View, size: tuple[int, int] | None, reach: float) -> Imager:
    """Return the camera of a recorded view; reach: of all contours without pixels."""
    if _has_pixels(view.camera):
        return Imager(view.camera, size or _likely_size(view))
    return Imager(view.camera) if size is None else Imager(view.camera, size, _fitted(size, reach))


def _has_pixels(camera: Camera) -> bool:
    return camera.K is not None and not np.array_equal(camera.K, np.eye(3))


def _likely_size(view: View) -> tuple[int, int]:
    """Return the size of an image about the principal point that holds what was seen."""
    middle = np.zeros(2) if view.camera.K is None else view.camera.K[:2, 2]
    width, height = np.maximum(2 * middle, view.silhouette.bounds[2:]).round() + 1
    if width * height > MAX_PIXELS:
        raise MomrecError(
            f"Expected recorded cameras of at most {MAX_PIXELS} pixels, got one that seems to have "
            f"{width:.6g} x {height:.6g}; tell the image size"
        )
    return max(1, int(width)), max(1, int(height))


def _reach(view: View) -> float:
    """Return how far a silhouette reaches from the optical axis, in x or y."""
    return float(np.abs(view.silhouette.bounds).max())


def _fitted(size: tuple[int, int], reach: float) -> NDArray[np.float64]:
    """Return the map to the pixels of an image about the optical axis that is filled so far."""
    scale = COVERAGE * min(size) / 2 / reach
    middle = (np.array(size) - 1) / 2
    return np.column_stack([scale * np.eye(2), middle])


def _target(imagers: Sequence[Imager]) -> NDArray[np.float64]:
    origins, directions = map(np.array, zip(*map(_central_ray, imagers), strict=True))
    normal, right = nearest_point_equations(origins, directions)
    if np.linalg.eigvalsh(normal)[0] < PARALLEL * len(imagers):
        raise MomrecError("Expected cameras that look at a place, got parallel central rays")
    return np.asarray(np.linalg.solve(normal, right))


def _central_ray(imager: Imager) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a point and the unit direction of the ray through the middle of the image."""
    pose = imager.camera.pose
    middle = np.zeros(2)
    if imager.size is not None:
        middle = imager.from_pixels((np.array(imager.size)[None] - 1) / 2)[0]
    elif imager.camera.K is not None:
        middle = imager.camera.K[:2, 2]
    if imager.camera.K is None:
        return pose[:3, :3] @ np.append(middle, 0.0) + pose[:3, 3], pose[:3, 2]
    ray = pose[:3, :3] @ np.linalg.solve(imager.camera.K, np.append(middle, 1.0))
    return pose[:3, 3], ray / np.linalg.norm(ray)


def fitted_imager(camera: Camera, mesh: trimesh.Trimesh, size: tuple[int, int]) -> Imager:
    """Give a camera an image that a mesh nearly fills however it is turned.

    Parameters
    ----------
    camera : Camera
        That looks at the middle of the mesh's bounding box.
    mesh : Trimesh
        In the world.
    size : tuple of int
        Width and height, pixels.

    Returns
    -------
    imager : Imager
    """
    center = np.asarray(mesh.bounds, dtype=np.float64).mean(axis=0)
    radius = float(np.linalg.norm(mesh.vertices - center, axis=1).max())
    if camera.K is None:
        return Imager(camera, size, _fitted(size, radius))
    away = float(np.linalg.norm(center - camera.pose[:3, 3]))
    reach = abs(float(camera.K[0, 0])) * radius / np.sqrt(away**2 - radius**2)
    fits = _fitted(size, reach)
    fits[:, 2] -= fits[:, :2] @ camera.K[:2, 2]
    return Imager(camera, size, fits)


def placed(
    mesh: trimesh.Trimesh,
    target: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    upright: bool = False,
) -> trimesh.Trimesh:
    """Turn a mesh at random and put it somewhere in its own size.

    Parameters
    ----------
    mesh : Trimesh
        Metres; left as it is.
    target : array, shape (3,)
        Where the middle of its bounding box comes to.
    rng : numpy Generator
        Source of randomness.
    upright : bool
        Whether it is turned about the vertical, z, only.

    Returns
    -------
    placed : Trimesh
    """
    angle = rng.uniform(0.0, 2.0 * np.pi) if upright else 0.0
    turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix() if upright else random_rotation(rng)
    turned = trimesh.Trimesh(np.asarray(mesh.vertices) @ turn.T, mesh.faces, process=False)
    turned.apply_translation(target - turned.bounds.mean(axis=0))
    return turned


def views_by(
    imagers: Iterable[Imager], mesh: trimesh.Trimesh, rng: np.random.Generator, noise: float = 0.0
) -> Iterator[View]:
    """Look at a mesh as cameras with images do: masks of their pixels, traced as real ones.

    Parameters
    ----------
    imagers : iterable of Imager
        The cameras.
    mesh : Trimesh
        In the world, before all of them.
    rng : numpy Generator
        Source of randomness for the noise.
    noise : float
        Of the contours, as for `noisy_view`, before there are pixels.

    Yields
    ------
    view : View
        For each camera that the mesh is in the image of.

    Raises
    ------
    InvalidCameraError, DegenerateShapeError
        As of `silhouettes_of_mesh`; the former tells the mesh's size.
    """
    imagers = list(imagers)
    views = silhouettes_of_mesh(mesh, [imager.camera for imager in imagers])
    for imager, exact in zip(imagers, _before_cameras(views, mesh), strict=True):
        view = noisy_view(exact, noise, rng) if noise > 0 else exact
        if imager.size is None:
            yield view
            continue
        region = shapely.transform(view.silhouette, imager.to_pixels)
        try:
            contours = contours_of_mask(
                mask_of_region(region, imager.size), tolerance=TOLERANCE.default
            )
        except InvalidContourError:  # outside of the image, or a few pixels
            continue
        silhouette = hull_silhouette(contours, margin=MARGIN.default)
        yield View(view.camera, shapely.transform(silhouette, imager.from_pixels))


def _before_cameras(views: Iterator[View], mesh: trimesh.Trimesh) -> Iterator[View]:
    """Pass views on; where the mesh is not before the cameras, its unit is most often why."""
    try:
        yield from views
    except InvalidCameraError as error:
        raise InvalidCameraError(
            f"Expected an object that fits before the cameras, got one of {mesh.scale:.3g} m "
            f"(--unit tells what one unit of its file is): {error}"
        ) from error
