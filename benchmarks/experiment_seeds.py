"""The paper's experiment with other random instances, more views and more slices, as numbers.

Each line is a draw of instances of the ten objects: the rate on the test sets, mean of the random
splits, with three moments of second order and with the best step of third order, by A.1 to A.3
alone and with admissible alternatives, and what second order confuses most.

    python benchmarks/experiment_seeds.py --seeds 5
"""

import argparse

import numpy as np

from momrec_ros.experiment import Plan, study
from momrec_ros.shared_data import shared_path
from momrec_ros.terminal import Terminal
from momrec_ros.training import find_classes
from momrec_ros.workers import shared_map

MORE = ((5, 64), (20, 64), (40, 64), (10, 128))  # views and slices


def main() -> None:
    """Print a line for each draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--splits", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    classes = find_classes([shared_path("meshes/ten_objects")])
    draws = [(seed, 10, 64) for seed in range(options.seeds)]
    second = []
    for seed, views, slices in [*draws, *((0, *pair) for pair in MORE)]:
        plan = Plan(seed, options.splits, views, slices, options.workers)
        with shared_map(options.workers) as apply:
            found = study(classes, plan, Terminal(), apply, orders=(2, 3))
        alike = found.ruled[2]
        rates = 100 * alike.spread().test_mean
        second.append(rates[-1])
        confused = ", ".join(f"{a} for {b} {n}" for (a, b), n in [*alike.confusions(3).items()][:2])
        print(
            f"seed {seed}, {views:2} views, {slices:3} slices: second order {rates[-1]:5.1f} %, "
            f"third {100 * found.ruled[3].spread().test_mean.max():5.1f} %, with alternatives "
            f"{100 * found.free[3].spread().test_mean.max():5.1f} %; {confused}",
            flush=True,
        )
    usual = second[: len(draws)]
    print(f"second order, mean of the seeds: {np.mean(usual):.1f} %, spread {np.std(usual):.1f} %")


if __name__ == "__main__":
    main()
