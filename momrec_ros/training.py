"""From meshes to a recognition model: simulated instances, reconstructed as real ones would be."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TypedDict

import numpy as np
import trimesh
from sklearn.model_selection import StratifiedKFold

from momrec_core.camera import Camera
from momrec_core.canonical import CanonicalShape, normalize
from momrec_core.errors import MomrecError
from momrec_core.hull import reconstruct
from momrec_core.model import UNKNOWN, Recognition, RecognitionModel
from momrec_core.simulation import (
    SCALES,
    Projection,
    random_similarity,
    simulate_cameras,
    simulate_instance,
)
from momrec_core.view import View
from momrec_ros.files import MESH_INPUTS, read_mesh
from momrec_ros.rigs import Imager, Rig, fitted_imager, placed, views_by
from momrec_ros.workers import Map, shared_map

__all__ = [
    "ClassRate",
    "Classes",
    "Sight",
    "find_classes",
    "held_back_recognitions",
    "mapped_instances",
    "read_classes",
    "recognition_rates",
    "reconstructed_instances",
]

FOLDS = 5  # of the cross-validation: each model learns from four fifths
JOBS_PER_WORKER = 16  # below, starting a process takes longer than it saves
# Folders that say how a mesh is kept, or how fine it is, not what it is of: those of the YCB
# objects, of robot descriptions, of collections of models.
VERSIONS = {
    *("google_16k", "google_64k", "google_512k", "poisson", "tsdf"),
    *("mesh", "meshes", "model", "models", "visual", "collision"),
    *("glb", "obj", "off", "ply", "stl", "train", "test"),
}


@dataclass(frozen=True, eq=False)
class Classes:
    """What `read_classes` found.

    Attributes
    ----------
    meshes : dict
        Label to meshes, sorted by label.
    losses : tuple of str
        A line for each file that could not be used, and why.
    """

    meshes: dict[str, list[trimesh.Trimesh]]
    losses: tuple[str, ...]


@dataclass(frozen=True)
class Sight:
    """How simulated instances are seen.

    Attributes
    ----------
    projection : {"orthographic", "central"}
        Of the cameras around each object, where there is no rig.
    distance : float
        Theirs, in diameters of the object.
    image_size : tuple of int, or None
        Width and height of their masks, which the object nearly fills; None for exact contours.
    rig : Rig or None
        The cameras to use instead; objects stand in their own size where it looks at.
    upright : bool
        Whether objects before a rig are turned about the vertical only.
    own_size : bool
        Whether objects keep their size; before a rig they always do.
    """

    projection: Projection = "orthographic"
    distance: float = 3.0
    image_size: tuple[int, int] | None = None
    rig: Rig | None = None
    upright: bool = False
    own_size: bool = False


class _Optics(TypedDict):
    projection: Projection
    distance: float


@dataclass(frozen=True)
class ClassRate:
    """How well the instances of one class are recognised.

    Attributes
    ----------
    label : str
        The class.
    instances : int
        Number of instances.
    training : float
        Share of them that the model names rightly, 0 to 1.
    cross_validated : float
        The same for models that did not learn from the instance in question.
    """

    label: str
    instances: int
    training: float
    cross_validated: float


def find_classes(paths: Sequence[Path]) -> dict[str, list[trimesh.Trimesh]]:
    """Read the meshes of the classes.

    Parameters
    ----------
    paths : sequence of Path
        As for `read_classes`.

    Returns
    -------
    classes : dict
        Label to meshes, sorted by label; meshes of equal labels are joined.

    Raises
    ------
    MomrecError
        If a folder has no mesh, a file is none, or no class may have its name.
    """
    return {
        label: [read_mesh(file) for file in files] for label, files in _found_classes(paths).items()
    }


def read_classes(paths: Sequence[Path], unit: float = 1.0) -> Classes:
    """Read the meshes of the classes as far as they can be read.

    Parameters
    ----------
    paths : sequence of Path
        A mesh file is of the class of its stem. In a folder, each mesh file is of the class of
        its stem, and each subfolder is a class with all mesh files at any depth in it. A given
        folder whose subfolders are named as versions of a mesh are, ``meshes`` or ``google_16k``
        say, is one class itself. Of files in a folder that differ by their suffix only, one is
        read.
    unit : float
        Metres of a unit of the files.

    Returns
    -------
    classes : Classes
        Meshes of equal labels are joined. A class without a mesh that can be read is left out.

    Raises
    ------
    MomrecError
        If a folder has no mesh, or no class may have its name.
    """
    meshes: dict[str, list[trimesh.Trimesh]] = {}
    losses = []
    for label, files in _found_classes(paths).items():
        for file in files:
            try:
                meshes.setdefault(label, []).append(read_mesh(file, unit))
            except (MomrecError, OSError) as error:
                losses.append(f"{file}: {error}")
    return Classes({label: found for label, found in meshes.items() if found}, tuple(losses))


def _found_classes(paths: Sequence[Path]) -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = {}
    for path in paths:
        files = _mesh_files(path) if path.is_dir() else [path]
        if not files:
            raise MomrecError(f"Expected meshes ({', '.join(MESH_INPUTS)}) in {path}, got none")
        for file, label in zip(files, _labels(path, files), strict=True):
            found.setdefault(label, []).append(file)
    wrong = [label for label in found if label == UNKNOWN or not label.isprintable()]
    if wrong:
        raise MomrecError(
            f'Expected printable names other than "{UNKNOWN}" for classes, got {wrong[0]!r}'
        )
    return {label: found[label] for label in sorted(found)}


def _mesh_files(folder: Path) -> list[Path]:
    """Return the meshes at any depth of a folder, one of those that differ by suffix only."""
    files = [path for path in folder.rglob("*") if path.suffix.lower() in MESH_INPUTS]
    files = [path for path in files if path.is_file() and not path.name.startswith(".")]
    by_preference = sorted(files, key=lambda path: MESH_INPUTS.index(path.suffix.lower()))
    return sorted({path.with_suffix(""): path for path in reversed(by_preference)}.values())


def _labels(path: Path, files: Sequence[Path]) -> list[str]:
    parts = [file.relative_to(path).parts for file in files]
    if path.is_dir() and all(len(inner) > 1 and inner[0].lower() in VERSIONS for inner in parts):
        return [path.resolve().name for _ in files]
    return [
        inner[0] if len(inner) > 1 else file.stem for file, inner in zip(files, parts, strict=True)
    ]


def reconstructed_instances(
    classes: Mapping[str, Sequence[trimesh.Trimesh]],
    *,
    instances: int,
    views: int,
    slices: int,
    noise: float = 0.0,
    seed: int = 0,
    workers: int = 1,
    sight: Sight = Sight(),
) -> Iterator[tuple[str, CanonicalShape]]:
    """Simulate instances of each class and reconstruct them from their views.

    Parameters
    ----------
    classes : mapping
        Label to meshes; the instances of a class take turns with its meshes.
    instances : int
        Of each class, each at its own random position, orientation and size.
    views : int
        Of each instance; with a rig, each of its cameras has one instead.
    slices : int
        Slicing planes of each reconstruction.
    noise : float
        Of the contours, as for `simulate_views`.
    seed : int
        Determines the outcome, whatever the number of workers.
    workers : int
        Processes to use at most.
    sight : Sight
        How the instances are seen.

    Yields
    ------
    label, shape : str, CanonicalShape
        Class by class, as soon as each is done.
    """
    make = partial(
        mapped_instances,
        classes,
        instances=instances,
        views=views,
        slices=slices,
        noise=noise,
        seed=seed,
        sight=sight,
    )
    with shared_map(min(workers, len(classes) * instances // JOBS_PER_WORKER)) as apply:
        yield from make(apply)


def mapped_instances(
    classes: Mapping[str, Sequence[trimesh.Trimesh]],
    apply: Map,
    *,
    instances: int,
    views: int,
    slices: int,
    noise: float = 0.0,
    seed: int = 0,
    sight: Sight = Sight(),
) -> Iterator[tuple[str, CanonicalShape]]:
    """Do as `reconstructed_instances` does, with workers that are there already.

    Parameters
    ----------
    classes, instances, views, slices, noise, seed, sight
        As for `reconstructed_instances`.
    apply : callable
        ``map``, or that of a pool.

    Yields
    ------
    label, shape : str, CanonicalShape
        Class by class, as soon as each is done.
    """
    labels = [label for label in classes for _ in range(instances)]
    meshes = [
        of_class[number % len(of_class)]
        for of_class in classes.values()
        for number in range(instances)
    ]
    seeds = [(seed, *pair) for pair in product(range(len(classes)), range(instances))]
    rebuild = partial(_rebuilt, views=views, slices=slices, noise=noise, sight=sight)
    yield from zip(labels, apply(rebuild, meshes, seeds), strict=True)


def _rebuilt(
    mesh: trimesh.Trimesh,
    seed: tuple[int, ...],
    *,
    views: int,
    slices: int,
    noise: float,
    sight: Sight,
) -> CanonicalShape:
    seen = _views(mesh, np.random.default_rng(seed), views, noise, sight)
    return normalize(reconstruct(seen, slices).mesh())


def _views(
    mesh: trimesh.Trimesh, rng: np.random.Generator, count: int, noise: float, sight: Sight
) -> Sequence[View]:
    if sight.rig is not None:
        stands = placed(mesh, sight.rig.target, rng, upright=sight.upright)
        return list(views_by(sight.rig.imagers, stands, rng, noise))
    optics: _Optics = {"projection": sight.projection, "distance": sight.distance}
    if sight.image_size is None and not sight.own_size:
        return simulate_instance(mesh, count, rng, noise=noise, **optics).views
    moved = random_similarity(mesh, rng, scales=(1.0, 1.0) if sight.own_size else SCALES)
    cameras = simulate_cameras(moved, count, rng, **optics)
    imagers = (_imager(camera, moved, sight.image_size) for camera in cameras)
    return list(views_by(imagers, moved, rng, noise))


def _imager(camera: Camera, mesh: trimesh.Trimesh, size: tuple[int, int] | None) -> Imager:
    return Imager(camera) if size is None else fitted_imager(camera, mesh, size)


def held_back_recognitions(
    fit: Callable[[Sequence[CanonicalShape], Sequence[str]], RecognitionModel],
    shapes: Sequence[CanonicalShape],
    labels: Sequence[str],
) -> list[Recognition]:
    """Ask of each instance a model that did not learn from it.

    Parameters
    ----------
    fit : callable
        Makes a model of shapes and labels; called for each fold of a cross-validation.
    shapes : sequence of CanonicalShape
        The training set.
    labels : sequence of str
        Of each shape; at least two of each class.

    Returns
    -------
    recognitions : list of Recognition
        One per shape.
    """
    names = np.array(labels)
    found: dict[int, Recognition] = {}
    counts = np.unique(names, return_counts=True)[1]
    folds = StratifiedKFold(min(FOLDS, counts.min()), shuffle=True, random_state=0)
    for learn, test in folds.split(names, names):
        of_fold = fit([shapes[index] for index in learn], names[learn].tolist())
        found |= {index: of_fold.recognize(shapes[index]) for index in test.tolist()}
    return [found[index] for index in range(len(shapes))]


def recognition_rates(
    model: RecognitionModel,
    held_back: Sequence[Recognition],
    shapes: Sequence[CanonicalShape],
    labels: Sequence[str],
) -> list[ClassRate]:
    """Measure how well a model names what it learned from, and what it did not.

    Parameters
    ----------
    model : RecognitionModel
        Fitted to all shapes.
    held_back : sequence of Recognition
        Of `held_back_recognitions`.
    shapes : sequence of CanonicalShape
        The training set.
    labels : sequence of str
        Of each shape.

    Returns
    -------
    rates : list of ClassRate
        Sorted by class.
    """
    names = np.array(labels)
    seen = np.array([model.recognize(shape).label for shape in shapes]) == names
    unseen = np.array([found.label for found in held_back]) == names
    return [
        ClassRate(
            str(label),
            int(np.sum(names == label)),
            float(seen[names == label].mean()),
            float(unseen[names == label].mean()),
        )
        for label in np.unique(names)
    ]
