"""Pictures: of the right size, with something in every panel, and of the very object given."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
import trimesh
from PIL import Image

from momrec_core import silhouette_of_mesh
from momrec_core.canonical import normalize
from momrec_core.hull import reconstruct
from momrec_core.simulation import simulate_views
from momrec_ros.cameras_json import MaskedView
from momrec_ros.figures import draw_coverage, draw_object, draw_overview
from momrec_ros.rendering import Viewpoint, render


def result_of(mesh, label="box"):
    hull = reconstruct(simulate_views(mesh, 6, np.random.default_rng(2)), 16)
    found = hull.mesh()
    return SimpleNamespace(
        object_id="object_1",
        mesh=found,
        canonical=normalize(found),
        recognition=SimpleNamespace(label=label, score=0.93, known=True),
        hull=hull,
        rejected_views=0,
        coverage=np.ones(6),
        left_out=(),
        views=6,
        slices=16,
        area=found.area,
        volume=found.volume,
    )


@pytest.fixture(scope="module")
def box():
    return result_of(trimesh.creation.box((0.2, 0.3, 0.6)))


@pytest.fixture(scope="module")
def wedge():
    return result_of(trimesh.creation.cone(0.3, 0.8, sections=5), "wedge")


def pixels_of(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), dtype=int)


def ink_share(pixels):
    return np.mean(pixels.min(axis=-1) < 240)


def test_an_object_s_picture_has_four_panels_none_of_them_blank(tmp_path, box):
    draw_object(box, tmp_path / "box.png")
    pixels = pixels_of(tmp_path / "box.png")
    assert pixels.shape == (600, 1920, 3)
    shares = [ink_share(panel) for panel in np.split(pixels[80:520], 4, axis=1)]
    assert min(shares) > 0.02
    assert max(shares) < 0.8


def test_another_mesh_gives_another_picture_and_the_same_mesh_the_same(tmp_path, box, wedge):
    for name, result in (("first", box), ("again", box), ("other", wedge)):
        draw_object(result, tmp_path / name)
    first, again, other = (pixels_of(tmp_path / name) for name in ("first", "again", "other"))
    np.testing.assert_array_equal(first, again)
    panels = np.split(np.abs(first - other).max(axis=-1)[80:520], 4, axis=1)
    assert min(np.mean(panel > 20) for panel in panels) > 0.01


def test_an_overview_has_a_cell_for_every_result(tmp_path, box, wedge):
    draw_overview([box, wedge, box], tmp_path / "overview.png")
    cells = np.split(pixels_of(tmp_path / "overview.png"), 3, axis=1)
    assert min(ink_share(cell) for cell in cells) > 0.03
    assert np.mean(cells[0] != cells[1]) > 0.03


def masked(views):
    """Return views as if they came from masks whose images hold all of them."""
    frame = shapely.box(-100.0, -100.0, 100.0, 100.0)
    return [
        MaskedView(
            f"view {number}",
            view,
            view.silhouette,
            frame,
            touches_border=False,
            specks=0,
            path=Path(f"{number}.png"),
        )
        for number, view in enumerate(views)
    ]


def test_coverage_shows_what_is_not_covered_in_its_own_colour(tmp_path, box):
    views = box.hull.views
    small = box.mesh.copy()
    small.apply_translation(-small.center_mass)
    small.apply_scale(0.6)
    own = [silhouette_of_mesh(small, view.camera) for view in views]
    draw_coverage(masked(views), small, tmp_path / "missed.png")
    draw_coverage(masked(own), small, tmp_path / "covered.png")
    vermilion = np.array([0xD5, 0x5E, 0x00])
    missed, covered = (
        np.mean(np.abs(pixels_of(tmp_path / name)[:-120] - vermilion).max(axis=-1) < 8)
        for name in ("missed.png", "covered.png")
    )
    assert missed > 0.01
    assert covered == 0


@pytest.mark.parametrize("draw", [draw_overview, lambda _, path: draw_coverage([], None, path)])
def test_a_picture_of_nothing_is_refused(tmp_path, draw):
    with pytest.raises(ValueError, match="Expected at least one"):
        draw([], tmp_path / "nothing.png")
    assert not (tmp_path / "nothing.png").exists()


def test_the_renderer_sees_the_nearest_surface():
    near = trimesh.creation.box(
        (1.0, 1.0, 0.2), transform=trimesh.transformations.translation_matrix([0, 0, 1])
    )
    far = trimesh.creation.icosphere(3, radius=0.9)
    viewpoint = Viewpoint(np.eye(3), np.zeros(3), 1.25)
    rendering = render(trimesh.util.concatenate([far, near]), viewpoint, (1.0, 1.0, 1.0), 100)
    x = (np.arange(100) + 0.25) / 50 - 1
    columns, rows = np.meshgrid(1.25 * x, -1.25 * x)
    in_box = np.maximum(abs(columns), abs(rows)) < 0.48
    in_ball = np.hypot(columns, rows) < 0.85
    np.testing.assert_allclose(rendering.depth[in_box], 1.1 / 1.25, atol=1e-9)
    beside = in_ball & (np.maximum(abs(columns), abs(rows)) > 0.52)
    expected = np.sqrt(0.81 - columns[beside] ** 2 - rows[beside] ** 2) / 1.25
    np.testing.assert_allclose(rendering.depth[beside], expected, atol=0.02)
    assert np.isneginf(rendering.depth[np.hypot(columns, rows) > 0.95]).all()
    assert rendering.image[..., 3].mean() == pytest.approx(np.pi * 0.81 / 6.25, rel=0.02)


def test_points_behind_the_surface_are_hidden():
    viewpoint = Viewpoint(np.eye(3), np.zeros(3), 1.25)
    rendering = render(trimesh.creation.box((1, 1, 1)), viewpoint, (1.0, 1.0, 1.0), 100)
    points = viewpoint.project(np.array([[0, 0, 0.4], [0, 0, 0.6], [0.9, 0, -3.0]]))
    np.testing.assert_array_equal(rendering.hides(points), [True, False, False])
