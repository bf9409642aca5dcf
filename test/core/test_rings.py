"""Contours one behind the other: measured like each one alone."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from momrec_core.rings import Rings, number_within, runs

seeds = st.integers(0, 2**32 - 1)


def random_loops(rng):
    """Return star-shaped contours, some of them clockwise."""
    loops = []
    for _ in range(rng.integers(1, 8)):
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(5, 40)))
        spokes = np.column_stack([np.cos(angles), np.sin(angles)])
        loop = rng.uniform(-50, 50, 2) + rng.uniform(1, 9, (len(angles), 1)) * spokes
        loops.append(loop[:: rng.choice([1, -1])])
    return loops


def rings_of(loops):
    return Rings(np.concatenate(loops), np.cumsum([0, *(len(loop) for loop in loops)]))


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_areas_and_centroids_are_those_of_shapely(seed):
    loops = random_loops(np.random.default_rng(seed))
    rings = rings_of(loops)
    outlines = [shapely.LinearRing(loop) for loop in loops]
    signs = np.where(shapely.is_ccw(outlines), 1, -1)
    regions = shapely.polygons(outlines)
    centroids = shapely.get_coordinates(shapely.centroid(regions))
    assert np.allclose(rings.areas, signs * shapely.area(regions))
    assert np.allclose(rings.centroids, centroids)


def test_each_contour_closes_on_itself():
    rings = rings_of([np.eye(3, 2), np.ones((1, 2)), np.zeros((4, 2))])
    assert rings.following.tolist() == [1, 2, 0, 3, 5, 6, 7, 4]
    assert np.allclose(rings.total(rings.edges), 0)


@pytest.mark.parametrize("counts", [[3, 0, 2], [0], []])
def test_members_are_numbered_within_their_groups(counts):
    groups, positions = number_within(np.array(counts, dtype=np.int64))
    expected = [(group, place) for group, count in enumerate(counts) for place in range(count)]
    assert list(zip(groups.tolist(), positions.tolist(), strict=True)) == expected


@given(st.lists(st.tuples(st.integers(-99, 99), st.integers(0, 5))))
def test_runs_are_ranges_one_behind_the_other(ranges):
    starts, counts = np.array(ranges, dtype=np.int64).reshape(-1, 2).T
    expected = [number for start, count in ranges for number in range(start, start + count)]
    assert runs(starts, counts).tolist() == expected
