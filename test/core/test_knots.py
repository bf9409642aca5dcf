"""Surfaces between pieces that split, join and cross, against shapely's regions."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from manifold3d import CrossSection, FillRule

from momrec_core.knots import Knots, join_knots
from momrec_core.layers import layers_of_sections, match_layers
from momrec_core.noding import TOUCH
from momrec_core.regions import Regions
from momrec_core.tiling import tile

HEIGHT = 2.0


def star(rng, count, center):
    angles = 2 * np.pi * (np.arange(count) + rng.uniform(-0.4, 0.4, count)) / count
    radii = rng.uniform(4.0, 10.0, count)
    return np.column_stack([np.cos(angles), np.sin(angles)]) * radii[:, None] + center


def tiled(*sections):
    """Return the surface through cross-sections, and their regions as it has them."""
    empty = CrossSection()
    offsets = HEIGHT * np.arange(len(sections) + 2)
    layers = layers_of_sections(offsets, Regions.of_sections([empty, *sections, empty]))
    mesh = trimesh.Trimesh(*tile(match_layers(layers, layers.adjacent)), process=False)
    spans = layers.spans[1:-1, 1:].tolist()
    pieces = [layers.pieces.part(first, first + count) for first, count in spans]
    return mesh, [shapely.union_all(part.polygons(1.0)) for part in pieces]


def projected(mesh, is_up, low, high):
    """Return the area, seen from above, of what faces up or down between two heights."""
    corners = mesh.triangles
    heights = corners[:, :, 2]
    upward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    is_within = (heights >= low).all(axis=1) & (heights <= high).all(axis=1)
    return float(np.abs(upward[is_within & ((upward > 0) == is_up)]).sum())


@given(st.integers(0, 2**32 - 1), st.integers(5, 40))
@settings(max_examples=40, deadline=None)
def test_where_only_one_layer_has_material_the_surface_faces_away_from_it(seed, count):
    rng = np.random.default_rng(seed)
    pair = [star(rng, count, (side * 11.0, 0.0)) for side in (-1, 1)]
    joint = star(rng, count + 3, rng.uniform(-3.0, 3.0, 2)) * (2.0, 0.7)
    low, high = (CrossSection(rings, FillRule.Positive) for rings in (pair, [joint]))
    mesh, (_, below, above, _) = tiled(low, low, high, high)
    assume(min((part & above).area for part in below.geoms) > 1.0)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    for is_up, expected in ((True, below - above), (False, above - below)):
        found = projected(mesh, is_up, 2 * HEIGHT, 3 * HEIGHT)
        assert found == pytest.approx(expected.area, rel=1e-3, abs=0.02)


def test_a_hole_that_opens_is_closed_where_it_opens():
    square = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])
    hole = square[::-1] * 0.3 + 5.0
    mesh, _ = tiled(CrossSection([square]), CrossSection([square, hole], FillRule.EvenOdd))
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    assert projected(mesh, True, HEIGHT, 2 * HEIGHT) == pytest.approx(400.0)
    assert mesh.volume == pytest.approx(HEIGHT * 400.0)


def test_a_knot_that_cannot_be_joined_is_closed_below_and_above():
    near = 0.8 * TOUCH  # corners at (40, 0) that lie on edges of each other, yet are further apart
    low = np.array([[0.0, 0.0], [40.0, near], [40.0, 10.0], [0.0, 10.0]])
    left = np.array([[0.0, 0.0], [15.0, 0.0], [15.0, 10.0], [0.0, 10.0]])
    right = np.array([[25.0, 0.0], [40.0 - near, 0.0], [40.0, 10.0], [25.0, 10.0]])
    below, above = CrossSection([low]), CrossSection([left, right])
    mesh, _ = tiled(below, below, above, above)
    assert mesh.is_watertight
    assert mesh.body_count == 3
    assert mesh.volume == pytest.approx(HEIGHT * (400.0 + 300.0), rel=1e-5)


BELOW = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0], [0.0, 2.0]])
ABOVE = np.array([[1.0, 1.0], [2.0, 1.0], [3.0, 1.0], [3.0, 3.0], [1.0, 3.0], [1.0, 2.0]])
CONTACTS = np.array([[2, 1], [4, 5]])  # of the vertices below and above


def crossing_squares(count):
    """Return the vertices of pairs of squares that cross each other, and each pair as a knot."""
    contours = [
        np.column_stack([square + 10.0 * pair, np.full(6, height)])
        for pair in range(count)
        for square, height in ((BELOW, 0.0), (ABOVE, HEIGHT))
    ]
    sides = np.arange(2 * count)
    links = [CONTACTS + 12 * pair + (0, 6) for pair in range(count)]
    knots = Knots(
        np.arange(12 * count),
        np.ones(12 * count, dtype=bool),
        6 * np.arange(2 * count + 1),
        sides,
        sides // 2,
        sides % 2 == 1,
        np.concatenate(links),
    )
    return np.concatenate(contours), knots


def upward_areas(points, triangles):
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.cross(b - a, c - a)[:, 2] / 2


def test_contours_that_cross_bound_what_faces_up_and_down_and_each_edge_is_used_once():
    points, knots = crossing_squares(3)
    triangles, failed = join_knots(points, knots)
    assert len(failed) == 0
    upward = upward_areas(points, triangles)
    assert upward[upward > 0].sum() == pytest.approx(3 * 3.0)
    assert upward[upward < 0].sum() == pytest.approx(3 * -3.0)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    used = {tuple(edge) for edge in edges.tolist()}
    assert len(used) == len(edges)
    vertices = np.arange(36).reshape(-1, 6)
    along = np.stack([vertices, np.roll(vertices, -1, axis=1)], axis=2)
    along[1::2] = along[1::2, :, ::-1]
    assert {(a, b) for a, b in used if (b, a) not in used} == set(
        map(tuple, along.reshape(-1, 2).tolist())
    )


@pytest.mark.parametrize("contradiction", [(14, 20), (15, 23), (12, 19)])
def test_a_knot_whose_contacts_contradict_each_other_is_left_out_alone(contradiction):
    points, knots = crossing_squares(3)
    links = np.concatenate([knots.links, [contradiction]])
    triangles, failed = join_knots(points, replace(knots, links=links))
    assert failed.tolist() == [1]
    assert set(np.unique(triangles)) == {*range(12), *range(24, 36)}


def test_a_contact_that_is_missed_leaves_its_knot_out():
    points, knots = crossing_squares(2)
    _, failed = join_knots(points, replace(knots, links=knots.links[1:]))
    assert failed.tolist() == [0]


def test_contours_that_coincide_are_joined_by_upright_walls():
    points, knots = crossing_squares(1)
    points[6:, :2] = BELOW
    links = np.column_stack([np.arange(6), np.arange(6, 12)])
    triangles, failed = join_knots(points, replace(knots, links=links))
    assert len(failed) == 0
    assert len(triangles) == 12
    surface = trimesh.Trimesh(points, triangles, process=False)
    assert surface.area == pytest.approx(8.0 * HEIGHT)
    outward = surface.triangles_center - (1.0, 1.0, HEIGHT / 2)
    assert ((surface.face_normals * outward).sum(axis=1) > 0).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"vertices": np.arange(12) + 1},
        {"is_own": np.zeros(12, dtype=bool)},
        {"first": np.array([0, 6, 13])},
        {"first": np.array([0, 0, 12])},
        {"pieces": np.array([0, 2])},
        {"pieces": np.array([1, 0])},
        {"is_above": np.array([True])},
        {"links": np.array([[2, 12]])},
    ],
)
def test_knots_that_do_not_agree_are_rejected(wrong):
    points, knots = crossing_squares(1)
    with pytest.raises(ValueError, match="Expected contours with vertices"):
        join_knots(points, replace(knots, **wrong))
