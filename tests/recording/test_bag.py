import io
import itertools
import shutil
import sqlite3
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from airpuck.boundary.errors import InputError
from airpuck.recording.bag import BagFile, read_bag, write_bag
from airpuck.recording.mapping import PoseMapping, RecordingMapping, Topics
from airpuck.recording.message import HOLOHOVER_MOTORS, StreamCodec
from airpuck.recording.read import read_recording
from airpuck.recording.stream import COLUMNS, POSES, Recording, Stream

from ..apparatus.bags import (
    COMMAND_TEXT,
    COMMAND_TYPE,
    HEADER,
    POSE_TEXT,
    POSE_TYPE,
    SIX,
    START_NS,
    flight,
    foreign_topics,
    ros1_bag,
    rosbags_folder,
    stamped,
    stream,
    write_channels,
    write_mcap,
)
from ..apparatus.refusals import rejected


@pytest.fixture
def topics():
    return foreign_topics()


def poses_of(folder: Path, topics, messages, msgtype: str = POSE_TYPE, text: str = POSE_TEXT):
    """The poses in messages that the recorder got one after the other."""
    timed = [(START_NS + k, message) for k, message in enumerate(messages)]
    topics["/optitrack/drone/pose"] = (msgtype, text, timed)
    return read_recording(write_mcap(folder / "a.mcap", topics))["pose"]


def assert_is_foreign(recording, topics):
    poses = topics["/optitrack/drone/pose"][2]
    assert recording["pose"].received_ns.tolist() == [received for received, _ in poses]
    assert recording["pose"].stamp_ns.tolist() == [
        START_NS + i * 4_166_667 for i in range(len(poses))
    ]
    numbers = np.array([np.frombuffer(message[-56:], "<f8") for _, message in poses])
    assert np.array_equal(recording["pose"].values[:, :2], numbers[:, :2])
    yaw = 2 * np.arctan2(numbers[:, 5], numbers[:, 6])
    assert np.abs(recording["pose"].values[:, 2] - yaw).max() < 1e-15
    commands = topics["/drone/control"][2]
    assert recording["command"].columns == SIX
    assert np.array_equal(
        recording["command"].values,
        [np.frombuffer(message[-48:], "<f8") for _, message in commands],
    )
    assert recording["command"].stamp_ns[3] == START_NS + 3 * 10**7


@pytest.mark.parametrize("suffix", [".mcap", ".db3", ".bag"])
def test_an_empty_file_is_reported_as_empty(tmp_path: Path, suffix: str):
    (tmp_path / f"a{suffix}").touch()
    with pytest.raises(InputError, match=rf"a{suffix}: is empty"):
        read_recording(tmp_path / f"a{suffix}")


BARE = ("chunking", "statistics", "summary_offsets")


@pytest.mark.parametrize(
    "options",
    [
        *({"compression": compression} for compression in CompressionType),
        {f"use_{part}": False for part in BARE} | {"repeat_channels": False},
    ],
)
def test_a_bare_mcap_file_of_another_writer_is_read(tmp_path: Path, topics, options):
    path = write_mcap(tmp_path / "flight.mcap", topics, **options)
    recording = read_recording(path)
    assert_is_foreign(recording, topics)
    assert set(recording.streams) == {"pose", "command"}
    assert recording.warnings == ()
    assert recording.source == str(path)
    assert set(recording.hashes) == {"flight.mcap"}


def test_a_folder_without_metadata_or_with_split_files_is_read(tmp_path: Path, topics):
    whole = read_recording(write_mcap(tmp_path / "whole.mcap", topics))
    folder = tmp_path / "bag"
    folder.mkdir()
    # Twelve files, so that sorting by name would put 10 before 2.
    edges = np.linspace(START_NS, START_NS + 4 * 10**9 + 10**8, 13)
    for index, (first, last) in enumerate(itertools.pairwise(edges)):
        part = {
            name: (msgtype, text, [item for item in messages if first <= item[0] < last])
            for name, (msgtype, text, messages) in topics.items()
        }
        write_mcap(folder / f"flight_{index}.mcap", part)
    recording = read_recording(folder)
    assert recording.streams == whole.streams
    assert len(recording.hashes) == 12


def assert_is_rosbags(recording):
    assert recording["pose"].stamp_ns.tolist() == [10**9 * (100 + i) + 5 for i in range(5)]
    assert recording["pose"].received_ns.tolist() == [10**9 * (200 + i) for i in range(5)]
    assert recording["pose"].values[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert recording["pose"].values[:, 2] == pytest.approx(0.3, abs=1e-15)
    assert np.array_equal(recording["command"].values, np.tile(0.1 * np.arange(6), (5, 1)))


@pytest.mark.parametrize(
    ("version", "change"), [(8, "VACUUM"), (9, "VACUUM"), (9, "DELETE FROM message_definitions")]
)
def test_a_sqlite_folder_is_read(tmp_path: Path, version: int, change: str):
    rosbags_folder(tmp_path / "bag", version=version)
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as database:
        database.execute(change)
    recording = read_recording(tmp_path / "bag")
    assert_is_rosbags(recording)
    assert set(recording.hashes) == {"bag.db3", "metadata.yaml"}
    assert_is_rosbags(read_recording(tmp_path / "bag" / "bag.db3"))


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_compressed_sqlite_folders_are_read(tmp_path: Path, mode: str):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode

    rosbags_folder(tmp_path / "bag", compress=(CompressionMode[mode], CompressionFormat.ZSTD))
    assert_is_rosbags(read_recording(tmp_path / "bag"))


def test_folders_can_be_moved_and_renamed(tmp_path: Path):
    rosbags_folder(tmp_path / "bag", plugin=StoragePlugin.MCAP)
    shutil.move(tmp_path / "bag", tmp_path / "elsewhere")
    assert_is_rosbags(read_recording(tmp_path / "elsewhere"))


def test_other_topics_can_be_named(tmp_path: Path, topics):
    moved = {
        {"/drone/control": "/craft/motors"}.get(name, name): topic for name, topic in topics.items()
    }
    path = write_mcap(tmp_path / "a.mcap", moved)
    with rejected(str(path), "/craft/motors", field="/drone/control"):
        read_recording(path)
    assert_is_foreign(read_recording(path, topics=Topics(command="/craft/motors")), topics)


def test_an_optional_topic_may_be_missing_unless_it_was_named(tmp_path: Path, topics):
    path = write_mcap(tmp_path / "a.mcap", topics)
    read_recording(path)
    with pytest.raises(InputError, match="/drone/imu2: there is no such topic"):
        read_recording(path, topics=Topics(imu="/drone/imu2"))


@pytest.mark.parametrize("stream", ["pose", "command", "imu"])
def test_a_wrong_type_names_file_topic_and_both_types(tmp_path: Path, topics, stream: str):
    path = write_mcap(tmp_path / "a.mcap", topics)
    with pytest.raises(InputError) as caught:
        read_recording(path, topics=Topics(**{stream: "/rosout"}))
    message = str(caught.value)
    assert "\n" not in message
    wanted = {"pose": POSE_TYPE, "command": "one for each motor", "imu": "IMUStamped"}[stream]
    for part in (str(path), "/rosout", "std_msgs/msg/String", wanted):
        assert part in message


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("garbage {{{", ""),
        ("std_msgs/Header header\nfloat64 a", ""),
        ("\0\0", ""),
        (
            "std_msgs/Header header\nfloat64 motor_1\nint32 mode\n" + HEADER,
            "my_msgs/msg/Command, but a command is",
        ),
    ],
    ids=["no definition", "a missing part", "zeros", "other than numbers"],
)
def test_an_unusable_command_definition_is_one_clear_line(
    tmp_path: Path, topics, text: str, says: str
):
    topics["/drone/control"] = ("my_msgs/msg/Command", text, [])
    with rejected(says, field="/drone/control"):
        read_recording(write_mcap(tmp_path / "a.mcap", topics))


def test_motors_are_named_by_the_embedded_definition(tmp_path: Path, topics):
    text = "std_msgs/Header header\nfloat64 left\nfloat64 right\nfloat64 lift\n" + HEADER
    messages = [(START_NS + i, stamped(START_NS + i, "b", (0.1, 0.2, 0.3))) for i in range(3)]
    topics["/drone/control"] = ("my_msgs/msg/Command", text, messages)
    command = read_recording(write_mcap(tmp_path / "a.mcap", topics))["command"]
    assert command.columns == ("left", "right", "lift")
    assert command.values.tolist() == [[0.1, 0.2, 0.3]] * 3


def test_an_idl_definition_is_read(tmp_path: Path, topics):
    line = "=" * 80
    idl = f"""{line}
IDL: my_msgs/msg/Command
#include "std_msgs/msg/Header.idl"
module my_msgs {{ module msg {{ struct Command {{
  std_msgs::msg::Header header;
  double left;
  double right;
}}; }}; }};
{line}
IDL: std_msgs/msg/Header
#include "builtin_interfaces/msg/Time.idl"
module std_msgs {{ module msg {{ struct Header {{
  builtin_interfaces::msg::Time stamp;
  string frame_id;
}}; }}; }};
{line}
IDL: builtin_interfaces/msg/Time
module builtin_interfaces {{ module msg {{ struct Time {{
  int32 sec;
  uint32 nanosec;
}}; }}; }};
"""
    messages = [(START_NS, stamped(START_NS, "b", (0.25, 0.5)))]
    pose = {"/optitrack/drone/pose": topics["/optitrack/drone/pose"]}
    folder = tmp_path / "bag"
    folder.mkdir()
    write_mcap(folder / "a_0.mcap", pose)
    write_mcap(
        folder / "a_1.mcap",
        {"/drone/control": ("my_msgs/msg/Command", idl, messages)},
        schemas="ros2idl",
    )
    command = read_recording(folder)["command"]
    assert command.columns == ("left", "right")
    assert command.values.tolist() == [[0.25, 0.5]]


@pytest.mark.parametrize(
    "msgtype",
    [
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/TransformStamped",
    ],
)
def test_other_stamped_pose_types_are_read(tmp_path: Path, topics, msgtype: str):
    from ..apparatus.messages import serialise

    position, turn = {"x": 0.5, "y": -0.5}, {"z": np.sin(-1.2), "w": np.cos(-1.2)}
    fields = {
        "geometry_msgs/msg/TransformStamped": {
            "transform": {"translation": position, "rotation": turn}
        }
    }.get(msgtype, {"pose": {"pose": {"position": position, "orientation": turn}}})
    header = {"stamp": {"sec": 9, "nanosec": 1}, "frame_id": "map"}
    message = serialise(msgtype, {"header": header, **fields})
    text, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(msgtype, ros_version=2)
    pose = poses_of(tmp_path, topics, [message], msgtype, text)
    assert pose.stamp_ns.tolist() == [9 * 10**9 + 1]
    assert pose.values[0] == pytest.approx([0.5, -0.5, -2.4], abs=1e-15)


def test_the_yaw_of_a_tilted_craft_is_its_heading(tmp_path: Path, topics):
    # Yaw 0.7, then pitch 0.2, then roll -0.1, multiplied out by hand as rotations.
    def turn(axis: int, angle: float) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        matrix = np.eye(3)
        matrix[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
        return matrix

    m = turn(2, 0.7) @ turn(1, 0.2) @ turn(0, -0.1)
    w = np.sqrt(1 + np.trace(m)) / 2
    x, y, z = (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]) / (4 * w)
    message = stamped(START_NS, "", (0, 0, 0, x, y, z, w))
    pose = poses_of(tmp_path, topics, [message])
    assert pose.values[0, 2] == pytest.approx(0.7, abs=1e-15)


def test_a_reader_neither_checks_sorts_nor_drops_messages(tmp_path: Path, topics):
    stamps = [5, 3, 3, 9]
    numbers = [-np.inf, np.inf, 1e300, -0.0]
    pairs = zip(stamps, numbers, strict=True)
    messages = [stamped(stamp, "", (x, 0, 0, 0, 0, 0, 1)) for stamp, x in pairs]
    pose = poses_of(tmp_path, topics, messages)
    assert pose.stamp_ns.tolist() == stamps
    assert np.array_equal(pose.values[:, 0], numbers, equal_nan=True)


@pytest.mark.parametrize(
    ("quaternion", "yaw"),
    [
        ((0, 0, np.inf, -np.inf), np.nan),
        ((0, 0, 0, 0), np.nan),
        ((0, 0.1, 0, np.inf), np.nan),
        ((np.inf, 0, 0, 0), np.nan),
        ((0, 0, np.nan, 1), np.nan),
        ((0, 0, 3 * np.sin(0.6), 3 * np.cos(0.6)), 1.2),
    ],
)
def test_any_quaternion_except_zero_has_a_yaw(tmp_path: Path, topics, quaternion, yaw):
    pose = poses_of(tmp_path, topics, [stamped(0, "", (0, 0, 0, *quaternion))])
    assert pose.values[0, 2] == pytest.approx(yaw, abs=1e-15, nan_ok=True)


def test_a_topic_without_messages_is_an_empty_stream(tmp_path: Path, topics):
    topics["/drone/control"] = (COMMAND_TYPE, COMMAND_TEXT, [])
    recording = read_recording(write_mcap(tmp_path / "a.mcap", topics))
    assert recording.streams["command"].columns == SIX
    with pytest.raises(InputError, match="the command stream is empty"):
        recording["command"]


def test_a_message_that_does_not_match_its_type_is_reported(tmp_path: Path, topics):
    messages = topics["/drone/control"][2]
    messages[7] = (messages[7][0], b"\x00\x01\x00\x00\x01\x00")
    path = write_mcap(tmp_path / "a.mcap", topics)
    with rejected(match="message 8 cannot be decoded", field="/drone/control"):
        read_recording(path)


def test_references_without_a_header_take_the_recorders_time(tmp_path: Path, topics):
    text = "float64 x\nfloat64 y\nfloat64 v_x\nfloat64 v_y\nfloat64 yaw\nfloat64 w_z"
    message = b"\x00\x01\x00\x00" + np.arange(6.0).tobytes()
    topics["/control/state_ref"] = ("holohover_msgs/msg/HolohoverState", text, [(77, message)])
    reference = read_recording(write_mcap(tmp_path / "a.mcap", topics))["reference"]
    assert reference.columns == COLUMNS["reference"]
    assert reference.values.tolist() == [[0, 1, 4, 2, 3, 5]]
    assert reference.stamp_ns.tolist() == reference.received_ns.tolist() == [77]


def test_messages_missing_according_to_metadata_are_reported(tmp_path: Path):
    rosbags_folder(tmp_path / "bag", plugin=StoragePlugin.MCAP)
    file = tmp_path / "bag" / "metadata.yaml"
    file.write_text(file.read_text().replace("message_count: 10\n", "message_count: 12\n"))
    (warning,) = read_recording(tmp_path / "bag").warnings
    assert "2 messages are missing" in warning


@pytest.mark.parametrize("text", ["", "{", "a: b", "- 1", "rosbag2_bagfile_information: 7", "\0"])
def test_damaged_metadata_does_not_prevent_reading_an_intact_file(tmp_path: Path, text: str):
    rosbags_folder(tmp_path / "bag", plugin=StoragePlugin.MCAP)
    (tmp_path / "bag" / "metadata.yaml").write_text(text)
    assert_is_rosbags(read_recording(tmp_path / "bag"))


@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.mcap.zstd"])
@pytest.mark.parametrize(
    "content", [b"", b"\0" * 100, b"\x89MCAP0\r\n", b"SQLite format 3\0" + b"\1" * 200, b"text\n"]
)
def test_a_junk_file_named_like_a_bag_is_rejected(tmp_path: Path, name: str, content: bytes):
    (tmp_path / name).write_bytes(content)
    for path in (tmp_path / name, tmp_path):
        with rejected(name):
            read_recording(path)


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE messages SET timestamp = NULL",
        "UPDATE messages SET timestamp = 'noon'",
        "UPDATE messages SET timestamp = -5",
        "UPDATE messages SET data = 7",
        "UPDATE topics SET name = x'00ff'",
        "DROP TABLE messages",
        "DELETE FROM topics",
    ],
)
def test_a_sqlite_file_with_the_wrong_content_is_rejected(tmp_path: Path, damage: str):
    rosbags_folder(tmp_path / "bag")
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as database:
        # The schema must be right, but the content may be anything.
        database.execute("PRAGMA ignore_check_constraints = ON")
        database.execute("PRAGMA writable_schema = ON")
        database.execute("UPDATE sqlite_master SET sql = replace(sql, ' NOT NULL', '')")
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as database:
        database.execute(damage)
    with pytest.raises(InputError):
        read_recording(tmp_path / "bag")


def test_intervals_are_rejected_for_a_bag_whose_messages_have_times(tmp_path):
    mapping = RecordingMapping(puck=PoseMapping(interval="dt"))
    with pytest.raises(InputError, match=r"puck\.interval: is a bag"):
        read_bag(tmp_path, mapping, ("pose",))


def halves(messages):
    return messages[: len(messages) // 2], messages[len(messages) // 2 :]


def test_each_message_is_decoded_by_the_definition_of_its_channel(tmp_path: Path, topics):
    """After an update of the firmware, the same type lists its motors in another order."""
    whole = read_recording(write_mcap(tmp_path / "whole.mcap", topics))
    before, after = halves(topics["/drone/control"][2])
    other = "std_msgs/Header header\n" + "".join(f"float64 {m}\n" for m in SIX[::-1]) + HEADER
    turned = [
        (time, data[:-48] + np.frombuffer(data[-48:], "<f8")[::-1].tobytes())
        for time, data in after
    ]
    path = write_channels(
        tmp_path / "a.mcap",
        ("/optitrack/drone/pose", *topics["/optitrack/drone/pose"]),
        ("/drone/control", COMMAND_TYPE, COMMAND_TEXT, before),
        ("/drone/control", COMMAND_TYPE, other, turned),
    )
    recording = read_recording(path)
    assert recording["command"] == whole["command"]
    assert "/drone/control: has 2 definitions" in recording.warnings[0]


def test_poses_of_two_types_on_one_topic_are_merged(tmp_path: Path, topics):
    whole = read_recording(write_mcap(tmp_path / "whole.mcap", topics))
    before, after = halves(topics["/optitrack/drone/pose"][2])
    name = "geometry_msgs/msg/TransformStamped"
    text, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(name, ros_version=2)
    # The same fields, with the name of the body before them.
    moved = [(time, stamped_transform(data)) for time, data in after]
    path = write_channels(
        tmp_path / "a.mcap",
        ("/optitrack/drone/pose", POSE_TYPE, POSE_TEXT, before),
        ("/optitrack/drone/pose", name, text, moved),
        ("/drone/control", *topics["/drone/control"]),
    )
    assert read_recording(path).streams == whole.streams


def stamped_transform(pose: bytes, child: bytes = b"craft") -> bytes:
    """A pose, which ends with its numbers, as a TransformStamped."""
    body = pose[4:12] + struct.pack("<I", 1) + b"\0"
    body += b"\0" * (-len(body) % 4) + struct.pack("<I", len(child) + 1) + child + b"\0"
    return pose[:4] + body + b"\0" * (-len(body) % 8) + pose[-56:]


def test_conflicting_definitions_are_rejected(tmp_path: Path, topics):
    before, after = halves(topics["/drone/control"][2])
    other = COMMAND_TEXT.replace("motor_c_2", "motor_d_2")
    path = write_channels(
        tmp_path / "a.mcap",
        ("/optitrack/drone/pose", *topics["/optitrack/drone/pose"]),
        ("/drone/control", COMMAND_TYPE, COMMAND_TEXT, before),
        ("/drone/control", COMMAND_TYPE, other, after),
    )
    with pytest.raises(InputError, match=r"control: its definitions name other values.*motor_d_2"):
        read_recording(path)
    with pytest.raises(InputError, match='command = "/drone/control"'):
        read_recording(path, topics=Topics(command="/motors"))


def test_an_unknown_message_encoding_is_rejected_by_name(tmp_path: Path):
    messages = [(START_NS, b"{}")]
    path = write_channels(
        tmp_path / "a.mcap",
        ("/pose", "foxglove.PoseInFrame", "{}", messages),
        ("/command", "foxglove.Motors", "{}", messages),
        encoding="json",
        schemas="jsonschema",
    )
    mapping = RecordingMapping(topics=Topics(pose="/pose", command="/command"))
    with pytest.raises(InputError, match=r"/pose: .* encoded as json, .*export the topic as CSV"):
        read_recording(path, mapping=mapping)
    with pytest.raises(InputError, match=r"/command \(foxglove\.Motors, encoded as json\)"):
        read_recording(path)


def test_an_mcap_file_converted_from_ros_1_is_read(tmp_path: Path):
    from rosbags.highlevel import AnyReader

    whole = read_recording(ros1_bag(tmp_path / "a.bag"))
    channels = []
    with AnyReader([tmp_path / "a.bag"]) as bag:
        for connection in bag.connections:
            found = [(t, data) for _, t, data in bag.messages([connection])]
            kind = connection.msgtype.replace("/msg", "")
            channels.append((connection.topic, kind, connection.msgdef.data, found))
    path = write_channels(tmp_path / "a.mcap", *channels, encoding="ros1", schemas="ros1msg")
    assert read_recording(path).streams == whole.streams


def test_topics_are_matched_by_their_exact_names(tmp_path: Path, topics):
    path = write_channels(
        tmp_path / "a.mcap",
        ("mocap/pose", *topics["/optitrack/drone/pose"]),
        ("motors of the craft", *topics["/drone/control"]),
    )
    named = Topics(pose="mocap/pose", command="motors of the craft")
    assert_is_foreign(read_recording(path, topics=named), topics)


def in_parts(folder: Path, topics, names, later: int = 0) -> Path:
    """Two halves of a flight, the second one some seconds later."""
    folder.mkdir()
    for k, name in enumerate(names):
        parts = {
            topic: (msgtype, text, [(t + k * later * 10**9, d) for t, d in halves(messages)[k]])
            for topic, (msgtype, text, messages) in topics.items()
        }
        write_mcap(folder / name, parts)
    return folder


@pytest.mark.parametrize(
    ("names", "later"),
    [
        (("monday.mcap", "tuesday.mcap"), 0),
        (("2025-03-04-10-00-00.mcap", "2025-03-04-10-00-01.mcap"), 0),
        (("flight_0.mcap", "flight_0.mcap.zstd"), 0),
        # Numbered flights, and flights whose clocks begin at the same time.
        (("flight_1.mcap", "flight_2.mcap"), 3600),
        (("flight_1.mcap", "flight_2.mcap"), -60),
    ],
)
def test_two_flights_in_one_folder_are_two_recordings(tmp_path: Path, topics, names, later):
    folder = in_parts(tmp_path / "flights", topics, names, later)
    if names[1].endswith(".zstd"):
        import zstandard

        (folder / names[1]).write_bytes(zstandard.compress((folder / names[1]).read_bytes()))
    with pytest.raises(InputError, match=rf"several recordings; choose one of {names[0]}"):
        read_recording(folder)


def test_files_listed_in_metadata_are_read_in_its_order(tmp_path: Path, topics):
    """Whatever their names, and however long the pause between them."""
    whole = read_recording(write_mcap(tmp_path / "whole.mcap", topics))["pose"]
    folder = in_parts(tmp_path / "bag", topics, ("late.mcap", "early.mcap"), later=600)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  relative_file_paths: [old/late.mcap, old/early.mcap]\n"
    )
    pose = read_recording(folder)["pose"]
    assert np.array_equal(pose.stamp_ns, whole.stamp_ns)
    assert np.array_equal(pose.values, whole.values)


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def assert_equal(read: Recording, made: Recording) -> None:
    assert set(read.streams) == set(made.streams)
    for name, stream_made in made.streams.items():
        stream_read = read.streams[name]
        assert stream_read.columns == stream_made.columns
        assert np.array_equal(stream_read.stamp_ns, stream_made.stamp_ns)
        assert np.array_equal(stream_read.received_ns, stream_made.received_ns)
        exact = slice(0, 2) if name in POSES else slice(None)
        assert np.array_equal(stream_read.values[:, exact], stream_made.values[:, exact])
    yaw = read["pose"].values[:, 2] - made["pose"].values[:, 2]
    assert np.abs(wrapped(yaw)).max() <= 1e-15


def in_order(made: Recording) -> Recording:
    """The same with every stream in the order of the recorder's clock, as bags are read."""
    streams = {}
    for name, item in made.streams.items():
        order = np.argsort(item.received_ns, kind="stable")
        streams[name] = Stream(
            item.stamp_ns[order], item.received_ns[order], item.values[order], item.columns
        )
    return Recording(streams, made.source)


def test_a_written_bag_round_trips(tmp_path: Path):
    made = flight()
    # References with stamps of their own keep them.
    reference = replace(made["reference"], stamp_ns=made["reference"].stamp_ns - 5)
    made = Recording({**made.streams, "reference": reference}, made.source)
    write_bag(made, tmp_path / "bag")
    read = read_recording(tmp_path / "bag")
    assert_equal(read, made)
    assert read.warnings == ()
    assert set(read.hashes) == {"bag_0.mcap", "metadata.yaml"}


@given(yaw=st.floats(-np.pi, np.pi, exclude_min=True))
def test_yaw_round_trips_through_the_quaternion(yaw: float):
    from airpuck.recording.conversion import yaw_of

    half, none = np.array([yaw / 2]), np.zeros(1)
    back = yaw_of(none, none, np.sin(half), np.cos(half))
    assert abs(wrapped(back[0] - yaw)) <= 1e-15


def test_independently_decoded_bytes_agree(tmp_path: Path):
    """With the mcap package and the fields unpacked by hand."""
    from mcap.reader import make_reader

    made = flight()
    write_bag(made, tmp_path / "bag")
    content = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    reader = make_reader(io.BytesIO(content), validate_crcs=True)
    assert reader.get_header().profile == "ros2"
    # In the order of the file, which tools that stream it rely on.
    times = [message.log_time for *_, message in reader.iter_messages(log_time_order=False)]
    assert times == sorted(times)
    by_topic: dict[str, list] = {}
    schemas = {}
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        assert schema.encoding == "ros2msg"
        assert channel.message_encoding == "cdr"
        by_topic.setdefault(channel.topic, []).append(message)
        schemas[channel.topic] = schema
    assert schemas["/drone/control"].name == "holohover_msgs/msg/HolohoverControlStamped"
    assert b"float64 motor_a_1" in schemas["/drone/control"].data
    assert b"MSG: std_msgs/Header" in schemas["/drone/control"].data
    for index in (0, 999):
        message = by_topic["/drone/control"][index]
        # Encapsulation, sec, nanosec, length of "body" and its closing zero, it, padding, motors.
        sec, nanosec, length, frame, *motors = struct.unpack("<4xiII5s7x6d", message.data)
        assert sec * 10**9 + nanosec == made["command"].stamp_ns[index]
        assert (length, frame) == (5, b"body\0")
        assert motors == made["command"].values[index].tolist()
        assert message.log_time == made["command"].received_ns[index]
    message = by_topic["/optitrack/drone/pose"][7]
    *_, frame, x, y, z, qx, qy, qz, qw = struct.unpack("<4xiII6s6x7d", message.data)
    assert frame == b"world\0"
    assert [x, y, z, qx, qy] == [*made["pose"].values[7, :2], 0, 0, 0]
    assert 2 * np.arctan2(qz, qw) == pytest.approx(made["pose"].values[7, 2], abs=1e-15)
    assert by_topic["/control/state_ref"][0].data == b"\x00\x01\x00\x00" + struct.pack(
        "<6d", *made["reference"].values[0][[0, 1, 3, 4, 2, 5]]
    )


def test_rosbags_reads_a_written_bag_equally(tmp_path: Path):
    """It compares each type's hash with its definition, as ROS does."""
    from rosbags.highlevel import AnyReader

    made = flight()
    write_bag(made, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == sum(map(len, made.streams.values()))
        topics = Topics().by_stream
        for name in made.streams:
            assert reader.topics[topics[name]].msgcount == len(made[name])
        connections = [item for item in reader.connections if item.topic == "/drone/imu"]
        for index, (connection, _, raw) in enumerate(reader.messages(connections)):
            message = reader.deserialize(raw, connection.msgtype)
            gyro = message.gyro  # pyright: ignore[reportAttributeAccessIssue]
            assert [gyro.x, gyro.y, gyro.z] == made["imu"].values[index, 3:].tolist()


def test_metadata_has_the_format_of_ros2_bag(tmp_path: Path):
    made = flight()
    write_bag(made, tmp_path / "bag")
    content = YAML(typ="safe").load((tmp_path / "bag" / "metadata.yaml").read_text())
    bag = content["rosbag2_bagfile_information"]
    assert bag["version"] == 8
    assert bag["storage_identifier"] == "mcap"
    assert bag["relative_file_paths"] == ["bag_0.mcap"]
    assert bag["compression_format"] == bag["compression_mode"] == ""
    first = min(item.received_ns.min() for item in made.streams.values())
    last = max(item.received_ns.max() for item in made.streams.values())
    assert bag["starting_time"]["nanoseconds_since_epoch"] == first
    assert bag["duration"]["nanoseconds"] == last - first
    for entry in bag["topics_with_message_count"]:
        topic = entry["topic_metadata"]
        assert topic["serialization_format"] == "cdr"
        (quality,) = YAML(typ="safe").load(topic["offered_qos_profiles"])
        sent_once = topic["name"] in ("/control/state_ref", "/navigation/state", "/game/event")
        assert quality["reliability"] == (1 if sent_once else 2)
        assert quality["durability"] == 2


def test_quality_of_service_matches_the_real_table(tmp_path: Path, experiments: Path):
    write_bag(flight(), tmp_path / "bag")

    def profiles(path: Path) -> dict[str, dict]:
        content = YAML(typ="safe").load(path.read_text())["rosbag2_bagfile_information"]
        load = YAML(typ="safe").load
        return {
            entry["topic_metadata"]["name"]: load(entry["topic_metadata"]["offered_qos_profiles"])
            for entry in content["topics_with_message_count"]
        }

    name = "2024_03_05-16_12_50_sysid_h1_blue"
    real, ours = (
        profiles(experiments / name / name / "metadata.yaml"),
        profiles(tmp_path / "bag" / "metadata.yaml"),
    )
    shared = set(real) & set(ours)
    assert len(shared) == 5
    assert {topic: ours[topic] for topic in shared} == {topic: real[topic] for topic in shared}


def test_the_same_recording_gives_the_same_bytes(tmp_path: Path):
    for parent in ("a", "b"):
        write_bag(flight(), tmp_path / parent / "bag")
    for name in ("bag_0.mcap", "metadata.yaml"):
        one, other = (tmp_path / parent / "bag" / name for parent in ("a", "b"))
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize(
    "motors", [("left", "right"), SIX[::-1], tuple(f"fan_{i}" for i in range(9)), ("only",)]
)
def test_bags_of_any_craft_round_trip(tmp_path: Path, motors: tuple[str, ...]):
    made = Recording({"pose": flight()["pose"], "command": stream(50, 100, motors, 8)}, "made up")
    write_bag(made, tmp_path / "bag")
    assert_equal(read_recording(tmp_path / "bag"), made)


def stamped_at(field: str, stamp: int) -> Stream:
    """Poses, one of which has another stamp."""
    made = flight()["pose"]
    stamps = getattr(made, field).copy()
    stamps[5] = stamp
    return replace(made, **{field: stamps})


@pytest.mark.parametrize(
    ("streams", "says"),
    [
        *(
            ({"command": stream(5, 100, (name,), 8)}, "cannot be a field of a ROS message")
            for name in ("Left", "a b", "header", "a__b", "é", "")
        ),
        *(
            ({"pose": stamped_at(field, stamp)}, "time stamps that ROS cannot hold")
            for field, stamp in (("stamp_ns", -1), ("stamp_ns", 2**31 * 10**9), ("received_ns", -1))
        ),
        ({"events": flight()["mouse"]}, "events: is not a stream that a bag can hold"),
    ],
)
def test_unrepresentable_recordings_are_rejected_before_writing(tmp_path, streams, says):
    with pytest.raises(InputError, match=says):
        write_bag(Recording(streams, "made up"), tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_other_topic_names_are_written_and_read(tmp_path: Path):
    topics = Topics(pose="/mocap/puck", command="/puck/motors")
    write_bag(flight(), tmp_path / "bag", topics=topics)
    with pytest.raises(InputError, match="/mocap/puck"):
        read_recording(tmp_path / "bag")
    assert_equal(read_recording(tmp_path / "bag", topics=topics), flight())


def test_empty_streams_round_trip(tmp_path: Path):
    made = flight()
    empty = Stream(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 6)), SIX)
    write_bag(Recording({"pose": made["pose"], "command": empty}, ""), tmp_path / "bag")
    read = read_recording(tmp_path / "bag")
    assert read.streams["command"] == empty
    nothing = Stream(empty.stamp_ns, empty.received_ns, np.zeros((0, 3)), ("x_m", "y_m", "yaw_rad"))
    write_bag(Recording({"pose": nothing, "command": empty}, ""), tmp_path / "none")
    assert read_recording(tmp_path / "none").streams["pose"] == nothing


@pytest.mark.parametrize("kind", ["folder", "file", "link"])
def test_existing_files_are_never_overwritten(tmp_path: Path, kind: str):
    target = tmp_path / "bag"
    if kind == "folder":
        target.mkdir()
        (target / "precious").touch()
    elif kind == "file":
        target.write_text("precious")
    else:
        target.symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="exists already"):
        write_bag(flight(), target)
    assert list(tmp_path.iterdir()) == [target]


def test_an_interrupted_run_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(BagFile, "add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bag(flight(), tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_location_is_reported(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_bag(flight(), tmp_path / "file" / "bag")


def test_the_authors_recording_round_trips_through_a_bag(tmp_path: Path, experiments: Path):
    made = read_recording(experiments / "2024_03_05-16_12_50_sysid_h1_blue")
    write_bag(made, tmp_path / "bag")
    first = read_recording(tmp_path / "bag")
    assert_equal(first, in_order(made))
    write_bag(first, tmp_path / "again")
    assert_equal(read_recording(tmp_path / "again"), first)


SECOND = 10**9
START = 1_700_000_000 * SECOND
POSE, COMMAND = StreamCodec("pose"), StreamCodec("command", HOLOHOVER_MOTORS)


def begun(folder, n=100):
    """A bag in the middle of a flight."""
    bag = BagFile(folder)
    places = {
        codec: bag.add_topic(name, codec.msgtype, codec.types, best_effort=True)
        for codec, name in ((POSE, "/optitrack/drone/pose"), (COMMAND, "/drone/control"))
    }
    for k in range(n):
        stamp = START + k * SECOND // 240
        bag.add(places[POSE], stamp + 10**6, stamp, POSE.encode(stamp, (k / n, 0.0, 0.5)))
        bag.add(places[COMMAND], stamp + 10**6, stamp, COMMAND.encode(stamp, np.full(6, k / n)))
    return bag, places


def test_flushed_messages_survive_a_killed_writer(tmp_path):
    bag, places = begun(tmp_path / "bag")
    assert bag.counts == {"/optitrack/drone/pose": 100, "/drone/control": 100}
    bag.flush()
    stamp = START + SECOND
    bag.add(places[POSE], stamp, stamp, POSE.encode(stamp, (0.0, 0.0, 0.0)))  # not flushed
    shutil.copytree(tmp_path / "bag", tmp_path / "killed")
    recording = read_recording(tmp_path / "killed")
    assert len(recording["pose"]) == len(recording["command"]) == 100
    assert "cut short" in recording.warnings[0]
    bag.close()
    assert len(read_recording(tmp_path / "bag")["pose"]) == 101


def test_two_recorders_never_write_to_one_file(tmp_path: Path):
    first = BagFile(tmp_path / "bag")
    with pytest.raises(FileExistsError):
        BagFile(tmp_path / "bag")
    first.close()
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
