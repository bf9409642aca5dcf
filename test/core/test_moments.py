"""Surface moments against rational arithmetic, closed forms and their laws."""

from __future__ import annotations

from fractions import Fraction
from math import factorial, isqrt

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from momrec_core import DegenerateShapeError, surface_moments
from momrec_core.moments import corners_of, volume_of_corners

ORDER = 8
GRID = 1024  # coordinates are multiples of 1 / GRID, so that the reference computes with integers
DIGITS = 10**60


def exact_moments(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the moments by expanding each monomial in barycentric coordinates a, b, c.

    The integral of a^p b^q c^r over a triangle is 2 A p! q! r! / (p + q + r + 2)!.
    """
    moments = np.full((ORDER + 1,) * 3, Fraction(0))
    for face in faces:
        corners = [[round(value * GRID) for value in vertices[index]] for index in face]
        twice_area = Fraction(isqrt(squared_cross(*corners) * DIGITS**2), DIGITS * GRID**2)
        for exponents, polynomial in monomials(corners).items():
            degree = sum(exponents)
            integral = sum(
                factor * factorial(p) * factorial(q) * factorial(degree - p - q)
                for (p, q), factor in polynomial.items()
            )
            moments[exponents] += (
                twice_area * integral / (factorial(degree + 2) * Fraction(GRID) ** degree)
            )
    return moments


def squared_cross(a: list[int], b: list[int], c: list[int]) -> int:
    u = [q - p for p, q in zip(a, b, strict=True)]
    v = [q - p for p, q in zip(a, c, strict=True)]
    normal = [u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3)]
    return sum(value * value for value in normal)


def monomials(corners: list[list[int]]) -> dict[tuple[int, int, int], dict[tuple[int, int], int]]:
    """Return x^i y^j z^k as polynomials {(p, q): factor of a^p b^q c^(degree - p - q)}."""
    table = {(0, 0, 0): {(0, 0): 1}}
    for degree in range(1, ORDER + 1):
        for i in range(degree + 1):
            for j in range(degree + 1 - i):
                exponents = (i, j, degree - i - j)
                axis = next(axis for axis in range(3) if exponents[axis])
                lower = tuple(e - (axis == n) for n, e in enumerate(exponents))
                product: dict[tuple[int, int], int] = {}
                for (p, q), factor in table[lower].items():
                    for corner, key in enumerate([(p + 1, q), (p, q + 1), (p, q)]):
                        product[key] = product.get(key, 0) + factor * corners[corner][axis]
                table[exponents] = product
    return table


@pytest.mark.parametrize("offset", [0.0, 50.0, -3.0])
def test_moments_up_to_order_eight_agree_with_rational_arithmetic(offset: float) -> None:
    rng = np.random.default_rng(8)
    vertices = np.round((rng.uniform(-2.0, 2.0, (12, 3)) + offset) * GRID) / GRID
    faces = rng.permuted(np.tile(np.arange(12), (14, 1)), axis=1)[:, :3]
    expected = exact_moments(vertices, faces)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    measured = surface_moments(mesh, order=ORDER)

    # The same moment of |x|, |y|, |z|: on faces cut at the coordinate planes they are signed.
    pieces = mesh
    for axis in np.eye(3):
        sides = [
            trimesh.intersections.slice_mesh_plane(pieces, sign * axis, np.zeros(3))
            for sign in (1.0, -1.0)
        ]
        pieces = trimesh.util.concatenate([side for side in sides if len(side.faces)])
    absolute = surface_moments(
        trimesh.Trimesh(np.abs(pieces.vertices), pieces.faces, process=False), order=ORDER
    )
    within = np.indices(measured.shape).sum(axis=0) <= ORDER
    errors = np.array(
        [float(Fraction(a) - b) for a, b in zip(measured.flat, expected.flat, strict=True)]
    )
    assert (np.abs(errors[within.ravel()]) <= 1e-12 * absolute[within]).all()
    assert (measured[~within] == 0).all()


def test_moments_of_a_box_follow_the_closed_form() -> None:
    size = np.array([2.0, 3.0, 5.0])
    moments = surface_moments(trimesh.creation.box(extents=size), order=6)

    def power_integral(axis: int, power: int) -> float:
        half = size[axis] / 2
        return (half ** (power + 1) - (-half) ** (power + 1)) / (power + 1)

    for exponents in np.ndindex(7, 7, 7):
        if sum(exponents) > 6:
            continue
        expected = 0.0
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            ends = (size[axis] / 2) ** exponents[axis] + (-size[axis] / 2) ** exponents[axis]
            expected += ends * power_integral(u, exponents[u]) * power_integral(v, exponents[v])
        assert moments[exponents] == pytest.approx(expected, rel=1e-12, abs=1e-9)


@given(order=st.integers(0, 12), seed=st.integers(0, 2**32 - 1))
def test_moments_do_not_depend_on_how_a_face_is_cut(order: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = trimesh.Trimesh(rng.uniform(0.0, 2.0, (3, 3)), [[0, 1, 2]], process=False)
    whole = surface_moments(mesh, order)
    cut = surface_moments(mesh.subdivide(), order)
    np.testing.assert_allclose(cut, whole, rtol=1e-11)


def test_lower_moments_do_not_depend_on_the_order_asked_for() -> None:
    mesh = trimesh.creation.torus(2.0, 0.7)
    high = surface_moments(mesh, order=7)
    low = surface_moments(mesh, order=3)
    within = np.indices(low.shape).sum(axis=0) <= 3
    np.testing.assert_allclose(low[within], high[:4, :4, :4][within], rtol=1e-12, atol=1e-9)


def test_moments_of_many_faces_are_summed_over_all_chunks() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=5)
    moments = surface_moments(mesh)
    assert moments[0, 0, 0] == pytest.approx(mesh.area, rel=1e-13)
    assert moments[2, 0, 0] == pytest.approx(4 * np.pi / 3, rel=1e-2)
    flipped = trimesh.Trimesh(mesh.vertices, mesh.faces[::-1, ::-1], process=False)
    np.testing.assert_allclose(surface_moments(flipped), moments, rtol=1e-12, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_volume_of_a_tetrahedron_is_a_determinant_with_the_sign_of_its_winding(
    seed: int,
) -> None:
    corners = np.random.default_rng(seed).uniform(-1.0, 1.0, (4, 3))
    expected = np.linalg.det(corners[1:] - corners[0]) / 6.0
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    outward = trimesh.Trimesh(corners, faces, process=False)
    inward = trimesh.Trimesh(corners, faces[:, ::-1], process=False)
    assert volume_of_corners(corners_of(outward)) == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert volume_of_corners(corners_of(inward)) == pytest.approx(-expected, rel=1e-12, abs=1e-15)


def test_the_volume_of_a_torus_is_near_that_of_the_round_one() -> None:
    sections = 64
    torus = trimesh.creation.torus(2.0, 0.5, sections, sections)
    assert volume_of_corners(corners_of(torus)) == pytest.approx(torus.volume, rel=1e-12)
    assert volume_of_corners(corners_of(torus)) == pytest.approx(
        2 * np.pi**2 * 2.0 * 0.5**2, rel=5e-3
    )


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.eye(3), np.empty((0, 3), int), "with faces, got none"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "finite vertices, got NaN or infinity in 3 of 3"),
        (np.full((3, 3), np.inf), [[0, 1, 2]], "finite vertices"),
        (np.ones((3, 3)), [[0, 1, 2]], "an area and finite moments up to order 5, got area 0"),
        (np.eye(3) * 1e200, [[0, 1, 2]], "finite moments"),
    ],
)
def test_a_surface_without_finite_area_is_refused(
    vertices: np.ndarray, faces: np.ndarray, message: str
) -> None:
    with pytest.raises(DegenerateShapeError, match=message):
        surface_moments(trimesh.Trimesh(vertices, faces, process=False))


@pytest.mark.parametrize("order", [-1, 65])
def test_an_order_out_of_range_is_refused(order: int) -> None:
    with pytest.raises(ValueError, match="order from 0 to 64"):
        surface_moments(trimesh.creation.box(), order)
