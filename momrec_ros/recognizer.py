"""The executable `recognizer`: the ROS 2 node, ended by a signal at any time with exit code 0."""

from __future__ import annotations

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
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # the interpreter would take long to tidy up modules, or wait for geometry
