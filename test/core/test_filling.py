"""Triangles between contours, against shapely's areas and by the edges that they share."""

from collections import Counter

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from momrec_core._filling import fill
from momrec_core.knots import cap

SEEDS = st.integers(0, 2**32 - 1)


def star(rng, count, radii):
    angles = 2 * np.pi * (np.arange(count) + rng.uniform(-0.4, 0.4, count)) / count
    return np.column_stack([np.cos(angles), np.sin(angles)]) * rng.uniform(*radii, (count, 1))


def divided(rng, ring):
    """Return a ring with further vertices on its straight edges, as exact as rounding allows."""
    ends = np.roll(ring, -1, axis=0)
    parts = []
    for start, end in zip(ring, ends, strict=True):
        along = np.sort(rng.uniform(0.0, 1.0, rng.integers(0, 3)))[:, None]
        parts.append(np.concatenate([start[None], start + along * (end - start)]))
    return np.concatenate(parts)


def loops_of(region):
    """Return the contours of a shapely region, with the inside on their left."""
    parts = shapely.get_parts(shapely.orient_polygons(region))
    return [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(parts)]


def filled(regions, faces_up=None):
    """Triangulate regions of contours: all vertices, and the triangles of each region or None."""
    loops = [loop for region in regions for loop in region]
    first = np.cumsum([0, *map(len, loops)])
    points = np.column_stack([np.concatenate(loops), np.zeros(first[-1])])
    triangles = np.empty((len(points) + 2 * len(loops), 3), dtype=np.int64)
    counts = np.empty(len(regions), dtype=np.int64)
    faces_up = np.ones(len(regions), dtype=bool) if faces_up is None else faces_up
    vertices, ends = np.arange(len(points)), np.cumsum([0, *map(len, regions)])
    fill(points, vertices, first, ends, faces_up, triangles, counts)
    parts = np.split(triangles, np.cumsum(np.maximum(counts, 0)))[:-1]
    return points, [part if count >= 0 else None for part, count in zip(parts, counts, strict=True)]


def doubled_areas(points, triangles):
    a, b, c = points[triangles, :2].transpose(1, 0, 2)
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def open_edges(triangles):
    """Return the edges that no triangle uses in the other direction, as often as they are left."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forward, backward = (Counter(map(tuple, it.tolist())) for it in (edges, edges[:, ::-1]))
    return forward - backward


def edges_of(loops, base=0):
    edges = Counter()
    for loop in loops:
        vertices = range(base, base + len(loop))
        edges.update(zip(vertices, [*vertices[1:], base], strict=True))
        base += len(loop)
    return edges


@given(SEEDS, st.integers(3, 40), st.integers(0, 6), st.floats(1e-3, 1.0))
@settings(max_examples=150, deadline=None)
def test_regions_with_holes_and_vertices_on_straight_edges_are_covered_once(
    seed, count, holes, flatness
):
    rng = np.random.default_rng(seed)
    rings = [star(rng, count, (4.0, 10.0))]
    rings += [star(rng, 5, (0.2, 1.5)) + rng.uniform(-6.0, 6.0, 2) for _ in range(holes)]
    flat = np.array([[1.0, 0.3], [0.0, flatness]])
    outline, *inner = (shapely.Polygon(ring @ flat) for ring in rings)
    region = shapely.difference(outline, shapely.union_all(inner))
    loops = [divided(rng, loop) for loop in loops_of(region)]
    points, (triangles,) = filled([loops])
    assert triangles is not None
    areas = doubled_areas(points, triangles)
    assert areas.min() > 0
    assert areas.sum() / 2 == pytest.approx(region.area, rel=1e-9)
    outlines = len(shapely.get_parts(region))
    assert len(triangles) == len(points) - 2 * outlines + 2 * (len(loops) - outlines)
    assert open_edges(triangles) == edges_of(loops)


@given(SEEDS, st.integers(5, 200), st.floats(1e-5, 0.1))
@settings(max_examples=60, deadline=None)
def test_slivers_between_nearly_equal_contours_are_covered_once(seed, count, width):
    rng = np.random.default_rng(seed)
    ring = star(rng, count, (4.0, 10.0))
    loops = [ring * (1 + width), divided(rng, ring)[::-1]]
    points, (triangles,) = filled([loops])
    assert triangles is not None
    assert doubled_areas(points, triangles).min() > 0
    assert open_edges(triangles) == edges_of(loops)


@given(SEEDS, st.integers(3, 30), st.integers(1, 3))
@settings(max_examples=300, deadline=None)
def test_contours_that_touch_or_cross_are_reported_or_come_out_with_the_edges_in_pairs(
    seed, count, contours
):
    rng = np.random.default_rng(seed)
    loops = [rng.integers(0, 6, (count, 2)).astype(float) for _ in range(contours)]
    points, (triangles,) = filled([loops])
    if triangles is not None:
        assert doubled_areas(points, triangles).min() > 0
        assert open_edges(triangles) == edges_of(loops)


def test_regions_face_up_or_down_and_a_doubtful_one_between_others_is_left_out():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    flat = square * (1.0, 0.0)
    points, parts = filled([[square], [flat], [square]], np.array([True, True, False]))
    assert parts[1] is None
    assert (doubled_areas(points, parts[0]) > 0).all()
    assert (doubled_areas(points, parts[2]) < 0).all()
    assert open_edges(parts[2]) == Counter(edge[::-1] for edge in edges_of([square], 8))


def test_regions_are_cut_alike_however_far_apart_the_layers_are():
    angles = 2 * np.pi * np.arange(12) / 12
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    flat = np.concatenate([circle, 0.8 * circle[::-1]])
    cuts = []
    for height in (0.01, 100.0):
        points = np.column_stack([flat, np.repeat([0.0, height], 12)])
        triangles, counts = np.empty((28, 3), dtype=np.int64), np.empty(1, dtype=np.int64)
        ends = np.array([0, 12, 24]), np.array([0, 2])
        fill(points, np.arange(24), *ends, np.array([True]), triangles, counts)
        assert counts[0] == 24
        cuts.append(triangles[:24])
    assert np.array_equal(*cuts)


def test_a_hole_further_from_all_vertices_than_slopes_can_tell_makes_a_region_doubtful():
    outline = np.array([[-1e-30, -1e290], [1e-30, -1e290], [1e-30, 1e290], [-1e-30, 1e290]])
    hole = np.array([[0.0, 0.0], [5e-31, 1e280], [5e-31, -1e280]])
    assert filled([[outline, hole]])[1] == [None]


def test_a_hole_that_touches_the_outline_is_still_covered():
    outline = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    hole = np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 1.0]])
    points = np.column_stack([np.concatenate([outline, hole]), np.zeros(7)])
    whole = np.array([0, 2])
    triangles = cap(points, np.arange(7), np.array([0, 4, 7]), whole, np.array([True]))
    assert doubled_areas(points, triangles).sum() / 2 == pytest.approx(16.0 - 1.5)
    assert open_edges(triangles) == edges_of([outline, hole])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_at_no_finite_place_make_a_region_doubtful(value):
    ring = star(np.random.default_rng(1), 20, (4.0, 10.0))
    ring[7, 1] = value
    assert filled([[ring]])[1] == [None]


def test_a_region_of_very_many_vertices_is_left_to_others():
    ring = star(np.random.default_rng(2), 20_000, (9.99, 10.0))
    assert filled([[ring]])[1] == [None]


@pytest.mark.parametrize(
    ("vertices", "loops", "regions"),
    [
        ([0, 1, 9], [0, 3], [0, 1]),
        ([0, 1, -1], [0, 3], [0, 1]),
        ([0, 1, 2], [0, 4], [0, 1]),
        ([0, 1, 2], [0, 0, 3], [0, 2]),
        ([0, 1, 2], [0, 3], [0, 2]),
        ([0, 1, 2], [0, 3], [0, 1, 1]),
    ],
)
def test_arrays_that_do_not_agree_are_rejected(vertices, loops, regions):
    triangles, counts = np.empty((5, 3), dtype=np.int64), np.empty(1, dtype=np.int64)
    arrays = (np.array(it) for it in (vertices, loops, regions))
    with pytest.raises(ValueError, match="Expected contours with vertices"):
        fill(np.zeros((3, 3)), *arrays, np.ones(1, dtype=bool), triangles, counts)
