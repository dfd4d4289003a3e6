"""Recordings in which something looks wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from airpuck.craft.vehicle import default_vehicle, read_vehicle
from airpuck.evaluation.suspects import clock_suspect, unit_suspect
from airpuck.model.model_file import Model, nominal_model
from airpuck.preprocessing.pipeline import preprocess

from ..apparatus.synthetic_flights import record

TRUTH = nominal_model(default_vehicle())
EXAMPLES = Path(__file__).parents[2] / "examples"


def test_an_inertia_is_compared_with_a_ring_around_all_propellers():
    start = nominal_model(read_vehicle(EXAMPLES / "free_flyers/freeflyer2.toml"))
    model = replace(start, free=start.parameters.mask(frozenset({"inertia"})))
    # Its thrusters are at 1.6 times the radius of its base.
    assert unit_suspect(model) == []
    inertia = 3 * model.parameters.inertia
    (said,) = unit_suspect(replace(model, parameters=replace(start.parameters, inertia=inertia)))
    assert said.kind == "units" and "larger than a ring's" in said.cause


def learned(lag: float, delay: float) -> Model:
    """A model that has learned its lag and delay [s]."""
    parameters = replace(TRUTH.parameters, motor_time_constant=lag, transport_delay=delay)
    free = TRUTH.free | parameters.mask(frozenset({"motor_time_constant", "transport_delay"}))
    return replace(TRUTH, parameters=parameters, free=free)


def test_a_delay_that_replaces_the_lag_is_no_fault_of_the_clocks():
    flight, lag = preprocess(record(TRUTH, 12.0)), float(TRUTH.parameters.motor_time_constant)
    assert clock_suspect(learned(1e-3, TRUTH.transport_delay + lag), flight) == []
    (said,) = clock_suspect(learned(lag, TRUTH.transport_delay + 0.05), flight)
    assert said.suspect and "after their time stamps" in said.cause


def test_a_delay_that_was_learned_in_a_few_seconds_accuses_no_clock():
    model = learned(float(TRUTH.parameters.motor_time_constant), TRUTH.transport_delay + 0.05)
    assert clock_suspect(model, preprocess(record(TRUTH, 6.0))) == []


def test_a_delay_too_short_to_see_accuses_no_clock():
    delay = np.float64(1e-3)
    true = replace(TRUTH, parameters=replace(TRUTH.parameters, transport_delay=delay))
    flight = preprocess(record(true, 12.0))
    for fitted in (0.0, 1e-3):
        model = learned(float(TRUTH.parameters.motor_time_constant), fitted)
        assert clock_suspect(model, flight) == [], fitted
