"""Contacts of contours, against shapely's intersections and against trying all pairs of edges."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from momrec_core._meeting import contacts
from momrec_core.noding import TOUCH, find_contacts
from momrec_core.rings import Rings

seeds = st.integers(0, 2**32 - 1)


def contours_of(below, above, groups=None):
    """Return contours of two layers, and for each its number, group and layer."""
    loops = [*below, *above]
    points = np.concatenate([np.empty((0, 2)), *loops])
    first = np.cumsum([0, *map(len, loops)])
    rings = Rings(np.column_stack([points, np.zeros(len(points))]), first)
    groups = np.zeros(len(loops), dtype=np.int64) if groups is None else groups
    return rings, np.arange(len(loops)), groups, np.arange(len(loops)) >= len(below)


def edges_of(rings):
    """Return the edges of contours, shape (n, 2, 2), numbered as the vertices they start from."""
    return np.stack([rings.points, rings.points[rings.following]], axis=1)[..., :2]


def star(rng, count, size):
    """Return a contour around the origin; with sizes of whole numbers, many touch."""
    angles = np.sort(rng.uniform(0.0, 2 * np.pi, count))
    radii = rng.uniform(1.0, size, count)
    ring = np.round(np.column_stack([np.cos(angles), np.sin(angles)]) * radii[:, None])
    kept = (ring != np.roll(ring, 1, axis=0)).any(axis=1)
    return ring[kept]


@given(seeds, st.integers(1, 3), st.sampled_from([4.0, 30.0, 1000.0]))
@settings(max_examples=60, deadline=None)
def test_contacts_are_where_contours_of_a_group_meet(seed, groups, size):
    rng = np.random.default_rng(seed)
    below, above = ([star(rng, 12, size) for _ in range(groups)] for _ in "ab")
    numbers = np.tile(np.arange(groups), 2)
    rings, *chosen = contours_of(below, above, numbers)
    contacts = find_contacts(rings, *chosen)
    edges, of_edges = edges_of(rings), np.repeat(np.arange(2 * groups), rings.counts)
    lines, points = shapely.linestrings(edges), shapely.points(contacts.points)
    assert (of_edges[contacts.below] == contacts.groups).all()
    assert (of_edges[contacts.above] == contacts.groups + groups).all()
    for which, at in ((contacts.below, contacts.below_at), (contacts.above, contacts.above_at)):
        assert (shapely.distance(points, lines[which]) <= 2 * TOUCH).all()
        along = edges[which, 0] + at[:, None] * (edges[which, 1] - edges[which, 0])
        assert (np.linalg.norm(along - contacts.points, axis=1) <= 2 * TOUCH).all()
    for group in range(groups):
        found = shapely.multipoints(contacts.points[contacts.groups == group])
        low, high = (lines[of_edges == contour] for contour in (group, group + groups))
        corners = shapely.points(
            shapely.get_coordinates(shapely.intersection(low[:, None], high[None]))
        )
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
    below, above = ([star(rng, 10, size) for _ in range(2)] for _ in "ab")
    rings, *chosen = contours_of(below, above, rng.integers(0, 2, 4))
    of_edges = np.repeat(chosen[1], rings.counts)
    lines = [tuple(map(tuple, edge)) for edge in edges_of(rings).astype(int).tolist()]
    border = int(rings.first[2])
    exact = {}
    for low, high in product(range(border), range(border, len(lines))):
        if of_edges[low] == of_edges[high]:
            for at, other_at in places_in_common(lines[low], lines[high]):
                exact[low, high, at == 0, other_at == 0] = float(at), float(other_at)
    contacts = find_contacts(rings, *chosen)
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
    contacts = find_contacts(*contours_of([star(rng, 40, 20.0)], [star(rng, 40, 20.0)]))
    rows = np.column_stack([contacts.below, contacts.above, contacts.below_at, contacts.above_at])
    assert len(np.unique(rows, axis=0)) == len(rows)


SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])


def test_groups_layers_and_contours_that_are_not_chosen_have_no_contacts():
    rings, contours, groups, is_above = contours_of([SQUARE], [SQUARE + 1.0])
    assert len(find_contacts(rings, contours, groups, is_above).points) == 2
    for chosen in (
        (contours, np.array([0, 1]), is_above),
        (contours, groups, np.array([True, True])),
        (contours[1:], groups[1:], is_above[1:]),
        (contours[:0], groups[:0], is_above[:0]),
    ):
        contacts = find_contacts(rings, *chosen)
        assert len(contacts.below) == len(contacts.above) == len(contacts.points) == 0


def test_vertices_within_the_touch_are_one():
    shaken = SQUARE + np.array([[1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0]]) * TOUCH / 2
    contacts = find_contacts(*contours_of([SQUARE], [shaken]))
    assert sorted(contacts.below.tolist()) == [0, 1, 2, 3]
    assert (contacts.above == contacts.below + 4).all()
    assert not contacts.below_at.any()
    assert not contacts.above_at.any()


@pytest.mark.parametrize(
    ("place", "value", "error"),
    [
        (0, np.full((8, 3), np.nan), ValueError),
        (0, np.full((8, 3), np.inf), ValueError),
        (0, np.zeros((8, 2)), TypeError),
        (1, np.array([0, 4, 7]), ValueError),
        (1, np.array([0, 0, 8]), ValueError),
        (1, np.empty(0, dtype=np.int64), ValueError),
        (2, np.array([0, 2]), ValueError),
        (2, np.array([-1, 0]), ValueError),
        (2, np.zeros(2), TypeError),
        (3, np.zeros(3, dtype=np.int64), ValueError),
        (4, np.zeros(1, dtype=bool), ValueError),
        (5, np.nan, ValueError),
        (5, "near", TypeError),
    ],
)
def test_contours_that_do_not_fit_are_refused(place, value, error):
    rings, *chosen = contours_of([SQUARE], [SQUARE + 1.0])
    arguments = [rings.points, rings.first, *chosen, TOUCH]
    assert len(contacts(*arguments)) > 0
    arguments[place] = value
    with pytest.raises(error):
        contacts(*arguments)
    with pytest.raises(TypeError, match=r"^Expected 5 arrays"):
        contacts(rings.points, rings.first, TOUCH)
