"""Rays cut with viewing volumes, against points sampled densely along them."""

import numpy as np
import pytest
import shapely
import trimesh

from momrec_core import Camera, View
from momrec_core.sightlines import Sightlines
from momrec_core.simulation import simulate_views

SAMPLES = np.linspace(-6.0, 6.0, 2001)
TOLERANCE = 0.004


def rings(projection, seed):
    """Return views of a body with a hole, each moved a little, so that they disagree."""
    mesh = trimesh.creation.annulus(0.5, 1.0, 0.8, sections=24)
    rng = np.random.default_rng(seed)
    views = simulate_views(mesh, 5, rng, projection=projection)
    moved = []
    for view in views:
        pose = view.camera.pose.copy()
        pose[:3, 3] += rng.normal(scale=0.08, size=3)
        moved.append(View(Camera(pose, view.camera.K), view.silhouette))
    return moved


def outline_rays(view, count):
    """Return points along rays at equal steps of the outline, shape (count, samples, 3)."""
    lines = [ring for part in view.silhouette.geoms for ring in (part.exterior, *part.interiors)]
    ends = np.cumsum([line.length for line in lines])
    points = []
    for step in ends[-1] * (np.arange(count) + 0.5) / count:
        which = int(np.searchsorted(ends, step))
        point = lines[which].interpolate(step - ends[which] + lines[which].length)
        points.append((point.x, point.y))
    points = np.array(points)
    camera = view.camera
    if camera.is_pinhole:
        rays = camera.rays_camera(points) @ camera.rotation.T
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        middle = np.linalg.norm(camera.position)  # the body is at the origin
        return camera.position + rays[:, None] * (middle + SAMPLES)[:, None]
    starts = camera.position + points @ camera.rotation[:, :2].T
    depth = -camera.position @ camera.rotation[:, 2]
    return starts[:, None] + (depth + SAMPLES)[:, None] * camera.rotation[:, 2]


def covers(view, points):
    """Return whether a view admits points, with the tolerance less and more by a half."""
    left, low, right, high = view.silhouette.bounds
    size = np.hypot(right - left, high - low)
    image, _ = view.camera.project(points.reshape(-1, 3))
    found = []
    for share in (0.5, 1.5):
        region = view.silhouette.buffer(share * TOLERANCE * size)
        shapely.prepare(region)
        found.append(shapely.contains_xy(region, *image.T).reshape(points.shape[:-1]))
    return found


@pytest.mark.parametrize("projection", ["orthographic", "central"])
@pytest.mark.parametrize("seed", range(3))
def test_the_fewest_refusals_are_those_of_points_sampled_along_the_rays(projection, seed):
    views = rings(projection, seed)
    count = 24
    lines = Sightlines(views, np.arange(len(views)), count, TOLERANCE)
    refused = lines.refusals(np.ones(len(views), dtype=bool))
    fewest = refused.sum(axis=1).reshape(len(views), count)
    for index, view in enumerate(views):
        points = outline_rays(view, count)
        others = [covers(other, points) for place, other in enumerate(views) if place != index]
        narrow, wide = (sum(~pair[kind] for pair in others).min(axis=1) for kind in (0, 1))
        assert (wide <= fewest[index]).all()
        assert (fewest[index] <= narrow).all()
    assert fewest.max() > 1


def test_views_that_do_not_count_neither_refuse_nor_are_refused():
    views = rings("central", 0)
    used = np.array([True, True, False, True, True])
    lines = Sightlines(views, np.arange(5), 20, TOLERANCE)
    refused = lines.refusals(used)
    assert not refused[:, 2].any()
    assert not refused[lines.owners == 2].any()
    kept = [view for view, counts in zip(views, used, strict=True) if counts]
    alone = Sightlines(kept, np.arange(4), 20, TOLERANCE).refusals(np.ones(4, dtype=bool))
    np.testing.assert_array_equal(refused[lines.owners != 2][:, used], alone)


def test_what_lies_behind_a_camera_is_refused():
    """A camera that looks away from the body admits none of the rays to it."""
    views = rings("central", 1)
    pose = views[0].camera.pose.copy()
    pose[:3, :3] = pose[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    away = View(Camera(pose, views[0].camera.K), views[0].silhouette)
    lines = Sightlines([away, *views[1:]], np.arange(5), 10, TOLERANCE)
    refused = lines.refusals(np.ones(5, dtype=bool))
    assert refused[lines.owners != 0, 0].mean() > 0.9
