"""Graphs for the tests of the node; see `graph`."""

import graph as graphs
import pytest


@pytest.fixture
def graph(tmp_path):
    with graphs.open_graph(tmp_path) as opened:
        yield opened


@pytest.fixture(scope="module")
def lasting_graph(tmp_path_factory):
    with graphs.open_graph(tmp_path_factory.mktemp("graph")) as opened:
        yield opened
