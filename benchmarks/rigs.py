"""How exact hulls are for rigs of pinhole cameras of every shape, near and far.

    python benchmarks/rigs.py [--cases 12] [--slices 64] [--seed 0]

prints volume and area against the exact hull, manifold3d's intersection of the cameras' pyramids,
for 8 to 36 cameras in a ring at one height, in two rings and on a sphere, 2 to 50 object sizes
away, their views in random order; and pinholes far away against parallel projection. The objects
are the ten shipped polyhedra, smooth blobs and random solids, each turned at random.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from reference import exact_hull, random_solid
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from momrec_core import Camera, View, reconstruct, silhouette_of_mesh
from momrec_core.simulation import look_at, random_directions, random_similarity
from momrec_ros.files import read_mesh
from momrec_ros.shared_data import shared_path

KINDS = ("ring", "two rings", "sphere")
DISTANCES = (2.0, 5.0, 15.0, 50.0)  # object sizes from a camera to the object's centre
FAR = 1000.0
CAMERAS = (8, 36)
LEVEL_SHARE = 0.25  # of the rings: exactly at the object's height
PIXELS = 1000.0  # of an object's diameter in the image
BLOB_WAVES = 4
PERCENT = 100.0


@dataclass(frozen=True)
class Errors:
    """Relative errors of the meshes' volumes and areas."""

    volume: list[float]
    area: list[float]

    def add(self, surface: trimesh.Trimesh, volume: float, area: float) -> None:
        """Compare a mesh."""
        self.volume.append(abs(surface.volume / volume - 1))
        self.area.append(abs(surface.area / area - 1))

    def columns(self) -> tuple[str, str]:
        """Write them, in percent."""
        return spread(self.volume), spread(self.area)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=12, help="of each rig and distance")
    parser.add_argument("--slices", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    table = Table("cameras", "object sizes away", "volume, %", "area, %", title="rigs")
    jobs = [(kind, distance) for kind in KINDS for distance in DISTANCES]
    with Progress(console=Console(stderr=True)) as progress:
        for kind, distance in progress.track(jobs):
            errors = rig_errors(kind, distance, options.cases, options.slices, options.seed)
            table.add_row(kind, f"{distance:g}", *errors.columns())
        table.add_row("bound", "", "0.5", "1", end_section=True)
        errors = far_errors(options.cases, options.slices, options.seed)
        table.add_row("against parallel", f"{FAR:g}", *errors.columns())
        table.add_row("bound", "", "0.2", "0.2")
    Console().print(table)


def spread(errors: Sequence[float]) -> str:
    """Write the median and the worst of relative errors, in percent."""
    return f"{PERCENT * np.median(errors):.3f} median, {PERCENT * max(errors):.3f} worst"


def rig_errors(kind: str, distance: float, cases: int, slices: int, seed: int) -> Errors:
    """Reconstruct objects seen by rigs of a kind, and compare with their exact hulls."""
    errors = Errors([], [])
    for views in rigs(kind, distance, cases, seed):
        exact = exact_hull(views, 3.0 * np.linalg.norm(views[0].camera.position))
        errors.add(reconstruct(views, slices).mesh(), exact.volume(), exact.surface_area())
    return errors


def far_errors(cases: int, slices: int, seed: int) -> Errors:
    """Compare pinholes far away with parallel projection from the same directions."""
    errors = Errors([], [])
    for number in range(cases):
        rng = np.random.default_rng([seed, number])
        mesh = some_object(number, rng)
        poses = rig_poses(KINDS[number % len(KINDS)], FAR, rng)
        near = [silhouette_of_mesh(mesh, pinhole(pose, FAR)) for pose in poses]
        parallel = [silhouette_of_mesh(mesh, Camera.orthographic(pose)) for pose in poses]
        surface = reconstruct(parallel, slices).mesh()
        errors.add(reconstruct(near, slices).mesh(), surface.volume, surface.area)
    return errors


def rigs(kind: str, distance: float, cases: int, seed: int) -> Iterator[list[View]]:
    """Look at objects of size 1 around the origin with rigs of a kind."""
    for number in range(cases):
        rng = np.random.default_rng([seed, number, KINDS.index(kind), int(distance)])
        mesh = some_object(number, rng)
        poses = rig_poses(kind, distance, rng)
        yield [silhouette_of_mesh(mesh, pinhole(pose, distance)) for pose in poses]


def rig_poses(kind: str, distance: float, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Place cameras that look at the origin; they come in random order."""
    count = int(rng.integers(CAMERAS[0], CAMERAS[1] + 1))
    if kind == "sphere":
        directions = random_directions(count, rng) * rng.choice([-1.0, 1.0], (count, 1))
    elif kind == "ring":
        height = 0.0 if rng.random() < LEVEL_SHARE else rng.uniform(-20.0, 50.0)
        directions = ring(count, height)
    else:
        low, high = rng.uniform(-20.0, 20.0), rng.uniform(30.0, 60.0)
        directions = np.concatenate([ring(count // 2, low), ring(count - count // 2, high)])
    return [
        look_at(np.zeros(3), direction, distance, rng.uniform(0, 2 * np.pi))
        for direction in rng.permutation(directions)
    ]


def ring(count: int, height: float) -> NDArray[np.float64]:
    """Return viewing directions of cameras around the z axis, so many degrees above."""
    angles = 2 * np.pi * np.arange(count) / count
    across, down = np.cos(np.radians(height)), -np.sin(np.radians(height))
    return np.column_stack([across * np.cos(angles), across * np.sin(angles), 0 * angles + down])


def pinhole(pose: NDArray[np.float64], distance: float) -> Camera:
    """Return a camera in whose image an object of size 1 has about as many pixels, near or far."""
    focal = PIXELS * distance
    return Camera.pinhole(pose, [[focal, 0.0, 500.0], [0.0, focal, 500.0], [0.0, 0.0, 1.0]])


def some_object(number: int, rng: np.random.Generator) -> trimesh.Trimesh:
    """Return a polyhedron, a blob or a random solid in turn, of size 1 around the origin."""
    paths = sorted(shared_path("meshes/ten_objects").glob("*.ply"))
    makers = (lambda: read_mesh(rng.choice(paths)), lambda: blob(rng), lambda: random_solid(rng))
    mesh = random_similarity(makers[number % 3](), rng, scales=(1.0, 1.0), shift=0.0)
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return mesh.apply_scale(1 / np.linalg.norm(np.ptp(mesh.bounds, axis=0)))


def blob(rng: np.random.Generator) -> trimesh.Trimesh:
    """Make a smooth body of a sphere with a few waves on it."""
    mesh = trimesh.creation.icosphere(4)
    waves = rng.normal(size=(BLOB_WAVES, 3)) * 1.5
    phases, heights = rng.uniform(0, 2 * np.pi, BLOB_WAVES), rng.uniform(0.05, 0.2, BLOB_WAVES)
    mesh.vertices *= 1 + np.sin(mesh.vertices @ waves.T + phases) @ heights[:, None]
    mesh.apply_scale(rng.uniform(0.4, 1.0, 3))
    return mesh


if __name__ == "__main__":
    main()
