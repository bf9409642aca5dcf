"""Edges that more than two triangles share, doubled so that each is shared by two."""

from __future__ import annotations

from collections import Counter, defaultdict

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from momrec_core._manifolds import crowded, take

__all__ = ["double_shared_edges"]

FEWEST_AROUND = 4  # triangles around an edge that more than two of a closed surface share


def double_shared_edges(
    points: NDArray[np.float64], triangles: NDArray[np.int64], sound: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Make a closed surface edge-manifold where it touches itself along an edge.

    The triangles around such an edge are taken in pairs with material between them. One pair
    keeps the edge, each other one gets a vertex of its own in the edge's middle; then bodies that
    only touch have no vertex in common either.

    Parameters
    ----------
    points : array, shape (n, 3)
    triangles : array of int, shape (m, 3)
        A closed, oriented surface: every edge is used as often in one direction as in the other.
    sound : int, default 0
        How many of them, the first, share no edge with more than one other of these first.

    Returns
    -------
    points : array, shape (n', 3)
        The given ones that are in use, some of them more than once, and the new ones.
    triangles : array of int, shape (m', 3)
        Every edge is shared by exactly two of them.
    """
    is_crowded = np.empty(len(triangles), dtype=bool)
    crowded(triangles, is_crowded, sound, len(points))
    suspicious = np.flatnonzero(is_crowded)
    if len(suspicious) == 0:
        return points, triangles
    kept = suspicious[_are_no_flaps(triangles[suspicious])]
    taken_points = np.empty_like(points)
    taken = np.empty((len(triangles) - len(suspicious) + len(kept), 3), dtype=np.int64)
    count = take(triangles, is_crowded, kept, points, taken_points, taken)
    points, triangles = taken_points[:count], taken
    if len(kept) < FEWEST_AROUND:
        return points, triangles
    whole, suspects = np.split(triangles, [len(triangles) - len(kept)])
    order, first, counts = _group_edges(len(points), suspects)
    shared = np.flatnonzero(counts > 2)
    if len(shared) == 0:
        return points, triangles
    heads, tails = suspects.ravel(), suspects[:, [1, 2, 0]].ravel()
    middles: list[NDArray[np.float64]] = []
    inserted: dict[int, dict[int, int]] = defaultdict(dict)
    for start, count in zip(first[shared], counts[shared], strict=True):
        sides = np.sort(order[start : start + count])
        middle = points[[heads[sides[0]], tails[sides[0]]]].mean(axis=0)
        for pair in _pair_around_edge(points, suspects, sides)[1:]:
            for side in pair:
                inserted[side // 3][side % 3] = len(points) + len(middles)
            middles.append(middle)
    parts = [_fan(suspects[face], corners) for face, corners in inserted.items()]
    suspects = np.delete(suspects, list(inserted), axis=0)
    ends = np.zeros(len(points) + len(middles), dtype=bool)
    ends[len(points) :] = True
    sides = order[first[shared]]
    ends[[heads[sides], tails[sides]]] = True
    return _split_vertices(
        np.concatenate([points, middles]), np.concatenate([whole, suspects, *parts]), ends
    )


def _split_vertices(
    points: NDArray[np.float64], triangles: NDArray[np.int64], is_suspect: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Give each suspect vertex as many copies as there are fans of triangles around it.

    Corners belong to one fan where their triangles share an edge at the vertex.
    """
    near = np.flatnonzero(is_suspect[triangles].any(axis=1))
    local = triangles[near]
    order, begin, counts = _group_edges(len(points), local)
    first, second = order[begin[counts == 2] + np.array([[0], [1]])]
    following = np.arange(local.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    joined = np.concatenate([[first, following[second]], [following[first], second]], axis=1)
    graph = coo_array((np.ones(joined.shape[1]), joined), shape=(local.size, local.size))
    _, labels = connected_components(graph, directed=False)
    corners = np.flatnonzero(is_suspect[local.ravel()])
    _, samples, fans = np.unique(labels[corners], return_index=True, return_inverse=True)
    vertices = local.ravel()[corners[samples]]
    _, kept = np.unique(vertices, return_index=True)
    copies = np.delete(np.arange(len(vertices)), kept)
    numbers = vertices.copy()
    numbers[copies] = len(points) + np.arange(len(copies))
    local.ravel()[corners] = numbers[fans]
    triangles[near] = local
    return np.concatenate([points, points[vertices[copies]]]), triangles


def _group_edges(
    count: int, triangles: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Sort the sides of triangles by edge; return the order, where each edge begins, how many."""
    heads, tails = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    edges = np.minimum(heads, tails) * count + np.maximum(heads, tails)
    order = np.argsort(edges)
    first = np.flatnonzero(np.diff(edges[order], prepend=-1))
    return order, first, np.diff(first, append=len(edges))


def _are_no_flaps(triangles: NDArray[np.int64]) -> list[bool]:
    """Tell which triangles do not lie upon others, back to back."""
    keys = [tuple(sorted(corners)) for corners in triangles.tolist()]
    rises = (triangles < triangles[:, [1, 2, 0]]).sum(axis=1)  # 2 as in 0, 1, 2; 1 as in 2, 1, 0
    balance: Counter[tuple[int, ...]] = Counter()
    for key, count in zip(keys, rises.tolist(), strict=True):
        balance[key] += 1 if count > 1 else -1
    return [balance[key] != 0 for key in keys]


def _fan(triangle: NDArray[np.int64], inserted: dict[int, int]) -> NDArray[np.int64]:
    """Divide a triangle that has vertices inserted into its sides."""
    loop: list[int] = []
    for corner in range(3):
        loop.append(int(triangle[corner]))
        if corner in inserted:
            loop.append(inserted[corner])
    hub = next(iter(inserted.values()))
    at = loop.index(hub)
    rim = loop[at + 1 :] + loop[:at]
    return np.array([(hub, rim[k], rim[k + 1]) for k in range(len(rim) - 1)])


def _pair_around_edge(
    points: NDArray[np.float64], triangles: NDArray[np.int64], sides: NDArray[np.int64]
) -> list[tuple[int, int]]:
    """Pair the sides that share an edge so that each pair has material between its triangles.

    Bodies that touch along the edge come apart so. Around the edge from its first vertex to its
    second, material ends at a triangle that runs along with it and begins at one that runs
    against it.
    """
    faces, corners = np.divmod(sides, 3)
    tails = triangles[faces, (corners + 1) % 3]
    along = triangles[faces, corners] == triangles[faces[0], corners[0]]
    origin = points[triangles[faces[0], corners[0]]]
    axis = points[tails[0]] - origin
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    basis = np.column_stack([across * np.linalg.norm(axis), np.cross(axis, across)])
    spokes = (points[triangles[faces, (corners + 2) % 3]] - origin) @ basis
    turn = np.lexsort([along, np.arctan2(spokes[:, 1], spokes[:, 0])])
    ends = along[turn]
    balance = np.cumsum(np.where(ends, -1, 1))
    begin = int(np.argmin(balance)) + 1
    waiting: list[int] = []
    pairs = []
    for side, is_end in zip(np.roll(sides[turn], -begin), np.roll(ends, -begin), strict=True):
        if is_end:
            pairs.append((int(side), waiting.pop()))
        else:
            waiting.append(int(side))
    return pairs
