"""How well a mesh explains the views it was made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import shapely

from momrec_core.silhouette import silhouette_of_mesh

if TYPE_CHECKING:
    import trimesh
    from shapely import MultiPolygon

    from momrec_core.view import View

__all__ = ["Coverage", "coverage"]


@dataclass(frozen=True)
class Coverage:
    """Agreement of a view's silhouette with the one a mesh would have there.

    Attributes
    ----------
    covered : float
        Share of the view's silhouette that the mesh's projection covers again, 0 to 1.
    iou : float
        Intersection over union of the two, 0 to 1.
    """

    covered: float
    iou: float

    @classmethod
    def of_regions(cls, seen: MultiPolygon, projected: MultiPolygon) -> Coverage:
        """Compare a silhouette with a mesh's projection, both in the same image coordinates."""
        common = shapely.intersection(seen, projected).area
        return cls(covered=common / seen.area, iou=common / (seen.area + projected.area - common))


def coverage(view: View, mesh: trimesh.Trimesh) -> Coverage:
    """Compare a view's silhouette with the projection of a mesh into the same camera.

    The visual hull of consistent views covers every silhouette; what is missing measures
    errors of the contours, the calibration and the slicing.

    Parameters
    ----------
    view : View
        The silhouette and its camera.
    mesh : Trimesh
        In the world, metres; the whole of it before a pinhole.

    Returns
    -------
    coverage : Coverage
        Shares of areas in the image plane.

    Raises
    ------
    InvalidCameraError
        If a vertex lies beside or behind a pinhole camera.
    DegenerateShapeError
        If the mesh has no face that projects to an area.

    See Also
    --------
    silhouette_of_mesh : The projection that is compared.
    """
    projected = silhouette_of_mesh(mesh, view.camera).silhouette
    return Coverage.of_regions(view.silhouette, projected)
