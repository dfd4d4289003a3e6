"""One-step innovations: the predictor, its noise, and simulation."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, Span
from airpuck.estimate.axis_filter import Noise
from airpuck.estimate.kalman import KalmanFilter
from airpuck.evaluation.innovations import (
    Innovations,
    cut_at_commands,
    free_run,
    innovations,
    most_likely_noise,
    motor_speeds_at,
)
from airpuck.model.model_file import published_model

from ..apparatus.noisy_flights import POSE_NOISE, TRUTH, noisy


@pytest.fixture(scope="module")
def flight():
    return noisy(duration=6.0, seed=3)


def test_intervals_are_split_where_commands_change():
    time = np.array([0.0, 1.0, 2.0, 3.0])
    events = np.array([-0.5, 1.2, 1.7, 2.0, 9.0])
    command = np.arange(5.0)[:, None]
    durations, acting = cut_at_commands(time, events, command)
    assert durations.shape == (4, 4)
    np.testing.assert_allclose(durations.sum(axis=1), [0, 1, 1, 1])
    # Each interval's integral of the command, by hand.
    area = (durations * acting[..., 0]).sum(axis=1)
    np.testing.assert_allclose(area, [0, 0, 0.2 * 0 + 0.5 * 1 + 0.3 * 2, 3])


def test_motors_follow_all_commands_before_the_first_pose():
    events, command, tau = np.array([0.0, 0.1]), np.array([[0.2], [0.8]]), 0.05
    [speed] = motor_speeds_at(np.array([0.15]), events, command, tau)
    np.testing.assert_allclose(speed, 0.8 - 0.6 * np.exp(-0.05 / tau))


def test_the_filter_matches_the_controllers_with_exact_integration(flight):
    # The real-time filter integrates by the midpoint rule and knows the pose's noise beforehand.
    noise = Noise(POSE_NOISE, (0.05, 0.05, 1.0), (0.1, 0.1, 3.0))
    found = innovations(TRUTH, flight, noise)
    online = KalmanFilter(TRUTH.with_delay(0.0), noise, compiled=False)
    speeds = []
    sent = 0
    for k in range(300):
        while flight.command_time[sent] <= flight.time[k]:
            online.command(flight.command_time[sent], flight.command[sent])
            sent += 1
        online.pose(flight.time[k], flight.state[k, :3])
        speeds.append(online.predict(flight.time[k]).state)
    late = slice(200, 300)
    ours = np.concatenate([found.mean[late, :, 0], found.mean[late, :, 1]], axis=1)
    scale = np.sqrt(found.covariance[250][:, [0, 1], [0, 1]]).T.ravel()
    assert (np.abs(ours - np.array(speeds)[late]) < 0.5 * scale).all()


def test_innovation_deviations_combine_prediction_and_pose_noise(flight):
    noise = Noise(POSE_NOISE, (0.05, 0.05, 1.0), (0.0, 0.0, 0.0))
    found, step = innovations(TRUTH, flight, noise), np.diff(flight.time)[:, None]
    place, both, speed = np.moveaxis(found.covariance[:-1, :, [0, 0, 1], [0, 1, 1]], 2, 0)
    density, pose = np.square(noise.acceleration), np.square(noise.pose)
    expected = place + 2 * step * both + step**2 * speed + density * step**3 / 3 + pose
    inside = slice(10, 400)
    np.testing.assert_allclose(found.deviation[1:][inside] ** 2, expected[inside], rtol=1e-6)


def test_maximum_likelihood_recovers_the_added_noise(flight):
    found = innovations(TRUTH, flight)
    np.testing.assert_allclose(found.noise.pose, POSE_NOISE, rtol=0.06)
    # The model is true: nothing else moves the craft.
    assert max(found.noise.acceleration[:2]) < 1e-3
    assert found.noise_parameters <= (2, 2, 2)
    scaled = found.standardised[found.used]
    np.testing.assert_allclose(scaled.std(axis=0), 1, atol=0.05)


def test_maximum_likelihood_recovers_the_noise_densities():
    # A body that only noise moves, with different densities on each axis.
    rng, n, h = np.random.default_rng(5), 6000, 1 / 240
    density, pose_noise = np.array([0.05, 0.2, 2.0]), np.array(POSE_NOISE)
    kicks = rng.normal(size=(n, 3)) * density * np.sqrt(h)
    speed = np.cumsum(kicks, axis=0)
    place = np.cumsum(speed * h - kicks * h / 2, axis=0)
    pose = place + rng.normal(size=(n, 3)) * pose_noise
    restart = np.arange(n) == 0
    used = np.arange(n) > 1
    period = np.where(restart, 0.0, h)
    given = pose, np.zeros((n, 3, 2)), period, restart, np.ones(n, dtype=bool), used
    noise, counts = most_likely_noise(*given, h)
    np.testing.assert_allclose(noise.pose, pose_noise, rtol=0.05)
    np.testing.assert_allclose(noise.acceleration, density, rtol=0.2)
    assert min(counts) >= 2


def test_no_prediction_spans_an_excluded_span(flight):
    spoiled = flight.state.copy()
    bad = slice(600, 640)
    spoiled[bad, :3] += 1.0
    span = Span(float(flight.time[600]), float(flight.time[639]), "made up")
    found = innovations(TRUTH, replace(flight, state=spoiled, excluded=(span,)))
    assert not found.used[600:642].any()
    assert found.used[642]
    assert np.abs(found.standardised).max() < 6


def test_a_simulation_of_the_truth_stays_close(flight):
    found = innovations(TRUTH, flight)
    starts = np.array([100, 700])
    simulated = free_run(TRUTH, flight, found, starts)
    assert np.isnan(simulated[:100]).all()
    error = np.abs(simulated - flight.state[:, :3])[100:]
    assert error.max(axis=0) == pytest.approx([0, 0, 0], abs=0.1)
    # It restarts: at the second start the error equals the error of the filter's estimate.
    assert (error[600] < 6 * np.array(POSE_NOISE)).all()


def test_too_few_poses_are_rejected(flight):
    with pytest.raises(InputError, match="one-step"):
        innovations(TRUTH, flight.slice(0, 0.02))
    other = replace(flight, propellers=("a",), command=flight.command[:, :1])
    with pytest.raises(InputError, match="motors"):
        innovations(published_model("M3"), other)


@pytest.mark.parametrize("seed", range(20))
def test_starts_are_the_earliest_with_the_required_spacing(seed):
    rng = np.random.default_rng(seed)
    n, period, ahead, apart = 400, 0.05, int(rng.integers(1, 12)), int(rng.integers(1, 25))
    used = np.ones(n, bool)
    used[rng.integers(0, n, 12)] = False
    empty = np.zeros((n, 3))
    noise = Noise((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    found = Innovations(
        time=period * np.arange(n),
        values=empty,
        deviation=empty,
        follows=used,
        used=used,
        restart=~used,
        added=np.zeros((n, 3, 2)),
        mean=np.zeros((n, 3, 3)),
        covariance=np.zeros((n, 3, 3, 3)),
        motor_speed=np.zeros((n, 6)),
        noise=noise,
        noise_parameters=(0, 0, 0),
    )
    # A quarter of a second is five samples, the start itself among them.
    expected, last = [], -apart
    for k in range(4, n - ahead):
        if k - last >= apart and used[k - 4 : k + ahead + 1].all():
            expected.append(k)
            last = k
    assert found.starts(ahead, apart).tolist() == expected
