"""The executable `recognizer`: the ROS 2 node, ended by a signal at any time with exit code 0."""

from __future__ import annotations

import gc
import os
import signal
import sys

__all__ = ["main"]


def main() -> None:
    """Run the node until a signal comes."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))  # loading modules leaves nothing to tidy
    from momrec_ros.node import run  # noqa: PLC0415

    code = run()
    gc.freeze()  # else the interpreter's end takes a third of a second, looking at all modules
    sys.exit(code)
