"""Files that are read with care and written at once or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from momrec_core.errors import DegenerateShapeError, MomrecError

__all__ = [
    "MESH_INPUTS",
    "MESH_OUTPUTS",
    "check_mesh_output",
    "expect_new",
    "file_name",
    "new_file",
    "new_folder",
    "read_mesh",
    "write_mesh",
]

MESH_INPUTS = (".ply", ".stl", ".obj", ".off", ".glb")
MESH_OUTPUTS = (".ply", ".stl", ".glb")
MATERIALS = (".obj", ".ply")  # whose readers look for textures unless told not to
DEBRIS_AREA = 1e-3  # of a scan's surface, for all that is left out as debris together
SMALLEST_UNITS, LARGEST_UNITS = (
    1e-12,
    1e12,
)  # of a file: beyond, areas and moments lose their digits
SMALLEST_AREA = 1e-12  # of the squared size: below, all faces are lines but for rounding
LARGEST_MESH = 1 << 30  # bytes; above, reading takes minutes and most of a desktop's memory
LONGEST_NAME = (
    80  # characters of a file name that an object's id gives; file systems take 255 bytes
)


def expect_new(*paths: Path | None) -> None:
    """Make sure that outputs do not exist yet, so that nothing is ever overwritten.

    Parameters
    ----------
    *paths : Path or None
        Outputs to be; None stands for an output that is not asked for.

    Raises
    ------
    FileExistsError
        If one exists.
    """
    for path in paths:
        if path is not None and os.path.lexists(path):
            raise FileExistsError(f"Expected an output that does not exist yet, got {path}")


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, which becomes the file when all went well.

    Parameters
    ----------
    path : Path
        The file to be; its folder is made if need be.

    Yields
    ------
    temporary : Path
        In the same folder, with the same suffix.

    Raises
    ------
    FileExistsError
        If the file exists, also if it came into being meanwhile.
    """
    expect_new(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = _beside(path)
    try:
        yield temporary
        expect_new(path)
        temporary.rename(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder to fill, which becomes the folder when all went well.

    Parameters
    ----------
    path : Path
        The folder to be; its parent is made if need be.

    Yields
    ------
    temporary : Path
        An empty folder beside it.

    Raises
    ------
    FileExistsError
        If there is something of that name, also if it came into being meanwhile.
    """
    expect_new(path)
    temporary = _beside(path)
    temporary.mkdir(parents=True)
    try:
        yield temporary
        expect_new(path)
        temporary.rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _beside(path: Path) -> Path:
    return path.with_name(f".{secrets.token_hex(8)}{path.suffix}")


def file_name(object_id: str) -> str:
    """Return a safe file name for an object, whatever its id.

    Parameters
    ----------
    object_id : str
        Untrusted; may be empty or contain separators.

    Returns
    -------
    name : str
        Of ASCII letters, digits, ``-``, ``_`` and ``.``, not empty, not beginning with a dot.
    """
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in object_id)
    return kept.lstrip(".")[:LONGEST_NAME] or "object"


def read_mesh(path: Path, unit: float = 1.0) -> trimesh.Trimesh:
    """Read a mesh.

    Parameters
    ----------
    path : Path
        A PLY, STL, OBJ, OFF or GLB file.
    unit : float
        Metres of a unit of the file.

    Returns
    -------
    mesh : Trimesh
        All bodies of the file as one, each where its scene has it; closed or not, wound as in the
        file. Textures are not read. Without faces that are not finite, and without small pieces
        beside the others, as scanners leave them.

    Raises
    ------
    OSError
        If the file cannot be read.
    DegenerateShapeError
        If it is no mesh, is damaged, has no faces, or is of no size that an object can have.
    """
    kind = path.suffix.lower()
    if kind not in MESH_INPUTS:
        raise DegenerateShapeError(f"Expected one of {', '.join(MESH_INPUTS)}, got {path}")
    if path.stat().st_size > LARGEST_MESH:
        raise DegenerateShapeError(
            f"Expected a mesh of at most {LARGEST_MESH} bytes, got {path} of {path.stat().st_size}"
        )
    options: dict[str, Any] = {"skip_materials": True} if kind in MATERIALS else {}
    try:
        with np.errstate(all="ignore"):  # numbers out of range are told in words
            mesh = trimesh.load(path, file_type=kind[1:], force="mesh", process=False, **options)
            cleaned = _cleaned(mesh) if isinstance(mesh, trimesh.Trimesh) else None
    except OSError:
        raise
    except Exception as error:  # the readers raise whatever a damaged file leads them to
        raise DegenerateShapeError(
            f"Expected a mesh, got a damaged file {path}: {error}"
        ) from error
    if cleaned is None or len(cleaned.faces) == 0:
        raise DegenerateShapeError(f"Expected a mesh with faces, got none in {path}")
    if not cleaned.area > SMALLEST_AREA * float(cleaned.extents.max()) ** 2:
        raise DegenerateShapeError(f"Expected a mesh with an area, got lines and points in {path}")
    cleaned.vertices = cleaned.vertices * unit
    return cleaned


def _cleaned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return what there is of the object itself, with equal vertices made one."""
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    lowest, highest = mesh.faces.min(initial=0), mesh.faces.max(initial=-1)
    if lowest < 0 or highest >= len(vertices):
        raise DegenerateShapeError(
            f"faces between vertices {lowest} to {highest}, where there are {len(vertices)}"
        )
    finite = np.asarray(np.isfinite(vertices[mesh.faces]).all(axis=(1, 2)))
    bare = trimesh.Trimesh(vertices, mesh.faces[finite], process=False)
    bare.remove_unreferenced_vertices()
    if len(bare.faces):
        bare = _merged(bare)
        bare.update_faces(~_is_debris(bare))
        bare.remove_unreferenced_vertices()
    return bare


def _merged(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Make equal vertices one, whatever the file's unit: rounded in sizes of the mesh."""
    vertices = np.asarray(mesh.vertices)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = float((high - low).max())
    if not SMALLEST_UNITS <= size <= LARGEST_UNITS or np.abs([low, high]).max() > LARGEST_UNITS:
        raise DegenerateShapeError(
            f"not of {SMALLEST_UNITS:g} to {LARGEST_UNITS:g} units, but from {low.tolist()} to "
            f"{high.tolist()}"
        )
    merged = trimesh.Trimesh((vertices - low) / size, mesh.faces, process=False)
    merged.merge_vertices()
    merged.vertices = merged.vertices * size + low
    return merged


def _is_debris(mesh: trimesh.Trimesh) -> NDArray[np.bool_]:
    """Mark the faces of pieces that are small, and outside of the box around the large ones."""
    left, right = np.asarray(mesh.face_adjacency).reshape(-1, 2).T
    joined = coo_array((np.ones(len(left)), (left, right)), shape=2 * (len(mesh.faces),))
    _, pieces = connected_components(joined, directed=False)
    areas = np.bincount(pieces, weights=mesh.area_faces)
    large = areas >= DEBRIS_AREA * areas.sum()
    if areas[~large].sum() > DEBRIS_AREA * areas.sum():  # a surface in pieces, not debris
        return np.zeros(len(mesh.faces), dtype=np.bool_)
    kept = mesh.triangles[large[pieces]].reshape(-1, 3)
    low, high = mesh.triangles.min(axis=1), mesh.triangles.max(axis=1)
    beside = ((high < kept.min(axis=0)) | (low > kept.max(axis=0))).any(axis=1)
    wholly = np.bincount(pieces, weights=beside) == np.bincount(pieces)
    return np.asarray((~large & wholly)[pieces])


def check_mesh_output(path: Path) -> None:
    """Make sure that a mesh can be written under a name.

    Parameters
    ----------
    path : Path
        The file to be.

    Raises
    ------
    MomrecError
        If its suffix is none of .ply, .stl and .glb.
    """
    if path.suffix.lower() not in MESH_OUTPUTS:
        raise MomrecError(f"Expected a name ending in {', '.join(MESH_OUTPUTS)}, got {path}")


def write_mesh(mesh: trimesh.Trimesh, path: Path) -> None:
    """Write a mesh, at once or not at all.

    Parameters
    ----------
    mesh : Trimesh
        In metres.
    path : Path
        A new file; its suffix says the format: .ply, .stl or .glb.

    Raises
    ------
    FileExistsError
        If the file exists.
    MomrecError
        If the suffix is another.
    """
    check_mesh_output(path)
    with new_file(path) as temporary:
        mesh.export(temporary, file_type=path.suffix[1:].lower())
