"""The paper's experiment: its folder, tables, figures and report, and what they are made of."""

import base64
import csv
import sys
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from rich.console import Console

from momrec_core.canonical import normalize
from momrec_core.errors import NoCommonLineError
from momrec_core.simulation import simulate_views
from momrec_core.stepwise import Instances, Split, StepwiseNames
from momrec_ros.bounds import Bound, paper_bounds
from momrec_ros.cli import main
from momrec_ros.experiment import ORDERS, Plan, Study, Trial
from momrec_ros.experiment_figures import draw_orders, draw_refinement
from momrec_ros.experiment_folder import Objects, write_experiment
from momrec_ros.experiment_report import bounds_section, html_page, neighbours_section
from momrec_ros.experiment_tables import bounds_table, table_1, write_first_split, write_spread
from momrec_ros.near_ties import near_ties
from momrec_ros.neighbours import Neighbour, nearest_neighbours
from momrec_ros.paper_table import PAPER_TABLE
from momrec_ros.terminal import Terminal

MESHES = Path(__file__).parents[2] / "meshes" / "ten_objects"
OBJECTS = [MESHES / f"{name}.ply" for name in ("castle", "l_bracket", "unequal_table")]
PLAN = Plan(seed=3, splits=2, views=4, slices=8, workers=1)
TABLES = (
    *("table1.csv", "table1_alternatives.csv"),
    *("table1_splits.csv", "table1_splits_alternatives.csv"),
)
FIGURES = (
    "figure_5",
    "figure_6",
    "figure_9",
    "figure_10",
    "figure_11",
    "rates",
    "ellipsoids",
    "trust",
)
RATES = {"train": 21, "test": 12}  # instances that a rate of one split is a share of


class Page(HTMLParser):
    """What a page shows and asks for."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.links, self.pictures, self.text, self.open = [], [], [], "", []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        for name, value in attributes:
            if name in ("src", "href"):
                self.links.append(value)
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def run(*arguments):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["momrec", "experiment", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
    return ended.value.code or 0


def do(folder, workers):
    options = {"--seed": 3, "--splits": 2, "--views": 4, "--slices": 8, "--workers": workers}
    words = [word for option in options.items() for word in option]
    return run(*OBJECTS, "--output", folder, *words)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("experiment") / "out"
    assert do(path, 1) == 0
    return path


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def trial_of(rights, labels, order=3):
    """Return a trial of one split of which so many of the test set are right at each step."""
    n = len(labels)
    split = Split(np.arange(n), np.arange(n))
    wrong = np.roll(np.unique(labels), 1)[np.searchsorted(np.unique(labels), labels)]
    named = np.array([np.where(np.arange(n) < right, labels, wrong) for right in rights])
    moments = tuple((0, 0, step) for step in range(len(rights)))
    return Trial(order, labels, (split,), (StepwiseNames(moments, named),))


# --- the command ----------------------------------------------------------------------------


def test_the_tables_have_a_row_for_each_step_of_each_order(folder):
    for name in ("table1.csv", "table1_alternatives.csv"):
        rows = rows_of(folder / name)
        assert list(rows[0]) == ["max_order", "step", "moment", "train_percent", "test_percent"]
        steps = [(int(row["max_order"]), int(row["step"])) for row in rows]
        expected = [(2, step) for step in range(1, 4)]
        expected += [(order, step) for order in (3, 4, 5) for step in range(1, 11)]
        assert steps == expected
        for order in ORDERS:
            moments = [row["moment"] for row in rows if row["max_order"] == str(order)]
            assert len(set(moments)) == len(moments)
            powers = [[int(digit) for digit in moment.removeprefix("eta_")] for moment in moments]
            assert all(2 <= sum(power) <= order for power in powers)
        for row in rows:
            for kind, count in RATES.items():
                right = float(row[f"{kind}_percent"]) * count / 100
                assert right == pytest.approx(round(right), abs=0.01)


def test_the_spread_covers_the_first_split(folder):
    ones, both = rows_of(folder / "table1.csv"), rows_of(folder / "table1_splits.csv")
    columns = ["max_order", "step", "train_mean", "train_std", "test_mean", "test_std"]
    assert list(both[0]) == columns
    assert len(ones) == len(both)
    for one, spread in zip(ones, both, strict=True):
        for kind in RATES:
            first = float(one[f"{kind}_percent"])
            mean, deviation = float(spread[f"{kind}_mean"]), float(spread[f"{kind}_std"])
            # Of two values the deviation is half of their difference.
            assert abs(first - mean) == pytest.approx(deviation, abs=0.011)
            assert 0 <= mean <= 100


def test_the_rates_are_far_above_chance(folder):
    best = max(float(row["test_mean"]) for row in rows_of(folder / "table1_splits.csv"))
    assert best > 80.0


def test_the_report_is_one_page_that_needs_nothing_else(folder):
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    assert not page.open
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    files = {path.read_bytes() for path in folder.glob("*.png")}
    prefix = "data:image/png;base64,"
    assert all(link.startswith(prefix) for link in page.links)
    shown = {base64.b64decode(link.removeprefix(prefix)) for link in page.links}
    assert files == shown
    for text in ("Table 1", "the paper's", "castle", "± ", "Seed 3"):
        assert text in page.text


def test_the_figures_show_something_and_tell_nothing_of_the_time(folder):
    assert {path.name for path in folder.iterdir()} == {
        *TABLES,
        *(f"{name}.png" for name in FIGURES),
        "report.html",
    }
    for name in FIGURES:
        with Image.open(folder / f"{name}.png") as picture:
            assert set(picture.info) <= {"dpi"}
            pixels = np.asarray(picture.convert("RGB"))
        assert 0.01 < np.mean(pixels.min(axis=-1) < 240) < 0.9
        border = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
        assert (border == 255).all()


def test_two_runs_of_one_seed_are_equal(folder, tmp_path):
    assert do(tmp_path / "again", 2) == 0
    first, second = (
        {path.name: path.read_bytes() for path in one.iterdir()}
        for one in (folder, tmp_path / "again")
    )
    assert first == second


def test_fewer_than_three_classes_are_refused(tmp_path, capsys):
    assert run(*OBJECTS[:2], "--output", tmp_path / "out") == 1
    assert "at least 3 classes, got castle, l_bracket" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_shipped_objects_are_ten_and_ten_with_near_ties():
    objects = Objects.shipped()
    assert sorted(objects.classes) == sorted(path.stem for path in MESHES.glob("*.ply"))
    assert len(objects.classes) == len(objects.ambiguous) == 10


def test_near_ties_and_few_views_are_in_the_report(tmp_path):
    names = {"near_cube": "$^{", "square_prism": "<b>&", "wedge": "wedge"}
    simple = {name: [near_ties()[shape]] for shape, name in names.items()}
    _, bounds = write_experiment(tmp_path, Objects(simple, simple, (5, 4)), PLAN, Terminal())
    assert len(bounds) == 8
    for what in ("near ties", "5 views"):
        assert sum(what in bound.what for bound in bounds) == 1
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "Near ties: mean and spread" in page.text
    for bound in bounds:
        assert bound.found in page.text
        assert bound.why in page.text
    for name in ("near_ties_splits.csv", "near_ties_splits_alternatives.csv"):
        assert {row["max_order"] for row in rows_of(tmp_path / name)} == {"3", "5"}


def test_nothing_is_overwritten(folder, capsys):
    before = sorted(path.stat().st_mtime_ns for path in folder.iterdir())
    assert do(folder, 1) == 1
    assert "does not exist yet" in capsys.readouterr().err
    assert sorted(path.stat().st_mtime_ns for path in folder.iterdir()) == before


# --- its parts ------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ORDERS)
def test_the_paper_s_rates_are_shares_of_its_instances(order):
    moments = [row.moment for row in PAPER_TABLE[order]]
    assert len(set(moments)) == len(moments)
    assert all(sum(moment) <= order for moment in moments)
    for row in PAPER_TABLE[order]:
        for percent, count in ((row.train, 70), (row.test, 40)):
            assert percent == round(100 * round(percent * count / 100) / count, 1)


def test_means_spreads_and_confusions_are_those_of_the_splits():
    labels = np.array(["a", "a", "b", "b"])
    splits = (Split(np.array([0, 2]), np.array([1, 3])), Split(np.array([1, 3]), np.array([0, 2])))
    names = (
        StepwiseNames(((0, 0, 2), (2, 0, 0)), np.array([list("abbb"), list("aabb")])),
        StepwiseNames(((0, 0, 2),), np.array([list("bbbb")])),
    )
    trial = Trial(2, labels, splits, names)
    assert trial.steps == 1
    spread = trial.spread()
    np.testing.assert_allclose(spread.train_mean, [0.75])
    np.testing.assert_allclose(spread.train_std, [0.25])
    np.testing.assert_allclose(spread.test_mean, [0.5])
    np.testing.assert_allclose(spread.test_std, [0.0])
    assert trial.confusions(1) == {("a", "b"): 2}


@pytest.mark.parametrize(
    ("third", "held"),
    [
        ([0, 0, 0, 98, 98, 100], [True, True, False, True]),
        ([100, 0, 0, 97, 98, 98], [False, True, False, True]),
        ([99, 99, 99, 99, 99, 99], [True, False, False, False]),
    ],
)
def test_a_bound_is_held_where_the_mean_reaches_it(third, held):
    labels = np.repeat(["a", "b"], 50)
    second = trial_of([92, 92, 92], labels, 2)
    trials = {2: second, 3: trial_of(third, labels)}
    instances = Instances(labels, (), ())
    study = Study({}, (), instances, trials, trials)
    neighbour = Neighbour("b", "a", 1.0, 9.0, 1.0, 0.5)
    better = Study({}, (), instances, {2: trial_of([92, 92, 96], labels, 2)}, {})
    bounds = paper_bounds({5: better, 10: study, 20: better}, 10, [neighbour])
    assert [bound.held for bound in bounds] == held
    assert bounds[2].found == "92.00 %"
    assert "b taken for a (8)" in bounds[2].why
    assert "9.00 apart" in bounds[2].why
    assert bounds[2].why.endswith("Seen in 20 views: 96.0 %.")
    assert "5 views" not in bounds[2].why


def test_neighbours_are_measured_in_the_total_covariance():
    rng = np.random.default_rng(5)
    labels = np.repeat(["a", "b", "c"], 40)
    centres = np.repeat([[0.0, 0.0], [3.0, 0.0], [0.0, 50.0]], 40, axis=0)
    vectors = centres + rng.normal(size=(120, 2)) * [0.5, 5.0]
    indices = ((2, 0, 0), (0, 2, 0))
    instances = Instances(labels, indices, tuple(vectors[:, None]))
    models = Instances(
        np.array(["c", "a", "b"]),
        indices,
        tuple(np.array([[[0.0, 50.0]], [[0.0, 0.0]], [[3.0, 0.0]]])),
    )
    inverse = np.linalg.inv(np.cov(vectors.T, bias=True))

    def length(offset):
        return np.sqrt(offset @ inverse @ offset)

    found = nearest_neighbours(instances, models)
    assert [one.label for one in found] == ["a", "b", "c"]
    means = {label: vectors[labels == label].mean(axis=0) for label in "abc"}
    exact = {"a": np.zeros(2), "b": np.array([3.0, 0.0]), "c": np.array([0.0, 50.0])}
    for one in found:
        others = {other: length(means[one.label] - means[other]) for other in "abc"}
        del others[one.label]
        assert one.nearest == min(others, key=others.get)
        assert one.apart == pytest.approx(min(others.values()))
        assert one.apart_as_modelled == pytest.approx(length(exact[one.label] - exact[one.nearest]))
        assert one.offset == pytest.approx(length(means[one.label] - exact[one.label]))
        own = [length(vector - means[one.label]) ** 2 for vector in vectors[labels == one.label]]
        assert one.stray == pytest.approx(np.sqrt(np.mean(own)))


def test_what_comes_from_outside_is_text_in_the_report(tmp_path):
    nasty = "<script>alert('&')</script>"
    (tmp_path / "picture.png").write_bytes(b"not looked at")
    sections = [
        bounds_section([Bound(nasty, nasty, nasty, held=False, why=nasty)]),
        neighbours_section(
            nasty, nasty, [Neighbour(nasty, nasty, 1, 1, 1, 1)], tmp_path / "picture.png"
        ),
    ]
    page = Page(html_page(nasty, PLAN, sections))
    assert "script" not in page.tags
    assert page.text.count(nasty) == 10


def test_the_terminal_shows_the_paper_s_numbers_beside_ours(tmp_path):
    labels = np.repeat(["a", "b"], 10)
    trials = {2: trial_of([5, 15, 20], labels, 2)}
    console = Console(width=160, record=True, file=StringIO())
    console.print(table_1(trials, trials))
    console.print(bounds_table([Bound("rate", "90 %", "80 %", held=False, why="[red]too few")]))
    shown = console.export_text()
    for text in ("25.0", "75.0", "100.0", "eta_020", "74.3", "95.0", "missed", "[red]too few"):
        assert text in shown
    write_first_split(trials, tmp_path / "first.csv")
    write_spread(trials, tmp_path / "spread.csv")
    assert [row["test_percent"] for row in rows_of(tmp_path / "first.csv")] == [
        "25.00",
        "75.00",
        "100.00",
    ]
    assert {row["test_std"] for row in rows_of(tmp_path / "spread.csv")} == {"0.00"}


def test_the_objects_with_near_ties_are_sound_and_none_has_a_sure_frame():
    meshes = near_ties()
    assert len(meshes) == 10
    for mesh in meshes.values():
        assert mesh.is_watertight
        assert mesh.volume > 0
        assert not normalize(mesh).is_unique


def test_figures_5_and_6_are_of_the_very_views(tmp_path):
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    views = simulate_views(mesh, 4, np.random.default_rng(0))
    for name, count in (("few", 3), ("more", 4)):
        draw_refinement(mesh, views[:count], tmp_path / f"{name}.png")
        with Image.open(tmp_path / f"{name}.png") as picture:
            assert picture.width == round(2.6 * 120 * count)
    draw_orders([views, views[::-1]], tmp_path / "orders.png")
    draw_orders([views, views], tmp_path / "same.png")
    pixels = {}
    for name in ("orders", "same"):
        with Image.open(tmp_path / f"{name}.png") as picture:
            pixels[name] = np.split(np.asarray(picture.convert("RGB")), 2, axis=1)
    assert (pixels["same"][0] == pixels["same"][1]).all()
    assert (pixels["orders"][0] != pixels["orders"][1]).any()
    with pytest.raises(NoCommonLineError, match="Expected two views"):
        draw_refinement(mesh, [views[0], views[0]], tmp_path / "none.png")
