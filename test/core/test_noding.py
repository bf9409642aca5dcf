"""Contacts of contours, against shapely's intersections and against trying all pairs of edges."""

import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

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
    assert contacts.below.tolist() == contacts.above.tolist() == [0, 1, 2, 3]
    assert not contacts.below_at.any()
    assert not contacts.above_at.any()
