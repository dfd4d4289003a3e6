"""Hypotheses against motors that are really let down."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from airpuck.data.trajectory import Span
from airpuck.faults.chain import Fault, predict_faults, usable_steps
from airpuck.model.model_file import published_model
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import acceleration

from ..apparatus.synthetic_flights import fly

MODEL = replace(published_model("M3"), indexing="start", frame="body")
#: Where the fault begins, in steps.
BEGIN = 40


@pytest.fixture(scope="module")
def flight():
    return fly(MODEL, duration=3.0)


@pytest.fixture(scope="module")
def predicted(flight):
    return predict_faults(flight, MODEL.dynamics)


def means(flight, predicted, command):
    """Mean acceleration over each step with other commands, at all samples, by the trapezoid."""
    speed = motor_speeds(flight.time, command, float(MODEL.dynamics.motor_time_constant))
    rates = np.array(acceleration(np, MODEL.dynamics, flight.state[:, 2:6].T, speed.T)).T
    knots = predicted.knots
    return np.array(
        [
            np.trapezoid(rates[a : b + 1], flight.time[a : b + 1], axis=0)
            / (flight.time[b] - flight.time[a])
            for a, b in pairwise(knots)
        ]
    )


def close(found, expected):
    """Within a tenth of what motors give: the steps' means are taken at fewer instants."""
    np.testing.assert_allclose(found[..., :2], expected[..., :2], atol=0.25)
    np.testing.assert_allclose(found[..., 2], expected[..., 2], atol=6.0)


def test_a_healthy_craft_is_normal(flight, predicted):
    close(predicted.normal, means(flight, predicted, flight.input))
    # The first speeds are a guess, soon forgotten.
    close(predicted.measured[6:], predicted.normal[6:])


@pytest.mark.parametrize("motors", [(0,), (4,), (1, 3), tuple(range(6))])
def test_motors_that_stand(flight, predicted, motors):
    command = flight.input.copy()
    command[predicted.knots[BEGIN] :, list(motors)] = 0
    expected = means(flight, predicted, command)
    ages = 5
    modelled = predicted.faulty[predicted.faults.index(Fault(motors, ages))]
    for age in range(ages):
        close(modelled[age, BEGIN + age], expected[BEGIN + age])
    # From then on, they stand for good.
    close(modelled[-1, BEGIN + ages :], expected[BEGIN + ages :])
    assert np.abs(expected - predicted.normal)[BEGIN + ages :, 2].max() > 20


def test_a_command_that_is_held(flight, predicted):
    knot = predicted.knots[BEGIN]
    command = flight.input.copy()
    command[knot:] = command[knot - 1]
    expected = means(flight, predicted, command)
    modelled = next(
        a for f, a in zip(predicted.faults, predicted.faulty, strict=True) if not f.motors
    )
    for age in range(len(modelled)):
        close(modelled[age, BEGIN + age], expected[BEGIN + age])
    assert len(modelled) >= 0.5 / 0.025


def test_steps_that_touch_an_excluded_span_are_left_out(flight, predicted):
    time = flight.time[predicted.knots]
    marked = replace(flight, excluded=(Span(time[10] + 0.001, time[12], "gap"),))
    usable = usable_steps(marked, predicted.knots)
    assert np.flatnonzero(~usable).tolist() == [10, 11, 12]
