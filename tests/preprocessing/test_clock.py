"""Clocks: offsets, drifts and epochs of made-up streams, known to the nanosecond."""

import re
from dataclasses import replace

import numpy as np
import pytest

from airpuck.preprocessing.clock import align_clocks, continued, seconds
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


def test_agreeing_clocks_are_used_unchanged():
    aligned = align_clocks(stream(2400, 240.0, offset=0.05), COMMANDS)
    np.testing.assert_allclose(aligned.pose_time, 0.05 + np.arange(2400) / 240, atol=1e-6)
    np.testing.assert_allclose(aligned.command_time, np.arange(1000) / 100, atol=1e-6)
    assert aligned.epoch == aligned.recorder_epoch == EPOCH / 1e9
    assert aligned.warnings == ()


def test_a_clock_corrected_in_flight_is_named_and_unchanged():
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
def test_a_drifting_clock_is_named_and_measured(name, drift):
    # The lowest offsets of the first and of the last quarter lie three quarters of 10 s apart, as
    # received minus sent: the faster the sender's clock, the less. Of each the 1 % quantile counts.
    drifting = {
        "pose": stream(2400, 240.0, drift=drift),
        "command": stream(1000, 100.0, latency=1e-4, drift=drift),
    }[name]
    found = drifts(drifting if name == "pose" else POSES, COMMANDS if name == "pose" else drifting)
    assert found == {name: pytest.approx(-7.5e3 * drift, abs=0.06)}
    removed = align_clocks(stream(2400, 240.0, drift=2 * drift), COMMANDS).pose_time
    np.testing.assert_allclose(removed - removed[0], np.arange(2400) / 240, atol=3e-4)


@pytest.mark.parametrize(("drift", "warns"), [(6e-4, False), (7e-4, True), (-7e-4, True)])
def test_a_drift_is_reported_from_five_milliseconds(drift, warns):
    assert bool(drifts(stream(2400, 240.0, drift=drift), COMMANDS)) == warns


def test_both_clocks_may_drift():
    both = stream(2400, 240.0, drift=1e-3), stream(1000, 100.0, drift=-2e-3)
    assert drifts(*both) == {
        "pose": pytest.approx(-7.5, abs=0.1),
        "command": pytest.approx(15, 0.01),
    }


def test_varying_latency_is_not_drift():
    # Even if the recorder becomes busier, the shortest latencies stay the same.
    growing = stream(2400, 240.0, jitter=5e-3)
    late = growing.received_ns + (np.arange(2400) % 7 > 0) * np.arange(2400) * 20_000
    busy = Stream(growing.stamp_ns, late, growing.values, growing.columns)
    assert align_clocks(busy, COMMANDS).warnings == ()


@pytest.mark.parametrize("first", [100, 2200])
def test_a_few_wrong_stamps_indicate_neither_drift_nor_another_clock(first):
    stamp = POSES.stamp_ns.copy()
    stamp[first : first + 5] += 3_000_000_000
    wrong = Stream(stamp, POSES.received_ns, POSES.values, POSES.columns)
    assert align_clocks(wrong, COMMANDS).warnings == ()


def test_too_few_messages_reveal_no_drift():
    assert drifts(stream(399, 40.0, drift=2e-3), COMMANDS) == {}
    assert drifts(stream(400, 40.0, drift=2e-3), COMMANDS).keys() == {"pose"}


@pytest.mark.parametrize("offset", [-86400.0, -0.12, 0.12, 7.3])
def test_commands_from_another_clock_are_shifted_to_the_poses(offset):
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
def test_the_recorders_clock_is_converted_to_the_time_axis(pose, command, ahead):
    # A message that the recorder got at 2 s: on the axis, the poses' clock, `ahead` later.
    poses = stream(2400, 240.0, offset=pose)
    aligned = align_clocks(poses, stream(1000, 100.0, offset=command))
    found = EPOCH / 1e9 + 2.0 - aligned.recorder_epoch
    on_axis = 2.0 + ahead - (aligned.epoch - EPOCH / 1e9)
    assert found == pytest.approx(on_axis, abs=1.1e-3)


def test_stamps_convert_to_seconds_like_in_ros():
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
def test_a_clock_step_is_measured_and_removed(name, step, latency):
    streams = {
        "pose": stream(2400, 240.0, jitter=latency),
        "command": stream(1000, 100.0, latency=1e-4, jitter=1e-4),
    }
    whole = align_clocks(*streams.values())
    streams[name] = stepped(streams[name], 6.0, step)
    aligned = align_clocks(*streams.values())
    [warning] = aligned.warnings
    found = re.match(rf"the clock of the {name} stream steps by (\S+) ms after 6.0 s", warning)
    assert found is not None
    assert float(found[1]) == pytest.approx(1e3 * step, abs=0.3)
    for found, true in (
        (aligned.pose_time, whole.pose_time),
        (aligned.command_time, whole.command_time),
    ):
        np.testing.assert_allclose(found - found[0], true - true[0], atol=4e-4)


def test_the_segment_with_the_usual_latency_is_the_reference():
    # The cameras' clock is 50 ms late until it is synchronised.
    early = stepped(stream(2400, 240.0, offset=0.05), 6.0, -0.05)
    aligned = align_clocks(early, COMMANDS)
    np.testing.assert_allclose(aligned.pose_time, np.arange(2400) / 240, atol=1e-6)


@pytest.mark.parametrize("held", [0.03, 0.3])
def test_a_busy_recorder_is_not_a_clock_step(held):
    pose = stream(2400, 240.0, jitter=5e-4)
    # The recorder stores nothing for a while, and then all at once.
    received = pose.received_ns.copy()
    for begin in (2.0, 5.0, 7.0):
        since = (received - received[0]) / 1e9 - begin
        received[(since > 0) & (since < held)] += np.rint(
            1e9 * (held - since[(since > 0) & (since < held)])
        ).astype(np.int64)
    assert align_clocks(replace(pose, received_ns=received), COMMANDS).warnings == ()


@pytest.mark.parametrize("step", [-0.03, 0.05])
@pytest.mark.parametrize("shared", [False, True])
def test_a_step_of_the_recorders_clock_moves_only_its_own_stamps(step, shared):
    moved = [
        np.rint(1e9 * step * (np.arange(count) > count // 2)).astype(np.int64)
        for count in (2400, 1000)
    ]
    pose, command = (
        replace(one, received_ns=one.received_ns + by)
        for one, by in zip((stream(2400, 240.0, jitter=5e-4), COMMANDS), moved, strict=True)
    )
    if shared:  # the commands' sender runs on the recorder's computer
        command = replace(command, stamp_ns=command.stamp_ns + moved[1])
    aligned = align_clocks(pose, command)
    [warning] = aligned.warnings
    assert re.match(rf"the recorder's clock steps by {1e3 * step:.0f}\.\d ms after 5\.0 s", warning)
    np.testing.assert_allclose(aligned.pose_time, np.arange(2400) / 240, atol=1e-6)
    np.testing.assert_allclose(aligned.command_time, np.arange(1000) / 100, atol=4e-4)


@pytest.mark.parametrize("latency", [4e-3, 12e-3])
@pytest.mark.parametrize("seed", range(5))
def test_network_latency_is_not_a_clock_step(latency, seed):
    time = np.arange(9600) / 240
    late = 1e-3 + np.random.default_rng(seed).exponential(latency, 9600)
    received = EPOCH + np.rint(1e9 * np.maximum.accumulate(time + late)).astype(np.int64)
    pose = replace(stream(9600, 240.0), received_ns=received)
    assert align_clocks(pose, stream(4000, 100.0, latency=1e-4)).warnings == ()
    # A true step is still found, and nothing else.
    jumped = replace(pose, stamp_ns=pose.stamp_ns + 30_000_000 * (time > 20))
    [warning] = align_clocks(jumped, stream(4000, 100.0, latency=1e-4)).warnings
    # The larger latencies hide its size in one of these cases, but not that something is wrong.
    assert "after 20.0 s" in warning or (latency > 4e-3 and "not steadily" in warning)


@pytest.mark.parametrize(
    ("turn", "says"),
    [(2**32 * 10**3, "4294.97 s"), (86_400 * 10**9, "86400 s"), (2**32, "4.29497 s")],
)
@pytest.mark.parametrize("logged", [False, True])
def test_a_restarted_clock_is_continued(turn, says, logged):
    made = stream(1000, 100.0)
    stamps = (made.stamp_ns - made.stamp_ns[0] + turn - 3_000_000_000) % turn
    stamps[[450, 451]] = stamps[[451, 450]]  # other disorder stays as it is
    received = made.received_ns if logged else stamps
    found, warnings = continued(replace(made, stamp_ns=stamps, received_ns=received), "pose")
    expected = made.stamp_ns - made.stamp_ns[0]
    expected[[450, 451]] = expected[[451, 450]]
    unrolled = found.stamp_ns - found.stamp_ns[0]
    np.testing.assert_array_equal(unrolled, expected)
    assert (found.received_ns == (received if logged else found.stamp_ns)).all()
    assert "the clock of the pose stream begins again after 3.0 s" in warnings[0]
    assert says in warnings[0]


def test_a_late_message_from_before_a_clock_restart_is_placed_before_it():
    made = stream(1000, 100.0)
    stamps = (made.stamp_ns - made.stamp_ns[0] - 3_000_000_000) % (86_400 * 10**9)
    stamps[[299, 300]] = stamps[[300, 299]]
    expected = made.stamp_ns - made.stamp_ns[0]
    expected[[299, 300]] = expected[[300, 299]]
    found, _ = continued(replace(made, stamp_ns=stamps, received_ns=stamps), "pose")
    np.testing.assert_array_equal(found.stamp_ns - found.stamp_ns[0], expected)


def test_a_pause_is_not_a_clock_restart():
    made = stream(1000, 100.0)
    paused = replace(made, stamp_ns=made.stamp_ns + 4_294_967_296 * (np.arange(1000) > 500))
    assert continued(paused, "pose") == (paused, ())
