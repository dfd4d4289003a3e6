"""Tracking performance at set points, against hand calculations."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, Recording, SetPoints, Stream
from airpuck.craft.vehicle import default_vehicle
from airpuck.flight.track import TOLERANCE, Track
from airpuck.recording.stream import COLUMNS

VEHICLE = default_vehicle()
MOTORS = VEHICLE.propeller_names
RATE, TAU = 240.0, 0.4
EPOCH = 1_700_000_000_000_000_000


def track(pose, set_points, *, duration=4.0, command=None, label="a"):
    """A flight whose pose is a function of time."""
    time = np.arange(round(duration * RATE)) / RATE
    command_time = np.arange(round(duration * 100)) / 100
    if command is None:
        command = np.full((len(command_time), 6), 0.03)
    times, poses = set_points
    return Track(
        label=label,
        time=time,
        pose=np.array([pose(t) for t in time], dtype=float),
        set_points=SetPoints(times, poses),
        command_time=command_time,
        command=command,
        motors=MOTORS,
        idle=np.full(6, 0.03),
    )


def approach(t):
    """From (0, 0, 0) to (1, 0.3, 1.5) exponentially."""
    left = np.exp(-t / TAU)
    return 1 - left, 0.3 * (1 - left), 1.5 * (1 - left)


TO_ONE = ([0.0], [(1.0, 0.3, 1.5)])


def test_the_settling_time_of_an_exponential_approach_is_exact():
    # x is within 20 mm after τ ln(1/0.02), y after τ ln(0.3/0.02), yaw after τ ln(1.5/0.05).
    (result,) = track(approach, TO_ONE).results()
    expected = TAU * max(np.log(1 / 0.02), np.log(0.3 / 0.02), np.log(1.5 / 0.05))
    assert TOLERANCE == (0.02, 0.02, 0.05)
    assert expected <= result.settling_time <= expected + 1 / RATE
    assert result.overshoot == (0, 0, 0)
    assert (result.start, result.pose) == (0, (1.0, 0.3, 1.5))
    assert result.stop == pytest.approx(4, abs=1.01 / RATE)


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        (lambda t: (1.0, 0.3, 1.5 * (1 - np.exp(-t / TAU))), TAU * np.log(1.5 / 0.05)),
        (lambda t: (1.0 + 0.03 * (2.0 <= t < 2.5), 0.3, 1.5), 2.5),  # it leaves again
        (lambda t: (1.021, 0.3, 1.5), None),
        (lambda t: (1.0, 0.3, 1.54), 0.0),
    ],
)
def test_a_craft_settles_once_its_whole_pose_stays_within_the_tolerance(pose, expected):
    (result,) = track(pose, TO_ONE).results()
    assert result.settling_time == pytest.approx(expected, abs=1.01 / RATE)
    assert result.to_json()["settling_time_s"] == result.settling_time


def test_overshoot_is_measured_along_the_step():
    # A damped oscillation: the first swing beyond is exp(-π d/w) of the step, on either side.
    damping, frequency = 2.0, 5.0

    def swinging(t):
        left = np.exp(-damping * t) * (
            np.cos(frequency * t) + damping / frequency * np.sin(frequency * t)
        )
        return 1 - left, -0.3 * (1 - left), 0.0

    (result,) = track(swinging, ([0.0], [(1.0, -0.3, 0.0)])).results()
    beyond = np.exp(-np.pi * damping / frequency)
    assert result.overshoot == pytest.approx((beyond, 0.3 * beyond, 0.0), rel=1e-3, abs=1e-12)


def test_the_steady_state_error_is_the_mean_over_the_last_second():
    # A ramp of 10 mm/s: the mean over 3 … 4 s equals the value at 3.5 s.
    (result,) = track(lambda t: (1.0 + 0.01 * t, 0.3, 1.5 - 0.02 * t), TO_ONE).results()
    assert result.steady_state_error == pytest.approx((0.035, 0, -0.07), abs=1e-4)


def test_the_steady_state_of_a_short_dwell_is_its_last_quarter():
    set_points = ([0.0, 2.0], [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    first, second = track(lambda t: (0.01 * t, 0.0, 0.0), set_points).results()
    assert first.steady_state_error[0] == pytest.approx(0.01 * 1.75, abs=5e-5)
    assert second.steady_state_error[0] == pytest.approx(0.01 * 3.75 - 1, abs=1e-4)
    assert (first.stop, second.start) == (2.0, 2.0)


def test_a_settled_craft_has_a_steady_state_within_the_tolerance():
    # It arrives 0.1 s before the end: the rest must not average the way there.
    (result,) = track(lambda t: (min(1.0, 0.25 * t + 0.025), 0.3, 1.5), TO_ONE).results()
    assert result.settling_time == pytest.approx(3.82, abs=1.01 / RATE)
    assert (np.abs(result.steady_state_error) <= TOLERANCE).all()
    # A craft that is still 30 mm away has not settled, and its rest says so.
    (late,) = track(lambda t: (0.25 * t - 0.03, 0.3, 1.5), TO_ONE).results()
    assert late.settling_time is None
    assert late.steady_state_error[0] < -TOLERANCE[0]


def test_the_effort_is_the_mean_square_command_above_idle():
    # Two motors 0.2 above idle, then three 0.5 above it.
    command = np.full((400, 6), 0.03)
    command[:200, :2] += 0.2
    command[200:, 3:] += 0.5
    set_points = ([0.0, 2.0], [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    first, second = track(lambda t: (0.0, 0.0, 0.0), set_points, command=command).results()
    assert first.effort == pytest.approx(2 * 0.2**2, rel=1e-9)
    assert second.effort == pytest.approx(3 * 0.5**2, rel=1e-9)


@pytest.mark.parametrize("turns", [-2, -1, 1, 3])
def test_whole_turns_are_not_an_error(turns):
    def turned(t):
        x, y, yaw = approach(t)
        return x, y, yaw + 2 * np.pi * turns

    (plain,), (found,) = track(approach, TO_ONE).results(), track(turned, TO_ONE).results()
    assert found.settling_time == plain.settling_time
    assert found.steady_state_error == pytest.approx(plain.steady_state_error, abs=1e-12)
    assert found.overshoot == pytest.approx(plain.overshoot, abs=1e-12)


def without(flight, begin, stop):
    """The flight with poses missing."""
    kept = (flight.time < begin) | (flight.time >= stop)
    return replace(flight, time=flight.time[kept], pose=flight.pose[kept])


def test_a_dwell_that_ends_without_poses_has_no_steady_state():
    set_points = ([0.0, 2.0], [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    whole = track(lambda t: (0.01 * t, 0.0, 0.0), set_points)
    first, second = without(whole, 1.4, 2.0).results()
    assert first.steady_state_error is None
    assert first.to_json()["steady_state_error"] is None
    assert second == whole.results()[1]
    # With some of them missing it is the mean of the others.
    first, _ = without(whole, 1.75, 2.0).results()
    assert first.steady_state_error[0] == pytest.approx(0.01 * 1.625, abs=5e-5)


STAYS = [(0.0, 0.0, 0.0), (1.0, 0.3, 1.5), (0.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    ("at", "poses", "first"),
    [
        ((0.0, 0.0, 0.0), STAYS, 1),
        ((0.01, -0.01, 2 * np.pi + 0.04), STAYS, 1),  # there, within the tolerance
        ((0.0, 0.0, 0.0), [STAYS[0], STAYS[0], (0.01, 0.0, 0.0)], 2),
        ((0.0, 0.0, 0.0), STAYS[1:], 0),
        ((0.5, 0.0, 0.0), STAYS, 0),
        ((0.0, 0.0, 0.0), [STAYS[0]] * 3, 0),  # nothing moves: nothing is left out
    ],
)
def test_a_set_point_at_the_start_pose_is_not_scored(at, poses, first):
    times = [0.7, 1.7, 2.7][: len(poses)]
    flight = track(lambda t: at, (times, poses))
    assert flight.first_move == first
    assert flight.moves() == flight.results()[first:]
    assert flight.origin == pytest.approx(times[first] - 0.5)


def test_time_counts_from_the_first_pose_at_the_earliest():
    assert track(approach, TO_ONE).origin == 0


def test_a_comparison_counts_time_from_the_first_move():
    set_points = ([0.0, 3.0], [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    one = track(lambda t: (0.0, 0.0, 0.0), set_points, duration=12.0)
    other = track(lambda t: (t, 0.0, 0.0), set_points, duration=12.0)
    apart = one.difference(other)[:, 0]
    assert (apart[0], apart[-1]) == pytest.approx((3.0, 9.0), abs=1.01 / RATE)


def test_a_set_point_active_for_fewer_than_ten_poses_is_ignored():
    set_points = ([0.0, 1.0, 1.03], [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
    assert [r.start for r in track(lambda t: (0.0, 0.0, 0.0), set_points).results()] == [0, 1.03]


def test_json_keys_are_complete():
    content = track(approach, TO_ONE).results()[0].to_json()
    assert content["set_point"] == {"x_m": 1.0, "y_m": 0.3, "yaw_rad": 1.5}
    assert (
        set(content["overshoot"]) == set(content["steady_state_error"]) == set(content["set_point"])
    )
    assert set(content) == {
        "start_s", "stop_s", "set_point", "settling_time_s", "overshoot",
        "steady_state_error", "effort",
    }  # fmt: skip


def test_a_difference_is_other_minus_own_pose():
    one = track(lambda t: (t, 0.0, 0.0), TO_ONE)
    other = track(lambda t: (t + 0.1, -0.2, 0.3), TO_ONE)
    np.testing.assert_allclose(
        one.difference(other, (1.0, 2.0)), np.tile([0.1, -0.2, 0.3], (241, 1)), atol=1e-12
    )


def test_flights_at_different_times_are_interpolated():
    one = track(lambda t: (t, 2 * t, -t), TO_ONE)
    shifted = replace(one, time=one.time + 0.3 / RATE)
    np.testing.assert_allclose(
        one.difference(shifted), np.tile(np.array([-1, -2, 1]) * 0.3 / RATE, (840, 1)), atol=1e-9
    )


@pytest.mark.parametrize("turns", [-1, 1, 2])
def test_a_difference_does_not_count_whole_turns(turns):
    one = track(lambda t: (0.0, 0.0, 3.0), TO_ONE)
    other = track(lambda t: (0.0, 0.0, 3.1 + 2 * np.pi * turns), TO_ONE)
    np.testing.assert_allclose(one.difference(other)[:, 2], 0.1, atol=1e-9)


def test_flights_without_common_time_are_rejected():
    one = track(approach, TO_ONE)
    later = replace(one, time=one.time + 100, label="b")
    with pytest.raises(InputError, match="a and b"):
        one.difference(later)


def recording(*, poses=None, start=0.5):
    """4 s of poses; commands and set points from `start` on."""
    time = np.arange(960) / RATE
    poses = np.array([approach(t) for t in time]) if poses is None else poses
    command_time = start + np.arange(300) / 100
    commands = np.linspace(0.1, 0.6, 6) * np.ones((300, 1))
    set_point_times = np.array([start, start, start + 2.0])
    set_points = np.array([[9, 9, 9], [0, 0, 0], [1, 0.3, 1.5]], dtype=float)

    def stream(times, values, names):
        stamp = EPOCH + np.rint(times * 1e9).astype(np.int64)
        return Stream(stamp, stamp, values, names)

    return Recording(
        streams={
            "pose": stream(time, poses, COLUMNS["pose"]),
            "command": stream(command_time, commands, MOTORS),
            "reference": stream(
                set_point_times, np.hstack([set_points, np.zeros((3, 3))]), COLUMNS["reference"]
            ),
        },
        source="made up",
    )


def test_a_recording_is_read_from_its_first_command():
    found = Track.of(recording(), VEHICLE, "flight")
    assert found.time[0] == pytest.approx(-0.5, abs=1e-6)
    assert found.command_time[0] == 0
    np.testing.assert_allclose(found.set_points.times, [0.0, 2.0], atol=1e-6)
    # If two set points have the same time, the last one is in force.
    np.testing.assert_array_equal(found.set_points.poses, [[0, 0, 0], [1, 0.3, 1.5]])
    np.testing.assert_allclose(found.command[0], np.linspace(0.1, 0.6, 6))
    assert (found.motors, found.label) == (MOTORS, "flight")
    np.testing.assert_array_equal(found.idle, 0.03)


def test_yaw_is_unwrapped():
    time = np.arange(960) / RATE
    wrapped = (3.0 * time + np.pi) % (2 * np.pi) - np.pi
    poses = np.column_stack([time, time, wrapped])
    found = Track.of(recording(poses=poses), VEHICLE, "flight")
    np.testing.assert_allclose(np.diff(found.pose[:, 2]), 3.0 / RATE, atol=1e-9)


def test_errors_are_relative_to_the_active_set_point():
    flight = track(lambda t: (t, 0.0, 3.0), ([1.0, 2.0], [(0.5, 0.1, 3.0), (1.0, 0.0, -3.0)]))
    expected = {0.5: (0, 0, 0), 1.0: (0.5, -0.1, 0), 1.75: (1.25, -0.1, 0)}
    expected[2.0] = (1.0, 0, 6 - 2 * np.pi)  # the shorter way round
    for time, error in expected.items():
        np.testing.assert_allclose(flight.errors[round(time * RATE)], error, atol=1e-12)
