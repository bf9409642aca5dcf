"""Ten polyhedra whose principal frames are ambiguous, or nearly so."""

from __future__ import annotations

import numpy as np
import trimesh
from manifold3d import CrossSection, FillRule, Manifold
from numpy.typing import NDArray

__all__ = ["near_ties"]

Ring = tuple[tuple[float, float], ...]

WEDGE: Ring = ((0, 0), (3, 0), (0, 1.4))
STAIRS: Ring = ((0, 0), (3, 0), (3, 0.6), (2, 0.6), (2, 1.2), (1, 1.2), (1, 1.8), (0, 1.8))
SQUARE: Ring = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
NEARLY_SQUARE: Ring = ((0, 0), (1, 0), (1, 1.03), (0, 1.03))
CHANNEL: Ring = ((0, 0), (2, 0), (2, 1.5), (1.7, 1.5), (1.7, 0.3), (0.3, 0.3), (0.3, 1.5), (0, 1.5))
TEE: Ring = (
    (-1.2, 0),
    (1.2, 0),
    (1.2, 0.5),
    (0.25, 0.5),
    (0.25, 2),
    (-0.25, 2),
    (-0.25, 0.5),
    (-1.2, 0.5),
)
ARROW: Ring = ((0, 0), (1, 1), (0.4, 1), (0.4, 2.6), (-0.4, 2.6), (-0.4, 1), (-1, 1))
CROSS: Ring = (
    *((1, 0.3), (0.3, 0.3), (0.3, 1), (-0.3, 1), (-0.3, 0.3), (-1, 0.3)),
    *((-1, -0.3), (-0.3, -0.3), (-0.3, -1), (0.3, -1), (0.3, -0.3), (1, -0.3)),
)
OPENING: Ring = ((-0.25, -0.25), (0.25, -0.25), (0.25, 0.25), (-0.25, 0.25))


def near_ties() -> dict[str, trimesh.Trimesh]:
    """Model ten objects that defeat the rules A.1 to A.3 of the paper, each in its way.

    Mirror-like ones have axes with equal ends (P1 and P2 tie), turns by a quarter leave two axes
    alike, the nearly cubic one has three, and the axes of frame and channel miss the surface.

    Returns
    -------
    meshes : dict
        Name to closed mesh, z upwards, metres.
    """
    solids = {
        "arrow": _prism([ARROW], 0.7),
        "channel": _prism([CHANNEL], 2.6),
        "cross": _prism([CROSS], 0.6),
        "frame": _prism([SQUARE, OPENING], 0.35),
        "near_cube": _prism([NEARLY_SQUARE], 1.05),
        "pyramid": _section([SQUARE]).extrude(1.3, scale_top=(0.0, 0.0)),
        "square_prism": _prism([SQUARE], 2.2),
        "stairs": _prism([STAIRS], 1.5),
        "tee": _prism([TEE], 0.9),
        "wedge": _prism([WEDGE], 1.6),
    }
    return {name: _mesh(solid) for name, solid in solids.items()}


def _section(rings: list[Ring]) -> CrossSection:
    return CrossSection([np.array(ring, dtype=np.float64) for ring in rings], FillRule.EvenOdd)


def _prism(rings: list[Ring], height: float) -> Manifold:
    return _section(rings).extrude(height)


def _mesh(solid: Manifold) -> trimesh.Trimesh:
    data = solid.to_mesh64()
    vertices: NDArray[np.float64] = np.asarray(data.vert_properties, dtype=np.float64)[:, :3]
    return trimesh.Trimesh(vertices, np.asarray(data.tri_verts), process=False)
