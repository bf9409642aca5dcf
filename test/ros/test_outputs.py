"""Results as messages, in a bag that two other implementations read."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from momrec_core.camera import Camera
from momrec_core.model import Recognition
from momrec_core.recognizer import Recognizer
from momrec_core.silhouette import silhouette_of_mesh
from momrec_ros.bag import BagError, BagWriter, StampedView, read_bag
from momrec_ros.interfaces import (
    Header,
    Level,
    Marker,
    MarkerAction,
    MarkerType,
    decode_diagnostic_array,
    decode_marker_array,
    decode_mesh,
    decode_pose_stamped,
    decode_string,
    encode_marker,
    encode_marker_array,
)
from momrec_ros.outputs import (
    markers_message,
    object_markers,
    removed_message,
    result_diagnostics,
    result_markers,
    result_messages,
)
from momrec_ros.session import Result

STAMP = 12_000_000_034
ORDER = ["recognition", "principal_frame", "mesh", "normalized_mesh", "label"]


def views_of_a_wedge():
    corners = [[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1], [2.4, 0, 0.3], [0.4, 1.2, 0.6]]
    mesh = trimesh.convex.convex_hull(np.add(corners, [1.0, -2.0, 0.5]))
    rng = np.random.default_rng(5)
    for _ in range(4):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        yield silhouette_of_mesh(mesh, Camera.orthographic(pose))


@pytest.fixture(scope="module")
def unnamed():
    recognizer = Recognizer(slices=16)
    for view in views_of_a_wedge():
        recognizer.add_view("part 7", view)
    recognizer.reject("part 7")
    return recognizer.result("part 7")


@pytest.fixture(scope="module")
def named(unnamed):
    ranking = (("wedge", 0.25, 0.9), ("box", 2.0, 0.1))
    recognition = Recognition("wedge", True, 0.25, 0.9, ranking, unnamed.canonical)
    return replace(unnamed, recognition=recognition)


def messages_of(result):
    return {output.name: output.data for output in result_messages(result, STAMP, "world")}


def test_the_outputs_of_a_result_go_out_in_their_order(named):
    assert [output.name for output in result_messages(named, STAMP, "world")] == ORDER


def test_the_principal_frame_is_a_stamped_pose_in_the_world(named):
    pose = decode_pose_stamped(messages_of(named)["principal_frame"])
    frame = named.canonical.principal_frame
    assert pose.header == Header(STAMP, "world")
    np.testing.assert_allclose(pose.pose.position, frame[:3, 3])
    rotation = Rotation.from_quat(pose.pose.orientation).as_matrix()
    np.testing.assert_allclose(rotation, frame[:3, :3], atol=1e-14)


def test_the_normalised_mesh_is_the_canonical_one(named):
    triangles, vertices = decode_mesh(messages_of(named)["normalized_mesh"])
    np.testing.assert_array_equal(triangles, named.canonical.mesh.faces)
    np.testing.assert_array_equal(vertices, named.canonical.mesh.vertices)


def test_the_label_is_just_the_label(named, unnamed):
    assert decode_string(messages_of(named)["label"]) == "wedge"
    assert decode_string(messages_of(unnamed)["label"]) == "unknown"


def test_the_verdict_comes_first_and_the_hypotheses_follow_best_first(named):
    diagnostics = decode_diagnostic_array(messages_of(named)["recognition"])
    verdict, *hypotheses = diagnostics.status
    assert diagnostics.header == Header(STAMP, "world")
    assert [status.name for status in hypotheses] == ["wedge", "box"]
    assert {status.hardware_id for status in diagnostics.status} == {"part 7"}
    assert dict(hypotheses[1].values) == {"score": "0.1", "distance": "2"}
    assert verdict.name == "wedge"
    values = dict(verdict.values)
    assert (values["score"], values["distance"]) == ("0.9", "0.25")
    assert (values["views"], values["slices"], values["rejected_views"]) == ("4", "16", "1")
    assert values["contradicting_views"] == "0"
    assert float(values["coverage_mean"]) >= float(values["coverage_worst"]) > 0.9
    assert float(values["area"]) == pytest.approx(named.mesh.area, rel=1e-8)
    assert float(values["volume"]) == pytest.approx(named.mesh.volume, rel=1e-8)
    assert float(values["scale"]) == pytest.approx(named.canonical.scale, rel=1e-8)
    position = [float(number) for number in values["position"].strip("[]").split(", ")]
    np.testing.assert_allclose(position, named.canonical.principal_frame[:3, 3], rtol=1e-8)
    assert len(values["orientation"].split(", ")) == 4
    assert values["unique_frame"] == str(named.canonical.is_unique).lower()


def test_views_that_contradict_others_are_told_and_those_left_in_are_a_warning(named):
    header = Header(STAMP, "world")
    left_out = replace(named, left_out=(named.hull.views[0],))
    spoiled = replace(named, coverage=np.array([1.0, 0.5, 1.0]))
    unique = replace(named.canonical, is_unique=True)
    first, second = (
        result_diagnostics(replace(result, canonical=unique), header).status[0]
        for result in (left_out, spoiled)
    )
    assert dict(first.values)["contradicting_views"] == "1"
    assert "views left out that contradict the others: 1" in first.message
    assert first.level == Level.OK
    assert dict(second.values)["coverage_worst"] == "0.5"
    assert "50% of one silhouette is explained" in second.message
    assert second.level == Level.WARN


@pytest.mark.parametrize(
    ("known", "unique", "level"), [(True, True, "OK"), (True, False, "WARN"), (False, True, "WARN")]
)
def test_an_unknown_object_and_an_ambiguous_frame_are_warnings(named, known, unique, level):
    canonical = replace(named.canonical, is_unique=unique)
    label = "wedge" if known else "unknown"
    recognition = replace(named.recognition, known=known, label=label)
    result = replace(named, canonical=canonical, recognition=recognition)
    verdict = result_diagnostics(result, Header(STAMP, "world")).status[0]
    assert (verdict.level, verdict.name) == (Level[level], label)


def test_a_result_without_a_model_is_a_warning_without_hypotheses(unnamed):
    (verdict,) = result_diagnostics(unnamed, Header(STAMP, "world")).status
    assert (verdict.level, verdict.name) == (Level.WARN, "unknown")
    assert "no model" in verdict.message


def test_people_see_mesh_axes_label_and_every_contour_where_it_was_seen(named):
    mesh, axes, label, *contours = result_markers(named, Header(STAMP, "world"))
    assert (mesh.type, len(mesh.points)) == (MarkerType.TRIANGLE_LIST, 3 * len(named.mesh.faces))
    assert mesh.pose == axes.pose
    assert (axes.type, len(axes.points), len(axes.colors)) == (MarkerType.LINE_LIST, 6, 6)
    assert label.text == "wedge 0.90"
    assert len(contours) == sum(len(view.rings) for view in named.hull.views) == 4
    identities = {(marker.ns, marker.id) for marker in (mesh, axes, label, *contours)}
    assert len(identities) == 7


def test_of_very_many_views_evenly_chosen_ones_are_shown(named):
    hull = copy(named.hull)
    hull.views = [named.hull.views[0]] * 120
    _, _, _, *contours = result_markers(replace(named, hull=hull), Header(STAMP, "world"))
    assert 30 <= len(contours) <= 50


@pytest.mark.parametrize("clear", [None, Header(STAMP + 9, "world")])
def test_the_markers_of_all_objects_are_one_message_that_may_clear_the_display(named, clear):
    other = replace(named, object_id="another one")
    results = [Result(named, STAMP, "world"), Result(other, STAMP + 7, "world")]
    output = markers_message([object_markers(result) for result in results], clear=clear)
    markers = [
        *([] if clear is None else [Marker(clear, action=MarkerAction.DELETEALL)]),
        *result_markers(named, Header(STAMP, "world")),
        *result_markers(other, Header(STAMP + 7, "world")),
    ]
    assert (output.name, output.type_name) == ("markers", "visualization_msgs/msg/MarkerArray")
    assert output.data == encode_marker_array(markers)


def test_without_objects_the_markers_only_clear_the_display():
    header = Header(STAMP, "world")
    (marker,) = decode_marker_array(markers_message([], clear=header).data)
    assert (marker.header, marker.action, marker.ns) == (header, MarkerAction.DELETEALL, "")
    assert decode_marker_array(markers_message([]).data) == ()


def test_a_removed_object_takes_its_mesh_from_the_displays(named):
    output = removed_message(named.object_id, STAMP, "world")
    assert (output.name, output.type_name) == ("mesh", "visualization_msgs/msg/Marker")
    removed = Marker(Header(STAMP, "world"), "part 7", 0, action=MarkerAction.DELETE)
    assert output.data == encode_marker(removed)


def test_a_result_bag_is_read_by_two_other_implementations_with_equal_values(named, tmp_path):
    path = tmp_path / "results"
    with BagWriter(path) as bag:
        for number, view in enumerate(named.hull.views):
            bag.write_view(StampedView("part 7", STAMP + number, "world", view))
        bag.write_result(named, STAMP + 3, "world")
    by_mcap = {}
    with (path / "results_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            by_mcap[channel.topic] = message
    by_rosbags = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            by_rosbags[connection.topic] = reader.deserialize(raw, connection.msgtype)
    topics = {f"/recognizer/{name}" for name in (*ORDER, "markers")}
    assert set(by_mcap) == set(by_rosbags) == {"/contours", *topics}
    triangles = named.mesh.vertices[named.mesh.faces].reshape(-1, 3)
    for found in (by_mcap, by_rosbags):
        mesh = found["/recognizer/mesh"]
        assert (mesh.ns, mesh.id, mesh.type, mesh.text) == ("part 7", 0, 11, "wedge")
        assert (mesh.scale.x, mesh.scale.y, mesh.scale.z, mesh.color.a) == (1, 1, 1, 1)
        stamp = mesh.header.stamp
        assert (stamp.sec, stamp.nanosec, mesh.header.frame_id) == (12, 37, "world")
        orientation, position = mesh.pose.orientation, mesh.pose.position
        turn = Rotation.from_quat([orientation.x, orientation.y, orientation.z, orientation.w])
        points = turn.apply([(point.x, point.y, point.z) for point in mesh.points])
        points += [position.x, position.y, position.z]
        np.testing.assert_allclose(points, triangles, atol=1e-12)
        canonical = found["/recognizer/normalized_mesh"]
        vertices = [(point.x, point.y, point.z) for point in canonical.vertices]
        np.testing.assert_array_equal(vertices, named.canonical.mesh.vertices)
        faces = [list(triangle.vertex_indices) for triangle in canonical.triangles]
        np.testing.assert_array_equal(faces, named.canonical.mesh.faces)
        assert found["/recognizer/label"].data == "wedge"
        verdict = found["/recognizer/recognition"].status[0]
        assert (verdict.name, verdict.hardware_id) == ("wedge", "part 7")


def test_a_result_bag_without_contours_is_not_taken_as_input(named, tmp_path):
    with BagWriter(tmp_path / "results") as bag:
        bag.write_result(named, STAMP, "world")
    with pytest.raises(BagError, match="/recognizer/markers"):
        list(read_bag(tmp_path / "results"))
