"""Coverage of silhouettes against areas known in closed form."""

import numpy as np
import pytest
import shapely
import trimesh

from momrec_core import Camera, Coverage, View, coverage, silhouette_of_mesh

CAMERA = Camera.orthographic(np.eye(4))


def square(side):
    return View(CAMERA, shapely.box(-side / 2, -side / 2, side / 2, side / 2))


def test_the_mesh_that_a_view_shows_covers_it_fully():
    mesh = trimesh.creation.icosphere(2)
    found = coverage(silhouette_of_mesh(mesh, CAMERA), mesh)
    assert found.covered == pytest.approx(1.0)
    assert found.iou == pytest.approx(1.0)


def test_a_smaller_mesh_covers_its_share():
    found = coverage(square(2.0), trimesh.creation.box((1.0, 1.0, 1.0)))
    assert found.covered == pytest.approx(0.25)
    assert found.iou == pytest.approx(0.25)


def test_a_larger_mesh_covers_all_but_not_only_the_silhouette():
    found = coverage(square(1.0), trimesh.creation.box((2.0, 2.0, 2.0)))
    assert found.covered == pytest.approx(1.0)
    assert found.iou == pytest.approx(0.25)


def test_a_mesh_beside_the_silhouette_covers_nothing():
    mesh = trimesh.creation.box((1.0, 1.0, 1.0))
    mesh.apply_translation([5.0, 0.0, 0.0])
    assert coverage(square(1.0), mesh) == Coverage(covered=0.0, iou=0.0)


def test_silhouettes_of_meshes_are_the_unions_of_their_projected_faces():
    rng = np.random.default_rng(5)
    for mesh in (
        trimesh.creation.torus(1.0, 0.3, major_sections=16, minor_sections=8),
        trimesh.creation.annulus(0.3, 0.6, 1.0, sections=12),
        trimesh.Trimesh(rng.normal(size=(60, 3)), rng.integers(0, 60, (40, 3))),
    ):
        triangles = mesh.triangles[:, :, :2]
        kept = [
            shapely.Polygon(corners)
            for corners in triangles
            if len(np.unique(corners, axis=0)) == 3
        ]
        union = shapely.union_all(kept)
        found = silhouette_of_mesh(mesh, CAMERA).silhouette
        assert shapely.symmetric_difference(found, union).area < 1e-7 * union.area
