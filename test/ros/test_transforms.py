"""Principal frames as transforms, against rosbags' type store, scipy and mcap_ros2."""

from functools import cache

import numpy as np
import pytest
import trimesh
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from momrec_core import Recognizer
from momrec_core.simulation import simulate_views
from momrec_ros.session import NANOSECONDS, Result
from momrec_ros.transforms import TRANSFORMS_TYPE, transform_message

STORE = get_typestore(Stores.ROS2_JAZZY)
STAMP = 12 * NANOSECONDS + 34


@cache
def result(object_id):
    recognizer = Recognizer(slices=8)
    for view in simulate_views(trimesh.creation.box((1, 2, 3)), 4, np.random.default_rng(1)):
        recognizer.add_view(object_id, view)
    return recognizer.result(object_id)


def by_rosbags(data):
    return STORE.deserialize_cdr(data, TRANSFORMS_TYPE)


def by_mcap_ros2(data):
    definition, _ = STORE.generate_msgdef(TRANSFORMS_TYPE, ros_version=2)
    schema = Schema(id=1, name=TRANSFORMS_TYPE, encoding="ros2msg", data=definition.encode())
    return DecoderFactory().decoder_for("cdr", schema)(data)


@pytest.mark.parametrize("decode", [by_rosbags, by_mcap_ros2])
@pytest.mark.parametrize(("object_id", "child"), [("cup", "robot/cup"), ("", "robot/object")])
def test_the_transform_takes_points_of_the_principal_frame_to_the_world(decode, object_id, child):
    output = transform_message(Result(result(object_id), STAMP, "map"), "robot")
    assert (output.name, output.type_name) == ("tf", TRANSFORMS_TYPE)
    (stamped,) = decode(output.data).transforms
    assert (stamped.header.stamp.sec, stamped.header.stamp.nanosec) == (12, 34)
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", child)
    turn, shift = stamped.transform.rotation, stamped.transform.translation
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    found[:3, 3] = shift.x, shift.y, shift.z
    np.testing.assert_allclose(found, result(object_id).canonical.principal_frame, atol=1e-12)
