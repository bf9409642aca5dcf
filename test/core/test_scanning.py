"""Segments of scan lines inside outlines: against GEOS."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from momrec_core._scanning import scan
from momrec_core.rings import Rings, ends_of
from momrec_core.scanning import scan_spans

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [0.0, 1.0]])


def outline_of(*loops):
    return Rings(np.concatenate(loops), ends_of(np.array([len(loop) for loop in loops])))


@given(st.integers(0, 2**32 - 1), st.integers(5, 40))
def test_segments_are_those_of_lines_within_a_star_with_a_hole(seed, count):
    rng = np.random.default_rng(seed)
    turn = 2 * np.pi * (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count
    star = rng.uniform(1.0, 3.0, (count, 1)) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    hole = 0.2 * star[::-1]
    region = shapely.Polygon(star).symmetric_difference(shapely.Polygon(hole))
    offsets = rng.permutation(np.linspace(-3.1, 3.1, 37))
    spans, counts = scan_spans(outline_of(star, hole), offsets, 1e-9)
    ends = ends_of(counts)
    for line, offset in enumerate(offsets):
        across = shapely.LineString([(-9.0, offset), (9.0, offset)])
        parts = shapely.get_parts(region.intersection(across))
        expected = np.array([part.bounds[0::2] for part in parts if part.length > 1e-9])
        found = spans[ends[line] : ends[line + 1]]
        assert len(found) == len(expected)
        np.testing.assert_allclose(found, np.sort(expected.reshape(-1, 2), axis=0), atol=1e-9)


def test_segments_that_nearly_touch_are_one_and_slim_ones_are_none():
    near, far, slim = SQUARE.copy(), SQUARE.copy(), SQUARE * (1e-3, 1.0)
    near[:, 0] += 4.001
    far[:, 0] += 8.1
    slim[:, 0] -= 5.0
    spans, counts = scan_spans(outline_of(far, SQUARE, slim, near), np.array([0.5, 2.0]), 0.01)
    np.testing.assert_allclose(spans, [[0.0, 8.001], [8.1, 12.1]])
    assert counts.tolist() == [2, 0]


def test_a_line_through_a_vertex_crosses_the_outline_there_once():
    diamond = np.array([[1.0, 0.0], [2.0, 1.0], [1.0, 2.0], [0.0, 1.0]])
    spans, counts = scan_spans(outline_of(diamond), np.array([0.0, 1.0, 2.0]), 1e-9)
    np.testing.assert_allclose(spans, [[0.0, 2.0]])
    assert counts.tolist() == [0, 1, 0]


def test_rings_that_do_not_agree_with_their_points_are_refused():
    for ends in ([0, 5], [1, 4], [0, 0, 4], [0, 3, 2, 4], []):
        with pytest.raises(ValueError, match="rings with vertices"):
            scan(SQUARE, np.array(ends, dtype=np.int64), np.zeros(1), 0.0)
    with pytest.raises(TypeError, match="kind or shape of points"):
        scan(SQUARE[:, :1].copy(), np.array([0, 4]), np.zeros(1), 0.0)
    with pytest.raises(TypeError, match="Expected 4 arguments, got 3"):
        scan(SQUARE, np.array([0, 4]), np.zeros(1))
