"""A listener in a process of its own: answers one line when its first result has come."""

import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from visualization_msgs.msg import Marker


def main():
    rclpy.init()
    node = rclpy.create_node("other_listener")
    qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    lines = iter(["got a result\n"])
    node.create_subscription(
        Marker, "/recognizer/mesh", lambda _: sys.stderr.write(next(lines, "")), qos, raw=True
    )
    rclpy.spin(node)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        main()
