"""ROS 1 bags, written by rosbags."""

import bz2
import struct

import numpy as np
import pytest
from rosbags.rosbag1 import Writer

from airpuck import InputError, read_recording

from ..apparatus.bags import ROS1_COMMANDS, ROS1_POSES, SIX, START_NS, ros1_bag


@pytest.mark.parametrize("compression", [None, *Writer.CompressionFormat])
def test_poses_and_commands_of_a_ros1_bag_are_read(tmp_path, compression):
    recording = read_recording(ros1_bag(tmp_path / "a.bag", compression))
    assert recording.warnings == ()
    pose, command = recording["pose"], recording["command"]
    np.testing.assert_allclose(pose.values, ROS1_POSES, atol=1e-12)
    np.testing.assert_array_equal(command.values, ROS1_COMMANDS)
    assert command.columns == SIX
    assert pose.stamp_ns[7] == START_NS + 7 * 4_166_667
    assert pose.received_ns[7] == START_NS + 7 * 4_166_667 + 10**6


def test_the_intact_part_of_a_truncated_bag_is_read(tmp_path):
    path = ros1_bag(tmp_path / "a.bag")
    path.write_bytes(path.read_bytes()[:20_000])
    recording = read_recording(path)
    n = len(recording["pose"].values)
    assert 50 < n < 300
    np.testing.assert_allclose(recording["pose"].values, ROS1_POSES[:n], atol=1e-12)
    assert "cut short after 20000 bytes" in recording.warnings[0]


def test_a_damaged_chunk_affects_no_other(tmp_path):
    path = ros1_bag(tmp_path / "a.bag", Writer.CompressionFormat.BZ2)
    content = bytearray(path.read_bytes())
    second = content.find(b"BZh", content.find(b"BZh") + 1)
    content[second + 20 : second + 40] = bytes(20)
    path.write_bytes(content)
    recording = read_recording(path)
    assert 250 < len(recording["pose"].values) < 300
    assert "1 damaged record left out" in recording.warnings[0]


def record(fields: dict[str, bytes], data: bytes) -> bytes:
    """A record by hand."""
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def chunk(size: int, data: bytes) -> bytes:
    """A chunk that claims to unpack to `size` bytes."""
    number = struct.pack("<I", size)
    return record({"op": b"\x05", "compression": b"bz2", "size": number}, data)


#: A long record of the index, which is passed over.
INDEX = record({"op": b"\x04"}, bytes(8_000_000))


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (lambda: chunk(2**31, bz2.compress(b"")), "unpacks to too much"),
        (lambda: chunk(1000, bz2.compress(bytes(10**7))), "damaged record"),
        (lambda: chunk(len(INDEX), bz2.compress(INDEX)) * 40, "unpacks to more than"),
        (lambda: struct.pack("<I", 2**32 - 1), "cut short"),
        (lambda: record({"op": b"\x07"}, b""), "damaged record"),
        (lambda: record({}, b""), "damaged record"),
        (lambda: b"\xff" * 100, "cut short"),
    ],
)
def test_a_hostile_bag_is_rejected_in_one_line(tmp_path, body, says):
    path = tmp_path / "a.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + body())
    with pytest.raises(InputError, match=says) as caught:
        read_recording(path)
    assert "a.bag" in str(caught.value)
    path.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(InputError, match=r"is not a ROS 1 bag of format 2\.0"):
        read_recording(path)
