"""Files: written at once or not at all, never overwritten, read with care."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from momrec_core import DegenerateShapeError, MomrecError
from momrec_ros.demo_folder import replaced_folder
from momrec_ros.files import expect_new, file_name, new_file, new_folder, read_mesh, write_mesh


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".glb", ".STL"])
def test_a_written_mesh_is_read_back(tmp_path, suffix):
    mesh = trimesh.creation.icosphere(subdivisions=1)
    path = tmp_path / "new" / f"ball{suffix}"
    write_mesh(mesh, path)
    again = read_mesh(path)
    assert again.volume == pytest.approx(mesh.volume, rel=1e-5)
    assert again.area == pytest.approx(mesh.area, rel=1e-5)
    assert names_in(path.parent) == [path.name]


def test_a_mesh_of_another_suffix_is_refused(tmp_path):
    mesh = trimesh.creation.box()
    with pytest.raises(MomrecError, match=r"\.ply, \.stl, \.glb"):
        write_mesh(mesh, tmp_path / "box.pickle")
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".off", ".glb"])
@pytest.mark.parametrize("content", [b"", b"ply\nformat", b"glTF\2\0\0\0", b"\xff" * 200])
def test_a_damaged_mesh_is_refused_with_its_name(tmp_path, suffix, content):
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(content)
    with pytest.raises(DegenerateShapeError, match="damaged"):
        read_mesh(path)


def test_a_file_that_is_no_mesh_is_refused_unread(tmp_path):
    path = tmp_path / "mesh.pickle"
    path.write_bytes(b"\x80\x04.")
    with pytest.raises(DegenerateShapeError, match=r"Expected one of \.ply"):
        read_mesh(path)


def test_what_exists_is_never_overwritten(tmp_path):
    kept = tmp_path / "kept"
    kept.write_text("kept")
    dangling = tmp_path / "dangling"
    dangling.symlink_to(tmp_path / "nowhere")
    expect_new(None, tmp_path / "new")
    for path in (kept, dangling, tmp_path):
        with pytest.raises(FileExistsError, match="does not exist yet"):
            expect_new(tmp_path / "new", path)
    for writer in (new_file, new_folder):
        with pytest.raises(FileExistsError):
            writer(kept).__enter__()
    assert kept.read_text() == "kept"


def test_what_came_into_being_meanwhile_is_not_overwritten(tmp_path):
    path = tmp_path / "output"
    writing = new_file(path)
    writing.__enter__().write_text("late")
    path.write_text("first")
    with pytest.raises(FileExistsError):
        writing.__exit__(None, None, None)
    assert path.read_text() == "first"
    assert names_in(tmp_path) == ["output"]


@pytest.mark.parametrize("writer", [new_file, new_folder, replaced_folder])
def test_a_failure_leaves_nothing_behind(tmp_path, writer):
    with pytest.raises(ZeroDivisionError), writer(tmp_path / "output"):
        raise ZeroDivisionError
    assert names_in(tmp_path) == []


@given(st.text())
def test_any_object_id_gives_a_safe_file_name(object_id):
    name = file_name(object_id)
    assert name
    assert not name.startswith(".")
    assert not set(name) & set('/\\:*?"<>|\0 \n')
    assert len(name.encode()) <= 80


def test_a_plain_object_id_is_its_file_name():
    assert file_name("cup_1.b-2") == "cup_1.b-2"
    assert file_name("../../etc/passwd") == "_.._etc_passwd"
    assert file_name("") == "object"


def fill(folder, text):
    with replaced_folder(folder) as temporary:
        (temporary / "inner").mkdir()
        (temporary / "inner" / "file").write_text(text)


def test_a_demo_replaces_what_a_demo_wrote(tmp_path):
    demo = tmp_path / "demo"
    for text in ("first", "second", "third"):
        fill(demo, text)
        assert (demo / "inner" / "file").read_text() == text
        assert names_in(tmp_path) == ["demo"]


def test_a_demo_that_fails_keeps_the_former_one(tmp_path):
    demo = tmp_path / "demo"
    fill(demo, "first")
    with pytest.raises(ZeroDivisionError), replaced_folder(demo):
        raise ZeroDivisionError
    assert (demo / "inner" / "file").read_text() == "first"
    assert names_in(tmp_path) == ["demo"]


def test_a_demo_replaces_nothing_else(tmp_path):
    foreign, added, link = tmp_path / "foreign", tmp_path / "added", tmp_path / "link"
    foreign.mkdir()
    fill(added, "first")
    (added / "inner" / "notes").write_text("mine")
    fill(tmp_path / "aim", "first")
    link.symlink_to(tmp_path / "aim")
    for folder, reason in (
        (foreign, "earlier demo"),
        (added, "also inner/notes"),
        (link, "earlier"),
    ):
        with pytest.raises(FileExistsError, match=reason):
            fill(folder, "second")
    assert (added / "inner" / "notes").read_text() == "mine"
    assert (link / "inner" / "file").read_text() == "first"


def test_all_bodies_of_a_file_are_one_mesh(tmp_path):
    scene = trimesh.Scene([trimesh.creation.box(), trimesh.creation.icosphere()])
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))
    mesh = read_mesh(path)
    assert len(mesh.faces) == 12 + 1280
    assert np.isfinite(mesh.vertices).all()


def written(path, vertices, faces):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices).tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("size", [1e30, 1e-30, 1e200])
def test_a_mesh_of_a_size_that_no_object_has_is_refused(tmp_path, size):
    box = trimesh.creation.box()
    path = written(tmp_path / "box.obj", box.vertices * size, box.faces)
    with pytest.raises(DegenerateShapeError, match=r"box\.obj: not of 1e-12 to 1e\+12 units"):
        read_mesh(path)


@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_equal_vertices_become_one_whatever_the_unit_is(tmp_path, size):
    ball = trimesh.creation.icosphere(subdivisions=1)
    corners = ball.triangles.reshape(-1, 3) * size
    path = written(tmp_path / "ball.obj", corners, np.arange(len(corners)).reshape(-1, 3))
    mesh = read_mesh(path, unit=1 / size)
    assert len(mesh.vertices) == len(ball.vertices)
    assert mesh.volume == pytest.approx(ball.volume, rel=1e-9)


@pytest.mark.parametrize("flattening", [(1, 0, 0), (0, 0, 0)])
def test_a_mesh_without_area_is_refused(tmp_path, flattening):
    box = trimesh.creation.box()
    path = written(tmp_path / "box.obj", box.vertices * flattening, box.faces)
    with pytest.raises(DegenerateShapeError, match="box"):
        read_mesh(path)


@pytest.mark.parametrize("number", [-7, 3, 2_000_000_000])
def test_faces_between_vertices_that_are_not_there_are_refused(tmp_path, number):
    path = tmp_path / "mesh.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"0 0 0\n1 0 0\n0 1 0\n3 0 1 {number}\n"
    )
    with pytest.raises(DegenerateShapeError, match="damaged"):
        read_mesh(path)
