"""Events to results: who is finished when, and what was lost."""

import numpy as np
import pytest
import trimesh

from momrec_core.simulation import simulate_views
from momrec_ros.messages import Forget, Rejected, StampedView
from momrec_ros.replay import Finished, Lost, Replay

VIEWS = simulate_views(trimesh.creation.box((1, 2, 3)), 4, np.random.default_rng(1))


@pytest.fixture
def replay():
    return Replay(None, slices=8, min_views=2, max_objects=3, max_views=100, object_timeout=10.0)


def show(replay, object_id, second, number=0):
    stamp = second * 1_000_000_000
    return list(replay.feed(StampedView(object_id, stamp, "map", VIEWS[number])))


def told(outcomes):
    return [
        (outcome.result.object_id, outcome.result.views, outcome.stamp // 1_000_000_000)
        if isinstance(outcome, Finished)
        else outcome.text.partition(":")[0]
        for outcome in outcomes
    ]


def test_objects_that_are_left_at_the_end_are_finished_in_their_order(replay):
    for second in range(4):
        assert show(replay, "ab"[second % 2], second, second // 2) == []
    outcomes = list(replay.finish())
    assert told(outcomes) == [("a", 2, 2), ("b", 2, 3)]
    assert {outcome.frame_id for outcome in outcomes} == {"map"}
    assert list(replay.finish()) == []


def test_a_forgotten_object_is_finished_and_begins_anew(replay):
    for second in range(2):
        show(replay, "a", second, second)
        show(replay, "b", second, second)
    assert told(replay.feed(Forget("a"))) == [("a", 2, 1)]
    assert told(replay.feed(Forget("a"))) == []
    for second in range(3):
        show(replay, "a", second, second)
    assert told(replay.feed(Forget(""))) == [("b", 2, 1), ("a", 3, 2)]
    assert list(replay.finish()) == []


def test_an_object_without_a_view_for_too_long_is_finished(replay):
    show(replay, "a", 0, 0)
    show(replay, "a", 1, 1)
    assert show(replay, "b", 11, 0) == []
    assert told(show(replay, "b", 12, 1)) == [("a", 2, 1)]


def test_with_one_object_too_many_the_least_recent_is_finished(replay):
    for second in range(2):
        for object_id in "abc":
            show(replay, object_id, second, second)
    show(replay, "a", 2, 2)
    assert told(show(replay, "d", 3)) == [("b", 2, 1)]


def test_an_object_without_a_result_is_told(replay):
    show(replay, "a", 0)
    (outcome,) = replay.finish()
    assert isinstance(outcome, Lost)
    assert outcome.text.startswith("object 'a' has no result: Expected at least 2 views")


def test_rejected_messages_are_told_and_counted(replay):
    rejected = Rejected("a", "Expected a pose, got none", 2_500_000_000)
    assert told(replay.feed(rejected)) == ["view of object 'a' at 2.500 s left out"]
    for second in range(2):
        show(replay, "a", second, second)
    list(replay.feed(rejected))
    (outcome,) = replay.finish()
    assert (outcome.result.views, outcome.result.rejected_views) == (2, 2)
