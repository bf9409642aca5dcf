"""Views: rings of any kind bound a region by the even-odd rule, or are refused with a reason."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import Polygon

from momrec_core import Camera, InvalidCameraError, InvalidContourError, View

CAMERA = Camera.orthographic(np.eye(4))
SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])


def region(*rings):
    return View.from_rings(CAMERA, list(rings)).silhouette


def star(rng, count):
    angles = np.sort(rng.uniform(0, 2 * np.pi, count))
    return np.c_[np.cos(angles), np.sin(angles)] * rng.uniform(0.5, 1.5, count)[:, None]


@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
@settings(max_examples=50, deadline=None)
def test_winding_and_closing_do_not_matter(seed, is_reversed, is_closed):
    ring = star(np.random.default_rng(seed), 12)
    other = ring[::-1] if is_reversed else ring
    other = np.vstack([other, other[:1]]) if is_closed else other
    assert region(ring).symmetric_difference(region(other)).area == 0


def test_a_closed_ring_begins_where_it_begins_open():
    ring = star(np.random.default_rng(3), 12)
    closed = np.vstack([ring, ring[:1]])
    for given_ring in (ring, closed):
        (found,) = View.from_rings(CAMERA, [given_ring]).rings
        np.testing.assert_array_equal(found, ring)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_a_point_is_inside_where_an_odd_number_of_rings_hold_it(seed):
    rng = np.random.default_rng(seed)
    rings = [star(rng, 10) * rng.uniform(0.3, 2) + rng.normal(size=2) for _ in range(4)]
    points = rng.uniform(-3, 3, (200, 2))
    inside = np.sum([shapely.contains_xy(Polygon(ring), points) for ring in rings], axis=0) % 2
    np.testing.assert_array_equal(shapely.contains_xy(region(*rings), points), inside == 1)


def test_a_ring_within_another_is_a_hole():
    assert region(SQUARE, SQUARE * 0.25 + 1.0).area == pytest.approx(15.0)


def test_a_ring_of_negligible_area_is_dropped():
    assert region(SQUARE, [[1, 1], [2, 2]], SQUARE * 1e-6).area == 16.0


def test_a_small_loop_is_mended():
    ring = [*SQUARE, [0, 2.01], [0.01, 2.0], [0, 2.0], [0.01, 2.01], [0, 1.9]]
    assert not Polygon(ring).is_valid
    assert region(ring).area == pytest.approx(16.0, rel=1e-3)


@pytest.mark.parametrize(
    ("ring", "message"),
    [
        ([[0, 0], [1, 1], [1, 0], [0, 1]], "does not cross itself, got one whose 4 vertices"),
        ([[0, 0], [1, 0]], "three distinct vertices"),
        ([[0, 0], [1, 0], [0, 0], [1, 0]], "three distinct vertices"),
        ([[0, 0], [1, 1], [2, 2]], "bounds an area"),
        ([[0, 0], [1, np.nan], [1, 1]], "finite vertices, got .* at vertex 1 of 3"),
        ([[0, 0], [np.inf, 1], [1, 1]], "finite vertices"),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0]], r"shape \(n, 2\), got shape \(3, 3\)"),
        ("ring", r"shape \(n, 2\)"),
    ],
)
def test_a_ring_that_bounds_no_region_is_refused(ring, message):
    with pytest.raises(InvalidContourError, match=message):
        View.from_rings(CAMERA, [ring])


def test_no_rings_and_rings_that_cancel_are_refused():
    with pytest.raises(InvalidContourError, match="got 0 rings"):
        View.from_rings(CAMERA, [])
    with pytest.raises(InvalidContourError, match="cancel out"):
        View.from_rings(CAMERA, [SQUARE, SQUARE])


def test_a_silhouette_given_as_polygon_is_checked_alike():
    assert View(CAMERA, Polygon(SQUARE)).silhouette.area == 16.0
    with pytest.raises(InvalidContourError, match="cross itself"):
        View(CAMERA, Polygon([[0, 0], [1, 1], [1, 0], [0, 1]]))
    with pytest.raises(InvalidContourError, match="Polygon or MultiPolygon, got Point"):
        View(CAMERA, shapely.Point(0, 0))
    with pytest.raises(InvalidContourError, match="three distinct"):
        View(CAMERA, Polygon())


def test_a_view_needs_a_camera():
    with pytest.raises(InvalidCameraError, match="Expected a Camera, got ndarray"):
        View(np.eye(4), Polygon(SQUARE))


def test_rings_bound_the_silhouette():
    view = View.from_rings(CAMERA, [SQUARE, SQUARE * 0.25 + 1.0])
    assert [len(ring) for ring in view.rings] == [4, 4]
    assert region(*view.rings).equals(view.silhouette)
