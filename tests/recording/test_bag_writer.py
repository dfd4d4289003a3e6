from __future__ import annotations

import io
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from airpuck.boundary.errors import InputError
from airpuck.recording.bag_writer import BagFile, write_bag
from airpuck.recording.mapping import Topics
from airpuck.recording.message import HOLOHOVER_MOTORS, StreamCodec
from airpuck.recording.read import read_recording
from airpuck.recording.stream import POSES, Recording, Stream

from ..apparatus.bags import SIX, flight, stream


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


def test_what_is_written_is_read_back_equal(tmp_path: Path):
    made = flight()
    write_bag(made, tmp_path / "bag")
    read = read_recording(tmp_path / "bag")
    assert_equal(read, made)
    assert read.warnings == ()
    assert set(read.hashes) == {"bag_0.mcap", "metadata.yaml"}


@given(yaw=st.floats(-np.pi, np.pi, exclude_min=True))
def test_yaw_survives_the_quaternion(yaw: float):
    from airpuck.recording.conversion import yaw_of

    half, none = np.array([yaw / 2]), np.zeros(1)
    back = yaw_of(none, none, np.sin(half), np.cos(half))
    assert abs(wrapped(back[0] - yaw)) <= 1e-15


def test_independent_reading_of_the_bytes(tmp_path: Path):
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


def test_independent_reading_by_rosbags(tmp_path: Path):
    """Which compares each type's hash with its definition, as ROS does."""
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


def test_metadata_as_ros2_bag_wants_it(tmp_path: Path):
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


def test_quality_of_service_as_the_table_recorded_it(tmp_path: Path, experiments: Path):
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
    "motors",
    [("left", "right"), SIX[::-1], tuple(f"fan_{i}" for i in range(9)), ("only",)],
)
def test_any_craft(tmp_path: Path, motors: tuple[str, ...]):
    made = Recording({"pose": flight()["pose"], "command": stream(50, 100, motors, 8)}, "made up")
    write_bag(made, tmp_path / "bag")
    assert_equal(read_recording(tmp_path / "bag"), made)


@pytest.mark.parametrize("motors", [("Left",), ("a b",), ("header",), ("a__b",), ("é",), ("",)])
def test_names_that_ros_does_not_allow(tmp_path: Path, motors: tuple[str, ...]):
    made = Recording({"command": stream(5, 100, motors, 8)}, "made up")
    with pytest.raises(InputError, match="cannot be a field of a ROS message"):
        write_bag(made, tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_other_topic_names(tmp_path: Path):
    topics = Topics(pose="/mocap/puck", command="/puck/motors")
    write_bag(flight(), tmp_path / "bag", topics=topics)
    with pytest.raises(InputError, match="/mocap/puck"):
        read_recording(tmp_path / "bag")
    assert_equal(read_recording(tmp_path / "bag", topics=topics), flight())


def test_references_with_stamps_of_their_own_keep_them(tmp_path: Path):
    made = flight()
    given = made["reference"]
    moved = Stream(given.stamp_ns - 5, given.received_ns, given.values, given.columns)
    made = Recording({**made.streams, "reference": moved}, "made up")
    write_bag(made, tmp_path / "bag")
    assert_equal(read_recording(tmp_path / "bag"), made)


def test_empty_streams(tmp_path: Path):
    made = flight()
    empty = Stream(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 6)), SIX)
    write_bag(Recording({"pose": made["pose"], "command": empty}, ""), tmp_path / "bag")
    read = read_recording(tmp_path / "bag")
    assert read.streams["command"] == empty
    nothing = Stream(empty.stamp_ns, empty.received_ns, np.zeros((0, 3)), ("x_m", "y_m", "yaw_rad"))
    write_bag(Recording({"pose": nothing, "command": empty}, ""), tmp_path / "none")
    assert read_recording(tmp_path / "none").streams["pose"] == nothing


@pytest.mark.parametrize(
    ("field", "stamp"), [("stamp_ns", -1), ("stamp_ns", 2**31 * 10**9), ("received_ns", -1)]
)
def test_stamps_that_ros_cannot_hold(tmp_path: Path, field: str, stamp: int):
    made = flight()["pose"]
    stamps = getattr(made, field).copy()
    stamps[5] = stamp
    pose = replace(made, **{field: stamps})
    with pytest.raises(InputError, match="time stamps that ROS cannot hold"):
        write_bag(Recording({"pose": pose}, "made up"), tmp_path / "bag")


def test_an_unknown_stream(tmp_path: Path):
    made = Recording({"events": flight()["mouse"]}, "made up")
    with pytest.raises(InputError, match="events: is not a stream that a bag can hold"):
        write_bag(made, tmp_path / "bag")


@pytest.mark.parametrize("kind", ["folder", "file", "link"])
def test_nothing_that_exists_is_overwritten(tmp_path: Path, kind: str):
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


def test_an_interrupted_run_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(BagFile, "add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bag(flight(), tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_bag(flight(), tmp_path / "file" / "bag")


def test_the_authors_recording_through_a_bag(tmp_path: Path, experiments: Path):
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


def test_a_bag_that_was_closed_reads_back_whole(tmp_path):
    bag, _ = begun(tmp_path / "bag")
    assert bag.counts == {"/optitrack/drone/pose": 100, "/drone/control": 100}
    bag.close()
    recording = read_recording(tmp_path / "bag")
    assert recording.warnings == ()
    assert recording["command"].columns == HOLOHOVER_MOTORS
    np.testing.assert_allclose(recording["pose"].values[:, 0], np.arange(100) / 100)
    np.testing.assert_array_equal(recording["pose"].received_ns - recording["pose"].stamp_ns, 10**6)


def test_what_was_flushed_is_there_whatever_happens_to_the_writer(tmp_path):
    bag, places = begun(tmp_path / "bag")
    bag.flush()
    stamp = START + SECOND
    bag.add(places[POSE], stamp, stamp, POSE.encode(stamp, (0.0, 0.0, 0.0)))  # not flushed
    shutil.copytree(tmp_path / "bag", tmp_path / "killed")
    recording = read_recording(tmp_path / "killed")
    assert len(recording["pose"]) == len(recording["command"]) == 100
    assert "cut short" in recording.warnings[0]
    bag.close()
    assert len(read_recording(tmp_path / "bag")["pose"]) == 101


def test_two_recorders_never_write_one_file(tmp_path: Path):
    first = BagFile(tmp_path / "bag")
    with pytest.raises(FileExistsError):
        BagFile(tmp_path / "bag")
    first.close()
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
