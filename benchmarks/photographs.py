"""Reconstruct from photographs' silhouettes and measure how much of them the mesh covers again.

Usage: python benchmarks/photographs.py FOLDER [--slices 128] [--margin 0.25] [--figure PNG], a
folder with cameras.json and masks.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from momrec_core.hull import reconstruct
from momrec_ros.cameras_json import read_cameras_json
from momrec_ros.figures import draw_coverage
from momrec_ros.mask_coverage import mask_coverage
from momrec_ros.parameters import MARGIN


def main() -> None:
    """Print the shares and the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--slices", type=int, default=128)
    parser.add_argument("--margin", type=float, default=MARGIN.default)
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    start = time.perf_counter()
    found = read_cameras_json(arguments.folder, margin=arguments.margin)
    for rejected in found.rejected:
        print(f"rejected {rejected.name}: {rejected.reason}", file=sys.stderr)
    loaded = time.perf_counter()
    hull = reconstruct([masked.view for masked in found.views], arguments.slices)
    cut = time.perf_counter()
    mesh = hull.mesh()
    tiled = time.perf_counter()
    agreement = [mask_coverage(masked, mesh) for masked in found.views]
    covered = np.array([share.covered for share in agreement])
    worst = int(covered.argmin())
    bordering = sum(masked.touches_border for masked in found.views)
    print(f"views          {len(found.views)}, {bordering} cut by the image's border")
    print(f"mesh           {len(mesh.faces)} triangles, closed: {mesh.is_watertight}")
    print(f"covered        mean {covered.mean():.4f}, worst {covered[worst]:.4f}", end=" ")
    print(f"({found.views[worst].name})")
    print(f"IoU            mean {np.mean([share.iou for share in agreement]):.4f}")
    print(f"seconds        masks {loaded - start:.2f}, slices {cut - loaded:.2f}", end=" ")
    print(f"mesh {tiled - cut:.2f}")
    if arguments.figure:
        draw_coverage(found.views, mesh, arguments.figure)


if __name__ == "__main__":
    main()
