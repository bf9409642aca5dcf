"""How recognition fares step by step on instances held back: the experiment of section 5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from momrec_core.covariance import distances_from_means, whitening
from momrec_core.features import feature_vectors, moment_indices

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from momrec_core.canonical import CanonicalShape

__all__ = ["Instances", "Split", "StepwiseNames", "model_names", "paper_names", "random_split"]

MAX_STEPS = 10  # of the selection, as in the paper


@dataclass(frozen=True, eq=False)
class Instances:
    """Shapes of known classes, by their moments.

    Attributes
    ----------
    labels : array of str, shape (n,)
        The class of each.
    indices : tuple of (int, int, int)
        The moments eta_ijk in the columns of the candidates.
    candidates : tuple of arrays, shape (frames, len(indices))
        For each instance its moments in each admissible frame; the frame by A.1 to A.3 first.
    """

    labels: NDArray[np.str_]
    indices: tuple[tuple[int, int, int], ...]
    candidates: tuple[NDArray[np.float64], ...]

    @classmethod
    def of_shapes(
        cls, labels: Sequence[str], shapes: Sequence[CanonicalShape], order: int = 5
    ) -> Self:
        """Take the moments of shapes.

        Parameters
        ----------
        labels : sequence of str
            The class of each shape.
        shapes : sequence of CanonicalShape
            At least one.
        order : int
            Highest order of the moments, 2 to 5.

        Returns
        -------
        instances : Instances
        """
        indices = moment_indices(order)
        candidates = [feature_vectors(shape, indices) for shape in shapes]
        return cls(np.array(labels), tuple(indices), tuple(candidates))

    def up_to(self, order: int) -> Self:
        """Return the same instances with the moments up to an order only."""
        kept = [column for column, index in enumerate(self.indices) if sum(index) <= order]
        return type(self)(
            self.labels,
            tuple(self.indices[column] for column in kept),
            tuple(vectors[:, kept] for vectors in self.candidates),
        )

    def by_rules_only(self) -> Self:
        """Return the same instances in the frame by A.1 to A.3 only, as in the paper."""
        return type(self)(
            self.labels, self.indices, tuple(vectors[:1] for vectors in self.candidates)
        )


@dataclass(frozen=True, eq=False)
class Split:
    """Which instances are learned from, and which are held back.

    Attributes
    ----------
    train, test : array of int
        Indices of instances.
    """

    train: NDArray[np.int64]
    test: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class StepwiseNames:
    """What instances are taken for after each step of the selection.

    Attributes
    ----------
    selected : tuple of (int, int, int)
        The moments in the order of their selection.
    named : array of str, shape (steps, n)
        The nearest class of each instance, by the first moments only.
    """

    selected: tuple[tuple[int, int, int], ...]
    named: NDArray[np.str_]

    def rates(self, labels: NDArray[np.str_], members: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the share of some instances that is named rightly after each step.

        Parameters
        ----------
        labels : array of str, shape (n,)
            The classes of all instances.
        members : array of int
            Indices of the instances in question.

        Returns
        -------
        rates : array, shape (steps,)
            0 to 1.
        """
        return np.asarray((self.named == labels)[:, members].mean(axis=1))


def random_split(labels: NDArray[np.str_], training: int, rng: np.random.Generator) -> Split:
    """Draw instances of each class to learn from; the others are held back.

    Parameters
    ----------
    labels : array of str, shape (n,)
        The class of each instance.
    training : int
        Number of instances of each class to learn from.
    rng : numpy Generator
        Source of randomness.

    Returns
    -------
    split : Split

    Raises
    ------
    ValueError
        If a class has no instance left to be held back.
    """
    train, test = [], []
    for label in np.unique(labels):
        members = rng.permutation(np.flatnonzero(labels == label))
        if not 1 <= training < len(members):
            raise ValueError(
                f"Expected more than {training} instances of each class, got {len(members)} "
                f"of {label}"
            )
        train.append(members[:training])
        test.append(members[training:])
    return Split(np.concatenate(train), np.concatenate(test))


def paper_names(instances: Instances, split: Split, max_steps: int = MAX_STEPS) -> StepwiseNames:
    """Learn and name instances as the paper does: each in its frame by A.1 to A.3 only.

    Parameters
    ----------
    instances : Instances
        Of their candidates the first counts.
    split : Split
        What is learned from; all instances are named.
    max_steps : int
        Number of moments at the most.

    Returns
    -------
    names : StepwiseNames
        Fewer steps where the moments left are determined by those chosen.
    """
    from momrec_core.estimators import (  # noqa: PLC0415  # scikit-learn takes a second
        MinimumDistanceClassifier,
        StepwiseSelector,
    )

    ruled = instances.by_rules_only()
    vectors, labels = np.concatenate(ruled.candidates)[split.train], ruled.labels[split.train]
    selected = StepwiseSelector(max_steps).fit(vectors, labels).selected_
    learned = MinimumDistanceClassifier().fit(vectors[:, selected], labels)
    return _names(ruled, selected, learned.classes_, learned.means_, learned.covariance_)


def model_names(instances: Instances, split: Split, max_steps: int = MAX_STEPS) -> StepwiseNames:
    """Learn and name instances as `RecognitionModel` does, in all their admissible frames.

    Parameters
    ----------
    instances, split, max_steps
        As for `paper_names`, but all candidates count: the instances of a class are aligned with
        each other, and an instance is of the class that one of its candidates is nearest to.

    Returns
    -------
    names : StepwiseNames
    """
    from momrec_core.learning import learn  # noqa: PLC0415  # scikit-learn takes a second

    learned = learn(
        [instances.candidates[member] for member in split.train],
        instances.labels[split.train].tolist(),
        instances.indices,
        max_steps,
    )
    return _names(
        instances,
        np.array(learned.selected),
        np.array(learned.classes),
        learned.means,
        learned.covariance,
    )


def _names(
    instances: Instances,
    selected: NDArray[np.int64],
    classes: NDArray[np.str_],
    means: NDArray[np.float64],
    covariance: NDArray[np.float64],
) -> StepwiseNames:
    """Name all instances by the first selected moment, by the first two, and so on."""
    counts = [len(vectors) for vectors in instances.candidates]
    starts = np.cumsum([0, *counts[:-1]])
    vectors = np.concatenate(instances.candidates)[:, selected]
    named = []
    for step in range(1, len(selected) + 1):
        metric, _ = whitening(covariance[:step, :step])
        distances = distances_from_means(vectors[:, :step], means[:, :step], metric)
        nearest = np.minimum.reduceat(distances, starts, axis=0).argmin(axis=1)
        named.append(classes[nearest])
    return StepwiseNames(
        tuple(instances.indices[column] for column in selected.tolist()), np.array(named)
    )
