"""The node's worker thread: messages in at any time, results out in time."""

import queue
import threading
from functools import partial

import numpy as np
import pytest
import trimesh

from momrec_core.simulation import simulate_views
from momrec_ros.errors import Reason
from momrec_ros.interfaces import (
    Header,
    Marker,
    MarkerAction,
    decode_diagnostic_array,
    decode_marker_array,
    encode_marker_array,
)
from momrec_ros.messages import StampedView, ViewDecoder, encode_view
from momrec_ros.pipeline import MAX_WAITING_BYTES, Input, Pace, Pipeline
from momrec_ros.session import NANOSECONDS, Cause, Session

VIEWS = simulate_views(trimesh.creation.box((1, 2, 3)), 12, np.random.default_rng(1))
LIMIT = 30.0  # seconds until what was awaited counts as missing
FAST = Pace(publish_rate=1000.0, object_timeout=0.0, pair_timeout=1.0)
NEVER = Pace(publish_rate=0.01, object_timeout=0.0, pair_timeout=1.0)
RESULT = ["recognition", "principal_frame", "mesh", "normalized_mesh", "label", "tf"]


class Lines:
    """A log whose lines are kept."""

    def __init__(self):
        self.lines = []

    def info(self, message):
        self.lines.append(message)

    warning = error = info


class Bench:
    """A pipeline whose outputs come to a queue, and whose clock is set by hand."""

    def __init__(self, pace=FAST, wanted=()):
        self.now = NANOSECONDS
        self.time = lambda: self.now
        self.log = Lines()
        self.sent = queue.Queue()
        self.publish = self.sent.put
        self.is_over = False
        make_session = partial(_session, slices=4, min_views=2, max_objects=3, max_views=100)
        self.pipeline = Pipeline(
            make_session,
            ViewDecoder,
            publish=self._publish,
            is_wanted=lambda name: name in wanted,
            is_over=lambda: self.is_over,
            log=self.log,
            pace=pace,
            clock=self._time,
            frame_prefix="robot",
        )

    def _time(self):
        return self.time()

    def hold(self, waiting):
        """Let the next message, of so many that wait, be at work until it may go on."""
        is_at_work, may_go_on = threading.Event(), threading.Event()

        def time():
            if self.pipeline.activity().waiting < waiting:
                is_at_work.set()
                assert may_go_on.wait(LIMIT)
            return self.now

        self.time = time
        return is_at_work, may_go_on

    def _publish(self, outputs):
        if outputs:
            self.publish(outputs)

    def receive(self, *numbers, object_id="box"):
        for number in numbers:
            stamped = StampedView(object_id, number * NANOSECONDS, "map", VIEWS[number])
            self.pipeline.receive(Input.CONTOURS, encode_view(stamped))

    def forget(self, object_id):
        marker = Marker(Header(1, "map"), object_id, action=MarkerAction.DELETEALL)
        self.pipeline.receive(Input.CONTOURS, encode_marker_array([marker]))

    def next(self):
        """Return the next outputs, by their names."""
        return {output.name: output.data for output in self.sent.get(timeout=LIMIT)}

    def until_views(self, count):
        """Await a result of so many views; return how many results came until then."""
        for results in range(1, 1000):
            outputs = self.next()
            if "recognition" in outputs and views_of(outputs) == count:
                return results
        raise AssertionError(count)

    @property
    def tally(self):
        return self.pipeline.activity().tally


def _session(tally, **limits):
    return Session(None, tally=tally, **limits)


def views_of(outputs):
    verdict = decode_diagnostic_array(outputs["recognition"]).status[0]
    return int(dict(verdict.values)["views"])


@pytest.fixture
def make():
    benches = []

    def made(**options):
        benches.append(Bench(**options))
        return benches[-1]

    yield made
    for bench in benches:
        assert bench.pipeline.stop(LIMIT)


def test_what_came_before_the_activation_is_used_before_the_first_result(make):
    bench = make()
    bench.receive(0, 1, 2)
    bench.pipeline.activate()
    outputs = bench.next()
    assert list(outputs) == RESULT
    assert views_of(outputs) == 3
    activity = bench.pipeline.activity()
    assert (activity.received, activity.waiting, activity.tally.used) == (3, 0, 3)


def test_nothing_is_published_while_inactive_and_nothing_gathered_is_lost(make):
    bench = make()
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    bench.pipeline.deactivate()
    bench.receive(2, 3)
    assert bench.pipeline.activity().waiting == 2
    assert bench.sent.empty()
    bench.pipeline.activate()
    assert bench.until_views(4) == 1


def test_a_slow_publisher_costs_no_view_and_the_last_one_has_a_result(make):
    bench = make()
    may_go_on = threading.Event()
    has_begun = threading.Event()

    def publish(outputs):
        has_begun.set()
        assert may_go_on.wait(LIMIT)
        bench.sent.put(outputs)

    bench.publish = publish
    bench.pipeline.activate()
    bench.receive(0, 1)
    assert has_begun.wait(LIMIT)
    bench.receive(*range(2, 12))
    assert bench.pipeline.activity().received == 12
    may_go_on.set()
    assert bench.until_views(12) == 2  # one result for all that came meanwhile
    assert bench.tally.used == 12


def test_a_fault_is_counted_and_told_and_the_next_result_comes(make):
    bench = make()
    has_failed = threading.Event()

    def publish_nothing(outputs):
        bench.publish = bench.sent.put
        has_failed.set()
        raise RuntimeError(len(outputs))

    bench.publish = publish_nothing
    bench.pipeline.activate()
    bench.receive(0, 1)
    assert has_failed.wait(LIMIT)
    bench.receive(2)
    bench.until_views(3)
    assert bench.tally.rejected == {Reason.FAULT: 1}
    (line,) = bench.log.lines
    assert line.startswith("a fault: RuntimeError: ")


def test_what_fails_after_the_end_of_publishing_is_no_fault(make):
    bench = make()
    has_failed = threading.Event()

    def publish_into_nothing(outputs):
        bench.is_over = True  # as a signal ends rclpy's context at any time
        has_failed.set()
        raise RuntimeError(len(outputs))

    bench.publish = publish_into_nothing
    bench.pipeline.activate()
    bench.receive(0, 1)
    assert has_failed.wait(LIMIT)
    assert bench.pipeline.stop(LIMIT)
    assert Reason.FAULT not in bench.tally.rejected
    assert bench.log.lines == []


def test_more_bytes_than_may_wait_are_counted_as_overload_and_the_rest_is_read(make):
    bench = make()
    large = bytes(MAX_WAITING_BYTES // 2)
    for _ in range(3):
        bench.pipeline.receive(Input.CONTOURS, large)
    assert bench.pipeline.activity().waiting == 2
    assert bench.pipeline.reset() == 0
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    assert bench.tally.rejected == {Reason.OVERLOAD: 1}
    (line,) = bench.log.lines
    assert "expected at most" in line


def test_many_bad_messages_are_all_counted_but_told_once(make):
    bench = make()
    bench.pipeline.activate()
    for _ in range(20):
        bench.pipeline.receive(Input.CONTOURS, b"garbage")
    bench.receive(0, 1)
    bench.until_views(2)
    assert bench.tally.rejected == {Reason.ENCODING: 20}
    assert len(bench.log.lines) == 1


def test_a_reset_deletes_the_meshes_and_begins_anew(make):
    bench = make()
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    bench.pipeline.reset()
    removed = bench.next()
    assert list(removed) == ["mesh"]
    bench.receive(2, 3)
    assert bench.until_views(2) == 1


def test_what_a_reset_overtakes_is_not_published(make):
    bench = make()
    bench.receive(0, 1)
    bench.pipeline.reset()
    bench.receive(2, 3, 4)
    bench.pipeline.activate()
    assert bench.until_views(3) == 1


def test_what_comes_after_a_reset_is_used_though_a_view_before_it_was_still_at_work(make):
    bench = make()
    bench.receive(0, 1, 2, 3, 4)
    is_at_work, may_go_on = bench.hold(5)
    bench.pipeline.activate()
    assert is_at_work.wait(LIMIT)
    bench.pipeline.reset()
    bench.receive(5, 6, 7)
    may_go_on.set()
    assert bench.until_views(3) == 1


def test_an_object_that_ends_while_a_reset_waits_is_deleted_all_the_same(make):
    bench = make()
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    bench.pipeline.deactivate()
    bench.forget("box")
    is_at_work, may_go_on = bench.hold(1)
    bench.pipeline.activate()
    assert is_at_work.wait(LIMIT)
    bench.pipeline.deactivate()
    bench.pipeline.reset()
    may_go_on.set()
    bench.pipeline.activate()
    assert list(bench.next()) == ["mesh"]


def test_results_come_while_more_views_wait_than_can_soon_be_read(make, monkeypatch):
    monkeypatch.setattr("momrec_ros.pipeline.BATCH", 0.0)
    bench = make()
    bench.receive(*range(12))
    bench.pipeline.activate()
    assert bench.until_views(12) == 11


def test_evictions_are_all_counted_but_told_once(make):
    bench = make()
    bench.pipeline.activate()
    for number in range(20):
        bench.receive(0, object_id=str(number))
    bench.receive(0, 1)
    bench.until_views(2)
    assert bench.tally.ended == {Cause.EVICTED: 18}
    (line,) = (line for line in bench.log.lines if "is evicted" in line)
    assert line.startswith("object '0' is evicted")


def test_an_object_at_its_end_has_its_last_result_and_then_a_deletion(make):
    bench = make(pace=NEVER)
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    bench.receive(2)
    bench.forget("box")
    assert views_of(bench.next()) == 3
    assert list(bench.next()) == ["mesh"]
    bench.receive(0, 1, object_id="other")  # the end of `box` is all done
    bench.until_views(2)
    assert bench.tally.ended == {Cause.FORGOTTEN: 1}


def test_a_new_pace_counts_at_once(make):
    bench = make(pace=NEVER)
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    bench.receive(2)
    bench.pipeline.change_pace(FAST)
    assert bench.until_views(3) == 1


def test_objects_time_out_by_the_clock_that_is_given(make):
    bench = make(pace=Pace(publish_rate=1000.0, object_timeout=5.0, pair_timeout=1.0))
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    bench.now = 7 * NANOSECONDS
    assert list(bench.next()) == ["mesh"]
    bench.receive(0, 1)  # by now the end is all done
    bench.until_views(2)
    assert bench.tally.ended == {Cause.TIMED_OUT: 1}
    assert bench.log.lines == ["object 'box' is ended: no view for object_timeout"]


def test_who_comes_late_is_served_the_last_result_of_every_object(make):
    bench = make()
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    bench.receive(0, 1, object_id="other")
    bench.until_views(2)
    bench.pipeline.serve("recognition")
    served = [bench.next(), bench.next()]
    assert [list(outputs) for outputs in served] == [["recognition"], ["recognition"]]
    ids = [decode_diagnostic_array(outputs["recognition"]).status[0] for outputs in served]
    assert {status.hardware_id for status in ids} == {"box", "other"}


def test_markers_of_all_objects_go_out_where_they_are_wanted(make):
    bench = make(wanted=("markers",))
    bench.pipeline.activate()
    bench.receive(0, 1)
    while "markers" not in (outputs := bench.next()):
        pass
    first, *others = decode_marker_array(outputs["markers"])
    assert first.action == MarkerAction.DELETEALL
    assert first.header.frame_id == "map"
    assert {"box/axes", "box/label", "box/contours"} <= {marker.ns for marker in others}


def test_a_stopped_pipeline_publishes_no_more(make):
    bench = make()
    bench.pipeline.activate()
    bench.receive(0, 1)
    bench.until_views(2)
    assert bench.pipeline.stop(LIMIT)
    bench.receive(2, 3)
    assert bench.sent.empty()
