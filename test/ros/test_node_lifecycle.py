"""The life cycle of the node `recognizer`, in a real graph."""

from functools import partial

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import box_views, view_message
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

VIEWS = box_views(10)


def has_views(results, count):
    return results.messages and dict(pairs(results.messages[-1]))["views"] == str(count)


def pairs(recognition):
    return ((pair.key, pair.value) for pair in recognition.status[0].values)


def test_the_node_goes_twice_through_all_states_and_gathers_views_in_between(graph):
    graph.start(autostart=False, slices=8)
    results = graph.listen("recognition", DiagnosticArray)
    publisher = graph.start_publisher()
    assert graph.state() == "unconfigured"
    for _ in range(2):
        results.messages.clear()
        assert graph.change("configure")
        assert graph.state() == "inactive"
        for first, last in ((0, 3), (3, 6)):  # deactivated in between, the object stays as it was
            assert graph.change("activate")
            assert graph.state() == "active"
            for view in VIEWS[first:last]:
                publisher.publish(view_message(view))
            graph.until(partial(has_views, results, last), f"a result of {last} views")
            assert graph.change("deactivate")
            publisher.publish(view_message(VIEWS[9]), listeners=0)
            assert graph.state() == "inactive"
        assert graph.change("cleanup")
        assert graph.state() == "unconfigured"
    assert graph.change("shutdown")
    assert graph.state() == "finalized"


def test_transitions_that_a_state_does_not_have_are_refused_and_change_nothing(graph):
    graph.start(autostart=False, slices=8)
    for transition in ("activate", "deactivate", "cleanup"):
        assert not graph.change(transition)
        assert graph.state() == "unconfigured"
    assert not graph.reset().success
    assert graph.change("configure")
    for transition in ("configure", "deactivate"):
        assert not graph.change(transition)
        assert graph.state() == "inactive"


@pytest.mark.parametrize(
    "transition",
    [
        Transition(id=Transition.TRANSITION_ACTIVATE),
        Transition(id=Transition.TRANSITION_CREATE),
        Transition(id=255),
        Transition(label="cleanup"),
        Transition(label="fly"),
    ],
    ids=["activate", "create", "unknown", "cleanup by name", "unknown by name"],
)
def test_a_transition_that_the_state_does_not_have_is_refused(unconfigured, transition):
    request = ChangeState.Request(transition=transition)
    assert not unconfigured.call("change_state", ChangeState, request).success
    assert unconfigured.state() == "unconfigured"


@pytest.fixture(scope="module")
def unconfigured(lasting_graph):
    lasting_graph.start(autostart=False)
    return lasting_graph
