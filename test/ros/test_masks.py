"""Contours of rasterised shapes against the shapes, and of noise against its pixels."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from shapely import MultiPolygon, Point, Polygon

from momrec_core import InvalidContourError
from momrec_ros.masks import contours_of_mask, hull_silhouette, object_pixels

SIDE = 120


def rasterised(region, shape=(SIDE, SIDE)):
    """Return which pixel centres lie in a region."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    shapely.prepare(region)
    return shapely.contains_xy(region, columns, rows)


def overlap(first, second):
    return (first & second).sum() / (first | second).sum()


def random_shapes(count):
    rng = np.random.default_rng(7)
    for _ in range(count):
        center = rng.uniform(57, 63, 2)
        yield Point(center).buffer(rng.uniform(12, 50), quad_segs=128)
        angles = 2 * np.pi * np.arange(9) / 9
        spikes = center + rng.uniform(20, 50, (9, 1)) * np.column_stack(
            [np.cos(angles), np.sin(angles)]
        )
        yield Polygon(spikes).difference(Point(center).buffer(8))


def test_the_area_of_rasterised_shapes_is_kept_without_bias():
    offsets = []
    for shape in random_shapes(20):
        region = contours_of_mask(rasterised(shape)).region
        offsets.append((region.area - shape.area) / shape.length)
    assert abs(np.mean(offsets)) < 0.02
    assert np.abs(offsets).max() < 0.08


def test_the_outline_of_rasterised_shapes_is_within_a_pixel_and_a_quarter_on_average():
    for shape in random_shapes(12):
        region = contours_of_mask(rasterised(shape)).region
        points = shapely.points(shapely.get_coordinates(shapely.segmentize(region, 0.5)))
        distances = shapely.distance(shape.boundary, points)
        assert distances.max() < 0.85
        assert np.sqrt(np.mean(distances**2)) < 0.3


def test_contours_rasterise_to_the_mask_again():
    overlaps = []
    for shape in random_shapes(12):
        mask = rasterised(shape)
        region = contours_of_mask(mask).region
        overlaps.append(overlap(rasterised(region), mask))
    assert np.mean(overlaps) > 0.995
    assert min(overlaps) > 0.99


@settings(max_examples=60, deadline=None)
@given(
    arrays(np.bool_, (14, 17), elements=st.booleans()),
    st.sampled_from([0.0, 0.3, 0.5, 1.0]),
)
def test_contours_of_noise_are_valid_and_within_the_tolerance(mask, tolerance):
    mask[6, 6] = True
    exact = contours_of_mask(mask, tolerance=0, min_area=0).region
    region = contours_of_mask(mask, tolerance=tolerance, min_area=0).region
    assert region.is_valid
    assert len(region.geoms) == len(exact.geoms)
    assert (
        shapely.hausdorff_distance(region.boundary, exact.boundary, densify=0.1) < 1e-9 + tolerance
    )


@settings(max_examples=60, deadline=None)
@given(arrays(np.bool_, (9, 11), elements=st.booleans()))
def test_the_unsimplified_outline_separates_object_from_background_pixels(mask):
    mask[4, 4] = True
    region = contours_of_mask(mask, tolerance=0, min_area=0).region
    np.testing.assert_array_equal(rasterised(region, mask.shape), mask)


def test_an_axis_aligned_edge_lies_halfway_between_pixel_centres():
    mask = np.zeros((40, 50), dtype=bool)
    mask[10:30, 5:45] = True
    assert contours_of_mask(mask).region.bounds == (4.5, 9.5, 44.5, 29.5)


def test_holes_and_pieces_are_kept():
    mask = rasterised(Point(30, 40).buffer(20).difference(Point(30, 40).buffer(10)))
    mask |= rasterised(Point(30, 40).buffer(5)) | rasterised(Point(90, 80).buffer(12))
    found = contours_of_mask(mask)
    assert len(found.region.geoms) == 3
    assert sorted(len(piece.interiors) for piece in found.region.geoms) == [0, 0, 1]
    assert found.specks == 0


def test_specks_are_left_out_and_counted_be_they_pieces_or_holes():
    mask = rasterised(Point(60, 60).buffer(30))
    mask[60, 60] = False
    mask[5:8, 5:8] = True
    found = contours_of_mask(mask)
    assert found.specks == 2
    assert isinstance(found.region, MultiPolygon)
    assert shapely.get_num_interior_rings(found.region.geoms[0]) == 0
    assert contours_of_mask(mask, min_area=0).specks == 0


@pytest.mark.parametrize(
    "edge", [np.s_[0, 50:70], np.s_[-1, 50:70], np.s_[50:70, 0], np.s_[50:70, -1]]
)
def test_an_object_at_the_border_is_flagged(edge):
    mask = rasterised(Point(60, 60).buffer(30))
    assert not contours_of_mask(mask).touches_border
    mask[edge] = True
    assert contours_of_mask(mask, min_area=4).touches_border


def test_a_speck_at_the_border_is_no_cut_object():
    mask = rasterised(Point(60, 60).buffer(30))
    mask[0, 0] = True
    assert not contours_of_mask(mask).touches_border


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_values_above_half_the_range_are_object(dtype):
    top = np.iinfo(dtype).max
    inside = rasterised(Point(60, 60).buffer(30))
    grey = np.where(inside, top // 2 + 1, top // 2).astype(dtype)
    np.testing.assert_array_equal(
        shapely.get_coordinates(contours_of_mask(grey).region),
        shapely.get_coordinates(contours_of_mask(inside).region),
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_where_no_value_is_above_one_those_of_one_are_object(dtype):
    inside = rasterised(Point(60, 60).buffer(30))
    np.testing.assert_array_equal(object_pixels(inside.astype(dtype)), inside)
    labels = inside.astype(dtype)
    labels[0, 0] = 2
    with pytest.raises(InvalidContourError, match=r"an empty one \(largest value 2\)"):
        contours_of_mask(labels)


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_a_tolerance_or_a_smallest_area_that_is_none_is_refused(value):
    mask = rasterised(Point(60, 60).buffer(30))
    with pytest.raises(ValueError, match="tolerance of 0 pixels or more, got"):
        contours_of_mask(mask, tolerance=value)
    with pytest.raises(ValueError, match="smallest area of 0 pixels or more, got"):
        contours_of_mask(mask, min_area=value)


def test_an_object_in_a_corner_goes_on_around_it_whatever_the_tolerance():
    disc = Point(12, 14).buffer(40)
    for tolerance in (0.0, 0.5, 5.0):
        contours = contours_of_mask(rasterised(disc), tolerance=tolerance)
        silhouette = hull_silhouette(contours, margin=1.0)
        assert disc.buffer(-0.5 - tolerance).difference(silhouette).area < 1e-6


def test_the_tolerance_holds_in_straightened_pixels():
    mask = rasterised(Point(60, 60).buffer(40).difference(Point(50, 70).buffer(9)))

    def straighten(pixels):
        return pixels * (1 + 2e-5 * np.sum((pixels - 60) ** 2, axis=1, keepdims=True))

    exact = contours_of_mask(mask, tolerance=0.0, straighten=straighten).region
    np.testing.assert_allclose(
        shapely.get_coordinates(exact),
        straighten(shapely.get_coordinates(contours_of_mask(mask, tolerance=0.0).region)),
    )
    region = contours_of_mask(mask, tolerance=0.5, straighten=straighten).region
    assert len(shapely.get_coordinates(region)) < 0.3 * len(shapely.get_coordinates(exact))
    assert shapely.hausdorff_distance(region.boundary, exact.boundary, densify=0.1) < 0.52


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.zeros((5, 5), bool), "shows an object, got an empty one"),
        (np.eye(5, dtype=bool), "object of 16 pixels or more, got 5 pieces"),
        (np.zeros((5, 5, 3), bool), r"shape \(height, width\), got \(5, 5, 3\)"),
        (np.zeros((5, 5)), "booleans or unsigned integers, got float64"),
        (np.zeros((0, 0), bool), "an empty one"),
        (np.broadcast_to(np.True_, (10_000, 10_000)), "at most 64000000 pixels, got 100000000"),
    ],
)
def test_what_is_no_mask_is_refused_with_what_came(mask, message):
    with pytest.raises(InvalidContourError, match=message):
        contours_of_mask(mask)


def test_a_margin_grows_a_silhouette_by_its_width_all_around():
    disc = contours_of_mask(rasterised(Point(60, 60).buffer(30)))
    assert hull_silhouette(disc, margin=0.0).equals(disc.region)
    for margin in (0.25, 1.0):
        grown = hull_silhouette(disc, margin=margin)
        assert grown.is_valid
        assert grown.contains(disc.region)
        expected = disc.region.area + margin * disc.region.length
        assert grown.area == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("margin", [-0.1, float("nan"), float("inf")])
def test_a_margin_that_is_none_is_refused(margin):
    disc = contours_of_mask(rasterised(Point(60, 60).buffer(30)))
    with pytest.raises(ValueError, match="margin of 0 pixels or more"):
        hull_silhouette(disc, margin=margin)


@pytest.mark.parametrize("center", [(0, 60), (SIDE, 60), (60, 0), (60, SIDE)])
def test_an_object_cut_by_the_border_may_go_on_outside(center):
    disc = Point(center).buffer(30)
    contours = contours_of_mask(rasterised(disc))
    assert contours.touches_border
    silhouette = hull_silhouette(contours, margin=1.0)
    assert disc.buffer(-0.5).difference(contours.region).area > 1000
    assert disc.buffer(-0.5).difference(silhouette).area < 1
    inside = silhouette.intersection(contours.frame)
    assert inside.difference(contours.region.buffer(1.5)).area < 5
