"""Clocks: offsets, drifts and epochs of made-up streams, known to the nanosecond."""

import re
from dataclasses import replace

import numpy as np
import pytest

from airpuck.preprocessing.clock import align_clocks, seconds
from airpuck.recording.stream import Stream

EPOCH = 1_700_000_000_000_000_000
WARNING = re.compile(
    r"the clock of the (\w+) stream drifts against the recorder's by (-?[\d.]+) ms over the recor"
)


def stream(
    count: int,
    rate: float,
    *,
    latency: float = 1e-3,
    jitter: float = 0.0,
    offset: float = 0.0,
    drift: float = 0.0,
) -> Stream:
    """Evenly sent messages of a clock that shows offset + (1 + drift) t, received with latency."""
    time = np.arange(count) / rate
    late = latency + np.random.default_rng(0).exponential(jitter, count)
    stamp, received = (
        EPOCH + np.rint(1e9 * t).astype(np.int64)
        for t in (offset + (1 + drift) * time, time + late)
    )
    return Stream(stamp, received, np.zeros((count, 1)), ("a",))


POSES = stream(2400, 240.0)
COMMANDS = stream(1000, 100.0, latency=1e-4)


def drifts(pose: Stream, command: Stream) -> dict[str, float]:
    found = [WARNING.match(warning) for warning in align_clocks(pose, command).warnings]
    return {match[1]: float(match[2]) for match in found if match}


def test_clocks_that_agree_are_used_as_they_are():
    aligned = align_clocks(stream(2400, 240.0, offset=0.05), COMMANDS)
    np.testing.assert_allclose(aligned.pose_time, 0.05 + np.arange(2400) / 240, atol=1e-6)
    np.testing.assert_allclose(aligned.command_time, np.arange(1000) / 100, atol=1e-6)
    assert aligned.epoch == aligned.recorder_epoch == EPOCH / 1e9
    assert aligned.warnings == ()


def test_a_clock_that_is_corrected_in_flight_is_named_and_left_alone():
    # It gains 30 ms between 3 and 5 s, as a time server would have it.
    time = np.arange(2400) / 240
    gained = 0.03 * np.clip((time - 3.0) / 2.0, 0.0, 1.0)
    stamps = POSES.stamp_ns + np.rint(1e9 * gained).astype(np.int64)
    aligned = align_clocks(replace(POSES, stamp_ns=stamps), COMMANDS)
    np.testing.assert_allclose(aligned.pose_time, time + gained, atol=1e-6)
    (warning,) = aligned.warnings
    assert "pose stream move by -30.0 ms against its stamps, but not steadily" in warning


@pytest.mark.parametrize("name", ["pose", "command"])
@pytest.mark.parametrize("drift", [-1e-3, 1e-3])
def test_a_clock_that_drifts_is_named_and_measured(name, drift):
    # The lowest offsets of the first and of the last quarter lie three quarters of 10 s apart, as
    # received minus sent: the faster the sender's clock, the less. Of each the 1 % quantile counts.
    drifting = {
        "pose": stream(2400, 240.0, drift=drift),
        "command": stream(1000, 100.0, latency=1e-4, drift=drift),
    }[name]
    found = drifts(drifting if name == "pose" else POSES, COMMANDS if name == "pose" else drifting)
    assert found == {name: pytest.approx(-7.5e3 * drift, abs=0.06)}


@pytest.mark.parametrize(("drift", "warns"), [(6e-4, False), (7e-4, True), (-7e-4, True)])
def test_a_drift_counts_from_five_milliseconds_on(drift, warns):
    assert bool(drifts(stream(2400, 240.0, drift=drift), COMMANDS)) == warns


def test_both_clocks_may_drift():
    both = stream(2400, 240.0, drift=1e-3), stream(1000, 100.0, drift=-2e-3)
    assert drifts(*both) == {
        "pose": pytest.approx(-7.5, abs=0.1),
        "command": pytest.approx(15, 0.01),
    }


def test_latencies_that_vary_are_no_drift():
    # Even if the recorder becomes busier, the shortest latencies stay the same.
    growing = stream(2400, 240.0, jitter=5e-3)
    late = growing.received_ns + (np.arange(2400) % 7 > 0) * np.arange(2400) * 20_000
    busy = Stream(growing.stamp_ns, late, growing.values, growing.columns)
    assert align_clocks(busy, COMMANDS).warnings == ()


@pytest.mark.parametrize("first", [100, 2200])
def test_a_few_wrong_stamps_are_no_drift_and_no_other_clock(first):
    stamp = POSES.stamp_ns.copy()
    stamp[first : first + 5] += 3_000_000_000
    wrong = Stream(stamp, POSES.received_ns, POSES.values, POSES.columns)
    assert align_clocks(wrong, COMMANDS).warnings == ()


def test_too_few_messages_tell_no_drift():
    assert drifts(stream(399, 40.0, drift=2e-3), COMMANDS) == {}
    assert drifts(stream(400, 40.0, drift=2e-3), COMMANDS).keys() == {"pose"}


@pytest.mark.parametrize("offset", [-86400.0, -0.12, 0.12, 7.3])
def test_commands_of_another_clock_are_moved_to_the_poses(offset):
    aligned = align_clocks(POSES, stream(1000, 100.0, latency=1e-3, offset=offset))
    np.testing.assert_allclose(aligned.command_time, np.arange(1000) / 100, atol=2e-6)
    np.testing.assert_allclose(aligned.pose_time, np.arange(2400) / 240, atol=2e-6)
    (warning,) = aligned.warnings
    assert f"differ by {-offset:.3f} s" in warning


@pytest.mark.parametrize(
    ("pose", "command", "ahead"),
    [
        (0.0, 0.0, 0.0),
        (0.05, 0.05, 0.0),  # latencies may explain this: not corrected
        (7.3, 0.0, 7.3),
        (-7.3, 0.0, -7.3),
        (0.0, 7.3, 0.0),
        (-7.3, -7.3, -7.3),
    ],
)
def test_the_recorders_clock_is_known_on_the_axis(pose, command, ahead):
    # A message that the recorder got at 2 s: on the axis, the poses' clock, `ahead` later.
    poses = stream(2400, 240.0, offset=pose)
    aligned = align_clocks(poses, stream(1000, 100.0, offset=command))
    found = EPOCH / 1e9 + 2.0 - aligned.recorder_epoch
    on_axis = 2.0 + ahead - (aligned.epoch - EPOCH / 1e9)
    assert found == pytest.approx(on_axis, abs=1.1e-3)


def test_seconds_are_those_of_ros():
    stamp = np.array([1_700_000_000_123_456_789, 5, -1], dtype=np.int64)
    expected = [1_700_000_000 + 123_456_789 * 1e-9, 5e-9, -1e-9]
    np.testing.assert_allclose(seconds(stamp), expected, rtol=0, atol=1e-16)


def stepped(made: Stream, after: float, step: float) -> Stream:
    """Let the sender's clock step."""
    late = made.received_ns - made.received_ns[0] > 1e9 * after
    return replace(made, stamp_ns=made.stamp_ns + np.rint(1e9 * step * late).astype(np.int64))


@pytest.mark.parametrize("step", [-0.05, -0.02, 0.02, 0.05])
@pytest.mark.parametrize("latency", [1e-4, 1.5e-3])
@pytest.mark.parametrize("name", ["pose", "command"])
def test_a_step_of_a_clock_is_measured_and_removed(name, step, latency):
    streams = {
        "pose": stream(2400, 240.0, jitter=latency),
        "command": stream(1000, 100.0, latency=1e-4, jitter=1e-4),
    }
    whole = align_clocks(*streams.values())
    streams[name] = stepped(streams[name], 6.0, step)
    aligned = align_clocks(*streams.values())
    [warning] = aligned.warnings
    assert f"the clock of the {name} stream steps by {1e3 * step:.0f}" in warning.replace(".0", "")
    assert "after 6.0 s" in warning
    for found, true in (
        (aligned.pose_time, whole.pose_time),
        (aligned.command_time, whole.command_time),
    ):
        np.testing.assert_allclose(found - found[0], true - true[0], atol=4e-4)


def test_the_part_with_the_usual_latency_is_right():
    # The cameras' clock is 50 ms late until it is synchronised.
    early = stepped(stream(2400, 240.0, offset=0.05), 6.0, -0.05)
    aligned = align_clocks(early, COMMANDS)
    np.testing.assert_allclose(aligned.pose_time, np.arange(2400) / 240, atol=1e-6)


@pytest.mark.parametrize("held", [0.03, 0.3])
def test_neither_a_busy_recorder_nor_its_own_clock_is_a_step_of_the_sender(held):
    pose = stream(2400, 240.0, jitter=5e-4)
    # The recorder stores nothing for a while, and then all at once.
    received = pose.received_ns.copy()
    for begin in (2.0, 5.0, 7.0):
        since = (received - received[0]) / 1e9 - begin
        received[(since > 0) & (since < held)] += np.rint(
            1e9 * (held - since[(since > 0) & (since < held)])
        ).astype(np.int64)
    assert align_clocks(replace(pose, received_ns=received), COMMANDS).warnings == ()
    # The recorder's clock steps by 50 ms: both senders seem to, but keep their rhythm.
    both = [
        replace(one, received_ns=one.received_ns + 50_000_000 * (np.arange(len(one)) > half))
        for one, half in ((pose, 1200), (COMMANDS, 500))
    ]
    assert not any("steps" in warning for warning in align_clocks(*both).warnings)


@pytest.mark.parametrize("drift", [-2e-3, 2e-3])
def test_a_drift_is_removed(drift):
    aligned = align_clocks(stream(2400, 240.0, drift=drift), COMMANDS)
    np.testing.assert_allclose(
        aligned.pose_time - aligned.pose_time[0], np.arange(2400) / 240, atol=3e-4
    )
