"""Surfaces between pieces that split, join and cross, against shapely's regions."""

from itertools import pairwise

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from manifold3d import CrossSection, FillRule

from momrec_core.layers import Slabs, layers_of_sections
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
    mesh = trimesh.Trimesh(*tile(Slabs().between(pairwise(layers))), process=False)
    return mesh, [shapely.union_all(layer.pieces.polygons(1.0)) for layer in layers[1:-1]]


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
