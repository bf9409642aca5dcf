"""The experiment's output folder: tables, figures, and the report that shows them all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
import trimesh

from momrec_core.camera import Camera
from momrec_core.canonical import normalize
from momrec_core.errors import MomrecError
from momrec_core.silhouette import silhouette_of_mesh
from momrec_core.simulation import look_at
from momrec_core.stepwise import Instances
from momrec_core.trust import rejection_curve, reliability
from momrec_core.view import View
from momrec_ros.bounds import (
    Bound,
    few_views_bounds,
    near_tie_bound,
    paper_bounds,
    trust_bounds,
)
from momrec_ros.experiment import Plan, Study, study, trust
from momrec_ros.experiment_figures import (
    draw_canonical_meshes,
    draw_objects,
    draw_orders,
    draw_refinement,
)
from momrec_ros.experiment_report import (
    bounds_section,
    html_page,
    neighbours_section,
    picture_section,
    spread_section,
    table_1_section,
)
from momrec_ros.experiment_tables import write_first_split, write_spread
from momrec_ros.near_ties import near_ties
from momrec_ros.neighbours import nearest_neighbours
from momrec_ros.paper_table import PAPER_TABLE
from momrec_ros.rate_figures import (
    RateCurve,
    RatePanel,
    draw_curves,
    draw_ellipsoids,
    draw_rates,
    draw_trust,
)
from momrec_ros.shared_data import shared_path
from momrec_ros.terminal import Terminal
from momrec_ros.training import find_classes
from momrec_ros.workers import Map, shared_map

__all__ = ["Objects", "write_experiment"]

OBJECTS = "meshes/ten_objects"
LEAST_CLASSES = 3  # one can be left out, and two remain to be told apart
NEAR_TIE_ORDERS = (3, 5)
VIEW_COUNTS, VIEW_COUNT_ORDERS = (3, 5, 20), (2, 3, 5)
REFINED = "unequal_table"  # the object of figures 5 and 6: many pieces in its slices
# Viewing directions of figures 5 and 6: two level ones, for upright slices, then from all sides.
DIRECTIONS = (
    (0.80, 0.60, 0.00),
    (-0.20, 0.98, 0.00),
    (-0.55, 0.68, -0.49),
    (0.66, -0.58, -0.48),
    (0.60, 0.67, 0.44),
    (0.74, 0.52, -0.42),
)
ORDERS = ((0, 1, 2, 3, 4, 5), (2, 5, 0, 1, 3, 4), (4, 3, 0, 1, 2, 5), (3, 5, 4, 0, 1, 2))

TITLE = "Recognition of three-dimensional objects by 3D moments: the paper's experiment, repeated"
CAPTIONS = {
    "figure_5": (
        "Figure 5: a reconstruction and its refinement",
        (
            "Two silhouettes give parallelograms in each plane across their common line; every "
            "further view clips them. Below, one slice: what the first two views allow (thin), "
            "what is left (filled), and the object's own cross-section (red)."
        ),
    ),
    "figure_6": (
        "Figure 6: four orders of the same views",
        (
            "The first two views determine the planes, so that the cross-sections (above) depend "
            "on the order of the views; the triangulated surfaces (below) hardly do."
        ),
    ),
    "figure_9": ("Figure 9: the objects", "As modelled, each seen from the same side."),
    "figure_10": (
        "Figure 10: canonical versions of the objects",
        "Centroid at the origin, area 100, principal axes v1 upwards (z), v2 to x, v3 to y.",
    ),
    "figure_11": (
        "Figure 11: reconstructed and canonical versions",
        (
            "The first instance of each class: moved, turned and scaled at random, reconstructed "
            "from its silhouettes, brought into its canonical frame; seen as in figure 10."
        ),
    ),
    "views": (
        "Number of views",
        (
            "Mean of the random splits, test set. Instances have the same places, orientations "
            "and sizes for each number of views; training and test sets are seen in as many."
        ),
    ),
    "near_ties": (
        "Near ties: ten objects whose frames are ambiguous",
        (
            "Mirror-like, nearly cubic or alike after a quarter turn, or with axes that miss the "
            "surface: A.1 to A.3 decide on noise."
        ),
    ),
    "trust": (
        "Unknown objects, and what the score means",
        (
            "Left: models without one class, each class left out in turn, are asked of its "
            "instances and of held-back ones of the others; a curve through the upper left corner "
            "rejects all strangers and nothing else. Right: labels gathered by score; on the "
            "dotted line the score is the share of labels that are right. Large marks stand for "
            "many labels."
        ),
    ),
}


@dataclass(frozen=True)
class Objects:
    """What the experiment is done with.

    Attributes
    ----------
    classes : dict
        Label to meshes; at least three classes.
    ambiguous : dict
        The same for objects with near ties; none for an experiment without them.
    view_counts : tuple of int
        Further numbers of views to do it with.
    """

    classes: dict[str, list[trimesh.Trimesh]]
    ambiguous: dict[str, list[trimesh.Trimesh]]
    view_counts: tuple[int, ...]

    @classmethod
    def shipped(cls) -> Self:
        """Return the ten objects of the shipped bag, and ten with near ties."""
        ambiguous = {label: [mesh] for label, mesh in near_ties().items()}
        return cls(find_classes([shared_path(OBJECTS)]), ambiguous, VIEW_COUNTS)

    @classmethod
    def given(cls, paths: Sequence[Path]) -> Self:
        """Return the classes of meshes.

        Raises
        ------
        MomrecError
            If there are less than three, or a file is no mesh.
        """
        classes = find_classes(paths)
        if len(classes) < LEAST_CLASSES:
            raise MomrecError(
                f"Expected at least {LEAST_CLASSES} classes, got {', '.join(classes)}"
            )
        return cls(classes, {}, ())


def write_experiment(
    folder: Path, objects: Objects, plan: Plan, terminal: Terminal
) -> tuple[Study, list[Bound]]:
    """Do the experiment and write all that comes of it.

    Parameters
    ----------
    folder : Path
        Exists.
    objects : Objects
        With what.
    plan : Plan
        How the experiment is done.
    terminal : Terminal
        Shows the progress.

    Returns
    -------
    study, bounds : Study, list of Bound
        What was found, and how it compares with what should be.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    with shared_map(plan.workers) as apply:
        studies = _studies(objects, plan, terminal, apply)
        ambiguous = _ambiguous_study(objects, plan, terminal, apply)
    found = studies[plan.views]
    write_first_split(found.ruled, folder / "table1.csv")
    write_spread(found.ruled, folder / "table1_splits.csv")
    write_first_split(found.free, folder / "table1_alternatives.csv")
    write_spread(found.free, folder / "table1_splits_alternatives.csv")
    sections, bounds = _recognition_sections(studies, plan.views, folder)
    sections += _figure_sections(found, folder, terminal)
    for more_sections, more_bounds in (
        _view_count_sections(studies, folder),
        _near_tie_sections(ambiguous, folder),
        _trust_sections(found, folder, terminal),
    ):
        sections += more_sections
        bounds += more_bounds
    page = html_page(TITLE, plan, [bounds_section(bounds), *sections])
    (folder / "report.html").write_text(page, encoding="utf-8")
    return found, bounds


def _studies(objects: Objects, plan: Plan, terminal: Terminal, apply: Map) -> dict[int, Study]:
    """Do the experiment as planned, and with other numbers of views; return them by these."""
    studies = {plan.views: study(objects.classes, plan, terminal, apply)}
    for views in objects.view_counts:
        if views not in studies:
            other = replace(plan, views=views)
            studies[views] = study(
                objects.classes, other, terminal, apply, orders=VIEW_COUNT_ORDERS
            )
    return dict(sorted(studies.items()))


def _ambiguous_study(objects: Objects, plan: Plan, terminal: Terminal, apply: Map) -> Study | None:
    """Do the experiment with objects whose frames are ambiguous, if there are any."""
    if not objects.ambiguous:
        return None
    return study(objects.ambiguous, plan, terminal, apply, orders=NEAR_TIE_ORDERS)


def _recognition_sections(
    studies: Mapping[int, Study], views: int, folder: Path
) -> tuple[list[str], list[Bound]]:
    """Return the report's sections on rates, and the bounds."""
    found = studies[views]
    second = found.instances.up_to(2)
    modelled = [normalize(mesh) for mesh in found.models.values()]
    models = Instances.of_shapes(list(found.models), modelled, 2)
    neighbours = nearest_neighbours(second, models)
    rates, ellipsoids = folder / "rates.png", folder / "ellipsoids.png"
    draw_rates(found.ruled, found.free, PAPER_TABLE, rates)
    draw_ellipsoids(second, models, ellipsoids)
    sections = [
        table_1_section(found.ruled),
        spread_section(
            "Mean and spread over random splits",
            "Percent; the spread is the standard deviation over the splits. With alternatives, a "
            "shape whose frame is ambiguous is learned in the frame that fits its class and "
            "recognised in the one that fits best, and distances are in the metric of the "
            "covariance within classes: as the models of momrec learn.",
            found.ruled,
            found.free,
            rates,
        ),
        neighbours_section(
            "Second order: how alike the ellipsoids are",
            "Second moments stand for an ellipsoid. Distances are in the metric of the total "
            "covariance T of the three second moments. Where a class strays farther than the next "
            "class is away, three moments can't tell the two apart.",
            neighbours,
            ellipsoids,
        ),
    ]
    return sections, paper_bounds(studies, views, neighbours)


def _figure_sections(found: Study, folder: Path, terminal: Terminal) -> list[str]:
    """Draw the paper's figures and return the report's sections with them."""
    refined = found.models.get(REFINED, next(iter(found.models.values())))
    views = [_level_view(refined, direction) for direction in DIRECTIONS]
    canonical = {label: normalize(mesh).mesh for label, mesh in found.models.items()}
    first = {label: shape.mesh for label, shape in sorted(found.first_instances().items())}
    drawings = {
        "figure_5": lambda path: draw_refinement(refined, views, path),
        "figure_6": lambda path: draw_orders([[views[i] for i in order] for order in ORDERS], path),
        "figure_9": lambda path: draw_objects(found.models, path),
        "figure_10": lambda path: draw_canonical_meshes(canonical, canonical, path),
        "figure_11": lambda path: draw_canonical_meshes(first, canonical, path),
    }
    sections = []
    for name in terminal.progress(drawings, "drawing", len(drawings)):
        path = folder / f"{name}.png"
        drawings[name](path)
        sections.append(picture_section(*CAPTIONS[name], path))
    return sections


def _view_count_sections(
    studies: Mapping[int, Study], folder: Path
) -> tuple[list[str], list[Bound]]:
    """Show how rates go with the number of views, if there are several."""
    if len(studies) < 2:
        return [], []
    picture = folder / "views.png"
    draw_curves([_view_count_panel(studies)], picture)
    section = picture_section(*CAPTIONS["views"], picture)
    return [section], few_views_bounds(studies)


def _view_count_panel(studies: Mapping[int, Study]) -> RatePanel:
    """Return how the mean rates on the test sets go with the number of views."""
    found = studies.values()
    curves = {
        "second order, three moments": [one.ruled[2].spread().test_mean[-1] for one in found],
        "third order, best step": [one.ruled[3].spread().test_mean.max() for one in found],
        "as models learn, fifth order": [one.free[5].spread().test_mean.max() for one in found],
    }
    drawn = [RateCurve(name, tuple(100 * rate for rate in rates)) for name, rates in curves.items()]
    return RatePanel("number of views", tuple(studies), tuple(drawn))


def _near_tie_sections(found: Study | None, folder: Path) -> tuple[list[str], list[Bound]]:
    """Show what comes of objects whose frames are ambiguous, if there are any."""
    if found is None:
        return [], []
    gallery, rates = folder / "near_ties.png", folder / "near_ties_rates.png"
    write_spread(found.ruled, folder / "near_ties_splits.csv")
    write_spread(found.free, folder / "near_ties_splits_alternatives.csv")
    draw_objects(found.models, gallery)
    draw_rates(found.ruled, found.free, {}, rates)
    sections = [
        picture_section(*CAPTIONS["near_ties"], gallery),
        spread_section(
            "Near ties: mean and spread over random splits",
            "The same as above. Alternatives are the further frames that fit as well within the "
            "tolerances: axes whose eigenvalues are nearly equal are exchanged, axes that the "
            "surface ends equally far on both sides of, or that miss it, are turned around.",
            found.ruled,
            found.free,
            rates,
        ),
    ]
    return sections, [near_tie_bound(found)]


def _trust_sections(
    found: Study, folder: Path, terminal: Terminal
) -> tuple[list[str], list[Bound]]:
    """Leave classes out and ask how sure models are."""
    verdicts = trust(found, terminal)
    curve = rejection_curve(verdicts.with_strangers)
    parts = {
        "known objects": reliability(verdicts.known),
        "with strangers": reliability(verdicts.with_strangers),
    }
    picture = folder / "trust.png"
    draw_trust(curve, parts, picture)
    section = picture_section(*CAPTIONS["trust"], picture)
    return [section], trust_bounds(curve, parts["known objects"])


def _level_view(mesh: trimesh.Trimesh, direction: tuple[float, float, float]) -> View:
    """Look at a mesh with the image's upward direction as near to z as may be."""
    towards = np.array(direction) / np.linalg.norm(direction)
    pose = look_at(mesh.bounds.mean(axis=0), towards, 3.0 * float(mesh.scale), np.pi)
    return silhouette_of_mesh(mesh, Camera.orthographic(pose))
