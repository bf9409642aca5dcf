"""Surfaces that touch themselves, taken apart into sheets that do not share edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["separate_sheets"]


def separate_sheets(
    points: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Double vertices where more than two triangles share an edge.

    Parameters
    ----------
    points : array, shape (n, 3)
    triangles : array of int, shape (m, 3)
        A closed, oriented surface: every edge is used as often in one direction as in the other.

    Returns
    -------
    points : array, shape (n', 3)
        The used ones, some of them twice.
    triangles : array of int, shape (m, 3)
        The same triangles; every edge is shared by exactly two of them.
    """
    heads, tails = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    edges = np.minimum(heads, tails) * len(points) + np.maximum(heads, tails)
    order = np.lexsort([heads > tails, edges])
    _, first, counts = np.unique(edges[order], return_index=True, return_counts=True)
    if (counts == 2).all():
        return points, triangles
    simple = first[counts == 2]
    pairs = [np.c_[order[simple], order[simple + 1]]]
    for start, count in zip(first[counts > 2], counts[counts > 2], strict=True):
        pairs.append(_pair_around_edge(points, triangles, order[start : start + count]))
    return _split_vertices(points, triangles, np.concatenate(pairs))


def _pair_around_edge(
    points: NDArray[np.float64], triangles: NDArray[np.int64], sides: NDArray[np.int64]
) -> NDArray[np.int64]:
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
    _, _, across = np.linalg.svd(axis[None, :])
    if np.linalg.det(np.vstack([axis, across[1:]])) < 0:
        across[2] *= -1
    spokes = (points[triangles[faces, (corners + 2) % 3]] - origin) @ across[1:].T
    turn = np.lexsort([along, np.arctan2(spokes[:, 1], spokes[:, 0])])
    waiting: list[int] = []
    pairs = []
    for side, ends in [*zip(sides[turn], along[turn], strict=True)] * 2:
        if not ends and len(waiting) + len(pairs) < len(sides) // 2:
            waiting.append(side)
        elif ends and waiting and not any(side == pair[0] for pair in pairs):
            pairs.append((side, waiting.pop()))
    return np.array(pairs)


def _split_vertices(
    points: NDArray[np.float64], triangles: NDArray[np.int64], side_pairs: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Give each vertex as many copies as there are fans of triangles around it."""
    following = np.arange(triangles.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    first, second = side_pairs.T
    joined = np.r_[np.c_[first, following[second]], np.c_[following[first], second]]
    shape = (triangles.size, triangles.size)
    graph = coo_array((np.ones(len(joined)), joined.T), shape=shape)
    _, fans = connected_components(graph, directed=False)
    _, representatives, faces = np.unique(fans, return_index=True, return_inverse=True)
    return points[triangles.ravel()[representatives]], faces.reshape(-1, 3)
