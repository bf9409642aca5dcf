"""One more class for a model: what it is learned from, and how well it is told from the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import KFold

from momrec_core.canonical import CanonicalShape
from momrec_core.errors import MomrecError
from momrec_core.model import RecognitionModel
from momrec_ros.files import MESH_INPUTS

__all__ = ["BAG_SUFFIX", "Closeness", "Lesson", "assess", "split_sources"]

BAG_SUFFIX = ".mcap"
FOLDS = 5  # of the instances, each held back once
LEAST_TO_HOLD_BACK = 3  # instances: without one there are two to learn from


@dataclass(frozen=True)
class Closeness:
    """How near the instances of a class come to another class, in spreads of the other.

    Attributes
    ----------
    label : str
        The other class.
    nearest, median : float
        Distance from its mean of the instance that is nearest to it, and of the median one.
    within : int
        Number of instances inside the model's threshold, which may be taken for the other class.
    """

    label: str
    nearest: float
    median: float
    within: int


@dataclass(frozen=True)
class Lesson:
    """What came of learning one more class.

    Attributes
    ----------
    label : str
        The new class.
    instances : int
        Number of instances that it was learned from.
    right : int
        How many of these the new model names rightly.
    held_back : int or None
        The same with models that did not learn from the instance in question; None where the
        instances are too few for that.
    threshold : float
        Distance from a class, in its spreads, beyond which a shape is unknown.
    others : tuple of Closeness
        The other classes, the one with the nearest instance first.
    """

    label: str
    instances: int
    right: int
    held_back: int | None
    threshold: float
    others: tuple[Closeness, ...]


def split_sources(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Tell meshes from bags.

    Parameters
    ----------
    paths : sequence of Path
        Mesh files, rosbag2 folders and .mcap files.

    Returns
    -------
    meshes, bags : list of Path

    Raises
    ------
    MomrecError
        If one is none of these.
    """
    meshes = [path for path in paths if path.suffix.lower() in MESH_INPUTS and path.is_file()]
    bags = [path for path in paths if path.suffix.lower() == BAG_SUFFIX or path.is_dir()]
    for path in paths:
        if path not in meshes and path not in bags:
            raise MomrecError(
                f"Expected meshes ({', '.join(MESH_INPUTS)}), rosbag2 folders or {BAG_SUFFIX} "
                f"files, got {path}"
            )
    return meshes, bags


def assess(
    model: RecognitionModel, learned: RecognitionModel, shapes: Sequence[CanonicalShape]
) -> Lesson:
    """Measure how well the instances of a new class are named, and what they may be taken for.

    Parameters
    ----------
    model : RecognitionModel
        That did not know the class.
    learned : RecognitionModel
        What its `with_class` made of the shapes.
    shapes : sequence of CanonicalShape
        The instances.

    Returns
    -------
    lesson : Lesson
    """
    label = learned.classes[-1]
    return Lesson(
        label=label,
        instances=len(shapes),
        right=_rightly_named(learned, shapes),
        held_back=_held_back(model, label, shapes),
        threshold=model.threshold,
        others=_others(model, shapes),
    )


def _rightly_named(learned: RecognitionModel, shapes: Sequence[CanonicalShape]) -> int:
    return sum(learned.recognize(shape).label == learned.classes[-1] for shape in shapes)


def _held_back(model: RecognitionModel, label: str, shapes: Sequence[CanonicalShape]) -> int | None:
    if len(shapes) < LEAST_TO_HOLD_BACK:
        return None
    folds = KFold(min(FOLDS, len(shapes)), shuffle=True, random_state=0)
    right = 0
    for kept, test in folds.split(np.arange(len(shapes))):
        of_fold = model.with_class(label, [shapes[index] for index in kept])
        right += _rightly_named(of_fold, [shapes[index] for index in test])
    return right


def _others(model: RecognitionModel, shapes: Sequence[CanonicalShape]) -> tuple[Closeness, ...]:
    distances = np.array([_distances(model, shape) for shape in shapes]) / model.spreads
    found = [
        Closeness(
            label,
            nearest=float(column.min()),
            median=float(np.median(column)),
            within=int(np.sum(column <= model.threshold)),
        )
        for label, column in zip(model.classes, distances.T, strict=True)
    ]
    return tuple(sorted(found, key=lambda other: other.nearest))


def _distances(model: RecognitionModel, shape: CanonicalShape) -> NDArray[np.float64]:
    """Return a shape's distance from each class, in the order of the model's classes."""
    found = {label: distance for label, distance, _ in model.recognize(shape).ranking}
    return np.array([found[label] for label in model.classes])
