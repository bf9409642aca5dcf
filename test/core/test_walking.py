"""The walks along pairs of contours, against all walks there are."""

import math
from collections import Counter
from itertools import combinations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from momrec_core._bands import expect, greedy, lay, least
from momrec_core.rings import Rings
from momrec_core.walking import walk_bands

HEIGHT = 0.7


def star(rng, count, center=(0.0, 0.0)):
    angles = np.sort(rng.uniform(0.0, 2 * np.pi, count))
    radii = rng.uniform(0.3, 1.0, count)
    return np.column_stack([np.cos(angles), np.sin(angles)]) * radii[:, None] + center


def pair_of(low, high):
    points = np.vstack(
        [np.column_stack([low, np.zeros(len(low))]), np.column_stack([high, len(high) * [HEIGHT]])]
    )
    return Rings(points, np.array([0, len(low), len(points)]))


def arrays_for(rings):
    """Return what walks are made of: the rings, their pair and what it suggests, and no walk."""
    pairs, expected = np.array([[0, 1]]), np.empty((1, 7))
    expect(rings.points, rings.first, pairs, expected)
    rises = np.empty(len(rings.points), dtype=bool)
    return [
        rings.points,
        rings.first,
        pairs,
        expected,
        np.array([[-1, -1]]),
        rises,
        np.empty((1, 3)),
    ]


def walked(how, rings, shift=(0.0, 0.0)):
    arrays = arrays_for(rings)
    *_, starts, rises, fits = arrays
    greedy(*arrays, np.array([shift]))
    if how is least:
        fits[0, 2] = np.inf
        least(*arrays)
    return starts[0], rises, fits[0, :2]


def triangles_of(rings, starts, rises):
    below, above = (
        np.roll(rings.points[first:last], -start, axis=0)
        for first, last, start in zip(rings.first, rings.first[1:], starts, strict=False)
    )
    corners, row, column = [], 0, 0
    for rise in rises:
        low, high = below[row % len(below)], above[column % len(above)]
        row, column = row + rise, column + (not rise)
        third = below[row % len(below)] if rise else above[column % len(above)]
        corners.append((low, third, high))
    return np.array(corners)


def area_of(corners):
    sides = corners[:, 1:] - corners[:, :1]
    return float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()) / 2


counts = st.integers(3, 6)
seeds = st.integers(0, 2**32 - 1)


def is_pinched(rises):
    return np.sum(rises & ~np.roll(rises, -1)) == 1


@given(counts, counts, seeds)
def test_the_least_walk_has_the_least_area_of_all_walks_that_are_not_pinched(below, above, seed):
    rng = np.random.default_rng(seed)
    rings = pair_of(star(rng, below), star(rng, above))
    starts, rises, (area, _) = walked(least, rings)
    steps = np.arange(below + above)
    walks = [np.isin(steps, chosen) for chosen in combinations(steps, below)]
    areas = np.array([area_of(triangles_of(rings, starts, walk)) for walk in walks])
    best = walks[int(areas.argmin())]
    assert area_of(triangles_of(rings, starts, rises)) == pytest.approx(area, rel=1e-12)
    assert not is_pinched(rises)
    if not is_pinched(best):
        assert area == pytest.approx(areas.min(), rel=1e-12)


def least_area(rings, starts):
    """Return the least area of all walks from a pair of vertices, by a table of all of them."""
    low, high = (
        np.roll(rings.points[first:last], -start, axis=0)
        for first, last, start in zip(rings.first, rings.first[1:], starts, strict=False)
    )
    low, high = np.vstack([low, low[:1]]), np.vstack([high, high[:1]])
    rises = np.cross(np.diff(low, axis=0)[:, None], high[None] - low[:-1, None])
    runs = np.cross(np.diff(high, axis=0)[None], low[:, None] - high[None, :-1])
    over, across = (np.linalg.norm(crosses, axis=-1) / 2 for crosses in (rises, runs))
    table = np.zeros((len(low), len(high)))
    for row, column in np.ndindex(table.shape):
        ways = []
        if row:
            ways.append(table[row - 1, column] + over[row - 1, column])
        if column:
            ways.append(table[row, column - 1] + across[row, column - 1])
        table[row, column] = min(ways, default=0.0)
    return table[-1, -1]


def lobed(rng, count):
    angles = 2 * np.pi * (np.arange(count) + rng.uniform(-0.4, 0.4, count)) / count
    waves, phases = rng.uniform(0.0, 0.25, 4), rng.uniform(0.0, 2 * np.pi, 4)
    radii = 1 + (waves * np.cos(np.arange(1, 5) * angles[:, None] + phases)).sum(axis=1)
    notch = rng.uniform(0.0, 2 * np.pi)
    radii[np.abs(np.angle(np.exp(1j * (angles - notch)))) < 0.3] *= 0.5
    return np.column_stack([np.cos(angles), np.sin(angles)]) * radii[:, None]


@given(st.integers(8, 60), st.integers(8, 60), seeds)
@settings(max_examples=40, deadline=None)
def test_a_window_that_follows_the_walk_finds_the_least_of_all(below, above, seed):
    rng = np.random.default_rng(seed)
    rings = pair_of(lobed(rng, below), lobed(rng, above))
    starts, _, (area, _) = walked(least, rings)
    assert area == pytest.approx(least_area(rings, starts), rel=1e-7)


@given(counts, counts, seeds)
def test_the_greedy_walk_takes_the_shorter_diagonal_at_every_step(below, above, seed):
    rng = np.random.default_rng(seed)
    rings = pair_of(star(rng, below), star(rng, above))
    starts, rises, _ = walked(greedy, rings)
    row = column = 0
    for rise in rises:
        low, high = (
            np.roll(rings.points[first:last, :2], -start, axis=0)
            for first, last, start in zip(rings.first, rings.first[1:], starts, strict=False)
        )
        if row < below and column < above:
            up = math.dist(low[(row + 1) % below], high[column % above])
            along = math.dist(low[row % below], high[(column + 1) % above])
            assert rise == (up <= along) or up == pytest.approx(along, rel=1e-5)
        row, column = row + rise, column + (not rise)
    assert (row, column) == (below, above)


@given(counts, counts, seeds, st.sampled_from([greedy, least]))
def test_area_and_flux_are_those_of_the_triangles(below, above, seed, how):
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-2.0, 2.0, 2)
    rings = pair_of(star(rng, below), star(rng, above, shift))
    starts, rises, (area, flux) = walked(how, rings, shift)
    corners = triangles_of(rings, starts, rises)
    sides = corners[:, 1:] - corners[:, :1]
    upward = np.cross(sides[:, 0], sides[:, 1])[:, 2] / 2
    assert flux == pytest.approx(corners[:, :, 2].mean(axis=1) @ upward, abs=1e-12)
    expected = math.inf if is_pinched(rises) else area_of(corners)
    assert area == pytest.approx(expected, rel=1e-12)


@given(seeds, st.integers(3, 40))
def test_a_shifted_contour_is_joined_as_one_that_lies_above(seed, count):
    rng = np.random.default_rng(seed)
    low, high, shift = star(rng, count), star(rng, count + 1), np.array([64.0, -32.0])
    upright, slanted = pair_of(low, high), pair_of(low, high + shift)
    assert np.array_equal(walked(greedy, upright)[1], walked(greedy, slanted, shift)[1])


def polygon(count, turn, radius=1.0):
    angles = 2 * np.pi * (np.arange(count) + turn) / count
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


@given(st.integers(3, 40), st.sampled_from([0.0, 0.5]), st.sampled_from([0.3, 1.0]), seeds)
def test_ties_are_not_decided_by_rounding(count, turn, radius, seed):
    rng = np.random.default_rng(seed)
    low, high = polygon(count, 0.0), polygon(count, turn, radius)
    exact = pair_of(low, high)
    rounded = pair_of(
        *(side + rng.uniform(-1e-10, 1e-10, side.shape) for side in (low, high)),
    )
    for how in (greedy, least):
        (starts, rises, _), (others, other_rises, _) = walked(how, exact), walked(how, rounded)
        assert np.array_equal(starts, others)
        assert np.array_equal(rises, other_rises)
    order, ends = np.arange(2 * count), np.arange(2 * count + 1)
    assert np.array_equal(band_of(exact, order, ends), band_of(rounded, order, ends))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e100, 1e160])
@pytest.mark.parametrize("how", [greedy, least])
def test_coordinates_beyond_measure_end_in_a_walk_all_the_same(how, value):
    rng = np.random.default_rng(5)
    for spoiled in (slice(None), 3, 20):
        rings = pair_of(star(rng, 17), star(rng, 23))
        rings.points[spoiled, 0] *= value
        starts, rises, _ = walked(how, rings)
        assert rises.sum() == 17
        assert 0 <= starts[0] < 17
        assert 0 <= starts[1] < 23


def band_of(rings, order, ends):
    """Return the triangles between two contours with vertices on their edges."""
    bands = walk_bands(rings, np.array([[0, 1]]))
    return bands.triangles(np.array([True]), order, ends, np.empty((0, 3), dtype=np.int64))


@given(st.integers(8, 30), st.integers(8, 30), st.integers(0, 20), seeds)
@settings(max_examples=40, deadline=None)
def test_a_band_uses_every_part_of_both_contours_once(below, above, inserted, seed):
    rng = np.random.default_rng(seed)
    rings = pair_of(star(rng, below), star(rng, above))
    count = below + above
    edges = np.sort(rng.integers(0, count, inserted))
    order = np.insert(np.arange(count), edges + 1, count + np.arange(inserted))
    ends = np.arange(count + 1) + np.searchsorted(edges, np.arange(count + 1))
    triangles = band_of(rings, order, ends)
    sides = Counter(
        (tail, head)
        for triangle in triangles.tolist()
        for tail, head in zip(triangle, triangle[1:] + triangle[:1], strict=True)
    )
    loops = order[: ends[below]].tolist(), order[ends[below] :][::-1].tolist()
    borders = {side for loop in loops for side in zip(loop, loop[1:] + loop[:1], strict=True)}
    assert len(triangles) == count + inserted
    assert set(sides.values()) == {1}
    assert {side for side in sides if side[::-1] not in sides} == borders


def test_bands_that_are_not_chosen_are_left_out_and_other_triangles_stand_behind():
    rng = np.random.default_rng(11)
    rings = pair_of(star(rng, 9), star(rng, 7))
    order, ends = np.arange(16), np.arange(17)
    bands = walk_bands(rings, np.array([[0, 1], [0, 1], [0, 1]]))
    others = np.array([[5, 6, 7]])
    for chosen in ([True, True, False], [False, False, True], [False] * 3):
        triangles = bands.triangles(np.array(chosen), order, ends, others)
        whole = np.concatenate([band_of(rings, order, ends)] * sum(chosen) + [others])
        assert np.array_equal(triangles, whole)


@given(st.integers(8, 30), st.integers(8, 30), seeds)
def test_expectations_are_those_of_prisms_and_slanted_prisms(below, above, seed):
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-2.0, 2.0, 2)
    rings = pair_of(lobed(rng, below), lobed(rng, above) + shift)
    rings.points[:, 2] += 3.0
    found = np.empty((1, 7))
    expect(rings.points, rings.first, np.array([[0, 1]]), found)
    low, high = (shapely.Polygon(rings.points[a:b, :2]) for a, b in ((0, below), (below, None)))
    (x, y), (other_x, other_y) = (np.ravel(side.centroid.coords) for side in (low, high))
    upright, widening = HEIGHT * (low.length + high.length) / 2, abs(high.area - low.area)
    area = math.hypot(upright, widening)
    way = np.array([other_x - x, other_y - y, HEIGHT])
    edges = rings.points[rings.following] - rings.points
    edges[:, 2] = 0.0
    slanted = np.linalg.norm(np.cross(edges, way), axis=1).sum() / 2
    volume = HEIGHT * (low.area + high.area + math.sqrt(low.area * high.area)) / 3
    base = (3.0 + HEIGHT) * high.area - 3.0 * low.area
    slant = math.hypot(slanted, widening) / area - 1
    expected = [area, slant, volume, base, upright + widening, *way[:2]]
    np.testing.assert_allclose(found[0], expected, rtol=1e-9, atol=1e-12)


def test_only_walks_around_their_contours_are_laid():
    rings = pair_of(star(np.random.default_rng(1), 5), star(np.random.default_rng(2), 4))
    triangles = np.empty((9, 3), dtype=np.int64)
    good = {
        "first": rings.first,
        "pairs": np.array([[0, 1]]),
        "starts": np.array([[4, 3]]),
        "rises": np.arange(9) < 5,
        "is_laid": np.array([True]),
        "order": np.arange(9),
        "ends": np.arange(10),
        "triangles": triangles,
    }
    lay(*good.values())
    assert triangles[0].tolist() == [4, 0, 8]
    assert triangles[-1].tolist() == [4, 8, 7]
    for name, wrong in (
        ("rises", np.arange(9) < 6),
        ("rises", np.arange(8) < 5),
        ("starts", good["starts"] + 1),
        ("starts", good["starts"] - 5),
        ("starts", good["starts"][:0]),
        ("is_laid", np.array([True, True])),
        ("is_laid", np.array([False])),
        ("order", np.arange(8)),
        ("ends", np.arange(9)),
        ("ends", np.arange(10) - 1),
        ("ends", np.arange(10)[::-1].copy()),
        ("ends", np.empty(0, dtype=np.int64)),
        ("triangles", triangles[:8]),
    ):
        with pytest.raises(ValueError, match="arrays that agree"):
            lay(*(good | {name: wrong}).values())
    with pytest.raises(TypeError, match="Expected 8 arrays, got 7"):
        lay(*list(good.values())[:-1])


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda arrays: arrays[:-1], TypeError),
        (lambda arrays: [arrays[0].astype(np.float32), *arrays[1:]], TypeError),
        (lambda arrays: [arrays[0][:, :2].copy(), *arrays[1:]], TypeError),
        (lambda arrays: [*arrays[:2], arrays[2].astype(np.int32), *arrays[3:]], TypeError),
        (lambda arrays: [arrays[0], arrays[1] + 1, *arrays[2:]], ValueError),
        (lambda arrays: [arrays[0], arrays[1][::-1].copy(), *arrays[2:]], ValueError),
        (lambda arrays: [*arrays[:2], arrays[2] + 1, *arrays[3:]], ValueError),
        (lambda arrays: [*arrays[:2], arrays[2] - 1, *arrays[3:]], ValueError),
        (lambda arrays: [*arrays[:5], arrays[5][:-1].copy(), arrays[6]], ValueError),
        (lambda arrays: [*arrays[:3], arrays[3][:0], *arrays[4:]], ValueError),
        (lambda arrays: [*arrays[:4], arrays[4][:0], *arrays[5:]], ValueError),
        (lambda arrays: [*arrays[:6], arrays[6][:0]], ValueError),
        (lambda arrays: [arrays[0][::2], *arrays[1:]], (ValueError, BufferError)),
    ],
)
def test_arrays_that_do_not_agree_are_refused(change, error):
    rings = pair_of(star(np.random.default_rng(1), 5), star(np.random.default_rng(2), 4))
    arrays = arrays_for(rings)
    with pytest.raises(error):
        greedy(*change(arrays), np.zeros((1, 2)))
    greedy(*arrays, np.zeros((1, 2)))
    with pytest.raises(error):
        least(*change(arrays))


def test_only_walks_around_their_contours_are_improved():
    rings = pair_of(star(np.random.default_rng(1), 5), star(np.random.default_rng(2), 4))
    *inputs, _, _, fits = arrays_for(rings)
    risen = np.arange(9) < 5
    no_bools = np.array([[2, 1, 1, 1, 1, 0, 0, 0, 0], [2, 2, 1, 0, 0, 0, 0, 0, 0]], dtype=np.uint8)
    for starts, rises in (
        ([[5, 0]], risen),
        ([[0, 4]], risen),
        ([[-1, 0]], risen),
        ([[0, 0]], np.arange(9) < 4),
        *(([[0, 0]], rises) for rises in no_bools.view(bool)),
    ):
        with pytest.raises(ValueError, match="arrays that agree"):
            least(*inputs, np.array(starts), rises, fits)


def test_results_that_share_memory_with_what_is_read_are_refused():
    rings = pair_of(star(np.random.default_rng(1), 5), star(np.random.default_rng(2), 4))
    arrays = arrays_for(rings)
    arrays[4] = arrays[2]
    with pytest.raises(ValueError, match="Expected starts to share no memory with pairs"):
        greedy(*arrays, np.zeros((1, 2)))


def test_only_doubtful_walks_are_replaced_and_only_by_those_that_fit_clearly_better():
    rings = pair_of(star(np.random.default_rng(1), 5), star(np.random.default_rng(2), 4))
    arrays = arrays_for(rings)
    *_, starts, rises, fits = arrays
    greedy(*arrays, np.zeros((1, 2)))
    (area, flux, misfit), (likely, _, volume, base, *_) = fits[0], arrays[3][0]
    assert misfit == pytest.approx(area / likely - 1 + 5 * abs((flux + base) / volume - 1))
    assert area > likely
    assert misfit > 0.05
    for known, is_kept in ((0.049, True), (misfit / 0.81, True), (misfit / 0.79, False)):
        starts[:], rises[:], fits[:] = 0, np.arange(9) < 5, (7.0, 7.0, known)
        greedy(*arrays, np.zeros((1, 2)))
        assert (fits[0, 0] == 7.0) == is_kept


def test_read_only_results_are_refused():
    rings = pair_of(star(np.random.default_rng(1), 5), star(np.random.default_rng(2), 4))
    arrays = arrays_for(rings)
    arrays[5].flags.writeable = False
    with pytest.raises((ValueError, BufferError)):
        greedy(*arrays, np.zeros((1, 2)))
