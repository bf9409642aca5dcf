"""Definitions and type hashes against the type store of rosbags."""

import pytest
from rosbags.typesys import Stores, get_typestore

from momrec_ros.definitions import TYPE_HASHES, message_definition

JAZZY = get_typestore(Stores.ROS2_JAZZY)


@pytest.mark.parametrize("name", sorted(TYPE_HASHES))
def test_a_type_hash_is_that_of_jazzy(name):
    assert TYPE_HASHES[name] == JAZZY.hash_rihs01(name)


@pytest.mark.parametrize("name", sorted(TYPE_HASHES))
def test_a_definition_is_that_of_jazzy(name):
    assert message_definition(name).strip() == JAZZY.generate_msgdef(name, ros_version=2)[0].strip()


def test_an_unknown_type_has_no_definition():
    with pytest.raises(KeyError):
        message_definition("sensor_msgs/msg/PointCloud2")
