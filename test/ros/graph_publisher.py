"""A publisher in a process of its own: serialised messages from stdin go into the graph.

Each line of stdin is a JSON object (topic, type, reliability, listeners, size), followed by `size`
bytes. The message is published once exactly so many listeners are matched (null: at once); then
one line is answered. A size of -1 publishes nothing.
"""

import json
import sys
from contextlib import suppress
from importlib import import_module

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import QoSProfile, ReliabilityPolicy

DEPTH = 1000


def message_type(name):
    package, _, kind = name.split("/")
    return getattr(import_module(f"{package}.msg"), kind)


def main():
    rclpy.init()
    node = rclpy.create_node("publisher")
    publishers = {}
    source = sys.stdin.buffer
    for line in iter(source.readline, b""):
        command = json.loads(line)
        key = command["topic"], command["type"], command["reliability"]
        if key not in publishers:
            qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy[key[2].upper()])
            publishers[key] = node.create_publisher(message_type(key[1]), key[0], qos)
        while command["listeners"] not in (None, publishers[key].get_subscription_count()):
            rclpy.spin_once(node, timeout_sec=0.02)
        if command["size"] >= 0:
            publishers[key].publish(source.read(command["size"]))
        sys.stdout.write("done\n")
        sys.stdout.flush()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        main()
