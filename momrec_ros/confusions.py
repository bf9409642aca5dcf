"""Which classes a model may take for each other, from instances that were held back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import leaves_list, linkage
from scipy.spatial.distance import squareform

from momrec_core.model import UNKNOWN, Recognition

__all__ = ["TELLING_SHARE", "Confusions", "Pair", "confusions"]

TELLING_SHARE = 0.01  # of a class's score that goes to another: less is not worth a line
NEVER = np.finfo(np.float64).tiny


@dataclass(frozen=True)
class Pair:
    """Two classes that may be taken for each other.

    Attributes
    ----------
    one, other : str
        The labels.
    share : float
        Of the score of instances of either that goes to the other, the mean of both, 0 to 1.
    mistaken : int
        Instances of either that are nearer to the other.
    """

    one: str
    other: str
    share: float
    mistaken: int


@dataclass(frozen=True, eq=False)
class Confusions:
    """What instances of each class are taken for by models that did not learn from them.

    Attributes
    ----------
    labels : tuple of str
        The classes, those that are like each other beside each other.
    nearest : array of int, shape (classes, classes)
        Of the instances of a class (row), how many are nearest to which class.
    unknown : array of int, shape (classes,)
        How many of them are not known.
    shares : array, shape (classes, classes)
        Mean share of the score that instances of a class (row) give to each class.
    """

    labels: tuple[str, ...]
    nearest: NDArray[np.int64]
    unknown: NDArray[np.int64]
    shares: NDArray[np.float64]

    def taken_for(self, label: str) -> tuple[str, float] | None:
        """Return the class that instances of another most go to, and their share; None for none."""
        row = self.labels.index(label)
        others = np.where(np.arange(len(self.labels)) == row, -1.0, self.shares[row])
        found = int(others.argmax())
        if others[found] < TELLING_SHARE:
            return None
        return self.labels[found], float(others[found])

    def alike(self) -> list[Pair]:
        """Return the pairs worth a look: taken for each other, or sharing enough of the score."""
        return [pair for pair in self.pairs() if pair.mistaken or pair.share >= TELLING_SHARE]

    def pairs(self) -> list[Pair]:
        """Return all pairs of classes, those that are taken for each other most first."""
        rows, columns = np.triu_indices(len(self.labels), 1)
        shares = (self.shares + self.shares.T)[rows, columns] / 2
        mistaken = (self.nearest + self.nearest.T)[rows, columns]
        order = np.lexsort((-shares, -mistaken))
        return [
            Pair(
                self.labels[rows[place]],
                self.labels[columns[place]],
                float(shares[place]),
                int(mistaken[place]),
            )
            for place in order.tolist()
        ]


def confusions(labels: Sequence[str], recognitions: Sequence[Recognition]) -> Confusions:
    """Gather what instances were taken for.

    Parameters
    ----------
    labels : sequence of str
        The class of each instance.
    recognitions : sequence of Recognition
        What a model that knows all classes and did not learn from the instance says of it.

    Returns
    -------
    confusions : Confusions
    """
    classes = sorted(set(labels))
    number = {label: index for index, label in enumerate(classes)}
    rows = np.array([number[label] for label in labels])
    distances = np.empty((len(labels), len(classes)))
    shares = np.empty_like(distances)
    for row, recognition in enumerate(recognitions):
        columns = [number[label] for label, _, _ in recognition.ranking]
        distances[row, columns] = [distance for _, distance, _ in recognition.ranking]
        shares[row, columns] = [score for _, _, score in recognition.ranking]
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), NEVER)
    members = (rows == np.arange(len(classes))[:, None]).astype(np.int64)
    each = members / members.sum(axis=1, keepdims=True)
    nearest = np.eye(len(classes), dtype=np.int64)[distances.argmin(axis=1)]
    strange = np.array([found.label == UNKNOWN for found in recognitions])
    order = _neighbours(each @ distances)
    return Confusions(
        tuple(classes[index] for index in order.tolist()),
        (members @ nearest)[np.ix_(order, order)],
        (members @ strange)[order],
        (each @ shares)[np.ix_(order, order)],
    )


def _neighbours(distances: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return an order in which classes stand beside those that they are near to.

    References
    ----------
    Z. Bar-Joseph, D. Gifford and T. Jaakkola, Fast optimal leaf ordering for hierarchical
    clustering, 2001.
    """
    if len(distances) < 3:
        return np.arange(len(distances))
    either = np.log1p((distances + distances.T) / 2)
    np.fill_diagonal(either, 0.0)
    tree = linkage(squareform(either, checks=False), "average", optimal_ordering=True)
    return np.asarray(leaves_list(tree), dtype=np.int64)
