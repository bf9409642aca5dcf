"""Outlines of binary images: closed curves halfway between pixels, by marching squares."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import MultiPolygon

__all__ = ["pixel_outline"]

# Edges of a cell of four pixels, whose bits are top left 1, top right 2, bottom right 4, bottom
# left 8. For each value the edges where curves enter and leave, object on their right hand; where
# two pixels meet in a corner only, they are two pieces.
TOP, RIGHT, BOTTOM, LEFT = range(4)
CURVES = {
    1: [(TOP, LEFT)],
    2: [(RIGHT, TOP)],
    3: [(RIGHT, LEFT)],
    4: [(BOTTOM, RIGHT)],
    5: [(TOP, LEFT), (BOTTOM, RIGHT)],
    6: [(BOTTOM, TOP)],
    7: [(BOTTOM, LEFT)],
    8: [(LEFT, BOTTOM)],
    9: [(TOP, BOTTOM)],
    10: [(RIGHT, TOP), (LEFT, BOTTOM)],
    11: [(RIGHT, BOTTOM)],
    12: [(LEFT, RIGHT)],
    13: [(TOP, RIGHT)],
    14: [(LEFT, TOP)],
}


def pixel_outline(inside: NDArray[np.bool_], left: float = 0.0, top: float = 0.0) -> MultiPolygon:
    """Return the region that object pixels cover, halfway to the background.

    Only cells with pixels of both kinds are worked on, so that it takes the time of the outline
    and hardly that of the area.

    Parameters
    ----------
    inside : array of bool, shape (height, width)
        Which pixels are object; beyond the image there is background.
    left, top : float
        Coordinates of the first pixel's centre.

    Returns
    -------
    outline : MultiPolygon
        Valid, with holes; pixel centres are a pixel apart, x the column and y the row.

    References
    ----------
    Lorensen, W. E., Cline, H. E. (1987). Marching cubes. SIGGRAPH, in two dimensions.
    """
    enters, leaves, width = _curves(np.pad(inside, 1))
    order = np.argsort(enters)
    following = order[np.searchsorted(enters[order], leaves)]
    points = _midpoints(enters, width) + np.array([left - 1, top - 1])
    rings = [points[ring] for ring in _cycles(following.tolist())]
    areas = np.array([_signed_area(ring) for ring in rings])
    outer = [ring for ring, area in zip(rings, areas, strict=True) if area > 0]
    holes = [ring for ring, area in zip(rings, areas, strict=True) if area < 0]
    return _assembled(outer, holes)


def _curves(padded: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Return the edges where pieces of curves enter and leave cells, and the cells in a row.

    An edge is numbered twice its cell, plus one for the left one; the others are those of the
    cells to the right and below.
    """
    bits = padded.astype(np.uint8)
    codes = bits[:-1, :-1] | bits[:-1, 1:] << 1 | bits[1:, 1:] << 2 | bits[1:, :-1] << 3
    width = codes.shape[1] + 1
    rows, columns = np.nonzero((codes != 0) & (codes != 15))
    cells, kinds = rows * width + columns, codes[rows, columns]
    edges = 2 * cells[:, None] + np.array([0, 3, 2 * width, 1])  # top, right, bottom, left
    pieces = [edges[kinds == kind][:, curve] for kind, curves in CURVES.items() for curve in curves]
    enters, leaves = np.concatenate(pieces).T
    return enters, leaves, width


def _midpoints(edges: NDArray[np.int64], width: int) -> NDArray[np.float64]:
    """Return the middles of edges, x and y in the padded image."""
    cells, is_left = np.divmod(edges, 2)
    rows, columns = np.divmod(cells, width)
    return np.column_stack([columns + 0.5 * (1 - is_left), rows + 0.5 * is_left])


def _cycles(following: list[int]) -> list[list[int]]:
    """Return the cycles of a permutation."""
    is_open = [True] * len(following)
    cycles = []
    for start in range(len(following)):
        if not is_open[start]:
            continue
        cycle, place = [], start
        while is_open[place]:
            is_open[place] = False
            cycle.append(place)
            place = following[place]
        cycles.append(cycle)
    return cycles


def _signed_area(ring: NDArray[np.float64]) -> float:
    x, y = (ring - ring[0]).T
    return float(x[:-1] @ y[1:] - x[1:] @ y[:-1])


def _assembled(outer: list[NDArray[np.float64]], holes: list[NDArray[np.float64]]) -> MultiPolygon:
    """Give each hole to the smallest outer ring around it."""
    shells = np.array([shapely.polygons(ring) for ring in outer])
    if not holes:
        return MultiPolygon(list(shells))
    within: list[list[NDArray[np.float64]]] = [[] for _ in outer]
    sizes = shapely.area(shells)
    points = shapely.points([hole[0] for hole in holes])
    owners = np.full(len(holes), -1)
    tree = shapely.STRtree(shells)
    for hole, shell in tree.query(points, predicate="within").T:
        if owners[hole] < 0 or sizes[shell] < sizes[owners[hole]]:
            owners[hole] = shell
    for hole, owner in zip(holes, owners, strict=True):
        within[owner].append(hole)
    return MultiPolygon(
        [shapely.Polygon(ring, inner) for ring, inner in zip(outer, within, strict=True)]
    )
