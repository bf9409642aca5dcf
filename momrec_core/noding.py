"""Where the contours of two adjacent layers touch or cross, seen along the planes' normal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from momrec_core._meeting import contacts

__all__ = ["Contacts", "Edges", "find_contacts"]

# Units: above Clipper2's grid, and below the layers' cleaning, so that no two vertices touch one.
TOUCH = 1e-4
CONTACT = np.dtype([("edges", np.int64, 2), ("at", np.float64, 2), ("points", np.float64, 2)])


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of closed rings, in the plane.

    Attributes
    ----------
    starts, ends : array, shape (n, 2)
        Edge k runs from ``starts[k]`` to ``ends[k]``; each vertex is the start of one edge.
    groups : array of int, shape (n,)
        Edges of different groups do not meet.
    """

    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    groups: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Contacts:
    """Points that two sets of edges have in common.

    Attributes
    ----------
    below, above : array of int, shape (n,)
        The edges that meet.
    below_at, above_at : array, shape (n,)
        Where on the edge, 0 to 1; exactly 0 where the contact is the edge's first vertex.
    points : array, shape (n, 2)
    """

    below: NDArray[np.int64]
    above: NDArray[np.int64]
    below_at: NDArray[np.float64]
    above_at: NDArray[np.float64]
    points: NDArray[np.float64]


def find_contacts(below: Edges, above: Edges) -> Contacts:
    """Find where two sets of edges share a vertex, touch, or cross.

    Vertices within `TOUCH` of each other or of an edge count as on it, so that edges that
    coincide but for rounding are found to share their ends.
    """
    sides = (below.starts, below.ends, below.groups, above.starts, above.ends, above.groups)
    found = np.frombuffer(contacts(*sides, TOUCH), dtype=CONTACT)
    lower, upper = found["edges"].T
    below_at, above_at = found["at"].T
    return Contacts(lower, upper, below_at, above_at, found["points"])
