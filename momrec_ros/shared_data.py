"""Where the files that momrec ships are: in the source tree, or installed by pip or colcon."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

__all__ = ["shared_path"]

PACKAGE = "momrec_ros"


def shared_path(relative: str) -> Path:
    """Return a shipped file or folder.

    Parameters
    ----------
    relative : str
        Within the source tree, for instance ``"models/ten_objects.json"``.

    Returns
    -------
    path : Path
        Of the first place that has it: the source tree that this module is part of, the
        prefixes that ROS looks in, the prefix of this Python.

    Raises
    ------
    FileNotFoundError
        If no place has it.
    """
    for root in _roots():
        if (root / relative).exists():
            return root / relative
    raise FileNotFoundError(
        f"Expected momrec's {relative} in one of {', '.join(map(str, _roots()))}"
    )


def _roots() -> Iterator[Path]:
    tree = Path(__file__).resolve().parent.parent
    if (tree / "package.xml").exists():
        yield tree
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / PACKAGE
    yield Path(sys.prefix) / "share" / PACKAGE
