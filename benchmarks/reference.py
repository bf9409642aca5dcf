"""What the tests and the measurements compare against: random solids and exact visual hulls."""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold

from momrec_core import View

__all__ = ["exact_hull", "random_solid", "to_trimesh"]

EVEN_ODD = manifold3d.FillRule.EvenOdd


def to_trimesh(solid: Manifold) -> trimesh.Trimesh:
    """Return a solid's surface."""
    mesh = solid.to_mesh64()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts, process=False)


def random_solid(rng: np.random.Generator) -> trimesh.Trimesh:
    """Make a polyhedron of a few blocks, wedges and prisms, some with holes through them.

    The pieces overlap, branch off or stand apart; size about 1 m.
    """
    solid = Manifold()
    for _ in range(rng.integers(1, 5)):
        solid += _random_block(rng)
    for _ in range(rng.integers(0, 3)):
        drill = Manifold.cylinder(4, rng.uniform(0.05, 0.2), -1, int(rng.integers(3, 9)), True)
        carved = solid - _placed(drill, rng, 0.3)
        solid = carved if carved.volume() > 0.1 * solid.volume() else solid
    return to_trimesh(solid)


def _random_block(rng: np.random.Generator) -> Manifold:
    kind = rng.integers(3)
    if kind == 0:
        block = Manifold.cube(rng.uniform(0.1, 0.8, 3), True)
    elif kind == 1:
        radii = rng.uniform(0.05, 0.4, 2)
        sides = int(rng.integers(3, 12))
        block = Manifold.cylinder(rng.uniform(0.2, 1.2), radii[0], radii[1], sides, True)
    else:
        block = Manifold.hull_points(rng.normal(scale=0.25, size=(int(rng.integers(5, 16)), 3)))
    return _placed(block, rng, 0.5)


def _placed(solid: Manifold, rng: np.random.Generator, reach: float) -> Manifold:
    turned = solid.rotate(rng.uniform(-180, 180, 3)) if rng.random() < 0.7 else solid
    return turned.translate(rng.uniform(-reach, reach, 3))


def exact_hull(views: Sequence[View], reach: float = 10.0) -> Manifold:
    """Intersect viewing volumes exactly: extruded silhouettes, or pyramids for pinholes.

    Parameters
    ----------
    views : sequence of View
        At least one.
    reach : float
        How far the volumes extend, metres: to both sides of the camera, or before a pinhole.
    """
    return Manifold.batch_boolean(
        [_viewing_volume(view, reach) for view in views], manifold3d.OpType.Intersect
    )


def _viewing_volume(view: View, reach: float) -> Manifold:
    camera = view.camera
    if not camera.is_pinhole:
        prism = CrossSection(view.rings, EVEN_ODD).extrude(2 * reach)
        return prism.translate((0, 0, -reach)).transform(camera.pose[:3])
    near = 1e-3 * reach
    rings = [camera.rays_camera(ring)[:, :2] * reach for ring in view.rings]
    shrink = (near / reach, near / reach)
    pyramid = CrossSection(rings, EVEN_ODD).extrude(reach - near, scale_top=shrink)
    flipped = pyramid.mirror((0, 0, 1)).translate((0, 0, reach))
    return flipped.transform(camera.pose[:3])
