"""Outlines of binary images against contourpy's, which matplotlib draws with."""

import numpy as np
import pytest
import shapely
import shapely.affinity
from contourpy import FillType, contour_generator
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from momrec_ros.tracing import pixel_outline


def outline_of_contourpy(inside):
    padded = np.pad(inside, 1).astype(float)
    generator = contour_generator(z=padded, name="serial", fill_type=FillType.OuterOffset)
    pieces = []
    for points, starts in zip(*generator.filled(0.5, np.inf), strict=True):
        rings = np.split(points - 1, starts[1:-1])
        pieces.append(shapely.Polygon(rings[0], rings[1:]))
    return shapely.MultiPolygon(pieces)


@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=15), elements=st.booleans()))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_outlines_are_those_of_contourpy(inside):
    inside[0, 0] = True
    ours, theirs = pixel_outline(inside), outline_of_contourpy(inside)
    assert ours.is_valid
    assert len(ours.geoms) == len(theirs.geoms)
    assert ours.symmetric_difference(theirs).area < 1e-9


def test_nested_rings_belong_to_the_smallest_around_them():
    rows, columns = np.mgrid[:41, :41]
    rings = np.maximum(abs(rows - 20), abs(columns - 20)) % 4 < 2
    outline = pixel_outline(rings, left=100.0, top=-7.0)
    assert outline.equals(shapely.affinity.translate(outline_of_contourpy(rings), 100.0, -7.0))
    holes = shapely.get_num_interior_rings(shapely.get_parts(outline))
    assert sorted(holes) == [0, *[1] * (len(holes) - 1)]


def test_an_image_of_one_pixel_is_a_diamond():
    outline = pixel_outline(np.ones((1, 1), bool))
    assert outline.area == pytest.approx(0.5)
    assert outline.bounds == (-0.5, -0.5, 0.5, 0.5)
