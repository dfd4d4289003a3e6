"""The transport delay by correlation."""

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.model.model_file import published_model
from airpuck.model.parameters import nominal_parameters
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import acceleration
from airpuck.preprocessing.delay import estimate_delay

from ..synthetic import fly

VEHICLE = default_vehicle()
NOMINAL = nominal_parameters(VEHICLE).dynamics(np, VEHICLE)


def shifted(samples):
    """A flight whose motion lags its commands by whole samples (or precedes them)."""
    flight = fly(published_model("M3"), duration=8.0, seed=4)
    motion = slice(max(-samples, 0), len(flight) - max(samples, 0))
    cause = slice(max(samples, 0), len(flight) - max(-samples, 0))
    return (
        flight.time[: len(flight) - abs(samples)],
        flight.state[motion],
        flight.acceleration[motion],
        flight.input[cause],
    )


@pytest.mark.parametrize("samples", [0, 1, 4, 5, 12, 48])
def test_finds_whole_samples(samples):
    estimate = estimate_delay(*shifted(samples), NOMINAL)
    assert estimate.samples == samples
    assert estimate.correlation > 0.9


def test_motion_before_its_commands_is_negative():
    assert estimate_delay(*shifted(-7), NOMINAL).samples == -7


def test_unusable_samples_do_not_count():
    time, state, acceleration, command = shifted(4)
    usable = np.ones(len(time), dtype=bool)
    usable[300:500] = False
    acceleration = acceleration.copy()
    acceleration[300:500] = 1e6
    assert estimate_delay(time, state, acceleration, command, NOMINAL, usable).samples == 4


def test_unrelated_commands_have_no_correlation():
    time, state, acceleration, command = shifted(4)
    other = np.random.default_rng(0).permutation(command)
    assert estimate_delay(time, state, acceleration, other, NOMINAL).correlation < 0.3


def test_flights_shorter_than_the_longest_delay():
    flight = [values[300:400] for values in shifted(4)]
    assert abs(estimate_delay(*flight, NOMINAL).samples - 4) <= 1


def test_the_correlation_is_that_of_paired_accelerations():
    time, state, measured, command = shifted(4)
    found = estimate_delay(time, state, measured, command, NOMINAL).correlation
    speed = motor_speeds(time, command, NOMINAL.motor_time_constant)[:-4]
    modelled = np.stack(acceleration(np, NOMINAL, state[4:, 2:].T, speed.T))
    cosine = [
        a @ b / np.linalg.norm(a) / np.linalg.norm(b)
        for a, b in zip(measured[4:].T, modelled, strict=True)
    ]
    assert found == pytest.approx(np.mean(cosine), rel=1e-9)
