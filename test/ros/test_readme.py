"""What the README says is true."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from momrec_ros.bag import read_bag
from momrec_ros.errors import Reason
from momrec_ros.outputs import RESULT_TYPES
from momrec_ros.parameters import NODE_PARAMETERS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def python_of_readme():
    return re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_the_library_in_ten_lines_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "models").symlink_to(ROOT / "models")
    monkeypatch.chdir(tmp_path)
    code, *_ = python_of_readme()
    exec(compile(code, "README.md", "exec"), {})  # noqa: S102
    label, volume, _ = capsys.readouterr().out.split()
    assert label == "unknown"
    polygon = 16 * 0.1**2 * np.tan(np.pi / 16)  # eight strips around a circle
    assert float(volume) == pytest.approx(0.4 * polygon, rel=0.01)
    assert (tmp_path / "part.ply").is_file()


def test_a_mask_becomes_a_view_with_the_lens_undone():
    _, code, *_ = python_of_readme()
    mask = np.zeros((480, 640), dtype=bool)
    mask[100:300, 200:400] = True
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    names = {"K": K, "mask": mask, "pose": np.eye(4)}
    exec(compile(code, "README.md", "exec"), names)  # noqa: S102
    area = names["view"].silhouette.area
    assert 1.02 * mask.sum() < area < 1.05 * mask.sum()  # a barrel's image is too small


def test_the_shipped_bag_is_what_the_command_makes(tmp_path):
    (command,) = re.findall(r"    momrec (simulate \S.* --output bags/ten_objects.*)", README)
    command = command.replace("bags/ten_objects", str(tmp_path / "bag"))
    words = [
        str(path)
        for word in shlex.split(command)
        for path in (sorted(ROOT.glob(word)) if word.endswith(".ply") else [word])
    ]
    momrec = Path(sys.executable).with_name("momrec")
    subprocess.run([momrec, *words], check=True, capture_output=True)
    made, shipped = read_bag(tmp_path / "bag"), read_bag(ROOT / "bags" / "ten_objects")
    for one, other in zip(made, shipped, strict=True):
        assert (one.object_id, one.stamp) == (other.object_id, other.stamp)
        np.testing.assert_allclose(one.view.camera.pose, other.view.camera.pose, atol=1e-12)
        difference = one.view.silhouette.symmetric_difference(other.view.silhouette)
        assert difference.area < 1e-6 * one.view.silhouette.area


def test_every_command_is_in_the_readme():
    for name in ("demo", "replay", "simulate", "train", "learn", "reconstruct", "experiment"):
        assert f"    momrec {name}" in README


@pytest.mark.parametrize("parameter", NODE_PARAMETERS, ids=lambda parameter: parameter.name)
def test_every_parameter_of_the_node_is_in_the_readme(parameter):
    kind = ": ".join(filter(None, (parameter.type_name, parameter.allowed)))
    default = json.dumps(parameter.default)
    row = f"| `{parameter.name}` | {kind} | `{default}` | {parameter.description}"
    assert row in README


def test_the_parameter_file_has_every_parameter_with_its_default_and_meaning():
    text = (ROOT / "config" / "recognizer.yaml").read_text()
    (node,) = yaml.safe_load(text).values()
    assert node["ros__parameters"] == {
        parameter.name: parameter.default for parameter in NODE_PARAMETERS
    }
    for parameter in NODE_PARAMETERS:
        assert f"    # {parameter.description}\n" in text


def test_every_reason_and_every_output_is_in_the_readme():
    for reason in Reason:
        assert re.search(rf"^\|.*`{reason}`.*\|", README, re.MULTILINE)
    for name, type_name in RESULT_TYPES.items():
        assert f"| `~/{name}` | {type_name.replace('/msg', '')} |" in README


def test_the_picture_is_there_and_small():
    (picture,) = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert 0 < (ROOT / picture).stat().st_size < 300_000
