"""From meshes to a recognition model: simulated instances, reconstructed as real ones would be."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedKFold

from momrec_core.canonical import CanonicalShape, normalize
from momrec_core.errors import MomrecError
from momrec_core.hull import reconstruct
from momrec_core.model import UNKNOWN, RecognitionModel
from momrec_core.simulation import simulate_instance
from momrec_ros.files import MESH_INPUTS, read_mesh
from momrec_ros.workers import Map, shared_map

__all__ = [
    "ClassRate",
    "find_classes",
    "mapped_instances",
    "recognition_rates",
    "reconstructed_instances",
]

FOLDS = 5  # of the cross-validation: each model learns from four fifths
JOBS_PER_WORKER = 16  # below, starting a process takes longer than it saves


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
        A mesh file is of the class of its stem. In a folder, each mesh file is of the class of
        its stem, and each subfolder is a class with all mesh files in it.

    Returns
    -------
    classes : dict
        Label to meshes, sorted by label; meshes of equal labels are joined.

    Raises
    ------
    MomrecError
        If a folder has no mesh, a file is none, or no class may have its name.
    """
    found: dict[str, list[Path]] = {}
    for path in paths:
        files = [path] if not path.is_dir() else [*_mesh_files(path), *_mesh_files(path, "*/*")]
        if not files:
            raise MomrecError(f"Expected meshes ({', '.join(MESH_INPUTS)}) in {path}, got none")
        for file in files:
            label = file.parent.name if path.is_dir() and file.parent != path else file.stem
            found.setdefault(label, []).append(file)
    wrong = [label for label in found if label == UNKNOWN or not label.isprintable()]
    if wrong:
        raise MomrecError(
            f'Expected printable names other than "{UNKNOWN}" for classes, got {wrong[0]!r}'
        )
    return {label: [read_mesh(file) for file in found[label]] for label in sorted(found)}


def _mesh_files(folder: Path, pattern: str = "*") -> list[Path]:
    return sorted(path for path in folder.glob(pattern) if path.suffix.lower() in MESH_INPUTS)


def reconstructed_instances(
    classes: Mapping[str, Sequence[trimesh.Trimesh]],
    *,
    instances: int,
    views: int,
    slices: int,
    noise: float = 0.0,
    seed: int = 0,
    workers: int = 1,
) -> Iterator[tuple[str, CanonicalShape]]:
    """Simulate instances of each class and reconstruct them from their views.

    Parameters
    ----------
    classes : mapping
        Label to meshes; the instances of a class take turns with its meshes.
    instances : int
        Of each class, each at its own random position, orientation and size.
    views : int
        Parallel projections of each instance.
    slices : int
        Slicing planes of each reconstruction.
    noise : float
        Of the contours, as for `simulate_views`.
    seed : int
        Determines the outcome, whatever the number of workers.
    workers : int
        Processes to use at most.

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
) -> Iterator[tuple[str, CanonicalShape]]:
    """Do as `reconstructed_instances` does, with workers that are there already.

    Parameters
    ----------
    classes, instances, views, slices, noise, seed
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
    rebuild = partial(_rebuilt, views=views, slices=slices, noise=noise)
    yield from zip(labels, apply(rebuild, meshes, seeds), strict=True)


def _rebuilt(
    mesh: trimesh.Trimesh, seed: tuple[int, ...], *, views: int, slices: int, noise: float
) -> CanonicalShape:
    instance = simulate_instance(mesh, views, np.random.default_rng(seed), noise=noise)
    return normalize(reconstruct(instance.views, slices).mesh())


def recognition_rates(
    model: RecognitionModel,
    fit: Callable[[Sequence[CanonicalShape], Sequence[str]], RecognitionModel],
    shapes: Sequence[CanonicalShape],
    labels: Sequence[str],
) -> list[ClassRate]:
    """Measure how well a model names what it learned from, and what it did not.

    Parameters
    ----------
    model : RecognitionModel
        Fitted to all shapes.
    fit : callable
        How it was fitted; called for each fold of the cross-validation.
    shapes : sequence of CanonicalShape
        The training set.
    labels : sequence of str
        Of each shape; at least two of each class.

    Returns
    -------
    rates : list of ClassRate
        Sorted by class.
    """
    names = np.array(labels)
    seen = _right(model, shapes, names)
    unseen = np.zeros(len(names), dtype=bool)
    counts = np.unique(names, return_counts=True)[1]
    folds = StratifiedKFold(min(FOLDS, counts.min()), shuffle=True, random_state=0)
    for learn, test in folds.split(names, names):
        of_fold = fit([shapes[index] for index in learn], names[learn].tolist())
        unseen[test] = _right(of_fold, [shapes[index] for index in test], names[test])
    return [
        ClassRate(
            str(label),
            int(np.sum(names == label)),
            float(seen[names == label].mean()),
            float(unseen[names == label].mean()),
        )
        for label in np.unique(names)
    ]


def _right(
    model: RecognitionModel, shapes: Sequence[CanonicalShape], names: NDArray[np.str_]
) -> NDArray[np.bool_]:
    given = np.array([model.recognize(shape).label for shape in shapes])
    right: NDArray[np.bool_] = given == names
    return right
