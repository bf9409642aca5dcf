"""Coverage of silhouettes against areas known in closed form."""

import numpy as np
import pytest
import shapely
import trimesh

from momrec_core import (
    Camera,
    Coverage,
    DegenerateShapeError,
    View,
    coverage,
    reconstruct,
    silhouette_of_mesh,
)
from momrec_core._covering import rims
from momrec_core.covering import covered_shares
from momrec_core.simulation import simulate_views

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


@pytest.mark.parametrize("projection", ["orthographic", "central"])
@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.box((1.0, 2.0, 3.0)),
        trimesh.creation.torus(1.0, 0.3),
        trimesh.creation.annulus(0.3, 0.6, 1.0),
        trimesh.creation.cone(0.5, 1.0, sections=100),  # many edges at one vertex
    ],
    ids=["box", "torus", "annulus", "cone"],
)
def test_shares_by_scan_lines_are_those_by_polygons(projection, mesh):
    rng = np.random.default_rng(4)
    views = simulate_views(mesh, 6, rng, projection=projection, noise=0.003)
    hull = reconstruct(views, 24).mesh()
    moved = hull.copy().apply_translation((0.1, -0.2, 0.15))
    for shown in (hull, moved):
        exact = [coverage(view, shown).covered for view in views]
        np.testing.assert_allclose(covered_shares(views, shown), exact, atol=0.004)


def test_a_mirrored_image_changes_no_share():
    mesh = trimesh.creation.icosphere(2)
    views = simulate_views(mesh, 3, np.random.default_rng(0), projection="central")
    mirror = np.diag([-1.0, 1.0, 1.0])
    mirrored = [
        View(
            Camera.pinhole(view.camera.pose, mirror @ view.camera.K),
            shapely.transform(view.silhouette, lambda points: points * (-1.0, 1.0)),
        )
        for view in views
    ]
    smaller = mesh.copy().apply_scale(0.8)
    expected = covered_shares(views, smaller)
    assert expected.max() < 0.7
    np.testing.assert_allclose(covered_shares(mirrored, smaller), expected, atol=1e-9)


def test_what_is_outside_of_the_frame_does_not_count():
    frame = shapely.box(-0.5, -2.0, 2.0, 2.0)
    whole = square(2.0)
    framed = View(whole.camera, whole.silhouette, frame)
    mesh = trimesh.creation.box((1.0, 2.0, 1.0))
    shares = covered_shares([whole, framed], mesh)
    np.testing.assert_allclose(shares, [0.5, 2 / 3], atol=1e-9)


def test_a_frame_beside_the_silhouette_is_as_good_as_none():
    whole = square(2.0)
    aside = View(whole.camera, whole.silhouette, shapely.box(5.0, 5.0, 6.0, 6.0))
    assert aside.visible.equals(whole.silhouette)


def test_no_views_have_no_shares():
    assert covered_shares([], trimesh.creation.box()).shape == (0,)


def test_an_open_mesh_has_no_shares():
    mesh = trimesh.creation.box()
    mesh.update_faces(np.arange(11))
    with pytest.raises(DegenerateShapeError, match="two faces each"):
        covered_shares([square(1.0)], mesh)


@pytest.mark.parametrize("face", [[0, 1, 8], [0, 1, -1]])
def test_faces_of_vertices_that_are_missing_have_no_shares(face):
    mesh = trimesh.creation.box()
    broken = trimesh.Trimesh(mesh.vertices, [*mesh.faces[:-1], face], process=False)
    with pytest.raises(DegenerateShapeError, match="two faces each, got 12 faces"):
        covered_shares([square(1.0)], broken)


def test_the_kernel_takes_no_other_arrays_than_it_expects():
    mesh = trimesh.creation.box()
    arrays = [
        np.array(mesh.vertices),
        np.array(mesh.faces, np.int64),
        np.zeros((1, 12)),
        np.zeros((1, 4)),
    ]
    assert rims(*arrays, 32) == b""
    for number, array in enumerate(arrays):
        for other in (array.astype(np.float32), array[:, :2], array.ravel()):
            with pytest.raises((TypeError, BufferError, ValueError)):
                rims(*arrays[:number], other, *arrays[number + 1 :], 32)
    with pytest.raises(TypeError):
        rims(*arrays)
    with pytest.raises(TypeError):
        rims(*arrays, "many")
    with pytest.raises(ValueError, match="closed mesh"):
        rims(*arrays[:3], np.zeros((2, 4)), 32)
