"""Lenses: the closed form against exact fractions, the inverse against scipy's root finder."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, root

from momrec_core import InvalidCameraError, Lens

PLUMB_BOB = (-0.28, 0.07, 0.0012, -0.0008, 0.01)
RATIONAL = (2.1, 0.9, 0.0007, -0.0004, 0.03, 2.4, 1.3, 0.15)
PINCUSHION = (0.2, 0.05, -0.001, 0.002)
LENSES = [Lens(PLUMB_BOB), Lens(RATIONAL), Lens(PINCUSHION), Lens((-0.4, 0.2, 0.0, 0.0, -0.05))]


def points_within(radius, count=400, seed=1):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(0, 2 * np.pi, count)
    radii = radius * np.sqrt(rng.uniform(0, 1, count))
    return radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])


def exact(coefficients, x, y):
    """Return the model's formulas in fractions."""
    k1, k2, p1, p2, k3, k4, k5, k6 = map(Fraction, (*coefficients, 0, 0, 0, 0)[:8])
    x, y = Fraction(x), Fraction(y)
    r2 = x * x + y * y
    stretch = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return (
        float(stretch * x + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)),
        float(stretch * y + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y),
    )


@pytest.mark.parametrize("coefficients", [PLUMB_BOB, RATIONAL, PINCUSHION])
def test_the_closed_form_is_the_models_formula_in_fractions(coefficients):
    points = points_within(0.9, 40)
    expected = [exact(coefficients, x, y) for x, y in points]
    np.testing.assert_allclose(Lens(coefficients).distort(points), expected, rtol=1e-14, atol=1e-16)


@pytest.mark.parametrize("lens", LENSES)
def test_the_inverse_is_that_of_another_root_finder(lens):
    points = points_within(min(0.6, 0.8 * lens.radius), 60)
    for distorted, ours in zip(points, lens.undistort(points), strict=True):
        theirs = root(lambda x, goal=distorted: lens.distort(x[None])[0] - goal, distorted)
        assert theirs.success
        np.testing.assert_allclose(ours, theirs.x, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_what_is_distorted_within_the_radius_comes_back(lens):
    points = points_within(min(1.5, 0.999 * lens.radius))
    np.testing.assert_allclose(lens.undistort(lens.distort(points)), points, atol=1e-8)


@pytest.mark.parametrize("lens", LENSES)
def test_the_lens_folds_nothing_within_its_radius(lens):
    """Finite differences: the Jacobian's symmetric part stays positive definite."""
    points = points_within(min(3.0, 0.999 * lens.radius), 2000)
    small = 1e-6
    columns = [
        (lens.distort(points + small * axis) - lens.distort(points - small * axis)) / (2 * small)
        for axis in np.eye(2)
    ]
    jacobians = np.stack(columns, axis=2)
    np.testing.assert_allclose(jacobians, jacobians.transpose(0, 2, 1), atol=1e-8)
    assert np.linalg.eigvalsh(jacobians).min() > -1e-8


def test_the_radius_of_a_barrel_is_where_its_images_turn_back():
    """The image r (1 + k r^2) grows until 1 + 3 k r^2 = 0."""
    assert Lens((-0.3,)).radius == pytest.approx(1 / np.sqrt(0.9), rel=1e-12)
    assert Lens((0.3, 0.1)).radius == np.inf
    five = Lens((-0.3, 0.05, 0.0, 0.0, -0.01))
    slope = lambda r: 1 - 0.9 * r**2 + 0.25 * r**4 - 0.07 * r**6  # noqa: E731
    assert five.radius == pytest.approx(brentq(slope, 0.5, 3.0), rel=1e-10)


def test_the_radius_of_a_rational_lens_ends_before_its_pole():
    lens = Lens((0.0, 0.0, 0.0, 0.0, 0.0, -1.0))
    assert lens.radius == pytest.approx(1.0)
    edge = lens.undistort([[50.0, 0.0]])
    np.testing.assert_allclose(lens.distort(edge), [[50.0, 0.0]], rtol=1e-12)
    assert edge[0, 0] < 1


def test_tangential_distortion_makes_the_radius_smaller():
    assert Lens((-0.3, 0, 0.01, 0.02)).radius < Lens((-0.3,)).radius
    assert Lens((0, 0, 0.01, 0.0)).radius == pytest.approx(1 / 0.06)


def test_points_that_no_point_within_the_radius_shows_are_refused_by_number():
    lens = Lens((-0.3,))
    largest = lens.distort([[lens.radius, 0.0]])[0, 0]
    inside, outside = [[0.999 * largest, 0.0]], [[0.0, 1.001 * largest]]
    assert lens.undistort(inside)[0, 0] < lens.radius
    with pytest.raises(InvalidCameraError, match=r"within 1\.05409 .* got 1 of 2 beyond, such as"):
        lens.undistort([*inside, *outside])


@given(
    st.lists(st.floats(-3, 3), min_size=4, max_size=8),
    st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
)
@settings(max_examples=120, deadline=None, derandomize=True)
def test_any_lens_is_undone_or_refused_never_wrong(coefficients, point):
    lens = Lens(coefficients)
    try:
        (found,) = lens.undistort([point])
    except InvalidCameraError as error:
        assert "got 1 of 1 beyond" in str(error)  # noqa: PT017 - both outcomes are right
        return
    assert np.linalg.norm(found) < lens.radius
    scale = max(1.0, float(np.hypot(*point)))
    np.testing.assert_allclose(lens.distort([found])[0], point, atol=2e-12 * scale)


@given(
    st.lists(st.floats(-3, 3), min_size=4, max_size=8), st.floats(0, 0.999), st.floats(0, 2 * np.pi)
)
@settings(max_examples=120, deadline=None, derandomize=True)
def test_what_any_lens_shows_within_its_radius_is_found_again(coefficients, share, angle):
    lens = Lens(coefficients)
    length = share * min(lens.radius, 10.0)
    point = np.array([[length * np.cos(angle), length * np.sin(angle)]])
    shown = lens.distort(point)
    again = lens.undistort(shown)
    np.testing.assert_allclose(lens.distort(again), shown, rtol=1e-11, atol=2e-12)


def test_a_lens_without_distortion_changes_nothing():
    points = points_within(5.0, 9)
    for lens in (Lens(()), Lens(np.zeros(5)), Lens(np.zeros(8))):
        assert lens.is_trivial
        assert lens.radius == np.inf
        np.testing.assert_array_equal(lens.undistort(points), points)
    assert Lens((0.1,)).undistort(np.empty((0, 2))).shape == (0, 2)


@pytest.mark.parametrize("point", [(np.nan, 0.0), (np.inf, 0.0), (0.0, -np.inf)])
def test_points_that_are_none_are_refused(point):
    with pytest.raises(InvalidCameraError, match="got 1 of 1 beyond"):
        Lens(PLUMB_BOB).undistort([point])


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        (np.zeros(9), r"at most 8 coefficients of a lens, got shape \(9,\)"),
        (np.zeros((2, 4)), r"got shape \(2, 4\)"),
        ((0.1, np.nan), r"finite coefficients of a lens, .* got \[0\.1, nan\]"),
        ((1e7,), "none above 1e"),
        (("a",), "Expected the numbers k1"),
    ],
)
def test_coefficients_that_are_none_are_refused(coefficients, message):
    with pytest.raises(InvalidCameraError, match=message):
        Lens(coefficients)
