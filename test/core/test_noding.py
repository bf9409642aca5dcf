"""Contacts of contours, against shapely's intersections and against trying all pairs of edges."""

from fractions import Fraction

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from momrec_core._meeting import contacts
from momrec_core.noding import TOUCH, Edges, find_contacts

seeds = st.integers(0, 2**32 - 1)


def edges_of(rings, groups):
    starts = np.concatenate(rings).astype(float)
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings]).astype(float)
    return Edges(starts, ends, np.repeat(groups, [len(ring) for ring in rings]))


def star(rng, count, size):
    """Return a contour around the origin; with sizes of whole numbers, many touch."""
    angles = np.sort(rng.uniform(0.0, 2 * np.pi, count))
    radii = rng.uniform(1.0, size, count)
    ring = np.round(np.column_stack([np.cos(angles), np.sin(angles)]) * radii[:, None])
    kept = (ring != np.roll(ring, 1, axis=0)).any(axis=1)
    return ring[kept]


def segments(edges):
    return shapely.linestrings(np.stack([edges.starts, edges.ends], axis=1))


@given(seeds, st.integers(1, 3), st.sampled_from([4.0, 30.0, 1000.0]))
@settings(max_examples=60, deadline=None)
def test_contacts_are_where_edges_of_a_group_meet(seed, groups, size):
    rng = np.random.default_rng(seed)
    below, above = (
        edges_of([star(rng, 12, size) for _ in range(groups)], np.arange(groups)) for _ in "ab"
    )
    contacts = find_contacts(below, above)
    low, high = segments(below), segments(above)
    points = shapely.points(contacts.points)
    assert (below.groups[contacts.below] == above.groups[contacts.above]).all()
    assert (shapely.distance(points, low[contacts.below]) <= 2 * TOUCH).all()
    assert (shapely.distance(points, high[contacts.above]) <= 2 * TOUCH).all()
    for edges, at, which in (
        (below, contacts.below_at, contacts.below),
        (above, contacts.above_at, contacts.above),
    ):
        along = edges.starts[which] + at[:, None] * (edges.ends - edges.starts)[which]
        assert (np.linalg.norm(along - contacts.points, axis=1) <= 2 * TOUCH).all()
    for group in range(groups):
        found = shapely.multipoints(contacts.points[below.groups[contacts.below] == group])
        met = shapely.intersection(
            low[below.groups == group][:, None], high[above.groups == group][None]
        )
        corners = shapely.points(shapely.get_coordinates(met))
        assert (shapely.distance(corners, found) <= 2 * TOUCH).all()


def cross(one, other):
    return one[0] * other[1] - one[1] * other[0]


def between(start, end):
    return end[0] - start[0], end[1] - start[1]


def places_in_common(first, second):
    """Return where on two edges, exact numbers, each contact is."""
    (start, end), (begin, stop) = first, second
    span, other_span, apart = between(start, end), between(begin, stop), between(start, begin)
    if start == begin:
        yield Fraction(0), Fraction(0)
    along = [
        Fraction(sum(a * b for a, b in zip(to, edge, strict=True)), sum(a * a for a in edge))
        for to, edge in ((apart, span), (between(begin, start), other_span))
    ]
    if cross(span, apart) == 0 and 0 < along[0] < 1:
        yield along[0], Fraction(0)
    if cross(other_span, apart) == 0 and 0 < along[1] < 1:
        yield Fraction(0), along[1]
    area = cross(span, other_span)
    if area:
        at, other_at = Fraction(cross(apart, other_span), area), Fraction(cross(apart, span), area)
        if 0 < at < 1 and 0 < other_at < 1:
            yield at, other_at


@given(seeds, st.sampled_from([3.0, 8.0, 30.0]))
@settings(max_examples=40, deadline=None)
def test_contacts_of_contours_on_a_grid_are_those_of_exact_arithmetic(seed, size):
    rng = np.random.default_rng(seed)
    below, above = (
        edges_of([star(rng, 10, size) for _ in range(2)], rng.integers(0, 2, 2)) for _ in "ab"
    )
    exact = {}
    lines = [
        [
            tuple(map(tuple, edge))
            for edge in np.stack([edges.starts, edges.ends], 1).astype(int).tolist()
        ]
        for edges in (below, above)
    ]
    for low, first in enumerate(lines[0]):
        for high, second in enumerate(lines[1]):
            if below.groups[low] == above.groups[high]:
                for at, other_at in places_in_common(first, second):
                    exact[low, high, at == 0, other_at == 0] = float(at), float(other_at)
    contacts = find_contacts(below, above)
    found = {
        (low, high, at == 0, other_at == 0): (at, other_at)
        for low, high, at, other_at in zip(
            contacts.below.tolist(),
            contacts.above.tolist(),
            contacts.below_at.tolist(),
            contacts.above_at.tolist(),
            strict=True,
        )
    }
    assert found.keys() == exact.keys()
    assert all(found[key] == pytest.approx(exact[key], abs=1e-9) for key in exact)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_no_contact_is_found_twice(seed):
    rng = np.random.default_rng(seed)
    below, above = (edges_of([star(rng, 40, 20.0)], [0]) for _ in "ab")
    contacts = find_contacts(below, above)
    rows = np.column_stack([contacts.below, contacts.above, contacts.below_at, contacts.above_at])
    assert len(np.unique(rows, axis=0)) == len(rows)


def test_groups_and_sides_without_edges_have_no_contacts():
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    one, other = edges_of([square], [0]), edges_of([square + 1.0], [1])
    nothing = Edges(np.empty((0, 2)), np.empty((0, 2)), np.empty(0, dtype=np.int64))
    for below, above in ((one, other), (one, nothing), (nothing, other), (nothing, nothing)):
        contacts = find_contacts(below, above)
        assert len(contacts.below) == len(contacts.above) == len(contacts.points) == 0


def test_vertices_within_the_touch_are_one():
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    shaken = square + np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0]]) * TOUCH / 2
    contacts = find_contacts(edges_of([square], [0]), edges_of([shaken], [0]))
    assert sorted(contacts.below.tolist()) == [0, 1, 2, 3]
    assert contacts.above.tolist() == contacts.below.tolist()
    assert not contacts.below_at.any()
    assert not contacts.above_at.any()


EDGE = (np.zeros((1, 2)), np.ones((1, 2)), np.zeros(1, dtype=np.int64))


@pytest.mark.parametrize(
    ("place", "value", "error"),
    [
        (0, np.array([[np.nan, 0.0]]), ValueError),
        (4, np.array([[0.0, np.inf]]), ValueError),
        (1, np.zeros((2, 2)), ValueError),
        (5, np.zeros(0, dtype=np.int64), ValueError),
        (3, np.zeros((1, 3)), TypeError),
        (2, np.zeros(1), TypeError),
        (6, np.nan, ValueError),
        (6, "near", TypeError),
    ],
)
def test_edges_that_do_not_fit_are_refused(place, value, error):
    arguments = [*EDGE, *EDGE, TOUCH]
    assert len(contacts(*arguments)) > 0
    arguments[place] = value
    with pytest.raises(error):
        contacts(*arguments)
    with pytest.raises(TypeError, match=r"^Expected 6 arrays"):
        contacts(*EDGE, TOUCH)
