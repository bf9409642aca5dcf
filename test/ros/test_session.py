"""Events to results: who changed, who is finished when, and what was lost."""

import numpy as np
import pytest
import trimesh
from shapely import box

from momrec_core.errors import NoCommonLineError
from momrec_core.simulation import simulate_views
from momrec_core.view import View
from momrec_ros.errors import Reason
from momrec_ros.messages import Forget, Rejected, StampedView
from momrec_ros.session import NANOSECONDS, Cause, Ended, Lost, Result, Session, Tally

VIEWS = simulate_views(trimesh.creation.box((1, 2, 3)), 4, np.random.default_rng(1))


@pytest.fixture
def tally():
    return Tally()


@pytest.fixture
def session(tally):
    return Session(None, slices=8, min_views=2, max_objects=3, max_views=100, tally=tally)


def show(session, object_id, second, number=0):
    stamp = second * NANOSECONDS
    return session.feed(StampedView(object_id, stamp, "map", VIEWS[number]), stamp)


def told(outcomes):
    return [
        (outcome.result.object_id, outcome.result.views, outcome.stamp // NANOSECONDS)
        if isinstance(outcome, Result)
        else (outcome.object_id, outcome.cause.value)
        if isinstance(outcome, Ended)
        else outcome.text.partition(":")[0]
        for outcome in outcomes
    ]


def test_objects_that_are_left_at_the_end_are_finished_in_their_order(session):
    for second in range(4):
        assert show(session, "ab"[second % 2], second, second // 2) == []
    outcomes = list(session.finish())
    assert told(outcomes) == [("a", 2, 2), ("a", "finished"), ("b", 2, 3), ("b", "finished")]
    assert {outcome.frame_id for outcome in outcomes[::2]} == {"map"}
    assert list(session.finish()) == []


def test_a_forgotten_object_is_finished_and_begins_anew(session):
    for second in range(2):
        show(session, "a", second, second)
        show(session, "b", second, second)
    assert told(session.feed(Forget("a"), 0)) == [("a", 2, 1), ("a", "forgotten")]
    assert told(session.feed(Forget("a"), 0)) == []
    for second in range(3):
        show(session, "a", second, second)
    assert told(session.feed(Forget(""), 0)) == [
        ("b", 2, 1),
        ("b", "forgotten"),
        ("a", 3, 2),
        ("a", "forgotten"),
    ]
    assert list(session.finish()) == []


def test_an_object_without_a_view_for_too_long_is_finished(session):
    show(session, "a", 0, 0)
    show(session, "a", 1, 1)
    show(session, "b", 11, 0)
    assert session.end_overdue(11 * NANOSECONDS, 10.0) == []
    assert session.end_overdue(1000 * NANOSECONDS, 0.0) == []
    ended = session.end_overdue(11 * NANOSECONDS + 1, 10.0)
    assert told(ended) == [("a", 2, 1), ("a", "timed_out")]
    assert session.objects == ("b",)


def test_a_clock_that_is_set_back_ends_nothing_before_its_time(session):
    show(session, "a", 1000, 0)
    assert session.end_overdue(NANOSECONDS, 10.0) == []
    assert session.end_overdue(11 * NANOSECONDS, 10.0) == []
    assert len(session.end_overdue(11 * NANOSECONDS + 1, 10.0)) == 2
    show(session, "b", 0, 0)
    session.touch(2000 * NANOSECONDS)
    assert session.end_overdue(2010 * NANOSECONDS, 10.0) == []


def test_with_one_object_too_many_the_least_recent_is_finished(session, tally):
    for second in range(2):
        for object_id in "abc":
            show(session, object_id, second, second)
    show(session, "a", 2, 2)
    assert told(show(session, "d", 3)) == [("b", 2, 1), ("b", "evicted")]
    assert set(session.objects) == {"a", "c", "d"}
    assert tally.ended == {Cause.EVICTED: 1}


def test_an_object_without_a_result_is_told(session):
    show(session, "a", 0)
    outcome, _ = session.finish()
    assert isinstance(outcome, Lost)
    assert outcome.text.startswith("object 'a' has no result: Expected at least 2 views")


def test_rejected_messages_are_told_and_counted(session, tally):
    rejected = Rejected("a", "Expected a pose, got none", 2_500_000_000, Reason.POSE)
    assert told(session.feed(rejected, 0)) == ["view of object 'a' at 2.500 s left out"]
    for second in range(2):
        show(session, "a", second, second)
    session.feed(rejected, 0)
    outcome, _ = session.finish()
    assert (outcome.result.views, outcome.result.rejected_views) == (2, 2)
    assert (tally.used, tally.rejected) == (2, {Reason.POSE: 2})


def test_a_view_that_comes_twice_counts_once(session, tally):
    for number in (0, 1, 0, 1, 2):
        show(session, "a", number, number)
    show(session, "b", 0, 0)
    show(session, "a", 7, 0)  # the same view at another time is another view
    (changed, _) = session.changed
    result = session.take(changed).result
    assert (result.object_id, result.views) == ("a", 4)
    assert (tally.used, tally.repeated) == (5, 2)
    session.feed(Forget("a"), 0)
    show(session, "a", 0, 0)
    assert tally.repeated == 2


def test_results_can_be_taken_as_the_views_come_and_are_not_told_again(session):
    show(session, "a", 0, 0)
    with pytest.raises(NoCommonLineError):
        session.take("a")
    assert session.changed == ()
    show(session, "a", 1, 1)
    show(session, "b", 2, 0)
    show(session, "a", 3, 2)
    assert session.changed == ("a", "b")
    taken = session.take("a")
    assert (taken.result.views, taken.stamp, taken.frame_id) == (3, 3 * NANOSECONDS, "map")
    assert told(session.feed(Forget("a"), 0)) == [("a", "forgotten")]
    show(session, "a", 4, 0)
    show(session, "a", 5, 1)
    assert told(session.feed(Forget("a"), 0)) == [("a", 2, 5), ("a", "forgotten")]


def test_a_view_against_all_others_is_counted_under_its_reason(session, tally):
    for number in range(4):
        show(session, "a", number, number)
    away = View.from_rings(VIEWS[0].camera, [ring + 100 for ring in VIEWS[0].rings])
    stray = StampedView("a", 9 * NANOSECONDS, "map", away)
    (lost,) = session.feed(stray, 0)
    assert lost.reason is Reason.CONTRADICTION
    assert tally.rejected == {Reason.CONTRADICTION: 1}
    assert session.take("a").stamp == 3 * NANOSECONDS


def test_a_view_beyond_the_most_is_counted_under_its_reason():
    session = Session(None, slices=8, min_views=2, max_objects=3, max_views=2, tally=Tally())
    outcomes = [show(session, "a", number, number) for number in range(4)]
    assert [[lost.reason for lost in some] for some in outcomes] == [
        [],
        [],
        [Reason.EXCESS],
        [Reason.EXCESS],
    ]


def test_an_object_seen_before_its_clock_was_set_counts_as_seen_when_it_is(session):
    show(session, "a", 0)
    assert session.end_overdue(100 * NANOSECONDS, 5.0) == []
    assert told(session.end_overdue(106 * NANOSECONDS, 5.0))[-1] == ("a", "timed_out")


def spoiled(count, place):
    """Return views of a box, one of which lost half of its silhouette."""
    views = list(simulate_views(trimesh.creation.box((1, 2, 3)), count, np.random.default_rng(3)))
    left, low, right, high = views[place].silhouette.bounds
    half = views[place].silhouette.intersection(box(left, low, (left + right) / 2, high))
    views[place] = View(views[place].camera, half)
    return views


def feed_all(session, views, first=0):
    for second, view in enumerate(views, start=first):
        session.feed(StampedView("a", second * NANOSECONDS, "map", view), second * NANOSECONDS)


@pytest.mark.parametrize("place", [0, 3, 7])
def test_a_view_that_contradicts_the_others_is_told_once_by_its_stamp(session, tally, place):
    feed_all(session, spoiled(8, place))
    named = f"view of object 'a' at {place}.000 s left out"
    assert session.take("a").result.views == 7
    assert told(session.told()) == [named]
    assert (tally.used, tally.rejected) == (7, {Reason.CONTRADICTION: 1})
    feed_all(session, box_views(2), first=8)
    assert told(session.finish()) == [("a", 9, 9), ("a", "finished")]
    assert (tally.used, tally.rejected) == (9, {Reason.CONTRADICTION: 1})


def box_views(count):
    return simulate_views(trimesh.creation.box((1, 2, 3)), count, np.random.default_rng(17))


def test_views_that_are_used_again_are_counted_as_used(session, tally):
    """The first view is far off; those after it contradict it until they are the majority."""
    views = list(box_views(6))
    pose = views[0].camera.pose.copy()
    pose[:3, 3] += 100 * pose[:3, 0]
    views[0] = View(type(views[0].camera)(pose), views[0].silhouette)
    feed_all(session, views)
    assert session.take("a").result.views == 5
    assert (tally.used, tally.rejected[Reason.CONTRADICTION]) == (5, 1)
