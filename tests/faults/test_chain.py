"""Forward-backward against the sum over all paths; and the chain of faults."""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest

from airpuck.data.trajectory import Span
from airpuck.faults.find import (
    RADIO_OUT,
    UNEXPLAINED,
    Fault,
    fault_chain,
    predict_faults,
    state_probabilities,
    usable_steps,
)
from airpuck.model.model_file import published_model
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import acceleration

from ..apparatus.synthetic_flights import fly

FAULTS = (Fault((0, 1, 2), 5), Fault((), 12), *(Fault((m,), 5) for m in range(3)), Fault((0, 2), 5))
NAMES = ("left", "right", "back")


def test_probabilities_are_sums_over_all_paths():
    rng = np.random.default_rng(0)
    states, steps = 3, 5
    transition = rng.dirichlet(np.ones(states), states)
    initial, seen = rng.dirichlet(np.ones(states)), rng.normal(size=(steps, states)) * 3
    expected = np.zeros((steps, states))
    for path in product(range(states), repeat=steps):
        weight = initial[path[0]] * np.exp(sum(seen[k, s] for k, s in enumerate(path)))
        weight *= np.prod([transition[a, b] for a, b in pairwise(path)])
        expected[np.arange(steps), path] += weight
    expected /= expected.sum(axis=1, keepdims=True)
    found = state_probabilities(seen, transition, initial)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_long_chains_neither_overflow_nor_underflow():
    seen = np.where(np.arange(20_000)[:, None] % 2 == [0, 1], -900.0, 0.0)
    transition = np.array([[0.5, 0.5], [0.5, 0.5]])
    found = state_probabilities(seen, transition, np.array([0.5, 0.5]))
    np.testing.assert_allclose(found, np.exp(seen), atol=1e-12)


def test_two_simultaneous_stalls_are_thirty_times_rarer_than_one():
    """FAULTS has one of the three pairs, which stands for all."""
    first = np.cumsum([1, *(fault.ages for fault in FAULTS)])[:-1]
    begins = fault_chain(FAULTS, NAMES).transition[0, first]
    count = np.array([len(fault.motors) for fault in FAULTS])
    assert begins[count == 2].sum() == pytest.approx(begins[count == 1].sum() / 30)


def test_the_chain_is_a_valid_markov_chain():
    chain = fault_chain(FAULTS, NAMES)
    np.testing.assert_allclose(chain.transition.sum(axis=1), 1)
    np.testing.assert_allclose(chain.initial.sum(), 1)
    assert (chain.transition >= 0).all()
    # Every state except normal has a cause; two if two motors stand still.
    times = np.sum(list(chain.causes.values()), axis=0)
    assert times[0] == 0
    assert (times[1:] >= 1).all()
    assert (chain.causes["left stalled"] & chain.causes["back stalled"]).sum() == 5
    assert set(chain.causes) == {RADIO_OUT, UNEXPLAINED, *(f"{name} stalled" for name in NAMES)}


def test_a_recording_may_start_unarmed_but_with_no_other_fault():
    chain, (unarmed, *_) = fault_chain(FAULTS, NAMES), FAULTS
    begins = {0: 0.98, unarmed.ages: 0.02}
    expected = [begins.get(state, 0.0) for state in range(len(chain.initial))]
    np.testing.assert_allclose(chain.initial, expected)


def test_motor_faults_last_at_least_a_tenth_of_a_second():
    chain = fault_chain(FAULTS, NAMES)
    states = np.zeros(len(chain.initial))
    states[0] = 1
    states = states @ chain.transition
    broken = states * ~chain.causes[UNEXPLAINED]
    broken[0] = 0
    for _ in range(3):
        broken = broken @ chain.transition
        assert broken[0] == 0
    assert (broken @ chain.transition)[0] > 0


MODEL = replace(published_model("M3"), indexing="start", frame="body")
#: Start of the fault, in steps.
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
    """Within a tenth of the motors' acceleration: the model averages over fewer instants."""
    np.testing.assert_allclose(found[..., :2], expected[..., :2], atol=0.25)
    np.testing.assert_allclose(found[..., 2], expected[..., 2], atol=6.0)


def test_a_healthy_craft_is_normal(flight, predicted):
    close(predicted.normal, means(flight, predicted, flight.input))
    # The first speeds are a guess, soon forgotten.
    close(predicted.measured[6:], predicted.normal[6:])


@pytest.mark.parametrize(("lag", "steps"), [(0.045, 6), (0.09, 11), (0.4, 20)])
def test_a_stalled_motor_stops_within_three_lags(flight, lag, steps):
    """In steps of 25 ms, at most 20 of them."""
    slow = replace(MODEL.parameters, motor_time_constant=lag)
    faults = predict_faults(flight, replace(MODEL, parameters=slow).dynamics).faults
    assert {fault.ages for fault in faults if fault.motors} == {steps}


@pytest.mark.parametrize("motors", [(0,), (4,), (1, 3), tuple(range(6))])
def test_stalled_motors_are_predicted(flight, predicted, motors):
    command = flight.input.copy()
    command[predicted.knots[BEGIN] :, list(motors)] = 0
    expected = means(flight, predicted, command)
    ages = 5
    modelled = predicted.faulty[predicted.faults.index(Fault(motors, ages))]
    for age in range(ages):
        close(modelled[age, BEGIN + age], expected[BEGIN + age])
    # From then on, they stand still.
    close(modelled[-1, BEGIN + ages :], expected[BEGIN + ages :])
    assert np.abs(expected - predicted.normal)[BEGIN + ages :, 2].max() > 20


def test_a_held_command_is_predicted(flight, predicted):
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


def test_steps_overlapping_an_excluded_span_are_left_out(flight, predicted):
    time = flight.time[predicted.knots]
    marked = replace(flight, excluded=(Span(time[10] + 0.001, time[12], "gap"),))
    usable = usable_steps(marked, predicted.knots)
    assert np.flatnonzero(~usable).tolist() == [10, 11, 12]
