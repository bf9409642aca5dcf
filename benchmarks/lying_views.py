"""Spoil views of a calibrated rig, one or two at a time, and see whether they are found.

Usage: python benchmarks/lying_views.py FOLDER [--step 1] [--slices 64] [--seeds 2], a folder with
cameras.json and masks. A camera is turned by 5 degrees about each of its axes, at its own place and
round the object, a mask is eroded to half its area, a mask shows another object as large. Volumes
are those of the slices. False alarms are counted on the folder's own views, in random choices of
them, and on simulated views of the shipped objects with noise.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from momrec_core import Camera, View, reconstruct
from momrec_core.agreement import contradicting_views
from momrec_core.covering import covered_shares
from momrec_core.simulation import simulate_instance
from momrec_ros.bag import read_bag
from momrec_ros.cameras_json import read_cameras_json
from momrec_ros.files import read_mesh
from momrec_ros.parameters import MAX_BAD_VIEWS
from momrec_ros.shared_data import shared_path

ANGLE = 5.0  # degrees
CHOICES = 60  # random choices of the folder's views
PAIRS = 20  # random pairs of bad views
PIXEL = 1 / 1024  # of the silhouette's diameter: simulated noise counts in it
BOUND = 0.01  # of the clean volume

Lie = Callable[[View], View]


def turned(view: View, axis: int, about: NDArray[np.float64]) -> View:
    """Turn a camera about one of its axes, through a point."""
    vector = np.radians(ANGLE) * view.camera.rotation[:, axis]
    turn = Rotation.from_rotvec(vector).as_matrix()
    pose = view.camera.pose.copy()
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] = about + turn @ (pose[:3, 3] - about)
    return replace(view, camera=Camera(pose, view.camera.K))


def eroded(view: View) -> View:
    """Erode a silhouette to half its area."""
    low, high = 0.0, float(np.sqrt(view.silhouette.area))
    for _ in range(30):
        middle = (low + high) / 2
        if view.silhouette.buffer(-middle).area > view.silhouette.area / 2:
            low = middle
        else:
            high = middle
    return replace(view, silhouette=view.silhouette.buffer(-low))


def exchanged(view: View, other: View) -> View:
    """Show another object, as large and at the same place."""
    scale = float(np.sqrt(view.silhouette.area / other.silhouette.area))
    region = shapely.affinity.scale(other.silhouette, scale, scale)
    here, there = view.silhouette.centroid, region.centroid
    return replace(
        view, silhouette=shapely.affinity.translate(region, here.x - there.x, here.y - there.y)
    )


def nearest_to_rays(views: Sequence[View]) -> NDArray[np.float64]:
    """Return the point nearest to the rays through the silhouettes' middles: the object."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for view in views:
        camera, middle = view.camera, view.silhouette.centroid
        ray = camera.rotation @ camera.rays_camera([[middle.x, middle.y]])[0]
        projector = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal += projector
        right += projector @ camera.position
    return np.linalg.solve(normal, right)


def lies(views: Sequence[View]) -> dict[str, Lie]:
    """Return what may be wrong with a view."""
    centre = nearest_to_rays(views)
    other = next(iter(read_bag(shared_path("bags/ten_objects")))).view
    found: dict[str, Lie] = {}
    for axis, name in enumerate("xyz"):
        found[f"turned about the camera's {name}"] = lambda view, axis=axis: turned(
            view, axis, view.camera.position
        )
        found[f"turned about the object, {name}"] = lambda view, axis=axis: turned(
            view, axis, centre
        )
    found["eroded by half"] = eroded
    found["another object"] = lambda view: exchanged(view, other)
    return found


def volume(views: Sequence[View], slices: int) -> float:
    """Return the volume of the slices."""
    hull = reconstruct(views, slices)
    spacing = hull.offsets[1] - hull.offsets[0]
    return float(spacing * sum(section.area for section in hull.sections))


def without(views: Sequence[View], left_out: Sequence[int]) -> list[View]:
    """Return the other views."""
    return [view for index, view in enumerate(views) if index not in left_out]


def named(views: Sequence[View]) -> tuple[int, ...]:
    """Return which views are found to contradict the others."""
    return contradicting_views(views, MAX_BAD_VIEWS.default)


def report_single(views: Sequence[View], step: int, slices: int) -> bool:
    """Spoil one view at a time."""
    clean = volume(views, slices)
    places = range(0, len(views), step)
    less = {place: volume(without(views, [place]), slices) for place in places}
    print(f"{'':28s} named  others named  volume: of all views' hull, of all but that one's")
    fine = True
    for name, lie in lies(views).items():
        found, wrong, deviations, own = 0, 0, [0.0], [0.0]
        for place in places:
            spoiled = list(views)
            spoiled[place] = lie(views[place])
            verdict = named(spoiled)
            found += place in verdict
            wrong += len(set(verdict) - {place})
            is_clean = verdict == (place,)
            left = less[place] if is_clean else volume(without(spoiled, verdict), slices)
            deviations.append(left / clean - 1)
            own.append(left / less[place] - 1)
        worst, worst_own = (max(values, key=abs) for values in (deviations, own))
        fine = fine and found == len(places) and wrong == 0 and abs(worst) <= BOUND
        print(
            f"{name:28s} {found:2d}/{len(places):2d}  {wrong:12d}  worst {100 * worst:+.2f} % "
            f"(bound {100 * BOUND:.0f} %), {100 * worst_own:+.2f} %"
        )
    return fine


def report_pairs(views: Sequence[View], rng: np.random.Generator) -> bool:
    """Spoil two views at a time."""
    kinds = list(lies(views).values())
    right = wrong = 0
    for _ in range(PAIRS):
        pair = sorted(rng.permutation(len(views))[:2].tolist())
        spoiled = list(views)
        for place in pair:
            spoiled[place] = kinds[rng.integers(len(kinds))](views[place])
        verdict = named(spoiled)
        right += verdict == tuple(pair)
        wrong += len(set(verdict) - set(pair))
    print(f"{'two views, any of these':28s} both named {right}/{PAIRS}, others named {wrong}")
    return wrong == 0


def report_false_alarms(views: Sequence[View], rng: np.random.Generator) -> bool:
    """Count views named among those that are right."""
    whole = len(named(views))
    alarms = 0
    for _ in range(CHOICES):
        count = int(rng.integers(4, len(views) + 1))
        alarms += bool(named([views[index] for index in rng.permutation(len(views))[:count]]))
    print(f"false alarms: all views {whole}; {CHOICES} random choices of 4 to all: {alarms}")
    return whole + alarms == 0


def simulated(seeds: int) -> Iterator[tuple[float, Sequence[View]]]:
    """Yield noise in pixels and views of the shipped objects."""
    meshes = [read_mesh(path) for path in sorted(shared_path("meshes/ten_objects").glob("*.ply"))]
    for seed in range(seeds):
        for number, mesh in enumerate(meshes):
            for noise in range(4):
                rng = np.random.default_rng((seed, number, noise))
                projection = "central" if rng.random() < 0.5 else "orthographic"
                count = int(rng.integers(5, 37))
                instance = simulate_instance(
                    mesh, count, rng, projection=projection, noise=noise * PIXEL
                )
                yield noise, instance.views


def report_simulated(seeds: int) -> bool:
    """Count views named among simulated ones."""
    alarms, totals = np.zeros(4, np.int64), np.zeros(4, np.int64)
    for noise, views in simulated(seeds):
        totals[int(noise)] += 1
        alarms[int(noise)] += bool(named(views))
    for noise, (alarm, total) in enumerate(zip(alarms, totals, strict=True)):
        print(f"false alarms, simulated, 5 to 36 views, noise {noise} pixels: {alarm}/{total}")
    return not alarms.any()


def report_cost(views: Sequence[View], slices: int) -> None:
    """Time what is done after views, beside the mesh."""
    for count in (10, len(views)):
        chosen = views[:: len(views) // count][:count]
        hull = reconstruct(chosen, slices)
        start = time.perf_counter()
        mesh = hull.mesh()
        meshed = time.perf_counter()
        covered = covered_shares(chosen, mesh)
        covering = time.perf_counter()
        named(chosen)
        judged = time.perf_counter()
        print(
            f"{count} views, {slices} slices: mesh {1e3 * (meshed - start):.0f} ms, coverage "
            f"{1e3 * (covering - meshed):.0f} ms, judging {1e3 * (judged - covering):.0f} ms; "
            f"covered {covered.mean():.4f}, worst {covered.min():.4f}"
        )


def main() -> int:
    """Run the benchmark; the exit code tells whether all bounds are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--step", type=int, default=1, help="spoil every so manieth view")
    parser.add_argument("--slices", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=2, help="of simulated views; 0 for none")
    arguments = parser.parse_args()
    views = [masked.view for masked in read_cameras_json(arguments.folder).views]
    rng = np.random.default_rng(0)
    report_cost(views, arguments.slices)
    fine = [
        report_single(views, arguments.step, arguments.slices),
        report_pairs(views, rng),
        report_false_alarms(views, rng),
        report_simulated(arguments.seeds),
    ]
    return 0 if all(fine) else 1


if __name__ == "__main__":
    sys.exit(main())
