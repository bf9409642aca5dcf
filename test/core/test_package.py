"""The package's names: complete, and each loads what it needs only."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import momrec_core

REPOSITORY = Path(__file__).parents[2]


def modules_after(program: str) -> set[str]:
    """Run a program in a fresh interpreter and return the packages that it has loaded."""
    report = f"{program}\nimport sys\nprint(*sys.modules, sep='\\n')"
    done = subprocess.run(
        [sys.executable, "-c", report], cwd=REPOSITORY, check=True, capture_output=True, text=True
    )
    return {name.partition(".")[0] for name in done.stdout.split()}


def test_every_public_name_is_there_and_listed() -> None:
    assert set(momrec_core.__all__) == set(momrec_core.MODULES) <= set(dir(momrec_core))
    for name in momrec_core.__all__:
        assert getattr(momrec_core, name).__name__ == name


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Kamera'"):
        _ = momrec_core.Kamera


def test_importing_the_package_loads_none_of_its_dependencies() -> None:
    heavy = {"numpy", "scipy", "sklearn", "shapely", "trimesh"}
    assert not modules_after("import momrec_core") & heavy


def test_recognising_needs_no_scikit_learn() -> None:
    loaded = modules_after(
        "import trimesh\n"
        "from momrec_core import Recognizer, load_model\n"
        "Recognizer(load_model('models/ten_objects.json'))\n"
        "mesh = trimesh.load('meshes/ten_objects/castle.ply', process=False)\n"
        "load_model('models/ten_objects.json').recognize(mesh)\n"
    )
    assert "trimesh" in loaded
    assert "sklearn" not in loaded
