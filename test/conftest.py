"""Settings of all tests: the same examples every time, ROS messages checked field by field."""

import os

from hypothesis import settings

# Before rclpy or a message is imported. Unchecked fields of a wrong type are sent as garbage.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

settings.register_profile("reproducible", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("reproducible")
