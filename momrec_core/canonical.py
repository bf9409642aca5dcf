"""Canonical position, orientation and size of a shape: section 4 of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from momrec_core.errors import DegenerateShapeError
from momrec_core.frames import admissible_frames, moment_tensor, turned_moments
from momrec_core.moments import (
    areas_of,
    corners_of,
    gathered_corners,
    moments_of_corners,
    volume_of_corners,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

__all__ = ["CANONICAL_AREA", "CanonicalShape", "normalize"]

CANONICAL_AREA = 100.0  # C of eq. 5, as in the paper's section 5
NO_AREA = 1e-14  # of the squared extent: what rounding leaves of a surface squeezed to a line
HIT_TOLERANCE = 1e-9  # of the extent: how near an axis line passes to an edge that it meets
LARGEST_EXTENT = 1e60  # metres, and one over it the smallest: eigenvalues go with its 4th power
LARGEST_AREA = 1e40  # of a canonical surface, and one over it the smallest: likewise with power 3.5
MAX_ORDER = 5  # of the moments that a canonical shape carries
TIE_TOLERANCE = 1e-7  # relative: below it, the two ends of an axis differ by rounding only


@dataclass(frozen=True, eq=False)
class CanonicalShape:
    """A shape in canonical position, orientation and size, made with `normalize`.

    Attributes
    ----------
    mesh : Trimesh
        The canonical mesh, unitless: centroid at the origin, v1 along z, v2 along x, v3 along y.
        Vertices and faces are those of the shape, in their order.
    matrix : array, shape (4, 4)
        Homogeneous similarity that takes the world (metres) to the canonical frame.
    principal_frame : array, shape (4, 4)
        Pose of the principal frame in the world (metres): origin the centroid, columns
        x, y, z = v2, v3, v1; right-handed.
    scale : float
        alpha of eq. 13, canonical units per metre.
    moments : array, shape (6, 6, 6)
        Normalised moments eta_ijk up to order 5 at [i, j, k].
    volume : float
        Within the canonical mesh, unitless, where that is closed; negative if it is wound inward.
    eigenvalues : array, shape (3,)
        Of the inertia matrix (eq. 9) in the world, increasing, metres to the power 4.
    eigenvalue_gaps : array, shape (2,)
        Second less first and third less second eigenvalue, relative to the third.
    sign_margins : array, shape (2,)
        For v1 and v2: how much farther the surface reaches on the axis' positive side than on
        its negative side, relative to the farther one, 0 to 1; NaN where the axis line misses the
        surface.
    is_unique : bool
        Whether all gaps and margins are above the tolerances.
    alternatives : tuple of arrays, shape (4, 4)
        World poses of the further right-handed principal frames that are as good within the
        tolerances. Where eigenvalues are equal, the axes turned to the peaks of moments of
        higher order are among them.
    """

    mesh: trimesh.Trimesh
    matrix: NDArray[np.float64]
    principal_frame: NDArray[np.float64]
    scale: float
    moments: NDArray[np.float64]
    volume: float
    eigenvalues: NDArray[np.float64]
    eigenvalue_gaps: NDArray[np.float64]
    sign_margins: NDArray[np.float64]
    is_unique: bool
    alternatives: tuple[NDArray[np.float64], ...]


def normalize(
    mesh: trimesh.Trimesh,
    area: float = CANONICAL_AREA,
    gap_tolerance: float = 0.02,
    sign_tolerance: float = 0.01,
) -> CanonicalShape:
    """Bring a shape into its canonical position, orientation and size.

    Parameters
    ----------
    mesh : Trimesh
        A triangle mesh in the world, metres; any size, place and winding, closed or not.
    area : float
        C of eq. 5, the area of the canonical surface.
    gap_tolerance : float
        Axes whose eigenvalues differ by less, relative to the largest, are interchangeable.
    sign_tolerance : float
        An axis whose two ends differ by less, relative to the farther, has no sure sign.

    Returns
    -------
    shape : CanonicalShape

    Raises
    ------
    DegenerateShapeError
        If the mesh has no face, a vertex that is not finite, or no area.
    ValueError
        If the area or a tolerance is out of its range.

    Notes
    -----
    Equations 6 to 13 with the rules A.1 to A.3 for the signs. Beyond the paper: where an axis line
    misses the surface, or meets it equally far on both sides, the axis points to where its
    third-order moment is positive, or, if that vanishes too, to the side of the first vertex that
    is off the centroid's plane. Every rule moves along with a similarity.
    """
    if not 1.0 / LARGEST_AREA <= area <= LARGEST_AREA:
        raise ValueError(f"Expected a positive area, at most {LARGEST_AREA:g}, got {area}")
    if not (0 <= gap_tolerance < 1 and 0 <= sign_tolerance < 1):
        raise ValueError(
            f"Expected tolerances from 0 to below 1, got {gap_tolerance} and {sign_tolerance}"
        )
    centred = _centred(mesh)
    eigenvalues, axes = _principal_axes(_inertia(centred.moments))
    (moments,) = turned_moments(centred.moments, axes[None])
    signs, margins = _directions(centred.vertices @ axes, np.asarray(mesh.faces), moments)
    gaps = np.diff(eigenvalues) / eigenvalues[2]
    principal, *alternatives = (
        axes @ frame
        for frame in admissible_frames(
            signs, margins >= sign_tolerance, gaps < gap_tolerance, moments
        )
    )
    metric_area = moments[0, 0, 0] * centred.extent**2
    scale = float(np.sqrt(area / metric_area))
    enlarged = scale * centred.extent
    canonical = trimesh.Trimesh(centred.vertices @ principal * enlarged, mesh.faces, process=False)
    return CanonicalShape(
        mesh=canonical,
        matrix=_similarity(principal, centred.centroid, scale),
        principal_frame=_pose(principal, centred.centroid),
        scale=scale,
        moments=_in_principal_frame(moments, signs, enlarged),
        volume=centred.volume * enlarged**3,
        eigenvalues=eigenvalues * centred.extent**4,
        eigenvalue_gaps=gaps,
        sign_margins=margins[:2],
        is_unique=not alternatives,
        alternatives=tuple(_pose(frame, centred.centroid) for frame in alternatives),
    )


@dataclass(frozen=True, eq=False)
class _Centred:
    """A shape about its centroid in units of its extent.

    Attributes
    ----------
    vertices : array, shape (n, 3)
    moments : array, shape (6, 6, 6)
        Up to order 5.
    volume : float
        Within the shape.
    centroid : array, shape (3,)
        In the world, metres.
    extent : float
        Metres.
    """

    vertices: NDArray[np.float64]
    moments: NDArray[np.float64]
    volume: float
    centroid: NDArray[np.float64]
    extent: float


def _centred(mesh: trimesh.Trimesh) -> _Centred:
    corners = corners_of(mesh)
    low, high = corners.min(axis=(1, 2)), corners.max(axis=(1, 2))
    extent = float(2.0 * np.max(high / 2.0 - low / 2.0))
    if not 1.0 / LARGEST_EXTENT <= extent <= LARGEST_EXTENT:
        raise DegenerateShapeError(f"Expected a mesh with an area, got an extent of {extent:.6g}")
    middle = (low + high) / 2.0
    corners -= middle[:, None, None]
    corners /= extent
    areas = areas_of(corners)
    area = float(areas.sum())
    if area <= NO_AREA:
        raise DegenerateShapeError(
            f"Expected a mesh with an area, got {area:.3g} of its squared extent"
        )
    shift = corners.sum(axis=1) @ areas / (3.0 * area)
    corners -= shift[:, None, None]
    vertices = (np.asarray(mesh.vertices, dtype=np.float64) - middle) / extent - shift
    return _Centred(
        vertices=vertices,
        moments=moments_of_corners(corners, areas, MAX_ORDER),
        volume=volume_of_corners(corners),
        centroid=middle + shift * extent,
        extent=extent,
    )


def _inertia(moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inertia matrix (eq. 9) of a shape with these moments, about the origin."""
    second = moment_tensor(moments, 2)
    return np.asarray(np.trace(second) * np.eye(3) - second)


def _principal_axes(
    inertia: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return eigenvalues, increasing, and as columns right-handed eigenvectors of the inertia."""
    eigenvalues, axes = np.linalg.eigh(inertia)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    return eigenvalues, axes


def _in_principal_frame(
    moments: NDArray[np.float64], signs: NDArray[np.float64], scale: float
) -> NDArray[np.float64]:
    """Return moments for x, y, z along v2, v3, v1 instead of v1, v2, v3 before their signs."""
    i, j, k = np.indices(moments.shape)
    first, second, _ = signs
    flips = second**i * (first * second) ** j * first**k
    powers = scale ** (np.minimum(i + j + k, MAX_ORDER) + 2)
    return np.asarray(moments.transpose(1, 2, 0) * flips * powers)


def _directions(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], moments: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return signs and sign margins (3,) of the coordinate axes of a centred mesh: A.1, A.2."""
    third = np.array([moments[3, 0, 0], moments[0, 3, 0], moments[0, 0, 3]])
    spread = np.array([moments[2, 0, 0], moments[0, 2, 0], moments[0, 0, 2]]) / moments[0, 0, 0]
    skewness = third / (moments[0, 0, 0] * np.maximum(spread, TIE_TOLERANCE**2) ** 1.5)
    signs, margins = np.ones(3), np.full(3, np.nan)
    for axis, near in enumerate(_faces_near_axes(vertices, faces)):
        heights = _axis_hits(np.roll(gathered_corners(vertices, faces[near]), -axis, axis=0))
        upper, lower = np.max(heights, initial=0.0), np.max(-heights, initial=0.0)
        farther = max(upper, lower)
        if len(heights):
            margins[axis] = abs(upper - lower) / farther if farther > HIT_TOLERANCE else 0.0
        if margins[axis] > TIE_TOLERANCE:
            signs[axis] = np.sign(upper - lower)
        elif abs(skewness[axis]) > TIE_TOLERANCE:
            signs[axis] = np.sign(skewness[axis])
        else:
            signs[axis] = _side_of_first_vertex(vertices[:, axis])
    return signs, margins


def _faces_near_axes(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> Iterator[NDArray[np.int64]]:
    """Yield, axis by axis, the faces that may meet it: not all corners lie to one side of it."""
    beyond = [vertices[:, axis] * side > HIT_TOLERANCE for axis in range(3) for side in (1, -1)]
    bits = 1 << np.arange(6, dtype=np.uint8)
    sides = np.take(bits @ np.array(beyond), faces)
    shared = sides[:, 0] & sides[:, 1] & sides[:, 2]
    for axis in range(3):
        across = 0b111111 ^ (0b11 << 2 * axis)
        yield np.flatnonzero(shared & across == 0)


def _side_of_first_vertex(heights: NDArray[np.float64]) -> float:
    off_plane = heights[np.abs(heights) >= np.abs(heights).max() / 2.0]
    return float(np.copysign(1.0, off_plane[0]))


def _axis_hits(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the first coordinates at which its axis meets triangles (3, 3, n), in no order.

    Faces are seen along the axis: one that has the origin inside is hit; edges and vertices are
    hit if the axis passes within `HIT_TOLERANCE`, so that no hit is lost between two faces or on
    a face seen edge on.
    """
    heights, starts = corners[0], corners[1:]
    next_heights, ends = np.roll(heights, -1, axis=0), np.roll(starts, -1, axis=1)
    turns = starts[0] * ends[1] - starts[1] * ends[0]
    total = turns.sum(axis=0)
    inside = ((turns >= 0).all(axis=0) | (turns <= 0).all(axis=0)) & (total != 0)
    opposite = np.roll(heights, 1, axis=0)  # an edge's turn weighs its third corner
    in_faces = (turns * opposite).sum(axis=0)[inside] / total[inside]

    sides = ends - starts
    squared = (sides**2).sum(axis=0)
    along = -(starts * sides).sum(axis=0)
    fraction = np.clip(along / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
    nearest = np.hypot(*(starts + fraction * sides))
    on_edges = (heights + fraction * (next_heights - heights))[nearest <= HIT_TOLERANCE]
    at_corners = heights[np.hypot(*starts) <= HIT_TOLERANCE]
    return np.concatenate([in_faces, on_edges, at_corners])


def _pose(rotation: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def _similarity(
    principal: NDArray[np.float64], centroid: NDArray[np.float64], scale: float
) -> NDArray[np.float64]:
    """Return A R T of eqs. 4a to 4c as one matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * principal.T
    matrix[:3, 3] = -matrix[:3, :3] @ centroid
    return matrix
