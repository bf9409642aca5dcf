"""How often the shipped model names unseen instances of the ten objects rightly.

Each instance has its own random position, orientation, size and viewpoints, all drawn with a
seed that training did not use. The stranger, which the model does not know, is asked as well.

    python benchmarks/recognition_rate.py --instances 25
"""

import argparse
from collections import Counter
from pathlib import Path

from momrec_core import load_model
from momrec_ros.files import read_mesh
from momrec_ros.shared_data import shared_path
from momrec_ros.training import find_classes, reconstructed_instances


def main() -> None:
    """Print the rate and the confusions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, default=shared_path("models/ten_objects.json"))
    parser.add_argument("--instances", type=int, default=25, help="of each object")
    parser.add_argument("--views", type=int, default=10)
    parser.add_argument("--slices", type=int, default=64)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=20_000)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    classes = find_classes([shared_path("meshes/ten_objects")])
    classes["stranger"] = [read_mesh(shared_path("meshes/stranger.ply"))]
    model = load_model(options.model)
    named = Counter(
        (label, model.recognize(shape).label)
        for label, shape in reconstructed_instances(
            classes,
            instances=options.instances,
            views=options.views,
            slices=options.slices,
            noise=options.noise,
            seed=options.seed,
            workers=options.workers,
        )
    )
    for label in classes:
        answers = ", ".join(
            f"{name} {count}" for (asked, name), count in named.most_common() if asked == label
        )
        print(f"{label:16} {answers}")
    known = options.instances * len(model.classes)
    right = sum(named[label, label] for label in model.classes)
    unknown = named["stranger", "unknown"]
    print(f"named rightly:        {100 * right / known:.1f} % of {known}")
    print(f"strangers unknown:    {100 * unknown / options.instances:.1f} % of {options.instances}")


if __name__ == "__main__":
    main()
