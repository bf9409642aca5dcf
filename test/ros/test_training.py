"""Meshes as people have them in folders, and instances seen as their cameras would see them."""

import numpy as np
import pytest
import trimesh

from momrec_core import MomrecError, normalize
from momrec_ros.files import read_mesh
from momrec_ros.training import Sight, find_classes, read_classes, reconstructed_instances


def box():
    return trimesh.creation.box((0.1, 0.2, 0.3))


def save(mesh, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


def test_a_scanner_s_folders_are_classes_whatever_is_in_them(tmp_path):
    for name in ("002_can", "003_box"):
        save(box(), tmp_path / name / "google_16k" / "textured.obj")
        save(box(), tmp_path / name / "google_16k" / "nontextured.ply")
        save(box(), tmp_path / name / "google_16k" / "nontextured.stl")
        (tmp_path / name / "google_16k" / "kinbody.xml").write_text("<KinBody/>")
    expected = {"002_can": 2, "003_box": 2}  # one of those that differ by suffix only
    for paths in ([tmp_path], sorted(tmp_path.iterdir())):
        found = read_classes(paths)
        assert {label: len(meshes) for label, meshes in found.meshes.items()} == expected
        assert found.losses == ()


def test_files_subfolders_and_what_is_deeper_are_classes(tmp_path):
    save(box(), tmp_path / "loose.stl")
    save(box(), tmp_path / "chair" / "one.off")
    save(box(), tmp_path / "chair" / "train" / "two.off")
    save(box(), tmp_path / "chair" / "._one.off")  # a trace of another file system
    found = find_classes([tmp_path])
    assert {label: len(meshes) for label, meshes in found.items()} == {"chair": 2, "loose": 1}


def test_files_that_cannot_be_read_are_told_one_by_one(tmp_path):
    save(box(), tmp_path / "good.stl")
    (tmp_path / "bad.ply").write_bytes(b"ply\n\xff")
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    found = read_classes([tmp_path])
    assert list(found.meshes) == ["good"]
    assert [line.split(":")[0] for line in found.losses] == [
        str(tmp_path / "bad.ply"),
        str(tmp_path / "empty.obj"),
    ]
    with pytest.raises(MomrecError):
        find_classes([tmp_path])


def test_a_scene_is_one_mesh_with_all_in_its_place(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(box())
    away = trimesh.transformations.translation_matrix([0.5, 0.0, 0.0])
    scene.add_geometry(trimesh.creation.icosphere(radius=0.1), transform=away)
    for suffix in (".glb", ".obj"):
        save(scene, tmp_path / f"scene{suffix}")
        mesh = read_mesh(tmp_path / f"scene{suffix}")
        np.testing.assert_allclose(mesh.bounds, [[-0.05, -0.1, -0.15], [0.6, 0.1, 0.15]], atol=1e-6)
        assert mesh.body_count == 2


def test_an_obj_without_its_material_and_with_odd_vertices_is_read(tmp_path):
    path = tmp_path / "part.obj"
    path.write_text(
        "mtllib gone.mtl\nusemtl red\n"
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv nan 0 0\nv 50 0 0\nv 0 0 0\n"
        "vt 0 0\nvt 1 0\nvt 0 1\n"
        "f 1/1 3/2 2/3\nf 7/2 2/1 4/3\nf 2 3 4\nf 1 4 3\nf 1 2 5\n"
    )
    mesh = read_mesh(path)
    assert len(mesh.faces) == 4
    assert len(mesh.vertices) == 4
    assert mesh.is_watertight
    np.testing.assert_array_equal(mesh.bounds, [[0, 0, 0], [1, 1, 1]])


def test_debris_beside_a_scan_is_left_out_and_parts_of_it_are_not(tmp_path):
    body = trimesh.creation.icosphere(subdivisions=3)
    crumb = trimesh.creation.box(
        (0.01, 0.01, 0.01), trimesh.transformations.translation_matrix([9] * 3)
    )
    knob = trimesh.creation.box(
        (0.5, 0.5, 0.5), trimesh.transformations.translation_matrix([3, 0, 0])
    )
    save(trimesh.util.concatenate([body, crumb, knob]), tmp_path / "scan.ply")
    mesh = read_mesh(tmp_path / "scan.ply")
    assert len(mesh.faces) == len(body.faces) + len(knob.faces)
    soup = body.triangles + np.random.default_rng(0).normal(0, 1e-4, body.triangles.shape)
    pieces = trimesh.Trimesh(soup.reshape(-1, 3), np.arange(soup.size // 3).reshape(-1, 3))
    save(pieces, tmp_path / "soup.stl")
    assert len(read_mesh(tmp_path / "soup.stl").faces) == len(body.faces)


def test_a_unit_is_that_of_the_file(tmp_path):
    save(trimesh.creation.box((100, 200, 300)), tmp_path / "part.stl")
    found = read_classes([tmp_path], unit=0.001).meshes["part"][0]
    np.testing.assert_allclose(found.extents, [0.1, 0.2, 0.3])


def instances(sight, mesh=None, views=8):
    rebuilt = reconstructed_instances(
        {"box": [mesh or box()]}, instances=3, views=views, slices=24, seed=4, sight=sight
    )
    return [shape for _, shape in rebuilt]


def test_instances_keep_their_size_where_size_counts():
    expected = normalize(box()).scale
    kept = np.array([shape.scale for shape in instances(Sight(own_size=True), views=20)])
    np.testing.assert_allclose(kept, expected, rtol=0.1)
    free = np.array([shape.scale for shape in instances(Sight(), views=20)])
    assert free.max() / free.min() > 1.2


@pytest.mark.parametrize("projection", ["orthographic", "central"])
def test_coarse_masks_give_nearly_the_instances_of_fine_ones(projection):
    fine, coarse = (
        instances(Sight(projection=projection, image_size=size, own_size=True), views=10)
        for size in ((1600, 1200), (160, 120))
    )
    for one, other in zip(fine, coarse, strict=True):
        assert one.scale == pytest.approx(other.scale, rel=0.03)
        assert one.scale != other.scale
