"""The transport delay by correlation."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.data.trajectory import Span
from airpuck.model.model_file import published_model
from airpuck.model.parameters import nominal_parameters
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import acceleration
from airpuck.preprocessing.delay import commands_explain, estimate_delay, motion_precedes

from ..apparatus.synthetic_flights import fly

VEHICLE = default_vehicle()
NOMINAL = nominal_parameters(VEHICLE).dynamics(np, VEHICLE)


def shifted(samples, kept=slice(None)):
    """A flight whose motion lags its commands by whole samples (or precedes them)."""
    flight = fly(published_model("M3"), duration=8.0, seed=4)
    motion = slice(max(-samples, 0), len(flight) - max(samples, 0))
    cause = slice(max(samples, 0), len(flight) - max(-samples, 0))
    time = flight.time[: len(flight) - abs(samples)][kept]
    return replace(
        flight,
        time=time,
        state=flight.state[motion][kept],
        acceleration=flight.acceleration[motion][kept],
        command_time=time,
        command=flight.input[cause][kept],
        delay=0.0,
    )


@pytest.mark.parametrize("samples", [0, 1, 4, 5, 12, 48])
def test_a_delay_of_whole_samples_is_found(samples):
    found, correlation = estimate_delay(shifted(samples), NOMINAL)
    assert found == samples
    assert correlation > 0.9


def test_motion_before_its_commands_gives_a_negative_delay():
    assert estimate_delay(shifted(-7), NOMINAL)[0] == -7


def test_unusable_samples_are_ignored():
    flight = shifted(4)
    flight.acceleration[300:500] = 1e6
    span = Span(flight.time[300], flight.time[499], "wrong")
    assert estimate_delay(replace(flight, excluded=(span,)), NOMINAL)[0] == 4


def test_unrelated_commands_have_no_correlation():
    flight = shifted(4)
    other = np.random.default_rng(0).permutation(flight.command)
    assert estimate_delay(replace(flight, command=other), NOMINAL)[1] < 0.3


@pytest.mark.parametrize("samples", [-24, 4])
def test_only_commands_of_the_flight_explain_its_motion(samples):
    flight = shifted(samples)
    other = np.random.default_rng(0).permutation(flight.command)
    assert commands_explain(shifted(4), NOMINAL)
    assert not commands_explain(replace(flight, command=other), NOMINAL)
    assert motion_precedes(flight, NOMINAL) == (samples < 0)


def test_the_delay_of_a_short_flight_is_estimated():
    assert abs(estimate_delay(shifted(4, slice(300, 400)), NOMINAL)[0] - 4) <= 1


def test_the_correlation_matches_paired_accelerations():
    flight = shifted(4)
    _, found = estimate_delay(flight, NOMINAL)
    speed = motor_speeds(flight.time, flight.command, NOMINAL.motor_time_constant)[:-4]
    modelled = np.stack(acceleration(np, NOMINAL, flight.state[4:, 2:].T, speed.T))
    cosine = [
        a @ b / np.linalg.norm(a) / np.linalg.norm(b)
        for a, b in zip(flight.acceleration[4:].T, modelled, strict=True)
    ]
    assert found == pytest.approx(np.mean(cosine), rel=1e-9)
