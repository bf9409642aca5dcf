"""The surface between contours that do not match one to one: splits, holes, pieces that vanish.

Seen along the planes' normal, the contours of two layers divide the plane into regions. Where only
the layer below has material the surface faces up, where only the one above has it faces down;
each region is triangulated in the plane and its vertices are lifted to the layer that they are
of. Where a contour below and one above cross or part, the region's border jumps from one layer to
the other by a vertical edge; where they coincide, a vertical wall stands on them.

To find the regions, contours are cut into chains at their own vertices. Two chains between the same
places coincide: if they run the same way a wall stands on them, if not the one below bounds what
faces up and the one above what faces down. Any other chain lies inside or outside the other layer's
pieces, which the middle of a long one tells for all that follow before the layers meet again; it
bounds what faces up if it is outside and below or inside and above. From chain to chain, furthest
to the left where several go on, these bounds are followed until they close. `_knots.c` does this;
`_filling.c` triangulates, and leaves to manifold3d what is degenerate.

References
----------
G. Barequet and M. Sharir, Piecewise-linear interpolation between polygonal slices, 1996.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import manifold3d
import numpy as np
from numpy.typing import NDArray

from momrec_core._filling import fill
from momrec_core._knots import outline

__all__ = ["Knots", "cap", "join_knots"]


@dataclass(frozen=True, eq=False)
class Knots:
    """Groups of contours below and above, each group with what its contours share.

    Attributes
    ----------
    vertices : array of int, shape (n,)
        The vertices around all contours, one contour behind the other.
    is_own : array of bool, shape (n,)
        Whether a vertex takes part in its knot's contacts; the others lie on straight edges and
        are there for the slab on the other side. The first of a contour does.
    first : array of int, shape (contours + 1,)
        Where each contour begins in `vertices`.
    pieces : array of int, shape (contours,)
        The piece that each contour is of: its shell, then its holes.
    knots : array of int, shape (pieces,)
        The knot that each piece is of.
    is_above : array of bool, shape (pieces,)
        Whether a piece is of the layer above.
    links : array of int, shape (m, 2)
        Vertices below and above that lie upon each other.
    """

    vertices: NDArray[np.int64]
    is_own: NDArray[np.bool_]
    first: NDArray[np.int64]
    pieces: NDArray[np.int64]
    knots: NDArray[np.int64]
    is_above: NDArray[np.bool_]
    links: NDArray[np.int64]


def cap(
    points: NDArray[np.float64],
    vertices: NDArray[np.int64],
    ends: NDArray[np.int64],
    pieces: NDArray[np.int64],
    faces_up: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Triangulate pieces of the plane between contours.

    Parameters
    ----------
    points : array, shape (n, 3)
        All vertices, in the planes' frame.
    vertices : array of int, shape (m,)
        Those around the contours, with the pieces on the left, one contour behind the other.
    ends : array of int, shape (contours + 1,)
        Where each contour begins, and where the last one ends.
    pieces : array of int, shape (pieces + 1,)
        The first contour of each piece, and the number of contours.
    faces_up : array of bool, shape (pieces,)
        Whether a piece faces up, or down.

    Returns
    -------
    triangles : array of int, shape (k, 3)
        Each edge of a contour is used once, in its direction where the piece faces up, and all
        others in pairs.
    """
    triangles = np.empty((len(vertices) + 2 * len(ends) - 2, 3), dtype=np.int64)
    counts = np.empty(len(faces_up), dtype=np.int64)
    fill(points, vertices, ends, pieces, faces_up, triangles, counts)
    parts = [triangles[: counts[counts > 0].sum()]]
    for piece in np.flatnonzero(counts < 0):
        bounds = ends[pieces[piece] : pieces[piece + 1] + 1].tolist()
        plane = [points[vertices[low:high], :2] for low, high in pairwise(bounds)]
        doubtful = vertices[bounds[0] + manifold3d.triangulate(plane)]
        parts.append(doubtful if faces_up[piece] else doubtful[:, ::-1])
    return np.concatenate(parts)


def join_knots(
    points: NDArray[np.float64], knots: Knots
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Join groups of contours.

    Parameters
    ----------
    points : array, shape (n, 3)
        All vertices, in the planes' frame.
    knots : Knots
        The contours.

    Returns
    -------
    triangles : array of int, shape (m, 3)
        Facing outward. Each edge of a contour is used once.
    failed : array of int
        The knots that are left out, as their contacts contradict each other, by rounding.
    """
    parts = outline(
        points,
        knots.vertices,
        knots.is_own,
        knots.first,
        knots.pieces,
        knots.knots,
        knots.is_above,
        np.ascontiguousarray(knots.links),
    )
    upright, vertices, ends, regions, failed = (
        np.frombuffer(part, dtype=np.int64) for part in parts[:5]
    )
    faces_up = np.frombuffer(parts[5], dtype=bool)
    flat = cap(points, vertices, ends, regions, faces_up)
    return np.concatenate([upright.reshape(-1, 3), flat]), failed
