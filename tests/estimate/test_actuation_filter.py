"""Motor effectiveness in flight: against the Kalman filter, the encoder, and known faults."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from airpuck import SetPoint, TrackingController
from airpuck.control.tuning import default_tuning
from airpuck.data.windows import Past
from airpuck.estimate import actuation
from airpuck.estimate.actuation import ActuationEncoder, EffectivenessPrior
from airpuck.estimate.axis_filter import Noise
from airpuck.estimate.estimator import ActuationEstimate, Estimate
from airpuck.estimate.kalman import ActuationFilter, KalmanFilter
from airpuck.model.model_file import published_model
from airpuck.physics.rigid_body import acceleration

from ..apparatus.measured_flights import IDLE, MODEL, NOISE, some_commands
from ..apparatus.models import scaled
from ..apparatus.random_flights import random_flight

M3 = replace(published_model("M3"), indexing="start").with_delay(0.0)
#: Noise of the twin's cameras, and a nearly constant disturbance.
QUIET = Noise(
    pose=(5e-5, 5e-5, 6e-4), acceleration=(0.02, 0.02, 0.6), disturbance=(0.02, 0.02, 0.6)
)


@pytest.fixture(scope="module")
def compiled():
    return ActuationFilter(M3, QUIET)


@pytest.fixture
def ours(compiled):
    """A new filter, with programs compiled once for all tests."""
    fresh = copy(compiled)
    fresh.reset()
    return fresh


def flown(ours, share, duration, seed=0):
    """Feed a random flight with noise of the cameras; return some estimates."""
    flight = random_flight(scaled(M3, share), duration, seed)
    noise = np.random.default_rng(seed).normal(size=(len(flight.time), 3)) * QUIET.pose
    found = []
    for time, state, command, off in zip(
        flight.time.tolist(), flight.state, flight.command, noise, strict=True
    ):
        ours.command(time, command)
        ours.pose(time, state[:3] + off)
        if len(found) % 60 == 0 or time == flight.time[-1]:
            found.append(ours.predict(time))
        else:
            found.append(None)
    return flight, found


def test_with_certain_motors_it_equals_the_kalman_filter():
    sure = ActuationEncoder(priors=(EffectivenessPrior(1.0, 0.0, 1e-9, "healthy"),))
    one = ActuationFilter(MODEL, NOISE, encoder=sure, delay_deviation=0.0, compiled=False)
    other = KalmanFilter(MODEL, NOISE, compiled=False)
    random, commands = np.random.default_rng(0), some_commands(0.3)
    for each in (one, other):
        for command in commands:
            each.command(*command)
    time, pose = 0.0, np.zeros(3)
    for k in range(40):
        kind = random.choice(["pose", "pose", "imu", "mouse"]) if k else "pose"
        pose = pose + 1e-4 * random.normal(size=3)
        force, gyro = 0.3 * random.normal(size=2), 0.05 * random.normal()
        for each in (one, other):
            if kind == "pose":
                each.pose(time, pose)
            elif kind == "imu":
                each.imu(time, force, gyro, (0.35, 0.15))
            else:
                each.mouse(time, 0.03 * force, 0.1)
        mine, theirs = one.predict(time + 0.02), other.predict(time + 0.02)
        np.testing.assert_allclose(mine.state, theirs.state, atol=1e-7)
        np.testing.assert_allclose(mine.disturbance, theirs.disturbance, atol=1e-5)
        np.testing.assert_allclose(mine.motor_speed, theirs.motor_speed, rtol=1e-12)
        time += random.uniform(1e-3, 8e-3)


@pytest.mark.parametrize("seed", range(3))
def test_the_recursion_equals_the_encoders_regression(monkeypatch, seed):
    # One prior, no disturbance, motor speeds known: both are the same linear Gaussian problem.
    monkeypatch.setattr(actuation, "_FIRST_SPEED", 0.0)
    share = [1.0, 0.6, 1.0, 1.1, 0.9, 1.0]
    flight = random_flight(scaled(M3, share), 1.0, seed)
    rng = np.random.default_rng(seed)
    pose = flight.state[:, :3] + rng.normal(size=(len(flight.time), 3)) * [5e-5, 5e-5, 6e-4]
    prior = EffectivenessPrior(1.0, 0.1, 0.3)
    encoder = ActuationEncoder(velocity="causal", priors=(prior,))
    still = Noise((5e-5, 5e-5, 6e-4), (0.086, 0.086, 2.1), (0.0, 0.0, 0.0))
    one = ActuationFilter(
        M3, still, encoder=encoder, lasting=1e9, delay_deviation=0.0, compiled=False
    )
    length, first = 60, 30
    # The first command has acted for a long time before the window begins.
    one.command(flight.time[first] - 10, flight.command[first])
    for k in range(first, first + length):
        one.command(flight.time[k], flight.command[k])
        one.pose(flight.time[k], pose[k])
    part = slice(first, first + length)
    state = np.concatenate([pose[part], np.zeros((length, 3))], axis=1)
    past = Past(
        state[..., None], flight.command[part][..., None], np.diff(flight.time[part])[:, None]
    )
    offline = encoder.estimate(M3.dynamics, past)
    online = one.predict(float(flight.time[first + length - 1]))
    assert online.actuation is not None
    spread = offline.deviation[:, 0]
    assert spread.min() < 0.15  # something was learned
    np.testing.assert_allclose(online.actuation.deviation, spread, rtol=0.1)
    apart = online.effectiveness - offline.effectiveness[:, 0]
    assert (np.abs(apart) < 0.35 * spread).all()
    np.testing.assert_allclose(online.state[:2], offline.state[:2, 0], atol=5e-5)
    np.testing.assert_allclose(online.state[3:5], offline.state[3:5, 0], atol=5e-3)


@pytest.mark.parametrize("motor", [0, 3, 5])
def test_a_motor_at_60_percent_is_estimated_at_60_percent(ours, motor):
    share = np.ones(6)
    share[motor] = 0.6
    _, found = flown(ours, share, 3.0, seed=motor)
    last = found[-1].actuation
    off = (last.effectiveness - share) / last.deviation
    assert last.deviation[motor] < 0.15
    assert abs(last.effectiveness[motor] - 0.6) < 0.15
    assert np.abs(off).max() < 3.5


def test_deviations_match_the_actual_errors(ours):
    # Over many instants of flights with any losses: 95 % within two of them, or more.
    random, off = np.random.default_rng(3), []
    for seed in range(3):
        ours.reset()
        share = np.clip(1 + 0.05 * random.normal(size=6), 0, 1.2)
        share[seed] = random.uniform(0.2, 0.8)
        _, found = flown(ours, share, 2.5, seed=seed + 10)
        for one in found[240::60]:
            off.append((one.effectiveness - share) / one.actuation.deviation)
    assert np.mean(np.abs(off) < 2) > 0.88
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_a_motor_that_dies_or_recovers_in_flight_is_detected_immediately(ours):
    healthy, dead = np.ones(6), np.array([1, 1, 0.0, 1, 1, 1])
    time = 0.0
    for share, right in ((healthy, 1.0), (dead, 0.0), (healthy, 1.0)):
        flight = random_flight(scaled(M3, share), 1.5, 5)
        for k, z in enumerate(flight.state):
            ours.command(time + k / 240, flight.command[k])
            ours.pose(time + k / 240, z[:3])
        time += len(flight.time) / 240 + 0.06  # as if it had been carried back unseen
        found = ours.predict(time - 0.06)
        assert found.actuation is not None
        if right == 0:
            assert found.actuation.probability["single motors"] > 0.9
        assert found.effectiveness[2] == pytest.approx(right, abs=0.2)


def test_idling_motors_return_to_the_healthy_prior(ours):
    rng = np.random.default_rng(0)
    _, found = flown(ours, [1, 1, 0.0, 1, 1, 1], 2.0)
    assert found[-1].effectiveness[2] < 0.2
    ours.command(2.0, np.zeros(6))
    ours.restart(3.0, np.zeros(3))
    assert ours.predict(3.0).effectiveness[2] < 0.5  # a restart at a pose keeps the motors
    for k in range(1, 8 * 100):
        ours.pose(3.0 + k / 100, rng.normal(size=3) * QUIET.pose)
    after = ours.predict(11.0)
    # The estimate is forgotten and replaced by the prior of a motor.
    np.testing.assert_allclose(after.effectiveness, 1, atol=0.12)
    priors = ActuationEncoder().priors
    of_any = np.sqrt(sum(p.weight * (p.common**2 + p.single**2) for p in priors))
    assert after.actuation is not None
    others = np.delete(after.actuation.deviation, 2)
    np.testing.assert_allclose(others, of_any, rtol=0.15)
    assert after.actuation.deviation[2] > of_any


def test_a_rail_is_not_blamed_on_motors(ours):
    # Half a metre per second, turned back within a frame.
    flight = random_flight(M3, 1.5, 2)
    knock = np.array([0.5, -0.3, 4.0])
    for k, z in enumerate(flight.state):
        later = max(flight.time[k] - 0.8, 0.0)
        ours.command(float(flight.time[k]), flight.command[k])
        ours.pose(float(flight.time[k]), z[:3] + knock * [1, 1, 0] * later)
    np.testing.assert_allclose(ours.predict(1.5).effectiveness, 1, atol=0.2)


def test_the_delay_starts_at_its_prior():
    before = ActuationFilter(MODEL, NOISE, delay_deviation=0.002, compiled=False)
    before.command(0.0, np.full(6, 0.3))
    before.pose(0.0, np.zeros(3))
    assert before.predict(0.0).actuation.delay_deviation == pytest.approx(0.002, rel=0.01)


def test_longer_delays_are_estimated(ours):
    # Commands act 4 ms later than the filter assumes.
    flight = random_flight(M3, 3.0, 4)
    for k, z in enumerate(flight.state):
        ours.command(float(flight.time[k]) - 0.004, flight.command[k])
        ours.pose(float(flight.time[k]), z[:3])
    told = ours.predict(3.0).actuation
    assert told.delay == pytest.approx(0.004, abs=0.0015)
    assert told.delay_deviation < 0.002


def test_commands_account_for_the_thrust_that_motors_give():
    # A feasible request is met if the weak motor is known, and missed otherwise.
    share = np.array([1, 0.6, 1, 1, 0.8, 1.1])
    controller = TrackingController(MODEL, SetPoint(0.01, 0.01, 0.05), compiled=False)
    speed = np.full(6, 0.35)
    known = ActuationEstimate(share, np.zeros(6))
    craft = scaled(MODEL, share).dynamics
    tau, h = float(craft.motor_time_constant), controller.tuning.period_s
    missed = []
    for actuation_estimate in (known, None):
        estimate = Estimate(0.0, np.zeros(6), speed, np.zeros(3), actuation_estimate)
        step = controller.steer(estimate, 0.0)
        assert step.status == "exact"
        after = step.command + (speed - step.command) * np.exp(-h / tau)
        # One period later the craft has turned a little.
        now = np.array(acceleration(np, craft, np.zeros(4), speed))
        yaw, spin = h * h / 2 * now[2], h * now[2]
        given = np.array(acceleration(np, craft, (yaw, *(h * now[:2]), spin), after))
        missed.append(np.abs(given - step.request).max())
    assert missed[0] < 1e-6
    assert missed[1] > 0.1


def test_the_tuning_selects_the_estimator():
    tuning = default_tuning().with_estimator("actuation")
    chosen = TrackingController(MODEL, SetPoint(0, 0, 0), tuning, compiled=False)
    assert isinstance(chosen.filter, ActuationFilter)
    chosen.pose(0.0, np.zeros(3))
    step = chosen.step(0.001)
    assert step.flies
    assert step.estimate is not None
    assert step.estimate.actuation is not None
    np.testing.assert_allclose(step.estimate.effectiveness, 1.0)
    assert sum(step.estimate.actuation.probability.values()) == pytest.approx(1)
    assert (step.command >= IDLE).all()
