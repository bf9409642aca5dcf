"""Reconstruct from photographs' silhouettes and measure how much of them the mesh covers again.

With `--node` the masks are written as a bag, which is replayed, and whose messages are played to
the node's executable in a ROS graph of its own; then the meshes of both are measured as well.

    python benchmarks/photographs.py FOLDER [--slices 128] [--margin 0.25] [--figure PNG]
    . install/setup.sh
    ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=54 \
        python benchmarks/photographs.py FOLDER --node

FOLDER has a cameras.json and masks.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import numpy as np
import trimesh

from momrec_core.hull import reconstruct
from momrec_ros.bag import read_bag
from momrec_ros.bag_writer import BagWriter
from momrec_ros.cameras_json import MaskedView, read_cameras_json, read_mask
from momrec_ros.figures import draw_coverage
from momrec_ros.interfaces import decode_marker, decode_diagnostic_array
from momrec_ros.mask_coverage import mask_coverage
from momrec_ros.mask_messages import MaskRules
from momrec_ros.mcap_scan import McapScan
from momrec_ros.parameters import MARGIN
from momrec_ros.poses import matrix_from_pose

EXECUTABLE = Path("install/momrec_ros/lib/momrec_ros/recognizer")
BOUND = 0.98  # mean share of a silhouette that the mesh covers again
RATE = 10.0  # views a second
PATIENCE = 120.0  # seconds for the node's last result
STEP = 100_000_000  # nanoseconds between views
WORLD = "world"
