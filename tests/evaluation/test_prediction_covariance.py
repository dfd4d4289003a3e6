"""Errors of predictions: by hand, and against moved predictions in NumPy."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.estimate.axis_filter import Noise
from airpuck.evaluation.innovations import innovations
from airpuck.evaluation.prediction_bands import predict_with_errors
from airpuck.physics.motor import motor_step
from airpuck.physics.rollout import rollout

from ..noisy import POSE_NOISE, TRUTH, noisy
from ..predicted import predicted

STARTS, STEPS, LEAD = np.array([200, 300]), 48, 40
NOISE = Noise(POSE_NOISE, (0.05, 0.04, 1.0), (0.1, 0.2, 3.0))


@pytest.fixture(scope="module")
def flight():
    return noisy(duration=3.0, seed=6)


@pytest.fixture(scope="module")
def filtered(flight):
    """A filter's estimates without a disturbance, which NumPy's rollout does not know."""
    known = innovations(TRUTH, flight, NOISE)
    mean = known.mean.copy()
    mean[:, :, 2] = 0.0
    return replace(known, mean=mean)


def simulate(model, flight, known, turned=0.0):
    """The same predictions by the plain rollout; commands change at samples only."""
    held, mean = np.diff(flight.time), known.mean[STARTS]
    speed, at = known.motor_speed[STARTS - LEAD].T, STARTS[:, None]
    for k in (at + np.arange(-LEAD, 0)).T:
        tau = model.parameters.motor_time_constant
        speed = motor_step(np, speed, flight.input[k].T, held[k], tau)
    pose = mean[:, :, 0].T + np.array([0, 0, turned])[:, None]
    ahead = (at + np.arange(STEPS)).T
    commands = np.moveaxis(flight.input[ahead], 2, 1)
    state = np.concatenate([pose, mean[:, :, 1].T, speed])
    return rollout(np, model.dynamics, state, commands, held[ahead])[:, :3]


def predict(flight, known, entries=()):
    mask = np.zeros(len(TRUTH.free), dtype=bool)
    mask[list(entries)] = True
    return predict_with_errors(TRUTH, flight, known, STARTS, STEPS, mask)


def test_predictions_and_sensitivities_are_those_of_moved_parameters(flight, filtered):
    labels = TRUTH.parameters.labels(TRUTH.vehicle.propeller_names)
    names = ("thrust motor_b_1 φ^2", "inertia", "motor_time_constant", "center_of_mass x")
    entries = sorted(labels.index(name) for name in names)
    predicted, _, slopes = predict(flight, filtered, entries)
    np.testing.assert_allclose(predicted, simulate(TRUTH, flight, filtered), atol=1e-9)
    vector = TRUTH.parameters.to_vector()
    for k, entry in enumerate(entries):
        moved = []
        for sign in (1, -1):
            step = np.zeros_like(vector)
            step[entry] = sign * 1e-4 * abs(vector[entry])
            parameters = TRUTH.parameters.with_vector(vector + step)
            moved.append(simulate(replace(TRUTH, parameters=parameters), flight, filtered))
        slope = (moved[0] - moved[1]) / (2e-4 * abs(vector[entry]))
        scale = np.abs(slope).max(axis=(0, 2), keepdims=True)
        assert (np.abs(slopes[..., k] - slope) < 1e-4 * scale).all()


@pytest.mark.parametrize("late", [0.0, 3e-3])
def test_the_sensitivity_to_the_delay_is_that_of_commands_cut_elsewhere(flight, filtered, late):
    # Without delay the commands of this flight are at samples, where pieces begin and end.
    delay = TRUTH.parameters.mask(frozenset({"transport_delay"}))
    model = replace(TRUTH, free=TRUTH.free | delay).with_delay(TRUTH.transport_delay + late)
    _, _, slopes = predict_with_errors(model, flight, filtered, STARTS, STEPS, delay)
    step = 1e-6
    moved = [
        predicted(TRUTH, flight, filtered, STARTS, STEPS, late + sign * step) for sign in (1, -1)
    ]
    slope = (moved[0] - moved[1]) / (2 * step)
    scale = np.abs(slope).max(axis=(0, 2), keepdims=True)
    assert (np.abs(slopes[..., 0] - slope) < 1e-3 * scale).all()


def test_yaw_spreads_as_double_integrals_of_its_noises(flight, filtered):
    # Nothing else turns the craft: r + t² s + q₁t³/3 + (d + q₂ t³/20) t⁴/4 …, by hand.
    _, variance, _ = predict(flight, filtered)
    t = (flight.time[STARTS + STEPS] - flight.time[STARTS])[:, None, None]
    one, zero = np.ones_like(t), np.zeros_like(t)
    by_start = np.concatenate([one, t, t**2 / 2], axis=2)
    start = (by_start @ filtered.covariance[STARTS, 2] @ np.moveaxis(by_start, 1, 2)) + zero
    t = t[:, 0, 0]
    expected = start[:, 0, 0] + NOISE.acceleration[2] ** 2 * t**3 / 3
    expected += NOISE.disturbance[2] ** 2 * t**5 / 20
    np.testing.assert_allclose(variance[-1, 2], expected, rtol=1e-6)


def test_what_is_not_known_of_yaw_spreads_to_x_and_y(flight, filtered):
    sigma = 1e-3
    only_yaw = np.zeros_like(filtered.covariance)
    only_yaw[:, 2, 0, 0] = sigma**2
    silent = Noise(POSE_NOISE, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    _, variance, _ = predict(flight, replace(filtered, covariance=only_yaw, noise=silent))
    plus, minus = (simulate(TRUTH, flight, filtered, turned) for turned in (1e-4, -1e-4))
    np.testing.assert_allclose(
        np.sqrt(variance), sigma * np.abs(plus - minus) / 2e-4, rtol=1e-4, atol=1e-10
    )
    assert (np.sqrt(variance[-1, :2]) > 1e-5).any()
