"""The surface between contours that do not match one to one: splits, holes, pieces that vanish.

Seen along the planes' normal, the contours of two layers divide the plane into regions. Where only
the layer below has material the surface faces up, where only the one above has it faces down;
each region is triangulated in the plane and its vertices are lifted to the layer that they are
of. Where a contour below and one above cross or part, the region's border jumps from one layer to
the other by a vertical edge; where they coincide, a vertical wall stands on them.

References
----------
G. Barequet and M. Sharir, Piecewise-linear interpolation between polygonal slices, 1996.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import manifold3d
import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["Knot", "KnotError", "cap", "join_knot"]

Triangles = list[tuple[int, int, int]]


class KnotError(Exception):
    """The contours' contacts contradict each other, by rounding."""


@dataclass(frozen=True, eq=False)
class Knot:
    """A group of contours below and above with what they share.

    Attributes
    ----------
    below, above : list of list of array of int
        Per piece the contours, as vertex indices in order: shell, then holes.
    links : array of int, shape (n, 2)
        Vertices below and above that lie upon each other.
    """

    below: list[list[NDArray[np.int64]]]
    above: list[list[NDArray[np.int64]]]
    links: NDArray[np.int64]


def cap(points: NDArray[np.float64], contours: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Triangulate what contours bound, facing up.

    Parameters
    ----------
    points : array, shape (n, 3)
        All vertices, in the planes' frame.
    contours : list of array of int
        Vertex indices, with the region on the left.

    Returns
    -------
    triangles : array of int, shape (m, 3)
        Each edge of a contour is used once, in its direction, and all others in pairs.
    """
    loops = [points[contour, :2] for contour in contours]
    return np.asarray(np.concatenate(contours)[manifold3d.triangulate(loops)])


def join_knot(
    points: NDArray[np.float64], knot: Knot, is_own: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Join a group of contours.

    Parameters
    ----------
    points : array, shape (n, 3)
        All vertices, in the planes' frame.
    knot : Knot
        The contours.
    is_own : array of bool, shape (n,)
        Whether a vertex takes part in this slab's contacts; the others lie on straight edges
        and are there for the slab on the other side.

    Returns
    -------
    triangles : array of int, shape (m, 3)
        Facing outward. Each edge of a contour is used once.

    Raises
    ------
    KnotError
        If the regions' borders do not close.
    """
    flat = {int(high): int(low) for low, high in knot.links}
    if len(flat) < len(knot.links) or len(set(flat.values())) < len(knot.links):
        raise KnotError("a vertex touches two others")
    below = [chain for piece in knot.below for ring in piece for chain in _chains(ring, is_own)]
    above = [chain for piece in knot.above for ring in piece for chain in _chains(ring, is_own)]
    by_ends = {_ends(chain, flat): chain for chain in below}
    walls: Triangles = []
    up: list[list[int]] = []
    down: list[list[int]] = []
    alone: list[list[int]] = []
    for chain in above:
        start, end = _ends(chain, flat)
        if (start, end) in by_ends:
            walls.extend(_wall(by_ends.pop((start, end)), chain))
        elif (end, start) in by_ends:
            up.append(by_ends.pop((end, start)))
            down.append(chain)
        else:
            alone.append(chain)
    rest = list(by_ends.values())
    for chain, inside in zip(rest, _inside(points, rest, knot.above), strict=True):
        (down if inside else up).append(chain[::-1] if inside else chain)
    for chain, inside in zip(alone, _inside(points, alone, knot.below), strict=True):
        (up if inside else down).append(chain[::-1] if inside else chain)
    facing_up = _fill(points, up, flat)
    facing_down = [triangle[::-1] for triangle in _fill(points, down, flat)]
    return np.array([*walls, *facing_up, *facing_down], dtype=np.int64).reshape(-1, 3)


def _chains(ring: NDArray[np.int64], is_own: NDArray[np.bool_]) -> list[list[int]]:
    """Cut a contour at its own vertices into straight chains."""
    own = np.flatnonzero(is_own[ring])
    turned = np.roll(ring, -own[0])
    cuts = [*(own - own[0]).tolist(), len(ring)]
    closed = [*turned.tolist(), int(turned[0])]
    return [closed[cuts[k] : cuts[k + 1] + 1] for k in range(len(own))]


def _ends(chain: list[int], flat: dict[int, int]) -> tuple[int, int]:
    return flat.get(chain[0], chain[0]), flat.get(chain[-1], chain[-1])


def _wall(below: list[int], above: list[int]) -> Triangles:
    """Return the vertical wall between two chains that lie upon each other."""
    foot = [(below[k], below[k + 1], above[0]) for k in range(len(below) - 1)]
    head = [(below[-1], above[k + 1], above[k]) for k in range(len(above) - 1)]
    return foot + head


def _inside(
    points: NDArray[np.float64], chains: list[list[int]], pieces: list[list[NDArray[np.int64]]]
) -> NDArray[np.bool_]:
    """Tell which chains run inside the pieces of the other layer."""
    region = shapely.MultiPolygon(
        [
            shapely.Polygon(points[piece[0], :2], [points[hole, :2] for hole in piece[1:]])
            for piece in pieces
        ]
    )
    ends = np.array([(chain[0], chain[-1]) for chain in chains], dtype=np.int64).reshape(-1, 2)
    middles = points[ends, :2].mean(axis=1)
    return np.asarray(shapely.contains_xy(region, middles))


def _fill(points: NDArray[np.float64], chains: list[list[int]], flat: dict[int, int]) -> Triangles:
    """Triangulate the regions that chains bound on their left, facing up.

    The corner between two chains belongs to the layer of the one that leaves it; where the one
    that arrives is of the other layer, a vertical triangle leads over.
    """
    if not chains:
        return []
    triangles: Triangles = []
    loops = []
    for cycle in _cycles(points, chains, flat):
        loop = [vertex for chain in cycle for vertex in chain[:-1]]
        for arriving, leaving in zip(cycle, [*cycle[1:], cycle[0]], strict=True):
            if arriving[-1] != leaving[0]:
                triangles.append((arriving[-2], arriving[-1], leaving[0]))
        loops.append(np.array(loop))
    triangles.extend(map(tuple, cap(points, loops).tolist()))
    return triangles


def _cycles(
    points: NDArray[np.float64], chains: list[list[int]], flat: dict[int, int]
) -> list[list[list[int]]]:
    """Order chains into closed borders, turning left where several meet."""
    leaving = defaultdict(list)
    for chain in chains:
        leaving[_ends(chain, flat)[0]].append(chain)
    cycles = []
    while leaving:
        start = next(iter(leaving))
        cycle: list[list[int]] = []
        corner = start
        while not cycle or corner != start:
            choices = leaving.get(corner)
            if not choices:
                raise KnotError("a region's border does not close")
            chain = _leftmost(points, cycle[-1], choices) if cycle else choices[0]
            choices.remove(chain)
            if not choices:
                del leaving[corner]
            cycle.append(chain)
            corner = _ends(chain, flat)[1]
        cycles.append(cycle)
    return cycles


def _leftmost(
    points: NDArray[np.float64], arriving: list[int], choices: list[list[int]]
) -> list[int]:
    """Return the chain that turns furthest to the left."""
    if len(choices) == 1:
        return choices[0]
    heading = points[arriving[-1], :2] - points[arriving[-2], :2]
    leads = np.array([points[chain[1], :2] - points[chain[0], :2] for chain in choices])
    sines = heading[0] * leads[:, 1] - heading[1] * leads[:, 0]
    return choices[int(np.argmax(np.arctan2(sines, leads @ heading)))]
