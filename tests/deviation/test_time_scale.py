"""The times for which a craft must be watched, and its poses smoothed."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.time_scale import measured_poses, patience, showing_time
from airpuck.preprocessing.derivative import (
    VELOCITY_TIME,
    acceleration,
    is_slow,
    smoothing_times,
    velocity,
)

PAPER = default_vehicle()


def pushing(push: float) -> Vehicle:
    """A craft whose actuators accelerate it by `push` at full command [m/s²]."""
    nominal = PAPER.nominal.model_copy(update={"thrust_N": (push * PAPER.mass_kg,)})
    return PAPER.model_copy(update={"nominal": nominal})


def watched(period: float, noise: float, push: float, seed: int = 0) -> Trajectory:
    """A motion with the acceleration ± push along x, which changes at random, and noise."""
    rng = np.random.default_rng(seed)
    time = period * np.arange(2000)
    moved = period**2 * np.cumsum(np.cumsum(push * np.repeat(rng.choice([-1, 1], 200), 10)))
    state = np.zeros((len(time), 6))
    state[:, :2] = np.stack([moved, 0 * moved], axis=1) + noise * rng.normal(size=(len(time), 2))
    return Trajectory(
        time=time,
        state=state,
        acceleration=np.zeros((len(time), 3)),
        command_time=time,
        command=np.zeros((len(time), 6)),
        propellers=PAPER.propeller_names,
    )


@pytest.mark.parametrize(("noise", "push"), [(1e-4, 0.02), (1e-2, 0.02), (1e-2, 1.0)])
def test_the_time_scale_is_when_motion_reaches_fifty_standard_deviations(noise, push):
    expected = np.sqrt(2 * 50 * noise / push)
    found = showing_time([watched(0.02, noise, push)], pushing(push))
    assert found == pytest.approx(min(expected, 3.0), rel=0.1)


def test_motion_between_sparse_poses_is_not_noise():
    assert showing_time([watched(0.125, 0.0, 1.0)], pushing(1.0)) < 0.05


def test_pauses_between_poses_are_not_noise():
    flight = watched(0.02, 1e-4, 0.02)
    kept = np.random.default_rng(1).random(len(flight)) > 0.1
    thinned = replace(
        flight,
        time=flight.time[kept],
        state=flight.state[kept],
        acceleration=flight.acceleration[kept],
    )
    whole = showing_time([flight], pushing(0.02))
    assert showing_time([thinned], pushing(0.02)) == pytest.approx(whole, rel=0.1)


def test_the_noisiest_recording_determines_the_time():
    flights = [watched(0.02, noise, 0.02) for noise in (1e-4, 4e-4)]
    assert showing_time(flights, pushing(0.02)) == showing_time(flights[1:], pushing(0.02))


def test_the_papers_craft_keeps_its_smoothing():
    flight = watched(1 / 240, 7e-5, 3.0)
    assert smoothing_times(*measured_poses(flight), PAPER) == (VELOCITY_TIME, VELOCITY_TIME)
    assert patience(PAPER) == patience(pushing(30.0)) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "push"), [(5e-5, 0.0125), (2e-4, 0.1), (1e-3, 0.1)])
def test_smoothing_is_near_the_best_for_velocities(noise, push):
    period, hold = 1 / 100, 2.0
    rng = np.random.default_rng(0)
    time = period * np.arange(30_000)
    signs = np.repeat(rng.choice([-1, 1], len(time)), round(hold / period))[: len(time)]
    truth = period * (np.cumsum(push * signs) - push * signs / 2)
    moved = period * np.cumsum(truth + push * signs * period / 2)
    position = np.stack([moved, 0 * moved], axis=1) + noise * rng.normal(size=(len(time), 2))
    truth = np.gradient(moved, time)

    def error(duration: float) -> float:
        found = velocity(time, position, period, duration)[:, 0]
        return float(np.sqrt(np.mean((found - truth) ** 2)))

    pose = np.column_stack([position, 0 * moved])
    chosen, of_yaw = smoothing_times(time, pose, pushing(push))
    assert error(chosen) < 1.5 * min(error(d) for d in np.geomspace(0.05, 0.5, 8))
    assert of_yaw == VELOCITY_TIME  # which has no noise


def test_noise_in_yaw_lengthens_only_the_smoothing_of_yaw():
    flight = watched(1 / 120, 2e-5, 3.0)
    noise = 0.015 * np.random.default_rng(1).normal(size=len(flight))
    noisy = replace(flight, state=flight.state + np.outer(noise, np.eye(6)[2]), vehicle=PAPER)
    position, yaw = smoothing_times(*measured_poses(noisy), PAPER)
    assert position == VELOCITY_TIME < yaw
    assert is_slow(noisy)
    assert not is_slow(replace(flight, vehicle=PAPER))


def test_long_smoothing_preserves_cubics_on_uneven_samples():
    time = np.cumsum(np.random.default_rng(2).uniform(0.01, 0.02, 300))
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.3])
    values = cubic(time)[:, None]
    for found, order in ((velocity, 1), (acceleration, 2)):
        expected = cubic.deriv(order)(time)[:, None]
        np.testing.assert_allclose(found(time, values, 0.015, 0.3), expected, rtol=1e-6, atol=1e-6)


def test_patience_grows_with_the_time_to_move_a_centimetre():
    assert patience(pushing(0.02)) == pytest.approx(1.0 / 0.075)
