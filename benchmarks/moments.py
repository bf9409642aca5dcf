"""How fast moments and canonical shapes are, beside trimesh's integrals on the same mesh.

    python benchmarks/moments.py [--rounds 15]

prints a table with the figures and their bounds. The measurements take turns, so that a busy
machine slows them alike.
"""

from __future__ import annotations

import argparse

import trimesh
from rich.console import Console
from rich.table import Table
from timing import medians

from momrec_core import load_model, normalize, surface_moments
from momrec_ros.shared_data import shared_path


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15, help="of which the medians are told")
    options = parser.parse_args()
    model = load_model(shared_path("models/ten_objects.json"))
    large, small = torus(sections=200), torus(sections=78)
    moments, integrals, recognised = medians(
        [
            lambda: surface_moments(fresh(large)),
            lambda: fresh(large).mass_properties,
            lambda: model.recognize(normalize(fresh(small))),
        ],
        options.rounds,
    )
    table = Table("figure", "measured", "bound", title="moments")
    count = f"{len(large.faces):,} triangles"
    table.add_row(f"56 moments, {count}", f"{moments:.1f} ms", "")
    table.add_row(f"mass_properties of trimesh, {count}", f"{integrals:.1f} ms", "")
    table.add_row("their ratio", f"{moments / integrals:.2f}", "1")
    figure = f"normalise and recognise, {len(small.faces):,} triangles"
    table.add_row(figure, f"{recognised:.1f} ms", "15 ms")
    Console().print(table)


def torus(sections: int) -> trimesh.Trimesh:
    """Return a squeezed torus of two triangles for each pair of sections."""
    round_one = trimesh.creation.torus(1.0, 0.4, sections, sections)
    return trimesh.Trimesh(round_one.vertices * [1.0, 1.3, 1.7], round_one.faces, process=False)


def fresh(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the same mesh, of which nothing is computed yet."""
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


if __name__ == "__main__":
    main()
