from __future__ import annotations

import shutil

import numpy as np

from airpuck.recording import read_recording
from airpuck.recording.bag_file import BagFile
from airpuck.recording.message import StreamCodec
from airpuck.recording.message_types import HOLOHOVER_MOTORS

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
