"""How well a mesh explains the masks it was made from, inside their images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import shapely
from shapely import MultiPolygon, Polygon

from momrec_core import Coverage, silhouette_of_mesh

if TYPE_CHECKING:
    import trimesh

    from momrec_ros.cameras_json import MaskedView

__all__ = ["mask_coverage", "visible_projection"]


def visible_projection(masked: MaskedView, mesh: trimesh.Trimesh) -> MultiPolygon:
    """Return the part of a mesh's silhouette that lies inside a mask's image.

    Parameters
    ----------
    masked : MaskedView
        The camera and its image.
    mesh : Trimesh
        In the cameras' world; the whole of it before a pinhole.

    Returns
    -------
    region : MultiPolygon
        In the view's image coordinates; empty if the mesh lies outside of the image.

    Raises
    ------
    MomrecError
        As for `silhouette_of_mesh`.
    """
    projected = silhouette_of_mesh(mesh, masked.view.camera).silhouette
    parts = shapely.get_parts(shapely.intersection(projected, masked.frame))
    return MultiPolygon([part for part in parts if isinstance(part, Polygon)])


def mask_coverage(masked: MaskedView, mesh: trimesh.Trimesh) -> Coverage:
    """Compare a mask with the visible part of a mesh's projection into its image.

    The mask's own region is compared, not the silhouette that the hull was intersected with: a
    margin that is too large costs intersection over union.

    Parameters
    ----------
    masked : MaskedView
        The mask's region, its camera and its image.
    mesh : Trimesh
        In the cameras' world; the whole of it before a pinhole.

    Returns
    -------
    coverage : Coverage
        Shares of areas in the image.

    Raises
    ------
    MomrecError
        As for `silhouette_of_mesh`.
    """
    return Coverage.of_regions(masked.seen, visible_projection(masked, mesh))
