"""How far a model's word can be trusted: strangers rejected, scores that mean what they say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momrec_core.model import UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from momrec_core.canonical import CanonicalShape
    from momrec_core.model import RecognitionModel

__all__ = ["Curve", "Reliability", "Verdicts", "judge", "rejection_curve", "reliability"]

BINS = 10  # of the reliability diagram, equally wide


@dataclass(frozen=True, eq=False)
class Verdicts:
    """What models said of shapes that they had not learned from.

    Attributes
    ----------
    familiar : array of bool, shape (n,)
        Whether a shape is of one of its model's classes.
    familiarity : array, shape (n,)
        How sure the model was of that, 0 to 1: its score, or what a score of ``unknown`` leaves.
    right : array of bool, shape (n,)
        Whether the label was right; of a stranger, ``unknown`` is.
    scores : array, shape (n,)
        How sure the model was of its label, 0 to 1.
    """

    familiar: NDArray[np.bool_]
    familiarity: NDArray[np.float64]
    right: NDArray[np.bool_]
    scores: NDArray[np.float64]

    @staticmethod
    def joined(parts: Sequence[Verdicts]) -> Verdicts:
        """Return the verdicts of several models as one."""
        return Verdicts(
            np.concatenate([part.familiar for part in parts]),
            np.concatenate([part.familiarity for part in parts]),
            np.concatenate([part.right for part in parts]),
            np.concatenate([part.scores for part in parts]),
        )


def judge(
    model: RecognitionModel, shapes: Sequence[CanonicalShape], labels: Sequence[str]
) -> Verdicts:
    """Let a model name shapes.

    Parameters
    ----------
    model : RecognitionModel
        Fitted to other shapes.
    shapes : sequence of CanonicalShape
        Of any classes, also of some that the model does not know.
    labels : sequence of str
        The class of each.

    Returns
    -------
    verdicts : Verdicts
    """
    found = [model.recognize(shape) for shape in shapes]
    familiar = np.isin(np.array(labels), model.classes)
    expected = np.where(familiar, np.array(labels), UNKNOWN)
    scores = np.array([recognition.score for recognition in found])
    known = np.array([recognition.known for recognition in found], dtype=bool)
    return Verdicts(
        familiar=familiar,
        familiarity=np.where(known, scores, 1.0 - scores),
        right=np.array([recognition.label for recognition in found]) == expected,
        scores=scores,
    )


@dataclass(frozen=True, eq=False)
class Curve:
    """Receiver operating characteristic of rejection, for every threshold on the familiarity.

    Attributes
    ----------
    known_rejected, strangers_rejected : array, shape (thresholds,)
        Shares, 0 to 1, both increasing.
    area : float
        Under the curve: the chance that a stranger is less familiar than a known shape.
    """

    known_rejected: NDArray[np.float64]
    strangers_rejected: NDArray[np.float64]
    area: float


def rejection_curve(verdicts: Verdicts) -> Curve:
    """Return how many strangers are rejected at the cost of how many known shapes.

    Parameters
    ----------
    verdicts : Verdicts
        With strangers and others.

    Returns
    -------
    curve : Curve

    Raises
    ------
    ValueError
        If there are no strangers, or nothing else.
    """
    strange = ~verdicts.familiar
    if not 0 < strange.sum() < len(strange):
        raise ValueError(
            f"Expected strangers and known shapes, got {strange.sum()} strangers of {len(strange)}"
        )
    order = np.argsort(verdicts.familiarity, kind="stable")
    ends = np.append(np.diff(verdicts.familiarity[order]) > 0, [True])  # of runs of ties
    strangers = np.cumsum(strange[order])[ends] / strange.sum()
    known = np.cumsum(~strange[order])[ends] / (~strange).sum()
    across, up = np.concatenate([[0.0], known]), np.concatenate([[0.0], strangers])
    area = float(np.sum(np.diff(across) * (up[1:] + up[:-1]) / 2))
    return Curve(across, up, area)


@dataclass(frozen=True, eq=False)
class Reliability:
    """How often labels are right that are given with about the same score.

    Attributes
    ----------
    scores : array, shape (bins,)
        Mean score; NaN in an empty bin.
    rates : array, shape (bins,)
        Share of right labels; NaN in an empty bin.
    counts : array of int, shape (bins,)
        Number of labels.
    error : float
        Expected calibration error: the mean difference of the two over all labels.
    """

    scores: NDArray[np.float64]
    rates: NDArray[np.float64]
    counts: NDArray[np.int64]
    error: float


def reliability(verdicts: Verdicts, bins: int = BINS) -> Reliability:
    """Compare scores with how often labels of such scores are right.

    Parameters
    ----------
    verdicts : Verdicts
        At least one.
    bins : int
        Equally wide intervals of the score.

    Returns
    -------
    reliability : Reliability
    """
    places = np.minimum((verdicts.scores * bins).astype(np.int64), bins - 1)
    counts = np.bincount(places, minlength=bins)
    weights = np.where(counts > 0, counts, np.nan)
    scores = np.bincount(places, weights=verdicts.scores, minlength=bins) / weights
    rates = np.bincount(places, weights=verdicts.right, minlength=bins) / weights
    error = float(np.nansum(counts * np.abs(scores - rates)) / len(verdicts.scores))
    return Reliability(scores, rates, counts, error)
