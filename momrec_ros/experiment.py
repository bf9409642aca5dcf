"""The experiment of section 5 of the paper: what is simulated, learned, held back and found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import trimesh
from numpy.typing import NDArray

from momrec_core.canonical import CanonicalShape
from momrec_core.model import RecognitionModel
from momrec_core.stepwise import (
    Instances,
    Split,
    StepwiseNames,
    model_names,
    paper_names,
    random_split,
)
from momrec_core.trust import Verdicts, judge
from momrec_ros.terminal import Terminal
from momrec_ros.training import mapped_instances
from momrec_ros.workers import Map

__all__ = ["ORDERS", "Plan", "Spread", "Study", "Trial", "Trust", "study", "trust"]

ORDERS = (2, 3, 4, 5)
TRUST_SPLITS = 10  # of the splits, for what takes a model without each class
INSTANCES, TRAINING = 11, 7  # of each class: all, and those that are learned from
SPLITS = 2**32  # in the seed of a split's random numbers: none of the instances' has it

Method = Callable[[Instances, Split], StepwiseNames]


@dataclass(frozen=True)
class Plan:
    """How the experiment is done.

    Attributes
    ----------
    seed : int
        Determines the outcome.
    splits : int
        Random splits in training and test set; the first gives Table 1.
    views : int
        Of each instance.
    slices : int
        Of each reconstruction.
    workers : int
        Processes to reconstruct with, at most.
    """

    seed: int
    splits: int
    views: int
    slices: int
    workers: int


@dataclass(frozen=True, eq=False)
class Spread:
    """Rates over several splits after each step, 0 to 1; arrays of shape (steps,)."""

    train_mean: NDArray[np.float64]
    train_std: NDArray[np.float64]
    test_mean: NDArray[np.float64]
    test_std: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trial:
    """What one way of recognition makes of the instances, for moments up to one order.

    Attributes
    ----------
    order : int
        Highest order of the moments.
    labels : array of str, shape (n,)
        The classes of the instances.
    splits : tuple of Split
        As many as names.
    names : tuple of StepwiseNames
        What the instances are taken for in each split.
    """

    order: int
    labels: NDArray[np.str_]
    splits: tuple[Split, ...]
    names: tuple[StepwiseNames, ...]

    @property
    def steps(self) -> int:
        """The number of steps that all splits have."""
        return min(len(names.selected) for names in self.names)

    def train_rates(self) -> NDArray[np.float64]:
        """Return the share of the training set named rightly, 0 to 1; shape (splits, steps)."""
        return self._rates([split.train for split in self.splits])

    def test_rates(self) -> NDArray[np.float64]:
        """Return the share of the test set named rightly, 0 to 1; shape (splits, steps)."""
        return self._rates([split.test for split in self.splits])

    def spread(self) -> Spread:
        """Return mean and standard deviation over the splits."""
        train, test = self.train_rates(), self.test_rates()
        return Spread(train.mean(axis=0), train.std(axis=0), test.mean(axis=0), test.std(axis=0))

    def confusions(self, step: int) -> dict[tuple[str, str], int]:
        """Return how often a class of the test sets is taken for another, commonest first.

        Parameters
        ----------
        step : int
            After how many steps, from 1.
        """
        counts: dict[tuple[str, str], int] = {}
        for names, split in zip(self.names, self.splits, strict=True):
            for member in split.test.tolist():
                pair = str(self.labels[member]), str(names.named[step - 1][member])
                if pair[0] != pair[1]:
                    counts[pair] = counts.get(pair, 0) + 1
        return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))

    def _rates(self, members: Sequence[NDArray[np.int64]]) -> NDArray[np.float64]:
        pairs = zip(self.names, members, strict=True)
        return np.array([names.rates(self.labels, some)[: self.steps] for names, some in pairs])


@dataclass(frozen=True, eq=False)
class Study:
    """Instances of some classes and how they are recognised.

    Attributes
    ----------
    models : dict
        Label to mesh, as modelled; the first one where a class has several.
    shapes : tuple of CanonicalShape
        All instances, reconstructed; class by class.
    instances : Instances
        Their moments.
    ruled : dict
        Order to trial, in the frames by A.1 to A.3 only: the paper's method.
    free : dict
        Order to trial, in all admissible frames.
    """

    models: dict[str, trimesh.Trimesh]
    shapes: tuple[CanonicalShape, ...]
    instances: Instances
    ruled: dict[int, Trial]
    free: dict[int, Trial]

    def first_instances(self) -> dict[str, CanonicalShape]:
        """Return the first instance of each class."""
        return dict(zip(self.instances.labels.tolist()[::-1], self.shapes[::-1], strict=True))


def study(
    classes: Mapping[str, Sequence[trimesh.Trimesh]],
    plan: Plan,
    terminal: Terminal,
    apply: Map = map,
    *,
    orders: Sequence[int] = ORDERS,
) -> Study:
    """Simulate, reconstruct and recognise instances of some classes.

    Parameters
    ----------
    classes : mapping
        Label to meshes; the instances of a class take turns with its meshes.
    plan : Plan
        How.
    terminal : Terminal
        Shows the progress.
    apply : callable
        ``map``, or that of a pool of workers.
    orders : sequence of int
        Highest orders of the moments to recognise by.

    Returns
    -------
    study : Study
    """
    rebuilt = mapped_instances(
        classes,
        apply,
        instances=INSTANCES,
        views=plan.views,
        slices=plan.slices,
        seed=plan.seed,
    )
    pairs = list(terminal.progress(rebuilt, "reconstructing", len(classes) * INSTANCES))
    shapes = tuple(shape for _, shape in pairs)
    instances = Instances.of_shapes([label for label, _ in pairs], shapes)
    splits = tuple(
        random_split(instances.labels, TRAINING, np.random.default_rng((plan.seed, SPLITS, number)))
        for number in range(plan.splits)
    )
    ruled, free = (
        {
            order: _trial(instances, order, splits, method, terminal=terminal, apply=apply)
            for order in orders
        }
        for method in (paper_names, model_names)
    )
    models = {label: meshes[0] for label, meshes in classes.items()}
    return Study(models, shapes, instances, ruled, free)


def _trial(
    instances: Instances,
    order: int,
    splits: tuple[Split, ...],
    method: Method,
    *,
    terminal: Terminal,
    apply: Map,
) -> Trial:
    named = apply(partial(method, instances.up_to(order)), splits)
    names = terminal.progress(named, f"recognising, order {order}", len(splits))
    return Trial(order, instances.labels, splits, tuple(names))


@dataclass(frozen=True, eq=False)
class Trust:
    """What models say of instances held back.

    Attributes
    ----------
    known : Verdicts
        By models of all classes.
    with_strangers : Verdicts
        By models without one class, each class in turn; its instances are strangers to them.
    """

    known: Verdicts
    with_strangers: Verdicts


def trust(found: Study, terminal: Terminal) -> Trust:
    """Ask models of instances held back, and of classes left out in turn.

    Parameters
    ----------
    found : Study
        Of three classes or more.
    terminal : Terminal
        Shows the progress.

    Returns
    -------
    trust : Trust
    """
    splits = next(iter(found.ruled.values())).splits[:TRUST_SPLITS]
    labels = np.unique(found.instances.labels).tolist()
    known, with_strangers = [], []
    for split in terminal.progress(splits, "leaving classes out", len(splits)):
        known.append(_verdicts(found, split, None))
        with_strangers += [_verdicts(found, split, label) for label in labels]
    return Trust(Verdicts.joined(known), Verdicts.joined(with_strangers))


def _verdicts(found: Study, split: Split, left_out: str | None) -> Verdicts:
    """Fit a model to a split's training set, without a class, and judge all it has not seen."""
    labels = found.instances.labels
    of_class = np.flatnonzero(labels == left_out)
    learned = np.setdiff1d(split.train, of_class).tolist()
    asked = np.union1d(split.test, of_class).tolist()
    model = RecognitionModel.fit([found.shapes[one] for one in learned], labels[learned].tolist())
    return judge(model, [found.shapes[one] for one in asked], labels[asked].tolist())
