"""How recognition fares with few views, coarse slices and noisy contours, as numbers and a figure.

Models are fitted to simulated instances of the ten objects and asked of others: a model fitted to
instances like those asked, one fitted to the usual ones (ten views, 64 slices, no noise), and one
fitted to a mix of all numbers of views. Noise is in pixels of a 640 x 480 image, 90 % of whose
height an object takes.

    python benchmarks/robustness.py --figure robustness.png
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from momrec_core.canonical import CanonicalShape
from momrec_core.model import RecognitionModel
from momrec_ros.rate_figures import RateCurve, RatePanel, draw_curves
from momrec_ros.shared_data import shared_path
from momrec_ros.training import find_classes, reconstructed_instances

OBJECT_PIXELS = 0.9 * 480  # diameter of an object in the image
VIEWS = (2, 3, 4, 5, 7, 10, 14, 20)
SLICES = (8, 16, 32, 64, 128)
NOISE_PIXELS = (0.0, 0.5, 1.0, 2.0, 3.0)
FIVE_VIEWS, FIVE_VIEWS_BOUND = 5, 97.0  # percent
TEST_SEED = 1_000_000  # apart from the training seed


@dataclass(frozen=True)
class Setting:
    """How instances are seen and reconstructed."""

    views: int = 10
    slices: int = 64
    noise_pixels: float = 0.0


Labelled = list[tuple[str, CanonicalShape]]


class Workshop:
    """Makes training and test instances of a setting, once."""

    def __init__(self, training: int, test: int, seed: int, workers: int) -> None:
        self._counts = {seed: training, seed + TEST_SEED: test}
        self._seed = seed
        self._workers = workers
        self._made: dict[tuple[Setting, int], Labelled] = {}
        self._classes = find_classes([shared_path("meshes/ten_objects")])

    def training(self, setting: Setting) -> Labelled:
        """Return what models are fitted to."""
        return self._instances(setting, self._seed)

    def test(self, setting: Setting) -> Labelled:
        """Return what models are asked of."""
        return self._instances(setting, self._seed + TEST_SEED)

    def _instances(self, setting: Setting, seed: int) -> Labelled:
        if (setting, seed) not in self._made:
            rebuilt = reconstructed_instances(
                self._classes,
                instances=self._counts[seed],
                views=setting.views,
                slices=setting.slices,
                noise=setting.noise_pixels / OBJECT_PIXELS,
                seed=seed,
                workers=self._workers,
            )
            self._made[setting, seed] = list(rebuilt)
        return self._made[setting, seed]


def fitted(pairs: Labelled) -> RecognitionModel:
    """Fit a model with the defaults of `momrec train`."""
    return RecognitionModel.fit([shape for _, shape in pairs], [label for label, _ in pairs])


def rate(model: RecognitionModel, pairs: Labelled) -> float:
    """Return the share of instances whose nearest class is theirs."""
    return float(np.mean([model.recognize(shape).ranking[0][0] == label for label, shape in pairs]))


def mixed(workshop: Workshop, settings: Sequence[Setting]) -> Labelled:
    """Take turns with the settings, so that each gives a part of every class's instances."""
    made = [workshop.training(setting) for setting in settings]
    count = len(made[0])
    return [made[(turn + part) % len(made)][turn] for turn in range(count) for part in range(2)]


def panel(
    workshop: Workshop,
    title: str,
    settings: Sequence[Setting],
    positions: Sequence[float],
    mix: RecognitionModel | None,
) -> RatePanel:
    """Measure one panel of the figure and print it."""
    usual = fitted(workshop.training(Setting()))
    columns: dict[str, list[float]] = {"trained alike": [], "trained with ten views": []}
    if mix is not None:
        columns["trained with all numbers of views"] = []
    for setting, position in zip(settings, positions, strict=True):
        asked = workshop.test(setting)
        models = [fitted(workshop.training(setting)), usual, *([mix] if mix else [])]
        for rates, model in zip(columns.values(), models, strict=True):
            rates.append(100 * rate(model, asked))
        shown = "   ".join(f"{name} {rates[-1]:5.1f} %" for name, rates in columns.items())
        print(f"{title:28} {position:5g}   {shown}", flush=True)
    curves = tuple(RateCurve(name, tuple(rates)) for name, rates in columns.items())
    return RatePanel(title, tuple(positions), curves)


def main() -> None:
    """Print rates, and draw them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--training", type=int, default=10, help="instances of each class")
    parser.add_argument("--test", type=int, default=10, help="instances of each class")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--figure", type=Path, help="PNG to write")
    options = parser.parse_args()
    workshop = Workshop(options.training, options.test, options.seed, options.workers)
    few = [replace(Setting(), views=views) for views in VIEWS]
    mix = fitted(mixed(workshop, few))
    coarse = [replace(Setting(), slices=slices) for slices in SLICES]
    noisy = [replace(Setting(), noise_pixels=pixels) for pixels in NOISE_PIXELS]
    panels = [
        panel(workshop, "views", few, VIEWS, mix),
        panel(workshop, "slices", coarse, SLICES, None),
        panel(workshop, "noise, pixels at 640 x 480", noisy, NOISE_PIXELS, None),
    ]
    best = max(curve.rates[VIEWS.index(FIVE_VIEWS)] for curve in panels[0].curves)
    verdict = "held" if best >= FIVE_VIEWS_BOUND else "missed"
    print(f"{FIVE_VIEWS} views: {best:.1f} %, bound {FIVE_VIEWS_BOUND:g} %: {verdict}")
    if options.figure:
        draw_curves(panels, options.figure)


if __name__ == "__main__":
    main()
