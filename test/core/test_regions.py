"""Regions of many planes against GEOS and Clipper2."""

import pickle
import resource

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from shapely import MultiPolygon, Polygon

from momrec_core import _clipping
from momrec_core.regions import CLEARANCE, Footprints, Regions
from momrec_core.rings import Rings

SEEDS = st.integers(0, 2**32 - 1)
RELAXED = settings(deadline=None, max_examples=60)


def star(rng, count, radius=100.0, centre=(0.0, 0.0)):
    """Return a ring around a centre, counter-clockwise."""
    angles = (np.arange(count) + rng.uniform(0, 0.9, count)) * 2 * np.pi / count
    radii = radius * rng.uniform(0.6, 1.0, count)
    return np.column_stack([np.cos(angles), np.sin(angles)]) * radii[:, None] + centre


def random_region(rng):
    """Return a few separate rings, some with a hole."""
    rings = []
    for place in range(rng.integers(1, 4)):
        centre = (250.0 * place, rng.uniform(-50, 50))
        rings.append(star(rng, rng.integers(6, 40), 100.0, centre))
        if rng.random() < 0.5:
            rings.append(star(rng, rng.integers(3, 12), 25.0, centre)[::-1])
    return rings


def polygon_of(rings):
    """Return a region of rings with the inside on their left as GEOS sees it."""
    signed = [(Polygon(ring), Polygon(ring).exterior.is_ccw) for ring in rings]
    shells = shapely.union_all([polygon for polygon, is_shell in signed if is_shell])
    return shells - shapely.union_all([polygon for polygon, is_shell in signed if not is_shell])


def footprints_of(rng, count):
    """Return outlines, some of them for several planes, scaled and shifted."""
    outlines = [random_region(rng) for _ in range(3)]
    chosen, scales = rng.integers(0, 3, count), rng.uniform(0.5, 2.0, count)
    shifts = rng.uniform(-100, 100, (count, 2))
    placed = [
        polygon_of([scale * ring + shift for ring in outlines[which]])
        for which, scale, shift in zip(chosen, scales, shifts, strict=True)
    ]
    return Footprints(Regions.of_rings(outlines), chosen, scales, shifts), placed


@RELAXED
@given(SEEDS)
def test_clipped_regions_are_what_geos_finds(seed):
    rng = np.random.default_rng(seed)
    regions = [random_region(rng) for _ in range(5)]
    steps = [footprints_of(rng, 5) for _ in range(3)]
    clipped = Regions.of_rings(regions).clipped([footprints for footprints, _ in steps])
    for plane, (rings, found) in enumerate(zip(regions, clipped.polygons(1.0), strict=True)):
        expected = polygon_of(rings)
        for _, placed in steps:
            expected &= placed[plane]
        assert found.is_valid
        assert shapely.area(found ^ expected) < 1e-6
        assert clipped.areas[plane] == pytest.approx(expected.area, abs=1e-6)


@RELAXED
@given(SEEDS)
def test_degenerate_regions_are_clipped_as_geos_does(seed):
    rng = np.random.default_rng(seed)

    def blocks():
        cells = rng.integers(0, 2, (3, 3))
        cells[1, 1] = 1
        squares = [shapely.box(x, y, x + 1, y + 1) for x, y in np.argwhere(cells)]
        region = shapely.orient_polygons(shapely.union_all(squares))
        parts = shapely.get_parts(region)
        return [np.array(ring.coords)[:-1] for part in parts for ring in shapely.get_rings(part)]

    below, above = ([blocks() for _ in range(4)] for _ in range(2))
    footprints = Footprints.as_they_are(Regions.of_rings(above))
    clipped = Regions.of_rings(below).clipped([footprints])
    for one, other, area in zip(below, above, clipped.areas, strict=True):
        assert area == pytest.approx((polygon_of(one) & polygon_of(other)).area, abs=1e-6)


def test_a_region_clipped_with_itself_stays():
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    regions = Regions.of_rings([[square], []])
    clipped = regions.clipped([Footprints.as_they_are(regions)] * 2)
    assert_allclose(clipped.areas, [100.0, 0.0])
    assert clipped.is_met.tolist() == [True, False]


def test_a_ring_inside_the_other_or_around_it_is_the_smaller_of_both():
    small, large = (radius * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]) for radius in (1.0, 5.0))
    regions, others = Regions.of_rings([[small], [large]]), Regions.of_rings([[large], [small]])
    assert_allclose(regions.clipped([Footprints.as_they_are(others)]).areas, [2.0, 2.0])


def test_regions_apart_leave_nothing():
    near = Regions.of_rings([[star(np.random.default_rng(1), 20)]])
    far = Footprints(near, np.zeros(1, dtype=np.int64), np.ones(1), np.array([[1000.0, 0.0]]))
    assert not near.clipped([far]).is_met.any()


def test_long_spikes_take_no_more_memory_than_vertices():
    count = 4000
    x = np.repeat(np.arange(count), 2) + np.tile([0.0, 0.5], count)
    comb = np.column_stack([x, np.tile([1.0, 1e4], count)])
    ring = np.concatenate([[[x[-1] + 1, 0.0], *comb[::-1], [-1.0, 0.0]]])[::-1]
    regions = Regions.of_rings([[ring if Polygon(ring).exterior.is_ccw else ring[::-1]]])
    band = np.array([[-10.0, 50.0], [5000.0, 50.0], [5000.0, 60.0], [-10.0, 60.0]])
    clipped = regions.clipped([Footprints.as_they_are(Regions.of_rings([[band]]))])
    expected = Polygon(ring) & Polygon(band)
    assert clipped.areas[0] == pytest.approx(expected.area, rel=1e-9)


def test_long_slanted_edges_take_no_more_memory_than_vertices():
    arc = np.linspace(0, np.pi / 2, 60_000)
    round_edge = np.column_stack([np.cos(arc), np.sin(arc)])
    teeth = np.linspace(0, 0.9, 346)[:, None] * [0.0, 1.0] + 0.04
    teeth[::2] = 1 - teeth[::2, ::-1]
    comb = Regions.of_rings([[1000 * round_edge, 1000 * teeth]])
    small = Regions.of_rings([[np.array([[5.0, 5.0], [6.0, 5.0], [5.0, 6.0]])]])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    small.clipped([Footprints.as_they_are(comb)])
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 1024  # KiB


def test_slivers_that_cleaning_would_turn_over_are_left_out():
    sliver = np.array([[0.34, 0.05], [0.01, 0.11], [0.18, 0.02], [0.97, 0.16]])
    block = np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]])
    cleaned = Regions.of_rings([[sliver], [block, sliver[::-1]], [block]]).cleaned(0.1)
    assert cleaned.rings.areas.tolist() == [324.0, 324.0]
    pieces, ends = cleaned.apart()
    assert ends.tolist() == [0, 0, 1, 2]
    assert pieces.areas.tolist() == [324.0, 324.0]


def test_rings_that_cleaning_leaves_no_area_are_left_out():
    flat = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 0.0]])
    assert not Regions.of_rings([[flat]]).cleaned(0.1).is_met.any()


@RELAXED
@given(SEEDS, st.floats(1e-3, 5.0))
def test_cleaned_rings_stay_within_the_tolerance(seed, tolerance):
    rng = np.random.default_rng(seed)
    rings = [star(rng, rng.integers(3, 200), radius) for radius in (1.0, 100.0)]
    cleaned = Regions.of_rings([[ring] for ring in rings]).cleaned(tolerance)
    for region, ring in enumerate(rings):
        left = cleaned.loops(region)
        if not left:
            assert shapely.hausdorff_distance(Polygon(ring), shapely.Point(ring[0])) < 2.1
            continue
        vertices = {tuple(vertex) for vertex in ring.tolist()}
        assert {tuple(vertex) for vertex in left[0].tolist()} <= vertices
        outline = shapely.LinearRing(left[0])
        assert shapely.distance(shapely.points(ring), outline).max() <= tolerance * (1 + 1e-9)


def test_rounding_between_vertices_is_cleaned_away():
    square = np.array([[0.0, 0.0], [5.0, 1e-7], [10.0, 0.0], [10.0, 1e-7], [10.0, 10.0], [0.0, 10]])
    cleaned = Regions.of_rings([[square]]).cleaned(1e-3)
    assert cleaned.rings.counts.tolist() == [4]


@RELAXED
@given(SEEDS)
def test_pieces_are_those_of_geos(seed):
    rng = np.random.default_rng(seed)
    regions = [random_region(rng) for _ in range(4)]
    shuffled = [[rings[at] for at in rng.permutation(len(rings))] for rings in regions]
    pieces, ends = Regions.of_rings(shuffled).apart()
    for rings, low, high in zip(regions, ends[:-1], ends[1:], strict=True):
        expected = sorted(part.area for part in shapely.get_parts(polygon_of(rings)))
        assert_allclose(sorted(pieces.areas[low:high]), expected)
    assert (pieces.rings.areas[pieces.first[:-1]] > 0).all()


def test_nested_pieces_keep_their_own_holes():
    radii = [(100.0, 1), (80.0, -1), (60.0, 1), (40.0, -1), (20.0, 1)]
    square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    rings = [radius * square[::turn] for radius, turn in radii]
    pieces, ends = Regions.of_rings([rings]).apart()
    assert ends.tolist() == [0, 3]
    expected = [4 * (100.0**2 - 80.0**2), 4 * (60.0**2 - 40.0**2), 4 * 20.0**2]
    assert_allclose(pieces.areas, expected)


def test_holes_of_no_shell_are_left_out():
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    pieces, ends = Regions.of_rings([[square[::-1]], [square, square[::-1] / 2 + 1]]).apart()
    assert ends.tolist() == [0, 0, 1]
    assert_allclose(pieces.areas, [12.0])


def test_contours_are_turned_until_the_inside_is_on_the_left():
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    hole = np.array([[1.0, 1.0], [1.0, 2.0], [2.0, 2.0], [2.0, 1.0]])
    clockwise = Regions.of_rings([[square[::-1], hole[::-1]], [square]])
    turned = Regions.facing_left(clockwise.rings, clockwise.first)
    assert_allclose(turned.areas, [15.0, 16.0])
    assert turned.rings.areas.tolist() == [16.0, -1.0, 16.0]


@RELAXED
@given(SEEDS, st.lists(st.integers(0, 4), max_size=12))
def test_regions_are_chosen_in_any_order_and_as_often_as_wanted(seed, chosen):
    rng = np.random.default_rng(seed)
    loops = [random_region(rng) if rng.random() < 0.7 else [] for _ in range(5)]
    taken = Regions.of_rings(loops).take(np.array(chosen, dtype=np.int64))
    assert len(taken) == len(chosen)
    for place, which in enumerate(chosen):
        found = taken.loops(place)
        assert len(found) == len(loops[which])
        assert all(map(np.array_equal, found, loops[which]))


@pytest.mark.parametrize("number", [-1, 2, 2**62])
def test_regions_that_are_not_there_are_refused(number):
    regions = Regions.of_rings([[star(np.random.default_rng(0), 5)], []])
    with pytest.raises(ValueError, match="arrays that agree"):
        regions.take(np.array([1, number]))


def test_unions_are_taken_plane_by_plane():
    one, other = shapely.box(0, 0, 2, 2), shapely.box(1, 1, 3, 3)
    rings = [[np.array(shapely.orient_polygons(box).exterior.coords)[:-1]] for box in (one, other)]
    united = Regions.of_rings([rings[0], rings[0], [], []]).united(
        Regions.of_rings([rings[1], [], rings[1], []])
    )
    assert_allclose(united.areas, [7.0, 4.0, 4.0, 0.0])


def test_regions_survive_pickling_and_become_polygons():
    rng = np.random.default_rng(3)
    regions = Regions.of_rings([random_region(rng), [], random_region(rng)])
    again = pickle.loads(pickle.dumps(regions))  # noqa: S301 -- our own bytes
    polygons = again.polygons(2.0)
    assert [type(polygon) for polygon in polygons] == [MultiPolygon] * 3
    assert_allclose([polygon.area for polygon in polygons], 4 * regions.areas)


GOOD = {
    "points": np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    "rings": np.array([0, 3]),
    "regions": np.array([0, 1]),
    "done": np.array([0]),
    "outline_points": np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    "outline_rings": np.array([0, 3]),
    "outline_regions": np.array([0, 1]),
    "chosen": np.array([0]),
    "scales": np.array([1.0]),
    "shifts": np.array([[0.25, 0.25]]),
}


def clip(arrays):
    """Clip with what is in `GOOD` or in its place."""
    ordered = list((GOOD | {"done": np.array([0])} | arrays).values())
    return _clipping.clip(*ordered[:4], (tuple(ordered[4:]),), CLEARANCE)


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("points", np.array([[0.0, 0.0], [np.nan, 0.0], [0.0, 1.0]]), ValueError),
        ("points", np.zeros((2, 2)), ValueError),
        ("points", np.zeros((3, 3)), TypeError),
        ("points", np.zeros((3, 2), dtype=np.float32), TypeError),
        ("rings", np.array([0, 2, 3]), ValueError),
        ("rings", np.array([0, -3]), ValueError),
        ("regions", np.array([0, 2]), ValueError),
        ("regions", np.array([1]), ValueError),
        ("outline_points", np.array([[0.0, 0.0], [np.inf, 0.0], [0.0, 1.0]]), ValueError),
        ("outline_regions", np.array([], dtype=np.int64), ValueError),
        ("chosen", np.array([1]), ValueError),
        ("chosen", np.array([-1]), ValueError),
        ("chosen", np.array([0.0]), TypeError),
        ("outline_points", np.array([[-1.7e308, 0], [1.7e308, 0], [0, 1]]), ValueError),
        ("scales", np.array([0.0]), ValueError),
        ("scales", np.array([1e-300]), ValueError),
        ("scales", np.array([np.nan]), ValueError),
        ("shifts", np.array([[np.inf, 0.0]]), ValueError),
        ("shifts", np.zeros((2, 2)), ValueError),
        ("done", np.array([-1]), ValueError),
        ("done", np.array([0, 0]), ValueError),
    ],
)
def test_arrays_that_do_not_fit_are_refused(name, value, error):
    clip({})
    with pytest.raises(error, match=r"^Expected"):
        clip({name: value})


def test_steps_that_are_counted_where_outlines_are_chosen_are_refused():
    done = np.array([0])
    with pytest.raises(ValueError, match=r"^Expected"):
        clip({"done": done, "chosen": done})


def test_nothing_left_in_any_plane_stays_nothing():
    arrays = list((GOOD | {"done": np.array([0]), "shifts": np.array([[5.0, 5.0]])}).values())
    points, rings, regions = _clipping.clip(*arrays[:4], (tuple(arrays[4:]),) * 3, CLEARANCE)
    assert points == b""
    assert np.frombuffer(rings, dtype=np.int64).tolist() == [0]
    assert np.frombuffer(regions, dtype=np.int64).tolist() == [0, 0]
    assert arrays[3].tolist() == [3]


def test_a_call_without_all_arguments_is_refused():
    arrays = list(GOOD.values())
    with pytest.raises(TypeError, match=r"^Expected 6 arguments"):
        _clipping.clip(GOOD["points"])
    with pytest.raises(TypeError, match=r"^Expected 3 arrays"):
        _clipping.simplify(GOOD["points"], 0.1)
    with pytest.raises(TypeError):
        _clipping.clip(*arrays[:4], (tuple(arrays[4:]),), "wide")
    for footprints in ([tuple(arrays[4:])], (arrays[4:],), (tuple(arrays[4:]), tuple(arrays[5:]))):
        with pytest.raises(TypeError, match=r"^Expected"):
            _clipping.clip(*arrays[:4], footprints, CLEARANCE)
    beyond = np.array([0, 2**63 - 1, 3]), np.array([0, 2])
    with pytest.raises(ValueError, match=r"^Expected"):
        _clipping.measure(GOOD["points"], *beyond, np.zeros(1), np.zeros((1, 4)))
    with pytest.raises(ValueError, match=r"^Expected"):
        _clipping.apart(GOOD["points"], GOOD["rings"], GOOD["regions"], np.zeros(1, int))
    with pytest.raises(ValueError, match=r"^Expected"):
        _clipping.simplify(GOOD["points"], np.array([0, 4]), GOOD["regions"], 0.1)


def test_rings_without_regions_are_none():
    none = Regions(
        Rings(np.empty((0, 2)), np.zeros(1, dtype=np.int64)), np.zeros(1, dtype=np.int64)
    )
    assert len(none) == len(none.areas) == len(none.apart()[0]) == 0
    assert none.clipped([Footprints.as_they_are(none)]).polygons(1.0) == []
