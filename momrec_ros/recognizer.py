"""The executable `recognizer`: the ROS 2 node, ended by a signal at any time with exit code 0."""

from __future__ import annotations

import os
import signal
import sys

__all__ = ["main"]

USAGE = """\
recognizer: ROS 2 life cycle node that turns contours into meshes, principal frames and labels
usage: recognizer [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]
Parameters, topics and services are listed in momrec's README and config/recognizer.yaml.
"""


def main() -> None:
    """Run the node until a signal comes."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        sys.stdout.write(USAGE)
        return
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))  # loading modules leaves nothing to tidy
    from momrec_ros.node import run  # noqa: PLC0415

    code = run()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # the interpreter would take long to tidy up modules, or wait for geometry
