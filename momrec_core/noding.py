"""Where the contours of two adjacent layers touch or cross, seen along the planes' normal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from momrec_core._meeting import contacts
from momrec_core.rings import Rings

__all__ = ["Contacts", "find_contacts"]

# Units: above Clipper2's grid, and below the layers' cleaning, so that no two vertices touch one.
TOUCH = 1e-4
CONTACT = np.dtype(
    [
        ("group", np.int64),
        ("edges", np.int64, 2),
        ("at", np.float64, 2),
        ("points", np.float64, 2),
    ]
)


@dataclass(frozen=True, eq=False)
class Contacts:
    """Points that contours below and above have in common.

    Attributes
    ----------
    groups : array of int, shape (n,)
        The group of the contours that meet.
    below, above : array of int, shape (n,)
        The edges that meet, numbered as the vertices that they start from.
    below_at, above_at : array, shape (n,)
        Where on the edge, 0 to 1; exactly 0 where the contact is the edge's first vertex.
    points : array, shape (n, 2)
    """

    groups: NDArray[np.int64]
    below: NDArray[np.int64]
    above: NDArray[np.int64]
    below_at: NDArray[np.float64]
    above_at: NDArray[np.float64]
    points: NDArray[np.float64]


def find_contacts(
    rings: Rings,
    contours: NDArray[np.int64],
    groups: NDArray[np.int64],
    is_above: NDArray[np.bool_],
) -> Contacts:
    """Find where contours of two layers share a vertex, touch, or cross.

    Vertices within `TOUCH` of each other or of an edge count as on it, so that edges that
    coincide but for rounding are found to share their ends.

    Parameters
    ----------
    rings : Rings
        All contours, in the planes' frame, shape (n, 3).
    contours : array of int, shape (k,)
        Those that may meet.
    groups : array of int, shape (k,)
        Contours of different groups do not meet.
    is_above : array of bool, shape (k,)
        Whether each is of the layer above, not below.

    Returns
    -------
    contacts : Contacts
    """
    found = np.frombuffer(
        contacts(rings.points, rings.first, contours, groups, is_above, TOUCH), dtype=CONTACT
    )
    below, above = found["edges"].T
    below_at, above_at = found["at"].T
    return Contacts(found["group"], below, above, below_at, above_at, found["points"])
