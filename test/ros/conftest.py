"""Graphs for the tests of the node, see `graph`; the command line in the tests' own process."""

import sys
from types import SimpleNamespace

import graph as graphs
import pytest

from momrec_ros.cli import main


@pytest.fixture
def graph(tmp_path):
    with graphs.open_graph(tmp_path) as opened:
        yield opened


@pytest.fixture(scope="module")
def lasting_graph(tmp_path_factory):
    with graphs.open_graph(tmp_path_factory.mktemp("graph")) as opened:
        yield opened


@pytest.fixture
def momrec(monkeypatch, capsys):
    """Return a function that runs `momrec` in this process: exit code, stdout, stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["momrec", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capsys.readouterr()
        return SimpleNamespace(code=ended.value.code or 0, out=out, err=err)

    return run
