"""Surface moments of triangle meshes: section 3 of the paper."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import roots_jacobi

from momrec_core.errors import DegenerateShapeError

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import NDArray

__all__ = [
    "areas_of",
    "corners_of",
    "gathered_corners",
    "moments_of_corners",
    "surface_moments",
    "volume_of_corners",
]

PRODUCTS_AT_ONCE = 2**18  # of numbers, by one matrix product: with more, BLAS starts threads
LOW_EXPONENTS = np.array(list(product((0, 1), repeat=3)))
RADON_DEGREES = (4, 5)  # seven points, where a conical product has nine
MAX_ORDER = 64  # beyond it, powers of coordinates say nothing that float64 could hold


def corners_of(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """Return the corners of a mesh's faces and make sure that they are numbers.

    Parameters
    ----------
    mesh : Trimesh
        Any triangle mesh.

    Returns
    -------
    corners : array, shape (3, 3, n)
        Coordinates, corners, faces; in the mesh's frame and unit. A copy.

    Raises
    ------
    DegenerateShapeError
        If there is no face, or a vertex that is not finite.
    """
    if len(mesh.faces) == 0:
        raise DegenerateShapeError("Expected a mesh with faces, got none")
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if not np.isfinite(vertices).all():
        wrong = np.sum(~np.isfinite(vertices).all(axis=1))
        raise DegenerateShapeError(
            f"Expected finite vertices, got NaN or infinity in {wrong} of {len(vertices)}"
        )
    return gathered_corners(vertices, mesh.faces)


def gathered_corners(
    vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]
) -> NDArray[np.float64]:
    """Return the corners (3, 3, n) of faces (n, 3): coordinates, corners, faces."""
    return np.asarray(np.take(np.ascontiguousarray(vertices.T), np.asarray(faces).T, axis=1))


def surface_moments(mesh: trimesh.Trimesh, order: int = 5) -> NDArray[np.float64]:
    """Integrate x^i y^j z^k over the surface of a mesh, for all i + j + k <= order.

    Parameters
    ----------
    mesh : Trimesh
        Any triangle mesh; need not be closed. Winding plays no part.
    order : int
        The highest i + j + k, 0 to 64.

    Returns
    -------
    moments : array, shape (order + 1, order + 1, order + 1)
        ``moments[i, j, k]`` in the mesh's unit to the power i + j + k + 2, about the origin of
        its frame; zero where i + j + k > order.

    Raises
    ------
    DegenerateShapeError
        If the mesh has no face, a vertex that is not finite, no area, or is so large that the
        moments are not finite.

    Notes
    -----
    Equation 3 of the paper, without its restriction to faces that are graphs over the x-y plane:
    a rule on the triangle with positive weights that is exact for polynomials of the degree
    ``order``, so the moments are exact up to rounding: Radon's seven points for the degrees 4 and
    5, else a conical product of Gauss rules.

    References
    ----------
    Stroud, A. H. (1971). Approximate calculation of multiple integrals, sections 2.6 and 8.8
    (rule T2 5-1).
    """
    if not 0 <= order <= MAX_ORDER:
        raise ValueError(f"Expected an order from 0 to {MAX_ORDER}, got {order}")
    corners = corners_of(mesh)
    with np.errstate(over="ignore", invalid="ignore"):
        areas = areas_of(corners)
    return moments_of_corners(corners, areas, order)


def moments_of_corners(
    corners: NDArray[np.float64], areas: NDArray[np.float64], order: int
) -> NDArray[np.float64]:
    """Do the work of `surface_moments` for the corners (3, 3, n) of triangles and their areas (n,).

    A power is 0 or 1 plus an even number, so that the monomials are products of few factors:
    w x^a y^b z^c with a, b, c = 0 or 1 by the monomials of x^2, y^2, z^2. The sums over all
    points are one matrix product.
    """
    barycentric, weights = _rule(order)
    even = np.array(_even_exponents(order // 2))
    exponents = LOW_EXPONENTS[:, None] + even
    sums = np.zeros(exponents.shape[:2])
    faces_at_once = max(1, PRODUCTS_AT_ONCE // (sums.size * len(weights)))
    rows = np.empty((sum(sums.shape), faces_at_once * len(weights)))
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, len(areas), faces_at_once):
            faces = slice(start, start + faces_at_once)
            points = (barycentric @ corners[:, :, faces]).reshape(3, -1)
            low, high = rows[: len(sums), : points.shape[1]], rows[len(sums) :, : points.shape[1]]
            np.multiply(weights[:, None], areas[faces], out=low[0].reshape(len(weights), -1))
            _raise_low_powers(points, low)
            _raise_even_powers(points, high)
            sums += low @ high.T
    within = exponents.sum(axis=2) <= order
    moments = np.zeros((order + 1,) * 3)
    moments[tuple(exponents[within].T)] = sums[within]
    if not np.isfinite(moments).all() or moments[0, 0, 0] <= 0:
        raise DegenerateShapeError(
            f"Expected a surface with an area and finite moments up to order {order}, got area "
            f"{moments[0, 0, 0]:.6g}"
        )
    return moments


def _raise_low_powers(points: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """Write w x^a y^b z^c for points (3, n) and `LOW_EXPONENTS` into rows (8, n), the first w."""
    for count, coordinate in zip((1, 2, 4), points[::-1], strict=True):
        np.multiply(rows[:count], coordinate, out=rows[count : 2 * count])


def _even_exponents(half: int) -> list[tuple[int, int, int]]:
    """Return all even i, j, k with i + j + k <= 2 half: by their sum, in it the last ones first."""
    return [
        (2 * i, 2 * j, 2 * (degree - i - j))
        for degree in range(half + 1)
        for i in range(degree, -1, -1)
        for j in range(degree - i, -1, -1)
    ]


def _raise_even_powers(points: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """Write x^i y^j z^k for points (3, n) and `_even_exponents` into rows (m, n)."""
    rows[0] = 1.0
    if len(rows) == 1:
        return
    squares = np.square(points, out=rows[1:4])
    start, end, degree = 1, 4, 1  # of the rows of the last degree
    while end < len(rows):
        last, start, degree = rows[start:end], end, degree + 1
        for square, count in zip(squares, (len(last), degree, 1), strict=True):
            np.multiply(last[-count:], square, out=rows[end : end + count])
            end += count


def areas_of(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the areas (n,) of triangles given by their corners (3, 3, n)."""
    x, y, z = _normals(corners)
    areas: NDArray[np.float64] = 0.5 * np.sqrt(x**2 + y**2 + z**2)
    return areas


def _normals(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the normals (3, n) of triangles (3, 3, n), twice their areas long."""
    (ux, uy, uz), (vx, vy, vz) = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])


def volume_of_corners(corners: NDArray[np.float64]) -> float:
    """Return the volume within a closed surface; negative where it is wound inward.

    Parameters
    ----------
    corners : array, shape (3, 3, n)
        Of its triangles, as of `corners_of`, with the origin within or near, else digits are lost.

    Returns
    -------
    volume : float
        In the corners' unit to the power 3.
    """
    x, y, z = corners
    shadows = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    return float(shadows @ z.sum(axis=0) / 6.0)


@cache
def _rule(degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return barycentric points (n, 3) and weights (n,), sum 1, exact up to a degree.

    One pair of arrays for each degree, not to be written to.
    """
    rule = _radon_rule() if degree in RADON_DEGREES else _conical_product_rule(degree)
    for array in rule:
        array.flags.writeable = False
    return rule


def _radon_rule() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points, weights = [np.full((1, 3), 1.0 / 3.0)], [9.0 / 40.0]
    for root in (-np.sqrt(15.0), np.sqrt(15.0)):
        near = (6.0 + root) / 21.0
        points.append(np.full((3, 3), near) + (1.0 - 3.0 * near) * np.eye(3))
        weights += 3 * [(155.0 + root) / 1200.0]
    return np.concatenate(points), np.array(weights)


def _conical_product_rule(degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points = degree // 2 + 1
    u, weights_u = roots_jacobi(points, 1.0, 0.0)
    v, weights_v = roots_jacobi(points, 0.0, 0.0)
    first = np.repeat((1.0 + u) / 2.0, points)
    second = (1.0 - first) * np.tile((1.0 + v) / 2.0, points)
    weights = np.outer(weights_u, weights_v).ravel()
    return np.column_stack([1.0 - first - second, first, second]), weights / weights.sum()
