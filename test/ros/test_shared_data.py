"""Shipped files are found in the source tree and where ROS looks."""

import sys

import pytest

from momrec_ros.shared_data import shared_path


def test_the_source_tree_comes_first():
    assert shared_path("meshes/stranger.ply").is_file()


def test_the_prefixes_of_ros_and_of_python_are_searched(tmp_path, monkeypatch):
    for number, prefix in enumerate(("ament", "python")):
        share = tmp_path / prefix / "share" / "momrec_ros"
        share.mkdir(parents=True)
        (share / f"{prefix}.txt").write_text(str(number))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'none'}:{tmp_path / 'ament'}")
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "python"))
    assert shared_path("ament.txt").read_text() == "0"
    assert shared_path("python.txt").read_text() == "1"


def test_what_is_nowhere_is_an_error_that_names_the_places():
    with pytest.raises(FileNotFoundError, match=r"no such thing in one of .*share/momrec_ros"):
        shared_path("no such thing")
