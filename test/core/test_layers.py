"""Pieces of adjacent layers matched by overlap, against GEOS."""

from itertools import product

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from momrec_core._matching import match
from momrec_core.layers import (
    LEAST_WIDTH,
    MIN_AREA_RATIO,
    STEEPEST,
    Slabs,
    layers_of_sections,
    match_layers,
)
from momrec_core.regions import CLEARANCE, Regions

SEEDS = st.integers(0, 2**32 - 1)
RELAXED = settings(deadline=None, max_examples=60)


def stars(rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Return pieces in the cells of a grid, some with a hole, some with whole coordinates."""
    shift, rings = rng.integers(-3, 4, 2) * rng.choice([0, 10]), []
    for cell in rng.permutation(9)[: rng.integers(1, 8)]:
        center = 100.0 * np.array(np.divmod(cell, 3)) + shift
        count = int(rng.integers(5, 16))
        angles = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.8, count)) / count
        rays = np.column_stack([np.cos(angles), np.sin(angles)])
        shell = center + rng.uniform(15, 43, (count, 1)) * rays
        hole = center + rng.uniform(-3, 3, 2) + rng.uniform(2, 8) * rays[::-1]
        if rng.random() < 0.3:
            shell = np.round(shell, -1)
        if shapely.Polygon(shell, [hole]).is_valid and rng.random() < 0.6:
            rings += [shell, hole]
        elif shapely.Polygon(shell).is_valid:
            rings.append(shell)
    return rings


def polygons_of(slab: Slabs, side: int) -> list[shapely.Polygon]:
    """Return the pieces below or above a slab as polygons."""
    layers = slab.layers
    pieces = layers.first[side] + np.arange(layers.counts[side])
    return [shapely.Polygon(*loops_of(layers.pieces.loops(piece))) for piece in pieces]


def loops_of(loops: list[NDArray[np.float64]]) -> tuple[NDArray[np.float64], list]:
    """Return a piece's shell, and its holes."""
    shell, *holes = loops
    return shell, holes


def pairs_of(slab: Slabs) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """Return the contours that belong together, of the pieces that do."""
    pairs = {}
    for _, low, high, *contours, _ in slab.pairs.tolist():
        pairs.setdefault((low, high), []).append(tuple(contours))
    return pairs


def knots_of(slab: Slabs) -> list[tuple[list[int], list[int]]]:
    """Return the other groups of pieces, below and above."""
    knots = {}
    for _, number, side, piece in slab.knots.tolist():
        knots.setdefault(number, ([], []))[side].append(piece)
    alone = [([piece], []) if side == 0 else ([], [piece]) for _, side, piece in slab.alone]
    return [*knots.values(), *alone]


def graph_of(slab: Slabs) -> set[tuple[frozenset[int], frozenset[int]]]:
    """Group a slab's pieces by the areas that GEOS finds in common."""
    below, above = polygons_of(slab, 0), polygons_of(slab, 1)
    groups = [({low}, set()) for low in range(len(below))]
    groups += [(set(), {high}) for high in range(len(above))]
    for low, one in enumerate(below):
        for high, other in enumerate(above):
            if one.intersection(other).area > 0:
                joined = [group for group in groups if low in group[0] or high in group[1]]
                groups = [group for group in groups if group not in joined]
                groups.append(tuple(set().union(*side) for side in zip(*joined, strict=True)))
    return {(frozenset(low), frozenset(high)) for low, high in groups}


def matched(below: list[NDArray[np.float64]], above: list[NDArray[np.float64]]) -> Slabs:
    """Match two layers so close that nothing is bridged between them."""
    layers = layers_of_sections([0.0, 1e-9 / STEEPEST], Regions.of_rings([below, above]))
    return match_layers(layers, layers.adjacent)


@RELAXED
@given(SEEDS)
def test_pieces_are_grouped_as_geos_has_them_overlap(seed):
    rng = np.random.default_rng(seed)
    slab = matched(stars(rng), stars(rng))
    pairs, knots = pairs_of(slab), knots_of(slab)
    groups = {(frozenset([low]), frozenset([high])) for low, high in pairs}
    groups |= {(frozenset(low), frozenset(high)) for low, high in knots}
    assert groups == graph_of(slab)
    assert len(groups) == len(pairs) + len(knots)


def are_alike(one: shapely.Polygon, other: shapely.Polygon) -> bool:
    """Tell whether pieces are of similar size, with holes that overlap one to one."""
    least, most = sorted([one.area, other.area])
    low, high = (np.subtract(part.bounds[2:], part.bounds[:2]) for part in (one, other))
    holes = [[shapely.Polygon(hole) for hole in part.interiors] for part in (one, other)]
    meet = [one.intersection(other).area > 0 for one, other in product(*holes)]
    meet = np.reshape(meet, [len(side) for side in holes])
    return bool(
        least > MIN_AREA_RATIO * most
        and (np.minimum(low, high) > LEAST_WIDTH * np.maximum(low, high)).all()
        and len(holes[0]) == len(holes[1])
        and (meet.sum(axis=0) == 1).all()
        and (meet.sum(axis=1) == 1).all()
    )


@RELAXED
@given(SEEDS)
def test_pieces_that_overlap_nothing_else_are_pairs_where_they_are_alike(seed):
    rng = np.random.default_rng(seed)
    slab = matched(stars(rng), stars(rng))
    below, above = polygons_of(slab, 0), polygons_of(slab, 1)
    single = [(low[0], high[0]) for low, high in knots_of(slab) if len(low) == len(high) == 1]
    assert all(are_alike(below[low], above[high]) for low, high in pairs_of(slab))
    assert not any(are_alike(below[low], above[high]) for low, high in single)


@RELAXED
@given(SEEDS)
def test_areas_of_knots_are_those_of_geos(seed):
    rng = np.random.default_rng(seed)
    slab = matched(stars(rng), stars(rng))
    sides = []
    for side in (0, 1):
        polygons = polygons_of(slab, side)
        pieces = [polygons[at] for knot in knots_of(slab) for at in knot[side]]
        sides.append(shapely.union_all(pieces))
    expected = [sides[0].area, sides[1].area, sides[0].intersection(sides[1]).area]
    assert_allclose(slab.areas, [expected], atol=1e-6)


def test_pieces_of_crowded_layers_are_found_all_the_same():
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    corners = 3.0 * np.stack(np.divmod(np.arange(900), 30), axis=-1)[:, None]
    slab = matched(list(square + corners), list(square[None] + corners[::-1] + 0.5))
    assert pairs_of(slab) == {(piece, 899 - piece): [(piece, 899 - piece)] for piece in range(900)}
    assert knots_of(slab) == []


def test_degenerate_overlaps_are_left_to_clipper():
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    half = square * (0.5, 1.0)
    slab = matched([square], [half + shift for shift in np.array([[0, 0], [2, 0], [4, 0]])])
    assert pairs_of(slab) == {}
    assert knots_of(slab) == [([0], [0, 1]), ([], [2])]
    assert_allclose(slab.areas, [[16.0, 24.0, 16.0]])


SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
BATCH = (
    SQUARE,
    np.array([0, 4]),
    np.array([0, 1]),
    np.array([16.0]),
    np.array([[0.0, 0.0, 4.0, 4.0]]),
)
GOOD = {
    "layers": np.array([[0, 0, 1], [0, 0, 1]]),
    "listed": np.empty((0, 3), dtype=np.int64),
    "batches": (BATCH,),
    "library": lambda _slab, _low, _high: 16.0,
    "most_tried": 10,
    "area_ratio": 0.4,
    "width_ratio": 0.5,
    "tolerance": CLEARANCE,
}


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("layers", np.array([[0, 0, 1]]), ValueError),
        ("layers", np.array([[0, 0, 1], [1, 0, 1]]), ValueError),
        ("layers", np.array([[0, 0, 1], [0, 0, 2]]), ValueError),
        ("layers", np.array([[0, 0, 1], [0, 1, 1]]), ValueError),
        ("layers", np.array([[0, 0, 1], [0, -1, 1]]), ValueError),
        ("layers", np.array([[0, 0, 1], [0, 2**63 - 1, 2]]), ValueError),
        ("layers", np.zeros((2, 2), dtype=np.int64), TypeError),
        ("listed", np.array([[0, 0, 1]]), ValueError),
        ("listed", np.array([[1, 0, 0]]), ValueError),
        ("listed", np.array([[0, -1, 0]]), ValueError),
        ("batches", [BATCH], TypeError),
        ("batches", (list(BATCH),), TypeError),
        ("batches", (BATCH[:4],), TypeError),
        ("batches", (BATCH, (SQUARE * np.nan, *BATCH[1:])), ValueError),
        ("batches", ((*BATCH[:3], np.ones(2), BATCH[4]),), ValueError),
        ("most_tried", -1, ValueError),
        ("tolerance", np.nan, ValueError),
    ],
)
def test_arrays_that_do_not_fit_are_refused(name, value, error):
    pairs, knots, alone, _ = match(*GOOD.values())
    assert np.frombuffer(pairs, dtype=np.int64).tolist() == [0, 0, 0, 0, 0, 1]
    assert knots == alone == b""
    with pytest.raises(error, match=r"^Expected"):
        match(*(GOOD | {name: value}).values())


def test_what_the_library_says_counts_and_its_errors_get_through():
    halves = np.concatenate([SQUARE * (0.5, 1.0), SQUARE * (0.5, 1.0) + (2.0, 0.0)])
    boxes = np.array([[0.0, 0.0, 2.0, 4.0], [2.0, 0.0, 4.0, 4.0]])
    batches = (BATCH, (halves, np.array([0, 4, 8]), np.arange(3), np.array([8.0, 8.0]), boxes))
    asked = []

    def library(slab: int, low: int, high: int) -> float:
        asked.append((slab, low, high))
        return [5.0, 6.0][high]

    task = GOOD | {"layers": np.array([[0, 0, 1], [1, 0, 2]]), "batches": batches}
    pairs, knots, alone, areas = match(*(task | {"library": library}).values())
    assert asked == [(0, 0, 0), (0, 0, 1)]
    assert pairs == alone == b""
    assert knots == np.array([[0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]).tobytes()
    assert np.frombuffer(areas).tolist() == [16.0, 16.0, 11.0]
    with pytest.raises(ZeroDivisionError):
        match(*(task | {"library": lambda *_: 1 / 0}).values())
    with pytest.raises(TypeError):
        match(*(task | {"library": lambda *_: "wide"}).values())
    with pytest.raises(TypeError, match=r"^Expected 8 arguments"):
        match(GOOD["layers"])
