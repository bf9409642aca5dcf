"""How well a class learned later from a few instances is named, and what it costs the others.

Each of the ten objects and the stranger is left out in turn of a model, which then learns it from
2, 3, 5 and 10 instances. The instances asked took part in nothing.

    python benchmarks/one_more_class.py --asked 12
"""

import argparse

from momrec_core import CanonicalShape, RecognitionModel
from momrec_ros.files import read_mesh
from momrec_ros.shared_data import shared_path
from momrec_ros.training import find_classes, reconstructed_instances

COUNTS = (2, 3, 5, 10)
TAUGHT = max(COUNTS)  # instances of each class that a model may learn from


def main() -> None:
    """Print the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--asked", type=int, default=12, help="instances of each object")
    parser.add_argument("--views", type=int, default=10)
    parser.add_argument("--slices", type=int, default=32)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    classes = find_classes([shared_path("meshes/ten_objects")])
    classes["stranger"] = [read_mesh(shared_path("meshes/stranger.ply"))]
    shapes: dict[str, list[CanonicalShape]] = {label: [] for label in classes}
    for label, shape in reconstructed_instances(
        classes,
        instances=TAUGHT + options.asked,
        views=options.views,
        slices=options.slices,
        noise=options.noise,
        seed=options.seed,
        workers=options.workers,
    ):
        shapes[label].append(shape)
    without = {label: model_without(label, shapes) for label in classes}
    for count in COUNTS:
        learned = [
            model.with_class(label, shapes[label][:count]) for label, model in without.items()
        ]
        new = sum(rightly_named(model, shapes, model.classes[-1:]) for model in learned)
        old = sum(rightly_named(model, shapes, model.classes[:-1]) for model in learned)
        before = sum(rightly_named(model, shapes, model.classes) for model in without.values())
        total = len(classes) * options.asked
        print(
            f"{count:2} instances: {100 * new / total:.1f} % of {total} named rightly; of the "
            f"other classes {old} of {total * (len(classes) - 1)}, before {before}"
        )


def model_without(label: str, shapes: dict[str, list[CanonicalShape]]) -> RecognitionModel:
    """Learn all classes but one."""
    others = [other for other in shapes if other != label]
    return RecognitionModel.fit(
        [shape for other in others for shape in shapes[other][:TAUGHT]],
        [other for other in others for _ in range(TAUGHT)],
    )


def rightly_named(
    model: RecognitionModel, shapes: dict[str, list[CanonicalShape]], labels: tuple[str, ...]
) -> int:
    """Count the instances of some classes, none of those taught, that get their label."""
    return sum(
        model.recognize(shape).label == label
        for label in labels
        for shape in shapes[label][TAUGHT:]
    )


if __name__ == "__main__":
    main()
