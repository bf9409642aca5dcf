"""The node's own diagnostics: levels, remarks and counts."""

from collections import Counter

import pytest

from momrec_ros.errors import Reason
from momrec_ros.health import health_status
from momrec_ros.interfaces import Level
from momrec_ros.pipeline import Activity
from momrec_ros.session import Cause, Tally


def activity(**rejected):
    counts = Counter({Reason(name): count for name, count in rejected.items()})
    tally = Tally(used=7, repeated=2, rejected=counts, ended=Counter({Cause.EVICTED: 4}))
    return Activity(received=20, waiting=1, objects=3, published=5, tally=tally, world_frame="map")


def test_a_node_that_loses_nothing_is_fine_and_says_its_state():
    status = health_status("/recognizer", "active", "", activity(), Activity())
    assert (status.level, status.message) == (Level.OK, "active")
    assert "/recognizer" in status.name


def test_losses_since_the_last_time_are_a_warning_with_their_reasons():
    status = health_status(
        "/recognizer", "active", "", activity(pair=5, frame=1), activity(pair=2, frame=1)
    )
    assert status.level == Level.WARN
    assert status.message == "active; views left out: 3 by pair"


def test_losses_of_long_ago_are_no_warning():
    status = health_status("/recognizer", "active", "", activity(pair=5), activity(pair=5))
    assert status.level == Level.OK


def test_a_refusal_to_be_configured_is_an_error_that_says_why():
    status = health_status("/recognizer", "unconfigured", "no such model", activity(), Activity())
    assert (status.level, status.message) == (Level.ERROR, "no such model")


def test_every_count_and_every_reason_is_told_once():
    status = health_status("/r", "active", "", activity(pair=5, type=2), Activity(), unreceived=9)
    values = dict(status.values)
    assert len(values) == len(status.values)
    expected = {
        "world_frame": "map",
        "messages": "20",
        "messages_waiting": "1",
        "messages_lost": "9",
        "objects": "3",
        "results": "5",
        "views_used": "7",
        "views_repeated": "2",
        "views_rejected": "7",
        "rejected_pair": "5",
        "rejected_type": "2",
        "objects_evicted": "4",
        "objects_forgotten": "0",
    }
    assert expected.items() <= values.items()


@pytest.mark.parametrize("reason", Reason)
def test_each_reason_has_a_count_of_its_own(reason):
    values = dict(health_status("/r", "active", "", activity(**{reason: 3}), Activity()).values)
    others = {values[f"rejected_{other}"] for other in Reason if other is not reason}
    assert values[f"rejected_{reason}"] == "3"
    assert others == {"0"}
