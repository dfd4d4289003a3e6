"""Bookkeeping of the filters: measurements that arrive late, twice, or never."""

from collections.abc import Callable
from copy import copy

import numpy as np
import pytest

from airpuck import Measurement, SetPoint, TrackingController
from airpuck.estimate.estimator import Estimate
from airpuck.estimate.kalman import ActuationFilter, KalmanFilter

from ..apparatus.measured_flights import DELAY, IDLE, MODEL, NOISE, TAU, simulate, some_commands


@pytest.fixture(scope="module")
def kinds() -> dict[str, KalmanFilter]:
    """One filter of each kind, whose programs are compiled only once."""
    return {
        "kalman, compiled": KalmanFilter(MODEL, NOISE),
        "kalman, numpy": KalmanFilter(MODEL, NOISE, compiled=False),
        "actuation": ActuationFilter(MODEL, NOISE),
    }


@pytest.fixture(params=["kalman, compiled", "kalman, numpy", "actuation"])
def make(request, kinds) -> Callable[[], KalmanFilter]:
    def made() -> KalmanFilter:
        another = copy(kinds[request.param])
        another.reset()
        return another

    return made


@pytest.mark.parametrize("seed", range(2))
def test_the_order_of_arrival_does_not_matter(make, seed):
    # Three sensors of different latencies, some stamps equal: by stamp or by arrival is the same.
    random = np.random.default_rng(seed)
    told = [(k / 100, "mouse", (random.normal(size=2), 0.01), 0.0) for k in range(1, 40)]
    told += [(k / 100, "imu", (random.normal(size=2), 0.1, (0.35, 0.015)), 0.01) for k in range(40)]
    told += [(k / 200, "pose", (0.01 * random.normal(size=3),), 0.0213) for k in range(1, 80)]
    told.append((0.0, "pose", (np.zeros(3),), -1.0))
    found = []
    for order in (lambda m: m[0], lambda m: m[0] + m[3]):
        ours, commands = make(), some_commands(0.45, seed)
        ours.pose(-0.001, np.zeros(3))
        ours.mouse(-0.001, np.zeros(2), 0.01)
        told.sort(key=lambda m: (m[0], m[3]))
        for time, kind, values, late in sorted(told, key=order):
            while commands and commands[0][0] <= time + max(late, 0):
                ours.command(*commands.pop(0))
            getattr(ours, kind)(time, *values)
            assert len(ours._history) < 60
        found.append(ours.predict(0.41))
    one, other = found
    np.testing.assert_allclose(one.state, other.state, atol=1e-9)
    np.testing.assert_allclose(one.disturbance, other.disturbance, atol=1e-7)
    np.testing.assert_allclose(one.motor_speed, other.motor_speed, atol=1e-12)


def test_later_data_do_not_change_earlier_estimates(make):
    random = np.random.default_rng(1)
    poses = 0.02 * random.normal(size=(60, 3))
    other = poses.copy()
    other[30:] += 0.5

    def estimates(poses: np.ndarray) -> list[tuple[Estimate, np.ndarray]]:
        ours, found = make(), []
        commands = some_commands(0.3)
        for k, pose in enumerate(poses):
            time = k / 240
            while commands and commands[0][0] <= time:
                ours.command(*commands.pop(0))
            ours.pose(time, pose)
            estimate = ours.predict(time + 0.01)
            found.append((estimate, np.append(estimate.state, estimate.disturbance)))
        return found

    one, two = estimates(poses), estimates(other)
    for k, ((kept, then), (_, changed)) in enumerate(zip(one, two, strict=True)):
        # An estimate that was returned does not change later either.
        np.testing.assert_array_equal(np.append(kept.state, kept.disturbance), then)
        assert np.array_equal(then, changed) == (k < 30)


def test_a_command_acts_exactly_after_the_transport_delay(make):
    assert DELAY > 0
    with_it, without = (make() for _ in range(2))
    command, sent = np.linspace(0.2, 0.9, 6), 0.1
    for one in (with_it, without):
        one.pose(0.0, np.zeros(3))
    with_it.command(sent, command)
    for time in (sent, sent + DELAY - 1e-9, sent + DELAY):
        one, other = with_it.predict(time), without.predict(time)
        np.testing.assert_allclose(one.state, other.state, atol=1e-15)
        np.testing.assert_allclose(one.motor_speed, other.motor_speed, atol=1e-15)
    for later in (1e-6, 0.01, 0.1, 1.0):
        found = with_it.predict(sent + DELAY + later)
        expected = command + (IDLE - command) * np.exp(-later / TAU)
        np.testing.assert_allclose(found.motor_speed, expected, rtol=1e-12)
    start = np.concatenate([np.zeros(6), IDLE])
    end = sent + DELAY + 0.02
    truth = simulate([(sent, command)], start, np.array([0.0, end]))[-1]
    np.testing.assert_allclose(with_it.predict(end).state[:2], truth[:2], atol=1e-4)


def test_a_command_announced_early_acts_the_same(make):
    # Only the time at which it acts matters, not the number of poses in between.
    command = np.linspace(0.2, 0.9, 6)
    one, other = (make() for _ in range(2))
    one.command(0.05, command)
    for k in range(40):
        time = k / 240
        if k == 12:  # at 0.05 s
            other.command(0.05, command)
        for each in (one, other):
            each.pose(time, np.zeros(3))
    np.testing.assert_array_equal(one.predict(0.2).state, other.predict(0.2).state)


def test_wrapped_and_continuous_yaw_give_the_same_result(make):
    one, other = (make() for _ in range(2))
    for k in range(200):
        time, yaw = k / 240, 2.5 + 12 * k / 240
        one.pose(time, np.array([0.1, 0.2, yaw]))
        other.pose(time, np.array([0.1, 0.2, np.arctan2(np.sin(yaw), np.cos(yaw))]))
        np.testing.assert_allclose(one.predict(time).state, other.predict(time).state, atol=1e-9)
    assert one.predict(199 / 240).state[5] == pytest.approx(12, abs=0.1)
    assert one.predict(199 / 240).state[2] == pytest.approx(2.5 + 12 * 199 / 240, abs=1e-2)


def test_a_pose_outside_the_gate_has_no_effect(make):
    ours, fresh = (make() for _ in range(2))
    gate = 0.1, 0.1, 1.0
    commands = some_commands(0.3)
    for one in (ours, fresh):
        for command in commands:
            one.command(*command)
    for k in range(60):
        time = k / 240
        if k % 7 == 3:
            for jump in ([0.3, 0, 0], [0, -0.3, 0], [0, 0, 1.5]):
                assert not ours.pose(time - 1e-3, np.array(jump), gate)
        for one in (ours, fresh):
            assert one.pose(time, np.zeros(3), gate)
        # A whole turn is not a jump.
        np.testing.assert_array_equal(ours.predict(time).state, fresh.predict(time).state)
    assert ours.pose(0.26, np.array([0, 0, 2 * np.pi]), gate)


@pytest.mark.parametrize("jump", [[0.3, 0, 0], [0, -0.3, 0], [0, 0, 1.5]])
def test_a_late_pose_outside_the_gate_has_no_effect(make, jump):
    ours, fresh = (make() for _ in range(2))
    gate = 0.1, 0.1, 1.0
    for one in (ours, fresh):
        one.pose(0.0, np.zeros(3), gate)
        for k in range(1, 8):
            one.imu(k / 100, np.zeros(2), 0.0, (0.35, 0.015))
    assert not ours.pose(0.045, np.array(jump), gate)
    np.testing.assert_array_equal(ours.predict(0.1).state, fresh.predict(0.1).state)
    assert ours.pose(0.045, np.array(jump) / 4, gate)
    assert np.abs(ours.predict(0.1).state[:3] - fresh.predict(0.1).state[:3]).max() > 1e-3


def test_before_the_first_pose_there_is_no_estimate(make):
    ours = make()
    ours.command(0.0, IDLE)
    ours.imu(0.0, np.zeros(2), 0.0, (0.1, 0.1))
    ours.mouse(0.1, np.zeros(2), 0.1)
    assert ours.time is None


def test_a_restart_keeps_motor_speeds_and_pending_commands(make):
    ours = make()
    command = np.linspace(0.2, 0.9, 6)
    ours.pose(0.0, np.zeros(3))
    ours.command(0.0, command)
    ours.command(0.1, IDLE)
    ours.restart(0.1, np.array([1.0, 2.0, 3.0]))
    now = ours.predict(0.1)
    np.testing.assert_allclose(now.state, [1, 2, 3, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(now.disturbance, np.zeros(3), atol=1e-12)
    reached = command + (IDLE - command) * np.exp(-(0.1 - DELAY) / TAU)
    np.testing.assert_allclose(now.motor_speed, reached, rtol=1e-12)
    later = 0.1 + DELAY + 0.02
    peak = command + (IDLE - command) * np.exp(-0.1 / TAU)
    np.testing.assert_allclose(
        ours.predict(later).motor_speed, IDLE + (peak - IDLE) * np.exp(-0.02 / TAU), rtol=1e-12
    )


def test_a_reset_forgets_everything(make):
    used, fresh = (make() for _ in range(2))
    used.pose(0.0, np.ones(3))
    used.command(0.0, np.full(6, 0.5))
    used.pose(0.1, np.ones(3))
    used.reset()
    assert used.time is None
    for one in (used, fresh):
        one.pose(0.0, np.zeros(3))
    np.testing.assert_array_equal(used.predict(0.3).state, fresh.predict(0.3).state)


def test_a_composed_function_receives_the_prediction(make):
    def energy(xp, state, speed, disturbance, effectiveness, weight):
        moving = xp.sum(weight * state[3:] ** 2)
        return xp.stack([moving, xp.sum(disturbance)]), speed * effectiveness

    ours, weight = make(), np.array([1.0, 2.0, 0.1])
    composed = ours.composed(energy, weight)
    for command in some_commands(0.2, 5):
        ours.command(*command)
    for k in range(20):
        ours.pose(k / 100, np.array([0.002 * k, 0.001 * k * k, 0.01 * k]))
    expected = ours.predict(0.23)
    found, (sums, thrusting) = ours.predict_with(composed, 0.23, weight)
    for name in ("state", "motor_speed", "disturbance", "effectiveness"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
    moving, pushed = weight @ expected.state[3:] ** 2, expected.disturbance.sum()
    np.testing.assert_allclose(sums, [moving, pushed], rtol=1e-10)
    np.testing.assert_allclose(thrusting, expected.motor_speed * expected.effectiveness, rtol=1e-10)
    assert (found.time, found.actuation is None) == (0.23, expected.actuation is None)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_measurements_are_ignored(make, bad):
    seen, spared = (TrackingController(MODEL, SetPoint(0, 0, 0), compiled=False) for _ in range(2))
    seen.filter, spared.filter = make(), make()
    for k in range(30):
        time = k / 240
        for one in (seen, spared):
            one.pose(time, np.array([0.001 * k, 0, 0]))
        for place in range(3):
            pose = np.zeros(3)
            pose[place] = bad
            seen.pose(time + 1e-3, pose)
        seen.pose(bad, np.zeros(3))
        seen.measured(Measurement("imu", time + 1e-3, np.array([0, bad, 0, 0, 0, 0])))
        seen.measured(Measurement("imu", time + 1e-3, np.array([0, 0, 0, 0, 0, bad])))
        seen.measured(Measurement("mouse", time + 1e-3, np.array([bad, 0])))
        one, other = seen.filter.predict(time + 0.05), spared.filter.predict(time + 0.05)
        np.testing.assert_array_equal(one.state, other.state)
        np.testing.assert_array_equal(one.disturbance, other.disturbance)
        assert np.isfinite(one.state).all()
        assert np.isfinite(one.effectiveness).all()
