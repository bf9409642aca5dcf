"""Read silhouettes from a folder of binary masks with their projection matrices."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import scipy.linalg
import shapely
from numpy.typing import NDArray
from PIL import Image
from shapely import MultiPolygon, Polygon

from momrec_core import Camera, InvalidContourError, MomrecError, View
from momrec_core.lines import nearest_point_equations
from momrec_ros.masks import (
    MAX_PIXELS,
    MaskContours,
    contours_of_mask,
    hull_silhouette,
    object_pixels,
)

__all__ = [
    "FILE_NAME",
    "CamerasError",
    "FiledCamera",
    "MaskedView",
    "MaskedViews",
    "RejectedMask",
    "read_cameras",
    "read_cameras_json",
    "read_mask",
]

FILE_NAME = "cameras.json"
MAX_JSON_BYTES = 32_000_000  # some 10,000 views
MAX_MASK_BYTES = 64_000_000  # one byte a pixel at the largest size that is traced
MAX_VIEWS = 10_000
MASK_FORMATS = ("PNG", "PPM", "BMP", "TIFF", "JPEG")
MASK_MODES = ("1", "L", "P", "RGB", "I;16")
SINGULAR = 1e-12  # of the largest: below, the left 3 x 3 of P has lost a direction to rounding


class CamerasError(MomrecError):
    """A folder whose cameras.json is missing, damaged or contradicts the folder."""


class _BadMaskError(Exception):
    """A mask that cannot be used, while the other views can."""


@dataclass(frozen=True, eq=False)
class MaskedView:
    """One view of the folder.

    Attributes
    ----------
    name : str
        The mask's path as cameras.json gives it.
    view : View
        Camera in the world of P, silhouette in pixels (world units for parallel projection):
        the one of `hull_silhouette`, grown and open at the image's border.
    seen : MultiPolygon
        The region that the mask itself shows, in the same image coordinates.
    frame : Polygon
        What the image covers of the same image plane.
    touches_border : bool
        Whether the object reaches the image's border, which cuts the silhouette there.
    specks : int
        Pieces and holes of the mask that were left out as too small.
    path : Path
        The mask's file.
    """

    name: str
    view: View
    seen: MultiPolygon
    frame: Polygon
    touches_border: bool
    specks: int
    path: Path


@dataclass(frozen=True)
class RejectedMask:
    """A view whose mask could not be used, and why."""

    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class MaskedViews:
    """What `read_cameras_json` found, both in the order of the file."""

    views: tuple[MaskedView, ...]
    rejected: tuple[RejectedMask, ...]


@dataclass(frozen=True, eq=False)
class FiledCamera:
    """A camera of a camera file.

    Attributes
    ----------
    camera : Camera
        In the world of P.
    pixels_from_image : array, shape (2, 3)
        Affine map from the camera's image coordinates to pixels, centres at integers.
    size : tuple of int, or None
        Width and height of its images, pixels, where the file tells them.
    """

    camera: Camera
    pixels_from_image: NDArray[np.float64]
    size: tuple[int, int] | None


def read_cameras(path: Path) -> tuple[FiledCamera, ...]:
    """Read the cameras of a camera file, whose masks need not be there.

    Parameters
    ----------
    path : Path
        As `read_cameras_json` describes it; ``mask`` may be missing.

    Returns
    -------
    cameras : tuple of FiledCamera
        In the order of the file. The sign of each P is the one that puts the point nearest to the
        rays through the images' middles at positive depth; the middle of an image whose size is
        not told is where its optical axis meets it.

    Raises
    ------
    CamerasError
        If the file is missing or not as described.
    """
    found = []
    for number, fields in enumerate(_load_views(path)):
        label = f"View {number}"
        if not isinstance(fields, Mapping):
            raise CamerasError(f"{label}: expected an object, got {_told(fields)}")
        P = _check_projection(fields.get("P"), label)
        found.append((P, _check_size(fields.get("width"), fields.get("height"), label)))
    signs = _signs([(P, _middle(P, size)) for P, size in found])
    return tuple(
        FiledCamera(*_camera_of(sign * P), size)
        for (P, size), sign in zip(found, signs, strict=True)
    )


def _middle(P: NDArray[np.float64], size: tuple[int, int] | None) -> shapely.Point:
    if size is not None:
        return shapely.Point((size[0] - 1) / 2, (size[1] - 1) / 2)
    if _is_parallel(P):
        return shapely.Point(P[:2, 3] / P[2, 3])
    return shapely.Point(P[:2, :3] @ P[2, :3] / (P[2, :3] @ P[2, :3]))


def read_cameras_json(
    folder: str | Path, *, tolerance: float = 0.5, margin: float = 0.25, min_area: float = 16.0
) -> MaskedViews:
    """Read the views that a folder's cameras.json lists.

    The file is an object with a list ``views``; each view has ``mask``, the path of a binary
    image inside the folder, and ``P``, its projection matrix (3 x 4, pixels, pixel centres at
    integers, up to scale and sign). ``width`` and ``height`` are compared with the mask where
    they are given; other fields are ignored.

    The sign of each P is the one that puts the point nearest to the rays through all
    silhouettes' centroids at positive depth. If the determinant of P[:, :3] is negative then, K
    carries the mirror (K[0, 0] < 0), so that the pose is a proper rotation.

    Parameters
    ----------
    folder : path
        Holds cameras.json and the masks; nothing outside is read.
    tolerance, min_area : float
        In pixels, as in `contours_of_mask`.
    margin : float
        In pixels, as in `hull_silhouette`.

    Returns
    -------
    views : MaskedViews
        The usable views and the rejected ones, whose masks are empty or damaged.

    Raises
    ------
    CamerasError
        If cameras.json is missing, is not as described, or names a mask that is not there.
    """
    entries = _read_entries(Path(folder))
    contours: list[tuple[_Entry, MaskContours]] = []
    rejected = []
    for entry in entries:
        try:
            mask = _read_pixels(entry.mask, entry.size)
            contours.append((entry, contours_of_mask(mask, tolerance=tolerance, min_area=min_area)))
        except (_BadMaskError, InvalidContourError) as error:
            rejected.append(RejectedMask(entry.name, str(error)))
    signs = _signs([(entry.P, found.region.centroid) for entry, found in contours])
    views = tuple(
        _masked_view(entry, sign * entry.P, found, margin)
        for (entry, found), sign in zip(contours, signs, strict=True)
    )
    return MaskedViews(views, tuple(rejected))


# --- cameras.json ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Entry:
    name: str
    mask: Path
    size: tuple[int, int] | None
    P: NDArray[np.float64]


def _read_entries(folder: Path) -> list[_Entry]:
    views = _load_views(folder / FILE_NAME)
    return [_check_entry(folder, number, fields) for number, fields in enumerate(views)]


def _load_views(path: Path) -> list[object]:
    content = _load_json(path)
    views = content.get("views") if isinstance(content, dict) else None
    if not isinstance(views, list) or not 1 <= len(views) <= MAX_VIEWS:
        got = f"{len(views)} of them" if isinstance(views, list) else _told(views)
        raise CamerasError(f"Expected 'views' in {path}, a list of 1 to {MAX_VIEWS}, got {got}")
    return views


def _load_json(path: Path) -> object:
    if not path.is_file():
        raise CamerasError(f"Expected a file {path}, got none there")
    try:
        with path.open("rb") as file:
            content = file.read(MAX_JSON_BYTES + 1)
    except OSError as error:
        raise CamerasError(f"Expected to read {path}, got {error.strerror}") from error
    if len(content) > MAX_JSON_BYTES:
        raise CamerasError(f"Expected {path} to have at most {MAX_JSON_BYTES} bytes, got more")
    try:
        return json.loads(content)
    except RecursionError as error:
        raise CamerasError(f"Expected JSON in {path}, got one nested too deep") from error
    except ValueError as error:
        raise CamerasError(f"Expected JSON in {path}, got {error}") from error


def _told(value: object) -> str:
    """Return a short text for a value of the file, whatever it is."""
    text = repr(value) if isinstance(value, str | float | int | None) else type(value).__name__
    return text if len(text) <= 80 else text[:77] + "..."


def _check_entry(folder: Path, number: int, fields: object) -> _Entry:
    if not isinstance(fields, Mapping):
        raise CamerasError(f"View {number}: expected an object, got {_told(fields)}")
    name = fields.get("mask")
    if not isinstance(name, str) or not name:
        raise CamerasError(f"View {number}: expected the path 'mask', got {_told(name)}")
    label = f"View {number} ({_told(name)})"
    return _Entry(
        name,
        _check_path(folder, name, label),
        _check_size(fields.get("width"), fields.get("height"), label),
        _check_projection(fields.get("P"), label),
    )


def _check_path(folder: Path, name: str, label: str) -> Path:
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or "\0" in name:
        raise CamerasError(f"{label}: expected a mask inside the folder, got a path out of it")
    try:
        resolved = (folder / path).resolve(strict=True)
    except (OSError, RuntimeError) as error:
        raise CamerasError(f"{label}: expected a mask file, got none at that path") from error
    if not resolved.is_relative_to(folder.resolve()):
        raise CamerasError(f"{label}: expected a mask inside the folder, got a link out of it")
    if not resolved.is_file():
        raise CamerasError(f"{label}: expected a mask file, got something else at that path")
    return resolved


def _check_size(width: object, height: object, label: str) -> tuple[int, int] | None:
    if width is None and height is None:
        return None
    if (
        isinstance(width, bool)
        or isinstance(height, bool)
        or not (isinstance(width, int) and isinstance(height, int) and min(width, height) > 0)
        or width * height > MAX_PIXELS
    ):
        raise CamerasError(
            f"{label}: expected 'width' and 'height' in pixels, got {_told(width)} and "
            f"{_told(height)}; an image has at most {MAX_PIXELS} pixels"
        )
    return width, height


def _check_projection(value: object, label: str) -> NDArray[np.float64]:
    try:
        P = np.array(value, dtype=np.float64) if isinstance(value, list) else None
    except (TypeError, ValueError, OverflowError):
        P = None
    if P is None or P.shape != (3, 4):
        raise CamerasError(
            f"{label}: expected 'P', 3 rows of 4 numbers, got "
            f"{_told(value) if P is None else f'shape {P.shape}'}"
        )
    if not np.isfinite(P).all():
        raise CamerasError(f"{label}: expected finite numbers in 'P', got NaN or infinity")
    singular = np.linalg.svd(P[:2, :3] if _is_parallel(P) else P[:, :3], compute_uv=False)
    if singular[-1] <= SINGULAR * singular[0] or not P[2].any():
        raise CamerasError(
            f"{label}: expected a 'P' whose left 3 x 3 is regular (or has a last row of zeros, "
            f"for parallel projection), got singular values {singular}"
        )
    scale: float = np.abs(P).max()
    return P / scale


def _is_parallel(P: NDArray[np.float64]) -> bool:
    return not P[2, :3].any()


# --- masks ----------------------------------------------------------------------------------


def read_mask(masked: MaskedView) -> NDArray[np.bool_]:
    """Read the mask of a view again.

    Parameters
    ----------
    masked : MaskedView
        One of `read_cameras_json`.

    Returns
    -------
    inside : array of bool, shape (height, width)
        Which pixels are object.

    Raises
    ------
    CamerasError
        If the file has changed meanwhile, and is no mask any more.
    """
    try:
        return object_pixels(_read_pixels(masked.path, None))
    except (_BadMaskError, OSError, InvalidContourError) as error:
        raise CamerasError(f"{masked.name}: {error}") from error


def _read_pixels(path: Path, size_given: tuple[int, int] | None) -> NDArray[np.generic]:
    """Return the pixels of a mask, booleans or unsigned integers, shape (height, width)."""
    size = path.stat().st_size
    if size > MAX_MASK_BYTES:
        raise _BadMaskError(f"Expected a mask of at most {MAX_MASK_BYTES} bytes, got {size}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path, formats=MASK_FORMATS) as image:
                return _pixels(image, size_given)
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise _BadMaskError(f"Expected at most {MAX_PIXELS} pixels, got more: {error}") from error
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        raise _BadMaskError(f"Expected an image, got a damaged or unknown one: {error}") from error


def _pixels(image: Image.Image, size: tuple[int, int] | None) -> NDArray[np.generic]:
    if size is not None and image.size != size:
        raise _BadMaskError(
            f"Expected a mask of {size[0]} x {size[1]} pixels, as its view says, got "
            f"{image.width} x {image.height}"
        )
    if image.width * image.height > MAX_PIXELS:
        raise _BadMaskError(f"Expected at most {MAX_PIXELS} pixels, got {image.size}")
    if image.mode not in MASK_MODES:
        raise _BadMaskError(
            f"Expected a mask of one channel, or RGB, without transparency, got {image.mode}"
        )
    return np.asarray(image.convert("L") if image.mode in {"P", "RGB"} else image)


# --- projection matrices --------------------------------------------------------------------


def _signs(seen: Sequence[tuple[NDArray[np.float64], shapely.Point]]) -> NDArray[np.float64]:
    """Return the sign of each P that puts the point nearest to all central rays before it."""
    if not seen:
        return np.empty(0)
    rays = [_ray(P, np.array([centroid.x, centroid.y])) for P, centroid in seen]
    origins, directions = map(np.array, zip(*rays, strict=True))
    nearest = np.linalg.lstsq(*nearest_point_equations(origins, directions), rcond=None)[0]
    homogeneous = np.append(nearest, 1.0)
    return np.array([np.copysign(1.0, P[2] @ homogeneous) for P, _ in seen])


def _ray(
    P: NDArray[np.float64], point_image: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a point and the unit direction, of either sign, of the line behind an image point."""
    # Two planes hold the line: x P[2] - P[0] and y P[2] - P[1].
    planes = np.outer(point_image, P[2]) - P[:2]
    direction: NDArray[np.float64] = np.cross(planes[0, :3], planes[1, :3])
    origin = np.linalg.lstsq(planes[:, :3], -planes[:, 3], rcond=None)[0].astype(np.float64)
    direction /= np.linalg.norm(direction)
    return origin, direction


def _masked_view(
    entry: _Entry, P: NDArray[np.float64], contours: MaskContours, margin: float
) -> MaskedView:
    camera, pixels_from_image = _camera_of(P)

    def to_image(points: NDArray[np.float64]) -> NDArray[np.float64]:
        offset = points - pixels_from_image[:, 2]
        return np.asarray(np.linalg.solve(pixels_from_image[:, :2], offset.T).T)

    silhouette = hull_silhouette(contours, margin=margin)
    frame = shapely.transform(contours.frame, to_image)
    return MaskedView(
        entry.name,
        View(camera, shapely.transform(silhouette, to_image), frame),
        shapely.transform(contours.region, to_image),
        frame,
        contours.touches_border,
        contours.specks,
        entry.mask,
    )


def _camera_of(P: NDArray[np.float64]) -> tuple[Camera, NDArray[np.float64]]:
    """Return a camera and the affine map from its image coordinates to pixels, (2, 3)."""
    return _parallel(P) if _is_parallel(P) else (_pinhole(P), np.eye(2, 3))


def _pinhole(P: NDArray[np.float64]) -> Camera:
    K, rotation = scipy.linalg.rq(P[:, :3])
    signs = np.copysign(1.0, np.diag(K))
    signs[0] *= np.linalg.det(rotation) * np.prod(signs)
    pose = np.eye(4)
    pose[:3, :3] = (np.round(signs)[:, None] * rotation).T
    pose[:3, 3] = -np.linalg.solve(P[:, :3], P[:, 3])
    return Camera.pinhole(pose, K * np.round(signs))


def _parallel(P: NDArray[np.float64]) -> tuple[Camera, NDArray[np.float64]]:
    """Return the camera of a parallel projection and the affine map from it to pixels, (2, 3)."""
    pixels_from_world, offset = P[:2, :3] / P[2, 3], P[:2, 3] / P[2, 3]
    pixels_from_image, axes = scipy.linalg.rq(pixels_from_world, mode="economic")
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([*axes, np.cross(*axes)])
    return Camera.orthographic(pose), np.column_stack([pixels_from_image, offset])
