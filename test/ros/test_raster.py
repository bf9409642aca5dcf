"""Masks of regions, against shapely's test of each pixel."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import MultiPolygon

from momrec_ros.masks import contours_of_mask
from momrec_ros.raster import mask_of_region

SIZE = (48, 36)


def some_region(seed):
    rng = np.random.default_rng(seed)
    discs = [
        shapely.Point(*rng.uniform(-5, 50, 2)).buffer(rng.uniform(2, 15), quad_segs=3)
        for _ in range(4)
    ]
    holes = shapely.union_all([shapely.centroid(disc).buffer(1.7) for disc in discs])
    return MultiPolygon(list(shapely.get_parts(shapely.union_all(discs) - holes)))


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_pixel_is_of_the_region_that_holds_its_centre(seed):
    region = some_region(seed)
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    mask = mask_of_region(region, SIZE)
    np.testing.assert_array_equal(mask, shapely.contains_xy(region, columns, rows))


def test_regions_that_share_a_boundary_through_pixel_centres_share_no_pixel():
    left, right = shapely.box(2, 3, 7, 9), shapely.box(7, 3, 12, 9)
    masks = [mask_of_region(MultiPolygon([box]), SIZE) for box in (left, right)]
    both = mask_of_region(MultiPolygon([shapely.box(2, 3, 12, 9)]), SIZE)
    assert not (masks[0] & masks[1]).any()
    np.testing.assert_array_equal(masks[0] | masks[1], both)


def test_what_is_outside_of_the_image_leaves_it_empty():
    assert not mask_of_region(MultiPolygon([shapely.box(60, 0, 70, 9)]), SIZE).any()
    assert not mask_of_region(MultiPolygon(), SIZE).any()
    assert mask_of_region(MultiPolygon([shapely.box(-9, -9, 99, 99)]), SIZE).all()


def test_a_traced_mask_is_the_region_again_within_a_pixel():
    region = MultiPolygon([shapely.Point(100.3, 80.7).buffer(60.0)])
    traced = contours_of_mask(mask_of_region(region, (200, 160))).region
    assert shapely.hausdorff_distance(region, traced) < 1.0
    assert traced.area == pytest.approx(region.area, rel=0.01)
