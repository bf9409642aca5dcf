"""How exact the meshes are: closed surfaces, and volumes and areas against the exact hull.

    python benchmarks/exactness.py [--cases 1000]

prints a table with the figures and their bounds. The exact hull is manifold3d's intersection of
the viewing volumes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray
from reference import exact_hull, random_solid
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from momrec_core import (
    Camera,
    View,
    VisualHull,
    normalize,
    reconstruct,
    silhouette_of_mesh,
)
from momrec_core.simulation import random_similarity, simulate_views
from momrec_ros.files import read_mesh
from momrec_ros.shared_data import shared_path

K = np.array([[1500.0, 0.0, 320.0], [0.0, 1500.0, 240.0], [0.0, 0.0, 1.0]])
PERCENT = 100.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1000, help="random cases of closed meshes")
    options = parser.parse_args()
    table = Table("figure", "measured", "bound", title="exactness")
    with Progress(console=Console(stderr=True)) as progress:
        closed = sum(progress.track(closed_meshes(options.cases), total=options.cases))
        table.add_row(
            "closed, manifold, outward", f"{closed} of {options.cases}", f"{options.cases}"
        )
        errors = np.array(list(progress.track(parallel_errors(), total=30)))
        for name, column, bound in zip(
            ("volume of the slices", "volume of the mesh", "area of the mesh"),
            errors.T,
            ("0.3 worst", "0.5 worst", "0.5 median, 2 worst"),
            strict=True,
        ):
            table.add_row(f"10 parallel views, {name}, %", spread(column), bound)
        orders = np.array(list(progress.track(order_spreads(), total=10)))
        table.add_row("area, views in another order, %", spread(orders), "0.5 median")
        for rig in ("ring", "sphere"):
            errors = np.array(list(progress.track(pinhole_errors(rig), total=10)))
            table.add_row(f"10 pinholes, {rig}, volume, %", spread(errors[:, 0]), "0.5 median")
            table.add_row(f"10 pinholes, {rig}, area, %", spread(errors[:, 1]), "1 median")
        shifts = np.array(list(progress.track(canonical_shifts(), total=10)))
        table.add_row("canonical coordinates", f"{shifts.max():.1e} worst", "1e-7")
    Console().print(table)


def spread(errors: NDArray[np.float64]) -> str:
    """Write the median and the worst of relative errors, in percent."""
    percent = PERCENT * np.abs(errors)
    return f"{np.median(percent):.3f} median, {percent.max():.3f} worst"


def ten_objects() -> list[trimesh.Trimesh]:
    """Read the ten shipped polyhedra."""
    return [read_mesh(path) for path in sorted(shared_path("meshes/ten_objects").glob("*.ply"))]


def closed_meshes(cases: int) -> Iterator[bool]:
    """Reconstruct random solids from 2 to 20 views, 8 to 128 slices; every third by pinholes."""
    for seed in range(cases):
        rng = np.random.default_rng(seed)
        mesh = random_solid(rng)
        count, slices = int(rng.integers(2, 21)), int(rng.integers(8, 129))
        projection = "central" if seed % 3 == 2 else "orthographic"
        views = simulate_views(mesh, count, rng, projection=projection)
        surface = reconstruct(views, slices).mesh()
        yield surface.is_watertight and surface.is_winding_consistent and surface.volume > 0


def parallel_errors() -> Iterator[tuple[float, float, float]]:
    """Compare the ten polyhedra, three poses each, ten views, 64 slices."""
    for number, mesh in enumerate(ten_objects()):
        for pose in range(3):
            rng = np.random.default_rng([number, pose])
            views = simulate_views(random_similarity(mesh, rng), 10, rng)
            hull = reconstruct(views, 64)
            volume, area = mesh_errors(hull, views)
            spacing = hull.offsets[1] - hull.offsets[0]
            slices = spacing * sum(section.area for section in hull.sections)
            yield slices / exact_hull(views, 100.0).volume() - 1, volume, area


def mesh_errors(hull: VisualHull, views: Sequence[View]) -> tuple[float, float]:
    """Return the relative errors of the mesh's volume and area."""
    exact, mesh = exact_hull(views, 100.0), hull.mesh()
    return mesh.volume / exact.volume() - 1, mesh.area / exact.surface_area() - 1


def order_spreads() -> Iterator[float]:
    """Reconstruct each polyhedron from the same eight views in four orders (Fig. 6)."""
    for number, mesh in enumerate(ten_objects()):
        rng = np.random.default_rng([number, 99])
        views = simulate_views(mesh, 8, rng)
        areas = [
            reconstruct([views[index] for index in rng.permutation(8)], 64).mesh().area
            for _ in range(4)
        ]
        yield float(np.ptp(areas) / np.mean(areas))


def pinhole_errors(rig: str) -> Iterator[tuple[float, float]]:
    """Compare the polyhedra, seen by ten pinholes three object sizes away."""
    for number, mesh in enumerate(ten_objects()):
        rng = np.random.default_rng([number, 7])
        if rig == "sphere":
            views = simulate_views(mesh, 10, rng, projection="central", distance=3.0)
        else:
            views = ring_views(random_similarity(mesh, rng, shift=0.0), 10, 3.0)
        hull = reconstruct(views, 64)
        yield mesh_errors(hull, views)


def ring_views(mesh: trimesh.Trimesh, count: int, distance: float) -> list[View]:
    """Look at a mesh from a ring of cameras a little above it."""
    center, size = mesh.bounds.mean(axis=0), float(np.linalg.norm(np.ptp(mesh.bounds, axis=0)))
    views = []
    for angle in 2 * np.pi * np.arange(count) / count:
        z = np.array([np.cos(angle), np.sin(angle), -0.3]) / np.hypot(1.0, 0.3)
        x = np.cross(z, (0.0, 0.0, 1.0))
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
        pose[:3, 3] = center - distance * size * z
        views.append(silhouette_of_mesh(mesh, Camera.pinhole(pose, K)))
    return views


def canonical_shifts() -> Iterator[float]:
    """Return how far canonical coordinates move when the object is moved, turned and scaled."""
    for number, mesh in enumerate(ten_objects()):
        rng = np.random.default_rng([number, 5])
        moved = random_similarity(mesh, rng)
        shapes = normalize(mesh), normalize(moved)
        yield float(np.abs(shapes[0].mesh.vertices - shapes[1].mesh.vertices).max())


if __name__ == "__main__":
    main()
