"""Detections against the definitions of vision_msgs, read and written by mcap_ros2 and rosbags."""

from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from momrec_core import Recognizer
from momrec_core.model import Recognition
from momrec_core.recognizer import ObjectResult
from momrec_core.simulation import simulate_views
from momrec_ros import interfaces
from momrec_ros.definitions import message_definition
from momrec_ros.detections import DETECTIONS_TYPE, detection_array
from momrec_ros.errors import CdrError
from momrec_ros.interfaces import (
    BoundingBox3D,
    Detection3D,
    Detection3DArray,
    Header,
    ObjectHypothesisWithPose,
    Pose,
    decode_detection_array,
    encode_detection_array,
)
from momrec_ros.session import Result

# The messages of vision_msgs 4.1.1, and the one of geometry_msgs that only they use.
VISION_MSGS = {
    "vision_msgs/msg/Detection3DArray": """\
std_msgs/Header header
vision_msgs/Detection3D[] detections
""",
    "vision_msgs/msg/Detection3D": """\
std_msgs/Header header
vision_msgs/ObjectHypothesisWithPose[] results
vision_msgs/BoundingBox3D bbox
string id
""",
    "vision_msgs/msg/ObjectHypothesisWithPose": """\
vision_msgs/ObjectHypothesis hypothesis
geometry_msgs/PoseWithCovariance pose
""",
    "vision_msgs/msg/ObjectHypothesis": """\
string class_id
float64 score
""",
    "vision_msgs/msg/BoundingBox3D": """\
geometry_msgs/Pose center
geometry_msgs/Vector3 size
""",
    "geometry_msgs/msg/PoseWithCovariance": """\
geometry_msgs/Pose pose
float64[36] covariance
""",
}

text = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=9)
number = st.floats(allow_nan=False)
headers = st.builds(Header, st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1), text)
poses = st.builds(Pose, st.tuples(*[number] * 3), st.tuples(*[number] * 4))
hypotheses = st.builds(
    ObjectHypothesisWithPose,
    text,
    number,
    poses,
    st.lists(number, min_size=36, max_size=36).map(tuple),
)
detections = st.builds(
    Detection3D,
    headers,
    st.lists(hypotheses, max_size=2).map(tuple),
    st.builds(BoundingBox3D, poses, st.tuples(*[number] * 3)),
    text,
)
arrays = st.builds(Detection3DArray, headers, st.lists(detections, max_size=3).map(tuple))


@cache
def rosbags_store():
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, definition in VISION_MSGS.items():
        store.register(get_types_from_msg(definition, name))
    return store


@cache
def mcap_ros2_decoder():
    inside = dict(VISION_MSGS)
    top = inside.pop(DETECTIONS_TYPE)
    vector = "float64 x\nfloat64 y\nfloat64 z\n"
    parts = [f"MSG: {name.replace('/msg/', '/')}\n{body}" for name, body in inside.items()]
    parts.append(f"MSG: geometry_msgs/Vector3\n{vector}")
    pose_stamped = message_definition("geometry_msgs/msg/PoseStamped")
    parts += pose_stamped.split("=" * 80 + "\n")[1:]  # Header, Time, Pose and what is inside it
    definition = ("=" * 80 + "\n").join([top, *parts])
    schema = Schema(id=1, name=DETECTIONS_TYPE, encoding="ros2msg", data=definition.encode())
    return DecoderFactory().decoder_for("cdr", schema)


def plain_pose(pose):
    position, orientation = pose.position, pose.orientation
    return Pose(
        (position.x, position.y, position.z),
        (orientation.x, orientation.y, orientation.z, orientation.w),
    )


def plain_header(header):
    return Header(header.stamp.sec * 10**9 + header.stamp.nanosec, header.frame_id)


def plain_detection(detection):
    return Detection3D(
        plain_header(detection.header),
        tuple(
            ObjectHypothesisWithPose(
                result.hypothesis.class_id,
                result.hypothesis.score,
                plain_pose(result.pose.pose),
                tuple(np.asarray(result.pose.covariance).tolist()),
            )
            for result in detection.results
        ),
        BoundingBox3D(
            plain_pose(detection.bbox.center),
            (detection.bbox.size.x, detection.bbox.size.y, detection.bbox.size.z),
        ),
        detection.id,
    )


def plain_array(array):
    """Return what another library decoded as our own values."""
    return Detection3DArray(
        plain_header(array.header), tuple(plain_detection(item) for item in array.detections)
    )


@given(arrays)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_detections_are_read_alike_by_mcap_ros2_and_rosbags_and_come_back(array):
    data = encode_detection_array(array)
    theirs = rosbags_store().deserialize_cdr(data, DETECTIONS_TYPE)
    assert plain_array(theirs) == array
    assert bytes(rosbags_store().serialize_cdr(theirs, DETECTIONS_TYPE)) == data
    assert plain_array(mcap_ros2_decoder()(data)) == array
    assert decode_detection_array(data) == array


def test_every_truncation_of_detections_is_refused():
    hypothesis = ObjectHypothesisWithPose("cup", 0.5)
    array = Detection3DArray(detections=(Detection3D(results=(hypothesis,), id="a"),) * 2)
    data = encode_detection_array(array)
    for length in range(len(data)):
        with pytest.raises(CdrError, match="Expected"):
            decode_detection_array(data[:length])


def test_the_smallest_sizes_of_items_judge_no_true_message_wrongly():
    empty = encode_detection_array(Detection3DArray())
    nothing = Detection3DArray(detections=(Detection3D(),))
    assert len(encode_detection_array(nothing)) - len(empty) >= interfaces.SMALLEST_DETECTION
    hypothesis = Detection3D(results=(ObjectHypothesisWithPose(),))
    longer = encode_detection_array(Detection3DArray(detections=(hypothesis,)))
    grown = len(longer) - len(encode_detection_array(nothing))
    assert grown >= interfaces.SMALLEST_HYPOTHESIS
    for data in (encode_detection_array(nothing), longer):
        assert encode_detection_array(decode_detection_array(data)) == data


@pytest.mark.parametrize("covariance", [(), (0.0,) * 35, (0.0,) * 37])
def test_a_covariance_of_another_size_is_refused(covariance):
    hypothesis = ObjectHypothesisWithPose(covariance=covariance)
    array = Detection3DArray(detections=(Detection3D(results=(hypothesis,)),))
    with pytest.raises(CdrError, match="Expected values that fit '44d'"):
        encode_detection_array(array)


@cache
def reconstructed():
    """Return what twelve views say of a cone that lies somewhere, without a model."""
    solid = trimesh.creation.cone(0.2, 0.5)
    solid.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (0.4, 0.1, 0)))
    recognizer = Recognizer(slices=24)
    for view in simulate_views(solid, 12, np.random.default_rng(5)):
        recognizer.add_view("cone", view)
    return recognizer.result("cone")


def judged(result, *, known):
    ranking = (("cone", 0.5, 0.4), ("cylinder", 2.0, 0.1))
    label, score = ("cone", 0.4) if known else ("unknown", 0.8)
    recognition = Recognition(label, known, 0.5, score, ranking, result.canonical)
    return ObjectResult(
        result.object_id,
        result.mesh,
        result.canonical,
        recognition,
        result.hull,
        rejected_views=0,
        coverage=result.coverage,
        left_out=(),
    )


@pytest.mark.parametrize(
    ("known", "expected"),
    [
        (True, [("cone", 0.4), ("cylinder", 0.1)]),
        (False, [("unknown", 0.8), ("cone", 0.4), ("cylinder", 0.1)]),
    ],
)
def test_the_first_hypothesis_is_the_verdict_and_the_ranking_follows(known, expected):
    result = judged(reconstructed(), known=known)
    (detection,) = detection_array([Result(result, 5, "map")]).detections
    assert [(item.class_id, item.score) for item in detection.results] == expected
    assert detection.id == "cone"


def test_without_a_model_the_only_hypothesis_is_unknown_with_score_zero():
    (detection,) = detection_array([Result(reconstructed(), 5, "map")]).detections
    assert [(item.class_id, item.score) for item in detection.results] == [("unknown", 0.0)]


def matrix(pose):
    x, y, z, w = pose.orientation
    transform = trimesh.transformations.quaternion_matrix([w, x, y, z])
    transform[:3, 3] = pose.position
    return transform


def test_the_box_has_the_principal_axes_and_touches_the_mesh_on_all_six_sides():
    result = reconstructed()
    (detection,) = detection_array([Result(result, 5, "map")]).detections
    box = detection.bbox
    in_box = trimesh.transform_points(result.mesh.vertices, np.linalg.inv(matrix(box.center)))
    np.testing.assert_allclose(in_box.max(axis=0), 0.5 * np.array(box.size), atol=1e-9)
    np.testing.assert_allclose(in_box.min(axis=0), -0.5 * np.array(box.size), atol=1e-9)
    assert box.center.orientation == detection.results[0].pose.orientation
    assert np.argmax(box.size) == 2  # the cone's axis, z of the principal frame


def test_every_hypothesis_has_the_principal_frame_of_unknown_covariance():
    result = judged(reconstructed(), known=True)
    (detection,) = detection_array([Result(result, 5, "map")]).detections
    for hypothesis in detection.results:
        np.testing.assert_allclose(
            matrix(hypothesis.pose), result.canonical.principal_frame, atol=1e-12
        )
        assert set(hypothesis.covariance) == {0.0}


def test_the_array_is_stamped_as_the_newest_and_each_detection_as_its_own():
    stamps = (7_000_000_001, 9_000_000_002, 8_000_000_003)
    array = detection_array([Result(reconstructed(), stamp, "map") for stamp in stamps])
    assert array.header == Header(max(stamps), "map")
    assert [item.header for item in array.detections] == [Header(stamp, "map") for stamp in stamps]
    assert decode_detection_array(encode_detection_array(array)) == array


def test_without_results_the_array_is_empty_and_has_the_given_header():
    assert detection_array([]) == Detection3DArray()
    header = Header(3, "map")
    assert detection_array([], header) == Detection3DArray(header)
