"""Transforms over time against products of matrices, and scipy's interpolation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from momrec_ros import transform_buffer
from momrec_ros.errors import TransformError
from momrec_ros.interfaces import Header, Pose, Transform
from momrec_ros.poses import pose_from_matrix
from momrec_ros.transform_buffer import TransformBuffer

SECOND = 10**9


def random_matrix(rng):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


def added(*items, is_static=False, buffer=None):
    buffer = TransformBuffer() if buffer is None else buffer
    for parent, child, stamp, matrix in items:
        pose = pose_from_matrix(np.asarray(matrix))
        buffer.add([Transform(Header(stamp, parent), child, pose)], is_static=is_static)
    return buffer


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_between_any_two_frames_of_a_tree_it_is_the_product_of_what_lies_between(seed):
    rng = np.random.default_rng(seed)
    buffer, world_from = TransformBuffer(), {"0": np.eye(4)}
    for child in range(1, 9):
        parent = str(rng.integers(child))
        matrix = random_matrix(rng)
        added((parent, str(child), 5, matrix), is_static=bool(rng.integers(2)), buffer=buffer)
        world_from[str(child)] = world_from[parent] @ matrix
    for target, source in rng.integers(0, 9, (10, 2)).astype(str):
        expected = np.linalg.inv(world_from[target]) @ world_from[source]
        np.testing.assert_allclose(buffer.lookup(target, source, 5), expected, atol=1e-12)


@given(st.integers(0, 10_000), st.floats(0, 1))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_between_samples_a_frame_goes_straight_and_turns_evenly(seed, share):
    rng = np.random.default_rng(seed)
    first, last = random_matrix(rng), random_matrix(rng)
    stamp = SECOND + round(share * SECOND)
    buffer = added(("map", "cam", SECOND, first), ("map", "cam", 2 * SECOND, last))
    found = buffer.lookup("map", "cam", stamp)
    turns = Rotation.from_matrix([first[:3, :3], last[:3, :3]])
    at = (stamp - SECOND) / SECOND
    np.testing.assert_allclose(found[:3, :3], Slerp([0, 1], turns)(at).as_matrix(), atol=1e-7)
    np.testing.assert_allclose(found[:3, 3], (1 - at) * first[:3, 3] + at * last[:3, 3], atol=1e-12)


def test_samples_may_come_in_any_order_and_again():
    rng = np.random.default_rng(3)
    matrices = [random_matrix(rng) for _ in range(6)]
    order = rng.permutation(6)
    items = [("map", "cam", SECOND + int(place), matrices[place]) for place in [*order, order[0]]]
    buffer = added(*items)
    for place, matrix in enumerate(matrices):
        np.testing.assert_allclose(buffer.lookup("map", "cam", SECOND + place), matrix, atol=1e-12)


@pytest.mark.parametrize(
    ("stamp", "why"),
    [(SECOND - 1, "is known from 1000000000 ns on only"), (SECOND + 2, "until 1000000001 ns only")],
)
def test_nothing_is_known_before_the_first_sample_and_after_the_last(stamp, why):
    buffer = added(("map", "cam", SECOND, np.eye(4)), ("map", "cam", SECOND + 1, np.eye(4)))
    assert not buffer.knows("cam", stamp)
    with pytest.raises(TransformError, match=why) as raised:
        buffer.lookup("map", "cam", stamp)
    assert "cam" in raised.value.ends


def test_frames_that_are_not_connected_are_told():
    buffer = added(("map", "base", 0, np.eye(4)), ("rig", "cam", 0, np.eye(4)), is_static=True)
    with pytest.raises(TransformError, match="nothing is known above 'rig' and nothing is known a"):
        buffer.lookup("map", "cam", 7)
    with pytest.raises(TransformError, match="from 'nowhere' to 'map' at 7 ns"):
        buffer.lookup("map", "nowhere", 7)


def test_a_circle_of_frames_ends():
    buffer = added(("a", "b", 0, np.eye(4)), ("b", "a", 0, np.eye(4)), is_static=True)
    with pytest.raises(TransformError, match="circle of frames"):
        buffer.lookup("map", "a", 0)


def test_a_frame_that_changes_its_parent_is_in_neither_between():
    buffer = added(("map", "cam", 10, np.eye(4)), ("rig", "cam", 20, np.eye(4)))
    assert buffer.lookup("map", "cam", 10).shape == (4, 4)
    with pytest.raises(TransformError, match="changes its parent"):
        buffer.lookup("map", "cam", 15)


def test_a_leading_slash_does_not_count():
    buffer = added(("/map", "/cam", 10, np.eye(4)), is_static=True)
    np.testing.assert_array_equal(buffer.lookup("map", "/cam", 0), np.eye(4))


@pytest.mark.parametrize(
    "transform",
    [
        Transform(Header(0, "map"), "", Pose()),
        Transform(Header(0, ""), "cam", Pose()),
        Transform(Header(0, "cam"), "cam", Pose()),
        Transform(Header(0, "map"), 1001 * "n", Pose()),
        Transform(Header(0, "map"), "cam", Pose((np.nan, 0, 0))),
        Transform(Header(0, "map"), "cam", Pose(orientation=(0.0, 0.0, 0.0, 0.0))),
    ],
)
def test_what_is_no_transform_is_left_out_and_told_where_it_is_missed(transform):
    buffer = TransformBuffer()
    buffer.add([transform], is_static=True)
    assert "Expected" in buffer.unusable
    with pytest.raises(TransformError, match="left out: "):
        buffer.lookup("map", "cam", 0)


@pytest.mark.parametrize("late", [10 * SECOND, 1000 * SECOND])
def test_a_clock_that_is_set_back_begins_anew(late):
    buffer = added(("map", "cam", late, np.eye(4)), ("map", "cam", SECOND, np.eye(4)))
    assert buffer.knows("cam", SECOND)
    assert not buffer.knows("cam", late)


def test_memory_is_bounded_by_time_samples_and_frames(monkeypatch):
    monkeypatch.setattr(transform_buffer, "MAX_SAMPLES", 10)
    monkeypatch.setattr(transform_buffer, "MAX_FRAMES", 3)
    monkeypatch.setattr(transform_buffer, "HORIZON", 100)
    buffer = added(*[("map", "cam", stamp, np.eye(4)) for stamp in range(0, 200, 40)])
    assert [buffer.knows("cam", stamp) for stamp in (40, 80, 160)] == [False, True, True]
    added(*[("map", "cam", 160 + number, np.eye(4)) for number in range(20)], buffer=buffer)
    assert [buffer.knows("cam", stamp) for stamp in (169, 170)] == [False, True]
    added(("map", "base", 0, np.eye(4)), is_static=True, buffer=buffer)
    added(*[("map", f"object {number}", 170, np.eye(4)) for number in range(9)], buffer=buffer)
    assert buffer.knows("base", 0)
    assert [buffer.knows(f"object {number}", 170) for number in (6, 7, 8)] == [False, True, True]
