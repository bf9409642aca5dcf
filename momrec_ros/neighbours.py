"""How near classes are to each other, as reconstructed and as modelled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from momrec_core.covariance import distances_from_means, whitening
from momrec_core.stepwise import Instances

__all__ = ["Neighbour", "nearest_neighbours"]


@dataclass(frozen=True)
class Neighbour:
    """A class and the one nearest to it; distances in the metric of the total covariance.

    Attributes
    ----------
    label, nearest : str
        The class, and that with the nearest mean.
    apart : float
        Distance of the two means.
    apart_as_modelled : float
        Distance of the two objects as modelled.
    stray : float
        Root mean square distance of the class's instances from their mean.
    offset : float
        Distance of the class's mean from the object as modelled.
    """

    label: str
    nearest: str
    apart: float
    apart_as_modelled: float
    stray: float
    offset: float


def nearest_neighbours(instances: Instances, models: Instances) -> list[Neighbour]:
    """Find the nearest class to each class.

    Parameters
    ----------
    instances : Instances
        Reconstructed; the frames by A.1 to A.3 count.
    models : Instances
        The same classes as modelled, one of each, with the same moments.

    Returns
    -------
    neighbours : list of Neighbour
        Sorted by label.
    """
    vectors = np.concatenate(instances.by_rules_only().candidates)
    classes, members = np.unique(instances.labels, return_inverse=True)
    means = np.array([vectors[instances.labels == label].mean(axis=0) for label in classes])
    order = [models.labels.tolist().index(label) for label in classes]
    exact = np.concatenate(models.by_rules_only().candidates)[order]
    metric, _ = whitening(np.atleast_2d(np.cov(vectors.T, bias=True)))
    own = distances_from_means(vectors, means, metric)[np.arange(len(vectors)), members]
    between = distances_from_means(means, means, metric)
    between_exact = distances_from_means(exact, exact, metric)
    to_exact = distances_from_means(means, exact, metric)
    nearest = (between + np.diag(np.full(len(classes), np.inf))).argmin(axis=1)
    return [
        Neighbour(
            label=str(label),
            nearest=str(classes[nearest[index]]),
            apart=float(between[index, nearest[index]]),
            apart_as_modelled=float(between_exact[index, nearest[index]]),
            stray=float(np.sqrt(np.mean(own[members == index] ** 2))),
            offset=float(to_exact[index, index]),
        )
        for index, label in enumerate(classes)
    ]
