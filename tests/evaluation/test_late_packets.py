"""Innovations under jitter, against flights whose packets come late by known amounts."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.deviation.packet_delays import delay_for
from airpuck.evaluation.innovations import innovations, motor_speeds_at
from airpuck.evaluation.late_packets import late_packets
from airpuck.evaluation.residuals import resid

from ..apparatus.models import scaled
from ..apparatus.noisy_flights import TRUTH, noisy

JITTER = 0.007
#: The truth, whose delay is known to a fraction of a sample.
MODEL = replace(TRUTH, free=TRUTH.free | TRUTH.parameters.mask(frozenset({"transport_delay"})))


def late_flight(seed, jitter=JITTER, later=0.0, duration=12.0):
    """A flight whose packets came late; its log contains only the mean delay."""
    flight = noisy(duration=duration, seed=seed)
    lateness = np.random.default_rng([seed, 3]).normal(size=len(flight.command_time)) * jitter
    sent = np.maximum.accumulate(flight.command_time - lateness)
    return replace(flight, command_time=sent - later)


def nothing(flight):
    return np.zeros((len(flight), 3, 0))


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, JITTER])
def test_jitter_is_estimated(jitter):
    flight = late_flight(0, jitter)
    late = late_packets(TRUTH, flight, innovations(TRUTH, flight), nothing(flight))
    # Delays of packets that wait for each other scatter less than the radio's.
    assert np.mean(late.jitter) == pytest.approx(jitter, abs=0.0015)


@pytest.mark.slow
def test_late_packets_do_not_reject_the_true_model():
    tests = resid(MODEL, late_flight(0))
    assert tests.passed, tests.verdicts
    delay = tests.errors[0]
    assert delay.value == pytest.approx(0.0, abs=0.003)


@pytest.mark.slow
def test_a_delay_is_distinguished_from_jitter():
    tests = resid(MODEL, late_flight(1, later=0.012))
    assert [error.name for error in tests.errors if not error.passed] == ["delay"]
    assert tests.errors[0].value == pytest.approx(0.012, abs=0.003)


def test_filter_and_directions_share_the_motors_of_a_model_with_idle_lag():
    """Otherwise a difference of 1 ms would contain the whole effect of the longer lag."""
    parameters = replace(TRUTH.parameters, idle_lag=2.0)
    model = replace(TRUTH, parameters=parameters, free=np.zeros(len(parameters.to_vector()), bool))
    flight = noisy(duration=2.0, seed=4)
    lag = float(model.parameters.motor_time_constant), model.parameters.idle_lag
    acts = flight.command_time + delay_for(model, flight)
    speeds = motor_speeds_at(flight.time, acts, flight.command, *lag)
    np.testing.assert_allclose(speeds, innovations(model, flight).motor_speed, atol=1e-9)


def test_directions_equal_differences_of_filtered_innovations():
    """The linear response to a stronger motor, against the innovations of a model with it."""
    flight, step = noisy(duration=4.0, seed=3), 1e-3
    before = innovations(TRUTH, flight)
    late = late_packets(TRUTH, flight, before, nothing(flight))
    after = innovations(scaled(TRUTH, [1, 1, 1 + step, 1, 1, 1]), flight, before.noise)
    same = innovations(TRUTH, flight, before.noise)
    change = -(after.values - same.values) / step / same.deviation
    answer = late.directions[..., 2 + 2]
    # In x and y the response neglects that yaw turns the thrusts; poses correct this at once.
    used = before.used
    np.testing.assert_allclose(
        change[used, 2], answer[used, 2], atol=2e-3 * np.abs(answer[used, 2]).max()
    )
