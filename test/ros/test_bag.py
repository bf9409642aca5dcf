"""Bags written and read again, cut at every byte, damaged, foreign."""

import os
import struct
import subprocess
import sys
from io import BytesIO

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from momrec_core.camera import Camera
from momrec_core.view import View
from momrec_ros.bag import BagError, BagWriter, Rejected, StampedView, read_bag
from momrec_ros.bag_writer import METADATA_FILE
from momrec_ros.definitions import TYPE_HASHES, message_definition
from momrec_ros.interfaces import (
    Header,
    PolygonStamped,
    Pose,
    PoseStamped,
    encode_polygon_stamped,
    encode_pose_stamped,
    encode_string,
)
from momrec_ros.mcap_scan import McapScan
from momrec_ros.messages import encode_view

ARRAY = "visualization_msgs/msg/MarkerArray"
POLYGON = "geometry_msgs/msg/PolygonStamped"
POSE = "geometry_msgs/msg/PoseStamped"
STRING = "std_msgs/msg/String"
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def stamped_view(number, object_id="box"):
    camera = Camera.orthographic(np.eye(4))
    return StampedView(
        object_id, 10**9 + number, "map", View.from_rings(camera, [SQUARE + number, SQUARE * 9])
    )


def write_mcap(path, messages, compression=CompressionType.NONE, chunk_size=2000, **options):
    """Write (topic, type, log time, data) as another recorder would."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size, compression, **options)
        writer.start("ros2", "test")
        channels = {}
        for topic, type_name, log_time, data in messages:
            if topic not in channels:
                definition = message_definition(type_name).encode()
                schema = writer.register_schema(type_name, "ros2msg", definition)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()
    return path


def views_as_messages(count, topic="/contours"):
    return [(topic, ARRAY, number, encode_view(stamped_view(number))) for number in range(count)]


def stamps(events):
    return [event.stamp for event in events]


def read_all(path):
    reader = read_bag(path)
    try:
        events = list(reader)
    except BagError:
        events = []
    return events, reader.report


@pytest.fixture
def bag(tmp_path):
    path = tmp_path / "views"
    with BagWriter(path) as writer:
        for number in range(5):
            writer.write_view(stamped_view(number))
    return path


def test_views_come_back_as_they_were_written(bag):
    reader = read_bag(bag)
    events = list(reader)
    assert stamps(events) == [10**9 + number for number in range(5)]
    for number, event in enumerate(events):
        expected = stamped_view(number)
        assert (event.object_id, event.frame_id) == ("box", "map")
        assert event.view.silhouette.equals(expected.view.silhouette)
        np.testing.assert_array_equal(event.view.camera.pose, np.eye(4))
    assert reader.report.is_whole
    assert (reader.report.messages, reader.report.rejected, reader.report.notes) == (5, 0, ())
    assert reader.position == reader.size == (bag / "views_0.mcap").stat().st_size


def test_another_implementation_reads_the_folder_and_finds_the_same_values(bag):
    with Reader(bag) as reader:
        assert reader.message_count == 5
        (connection,) = reader.connections
        assert connection.digest == TYPE_HASHES[ARRAY]
        (qos,) = connection.ext.offered_qos_profiles
        assert (qos.reliability.name, qos.durability.name) == ("RELIABLE", "VOLATILE")
    mcap = bag / "views_0.mcap"
    with AnyReader([bag]) as rosbags, mcap.open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        for number, ((connection, time, raw), (_, _, message, by_mcap)) in enumerate(
            zip(rosbags.messages(), decoded, strict=True)
        ):
            by_rosbags = rosbags.deserialize(raw, connection.msgtype)
            assert time == message.log_time == 10**9 + number
            for ours, theirs in zip(by_rosbags.markers, by_mcap.markers, strict=True):
                points = [(p.x, p.y, p.z) for p in theirs.points]
                assert points == [(p.x, p.y, p.z) for p in ours.points]
                assert points[0] == points[-1]
                assert (ours.ns, ours.id, ours.type) == (theirs.ns, theirs.id, 4)
                assert theirs.scale.x > 0
                assert theirs.color.a > 0


def test_a_written_file_is_finished_with_a_summary_and_statistics(bag):
    with (bag / "views_0.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary.statistics.message_count == 5
    (channel,) = summary.channels.values()
    assert channel.metadata["topic_type_hash"] == TYPE_HASHES[ARRAY]
    (profile,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    assert profile["reliability"] == "reliable"
    (schema,) = summary.schemas.values()
    assert (schema.name, schema.encoding, channel.message_encoding) == (ARRAY, "ros2msg", "cdr")


def test_the_same_input_gives_the_same_bytes(tmp_path):
    contents = []
    for folder in ("one", "two"):
        with BagWriter(tmp_path / folder / "bag") as writer:
            writer.write_view(stamped_view(0))
        contents.append(
            [path.read_bytes() for path in sorted((tmp_path / folder / "bag").iterdir())]
        )
    assert contents[0] == contents[1]


def test_a_name_ending_in_mcap_gives_a_single_file(tmp_path):
    path = tmp_path / "views.mcap"
    with BagWriter(path) as writer:
        writer.write_view(stamped_view(3))
    assert path.is_file()
    assert stamps(read_bag(path)) == [10**9 + 3]


@pytest.mark.parametrize("name", ["bag", "bag.mcap"])
def test_an_existing_output_is_never_overwritten(tmp_path, name):
    path = tmp_path / name
    path.write_text("precious")
    with pytest.raises(FileExistsError, match="does not exist yet"), BagWriter(path):
        pass
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["bag", "bag.mcap"])
def test_a_failure_while_writing_leaves_nothing_behind(tmp_path, name):
    def write_and_fail():
        with BagWriter(tmp_path / name) as writer:
            writer.write_view(stamped_view(0))
            writer.write_view(StampedView("box", -1, "map", stamped_view(0).view))

    with pytest.raises(BagError, match="got -1"):
        write_and_fail()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("stamp", [-1, 2**31 * 10**9])
def test_a_stamp_that_no_message_can_hold_is_refused(tmp_path, stamp):
    view = StampedView("box", stamp, "map", stamped_view(0).view)
    with BagWriter(tmp_path / "bag") as writer, pytest.raises(ValueError, match="Expected"):
        writer.write_view(view)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_compression_is_read(tmp_path, compression):
    path = write_mcap(tmp_path / "a.mcap", views_as_messages(20), compression)
    events, report = read_all(path)
    assert stamps(events) == [10**9 + number for number in range(20)]
    assert report.is_whole


def test_a_file_without_chunks_is_read(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", views_as_messages(5), use_chunking=False)
    events, report = read_all(path)
    assert len(events) == 5
    assert report.is_whole


def test_messages_come_in_the_order_of_their_log_time(tmp_path):
    messages = views_as_messages(20)
    messages = [messages[place] for place in np.random.default_rng(1).permutation(20)]
    events, report = read_all(write_mcap(tmp_path / "a.mcap", messages))
    assert stamps(events) == [10**9 + number for number in range(20)]
    assert report.notes == ()


def ends_of_messages(content, count):
    """Return where the messages of an uncompressed file end, by their bytes alone."""
    data = [message[-1] for message in views_as_messages(count)]
    return [content.index(message) + len(message) for message in data]


@pytest.mark.parametrize("use_chunking", [True, False])
def test_a_file_cut_anywhere_gives_every_whole_message_before_the_cut(tmp_path, use_chunking):
    whole = write_mcap(tmp_path / "a.mcap", views_as_messages(4), use_chunking=use_chunking)
    content = whole.read_bytes()
    ends = ends_of_messages(content, 4)
    path = tmp_path / "cut.mcap"
    path.write_bytes(content)
    for cut in range(len(content) - 1, 7, -1):
        os.truncate(path, cut)
        scan = McapScan(path, lambda *_: True)
        assert len(list(scan)) == sum(end <= cut for end in ends)
        assert scan.losses
        assert 0 <= sum(loss.size for loss in scan.losses) <= cut


@pytest.mark.parametrize("use_chunking", [True, False])
def test_a_cut_bag_yields_whole_views_and_tells_what_is_lost(tmp_path, use_chunking):
    whole = write_mcap(tmp_path / "a.mcap", views_as_messages(4), use_chunking=use_chunking)
    content = whole.read_bytes()
    ends = ends_of_messages(content, 4)
    path = tmp_path / "cut.mcap"
    for cut in np.random.default_rng(0).integers(8, len(content), 60):
        path.write_bytes(content[:cut])
        events, report = read_all(path)
        assert stamps(events) == [
            10**9 + number for number in range(sum(end <= cut for end in ends))
        ]
        assert not report.is_whole


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_cut_compressed_file_gives_all_messages_of_its_whole_chunks(tmp_path, compression):
    path = write_mcap(tmp_path / "a.mcap", views_as_messages(12), compression)
    content = path.read_bytes()
    with path.open("rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
        records = StreamReader(BytesIO(content), emit_chunks=True).records
        chunks = [breakup_chunk(record) for record in records if isinstance(record, Chunk)]
    ends = np.array([index.chunk_start_offset + index.chunk_length for index in indexes])
    counts = np.array([sum(isinstance(part, Message) for part in chunk) for chunk in chunks])
    assert len(ends) > 2
    for cut in range(len(content) - 1, 7, -7):
        os.truncate(path, cut)
        scan = McapScan(path, lambda *_: True)
        times = [message.log_time for message in scan]
        assert len(times) >= counts[ends <= cut].sum()
        assert times == list(range(len(times)))
        assert scan.losses


FLIPPED = views_as_messages(6)


@given(
    flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1),
    compression=st.sampled_from(list(CompressionType)),
)
@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_flipped_bytes_raise_nothing_but_our_error(tmp_path, flips, compression):
    path = write_mcap(tmp_path / "a.mcap", FLIPPED, compression)
    content = bytearray(path.read_bytes())
    for place, change in flips:
        content[int(place * len(content))] ^= change
    path.write_bytes(content)
    try:
        reader = read_bag(path)
        assert sum(1 for _ in reader) <= 12
    except BagError as error:
        assert str(error).startswith("Expected")  # noqa: PT017 - both outcomes are right


def test_a_flipped_byte_of_a_contour_is_told(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", views_as_messages(6))
    content = bytearray(path.read_bytes())
    start = content.index(encode_view(stamped_view(2)))
    content[start + 250] ^= 1
    path.write_bytes(content)
    _, report = read_all(path)
    (loss,) = report.losses
    assert "checksum" in loss.reason


@pytest.mark.parametrize("at", range(9, 9 + 40))
def test_a_damaged_chunk_head_costs_its_chunk_only(tmp_path, at):
    path = write_mcap(tmp_path / "a.mcap", views_as_messages(12))
    with path.open("rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[1]
    content = bytearray(path.read_bytes())
    content[chunk.chunk_start_offset + at] ^= 0x55
    path.write_bytes(content)
    events, report = read_all(path)
    assert len(events) >= 8
    assert events[-1].stamp == 10**9 + 11
    is_of_use = at >= 9 + 24  # times, and the size of what is not compressed, are not needed
    assert not (is_of_use and report.is_whole)


@pytest.mark.parametrize("at", range(9))
def test_a_damaged_frame_of_a_chunk_costs_its_chunk_only(tmp_path, at):
    path = write_mcap(tmp_path / "a.mcap", views_as_messages(12))
    with path.open("rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[1]
    content = bytearray(path.read_bytes())
    content[chunk.chunk_start_offset + at] ^= 0x55
    path.write_bytes(content)
    events, report = read_all(path)
    assert len(events) >= 8
    assert events[-1].stamp == 10**9 + 11
    assert len(events) == len(set(stamps(events)))
    assert not report.is_whole


def test_a_message_that_is_no_marker_array_is_rejected_with_its_log_time(tmp_path):
    messages = views_as_messages(3)
    messages[1] = ("/contours", ARRAY, 77, b"\x00\x01\x00\x00garbage")
    events, report = read_all(write_mcap(tmp_path / "a.mcap", messages))
    assert [type(event) for event in events] == [StampedView, StampedView, Rejected]
    assert events[-1].stamp == 77
    assert (report.messages, report.rejected) == (3, 1)


def test_pairs_of_contour_and_camera_pose_are_read_per_namespace(tmp_path):
    def pair(camera, stamp):
        header = Header(stamp, "map")
        points = np.column_stack([SQUARE, np.zeros(4)]).astype(np.float32)
        polygon = encode_polygon_stamped(PolygonStamped(Header(stamp, "optical"), points))
        pose = encode_pose_stamped(PoseStamped(header, Pose((0.0, 0.0, float(stamp)))))
        yield (f"{camera}/contour", POLYGON, stamp, polygon)
        yield (f"{camera}/camera_pose", POSE, stamp, pose)

    messages = [*pair("/left", 1), *pair("/left", 2), *pair("/right", 3), *pair("/left", 4)]
    events, report = read_all(write_mcap(tmp_path / "a.mcap", messages[:-1]))
    assert stamps(events) == [1, 2, 3, 4]
    assert [event.view.camera.position[2] for event in events[:3]] == [1, 2, 3]
    assert isinstance(events[3], Rejected)
    assert "camera_pose" in events[3].text
    assert report.notes == (
        "contours on 2 topics, all of them used: /left/contour, /right/contour",
    )


def test_results_are_never_taken_as_input(tmp_path):
    messages = views_as_messages(2, "/recognizer/markers") + views_as_messages(3, "/robot/contours")
    events, report = read_all(write_mcap(tmp_path / "a.mcap", messages))
    assert len(events) == report.messages == 3


def test_a_bag_without_contours_says_what_it_has(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", [("/chatter", STRING, 0, encode_string("hi"))])
    with pytest.raises(BagError, match=r"topic named contours .* got /chatter \(std_msgs/msg/Str"):
        list(read_bag(path))


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"PK\x03\x04 an archive", b"#ROSBAG V2.0\n"])
def test_a_foreign_file_is_one_clear_error(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError, match="Expected an mcap file"):
        read_bag(path)


def test_a_path_without_a_bag_is_one_clear_error(tmp_path):
    with pytest.raises(BagError, match="readable mcap file"):
        read_bag(tmp_path / "missing")
    with pytest.raises(BagError, match="folder with mcap files"):
        read_bag(tmp_path)


def change_metadata(bag, **changes):
    path = bag / METADATA_FILE
    document = yaml.safe_load(path.read_text())
    document["rosbag2_bagfile_information"].update(changes)
    path.write_text(yaml.safe_dump(document))


@pytest.mark.parametrize(
    "name", ["../outside.mcap", "/etc/passwd", "a\x00b", "x/../../y", "n" * 9999]
)
def test_a_file_outside_the_folder_is_refused(bag, name):
    change_metadata(bag, relative_file_paths=[name])
    with pytest.raises(BagError, match="Expected"):
        read_bag(bag)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"storage_identifier": "sqlite3"}, "stored as mcap, got 'sqlite3'"),
        ({"compression_mode": "file"}, "ros2 bag convert"),
    ],
)
def test_another_kind_of_bag_is_one_clear_error(bag, changes, reason):
    change_metadata(bag, **changes)
    with pytest.raises(BagError, match=reason):
        read_bag(bag)


@pytest.mark.parametrize(
    "content",
    [None, "", "a: [", "[" * 5000, "rosbag2_bagfile_information: 3", "\x01", "a: &a [*a]"],
)
def test_a_folder_with_missing_or_damaged_metadata_is_read_and_told(bag, content):
    if content is None:
        (bag / METADATA_FILE).unlink()
    else:
        (bag / METADATA_FILE).write_text(content)
    events, report = read_all(bag)
    assert len(events) == 5
    assert METADATA_FILE in report.losses[0].reason


def test_a_missing_file_of_several_is_told(bag):
    change_metadata(bag, relative_file_paths=["views_0.mcap", "views_1.mcap"])
    events, report = read_all(bag)
    assert len(events) == 5
    assert "views_1.mcap" in report.losses[0].reason


def test_a_compressed_chunk_that_unfolds_beyond_its_size_is_not_unfolded(tmp_path):
    path = write_mcap(
        tmp_path / "a.mcap",
        [("/chatter", STRING, 0, encode_string("x" * 10**7))],
        CompressionType.ZSTD,
    )
    content = bytearray(path.read_bytes())
    size_at = content.index(struct.pack("<I", 4) + b"zstd") - 12
    content[size_at : size_at + 8] = struct.pack("<Q", 1 << 40)
    path.write_bytes(content)
    with pytest.raises(BagError, match="unfolds to 1099511627776 bytes, above"):
        list(read_bag(path))


def test_a_record_length_of_exabytes_is_only_a_loss(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", views_as_messages(3), use_chunking=False)
    content = path.read_bytes()
    at = content.index(encode_view(stamped_view(2))) - 22 - 8
    path.write_bytes(content[:at] + struct.pack("<Q", 2**63) + content[at + 8 :])
    events, report = read_all(path)
    assert len(events) == 2
    assert report.lost_bytes == len(content) - at + 1


def test_reading_and_writing_bags_needs_no_ros_and_no_plotting():
    names = [
        "bag",
        "bag_writer",
        "cdr",
        "definitions",
        "interfaces",
        "mcap_scan",
        "messages",
        "outputs",
    ]
    imports = "; ".join(f"import momrec_ros.{name}" for name in names)
    check = "import sys; sys.exit(any(name in sys.modules for name in ('rclpy', 'matplotlib')))"
    subprocess.run([sys.executable, "-c", f"{imports}; {check}"], check=True)


def test_a_stream_of_the_library_agrees_on_what_is_written(bag):
    content = BytesIO((bag / "views_0.mcap").read_bytes())
    data = [message.data for _, _, message in make_reader(content).iter_messages()]
    assert data == [encode_view(stamped_view(number)) for number in range(5)]
