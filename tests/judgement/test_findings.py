"""Causes of a verdict, each from evidence made by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airpuck.boundary.results import Finding
from airpuck.craft.vehicle import default_vehicle, read_vehicle
from airpuck.deviation.effect_errors import effect_errors
from airpuck.judgement.findings import (
    Evidence,
    clock_suspect,
    first_causes,
    incomplete,
    too_quiet,
    too_wrong,
    unit_suspect,
)
from airpuck.model.model_file import Model, nominal_model, published_model
from airpuck.model.parameters import LAG
from airpuck.preprocessing.pipeline import preprocess

from ..apparatus.synthetic_flights import fly, record

MODEL = replace(published_model("M3"), frame="body", indexing="start")


@pytest.fixture(scope="module")
def flight():
    return fly(MODEL, 8.0, seed=3)


@pytest.fixture(scope="module")
def effects(flight):
    found = effect_errors(MODEL, flight)
    assert found is not None
    return found


def test_a_model_needs_a_lag_or_a_fit_that_learns_one():
    held = replace(MODEL, free=MODEL.free & ~MODEL.parameters.mask(LAG))
    assert incomplete(MODEL) == [] and incomplete(held) == []
    parameters = replace(MODEL.parameters, motor_time_constant=0.0)
    assert incomplete(replace(MODEL, parameters=parameters)) == []
    (finding,) = incomplete(replace(held, parameters=parameters))
    assert "no motor lag" in finding.cause


def test_a_recording_that_barely_pushes_one_way_names_that_direction(flight, effects, monkeypatch):
    error = np.array([0.1, 0.1, 0.1, 0.5, 0.1, 0.1])
    vague = replace(effects, push_error=error)
    monkeypatch.setattr("airpuck.judgement.findings.effect_errors", lambda *_: vague)
    (finding,) = too_quiet(Evidence(MODEL, flight, None))
    assert "acceleration right only to 50 %" in finding.cause


@pytest.mark.parametrize("inertia", [1e-6, 1e2])
def test_translation_and_rotation_are_compared_separately(inertia):
    nominal = MODEL.vehicle.nominal.model_copy(update={"inertia_kg_m2": inertia})
    model = nominal_model(MODEL.vehicle.model_copy(update={"nominal": nominal}))
    assert Evidence(model, None, None).able.all()


@pytest.mark.parametrize(("low", "size"), [(0.5, "large"), (-0.5, "small")])
def test_wrong_thrusts_at_low_speed_are_reported_with_their_sign(effects, low, size):
    bent = replace(effects, low=np.full(6, low))
    (finding,) = too_wrong(MODEL, np.zeros(6), 0.0, bent)
    assert f"accelerations are 50 % too {size}" in finding.cause


def test_only_the_first_cause_of_a_suspect_recording_is_reported():
    clock, other = Finding("clock", "late", "", ""), Finding("clock", "early", "", "")
    physics, control = Finding("physics", "drag", "", ""), Finding("control", "noise", "", "")
    assert first_causes([control, physics]) == (physics, control)
    assert first_causes([control, other, physics, clock]) == (other, clock)
    assert first_causes([]) == ()


TRUTH = nominal_model(default_vehicle())
EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_inertia_is_compared_with_a_ring_around_all_propellers():
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


def test_a_delay_that_replaces_the_lag_accuses_no_clock():
    flight, lag = preprocess(record(TRUTH, 12.0)), float(TRUTH.parameters.motor_time_constant)
    assert clock_suspect(learned(1e-3, TRUTH.transport_delay + lag), flight) == []
    (said,) = clock_suspect(learned(lag, TRUTH.transport_delay + 0.05), flight)
    assert said.suspect and "after their time stamps" in said.cause


def test_a_delay_learned_from_a_few_seconds_accuses_no_clock():
    model = learned(float(TRUTH.parameters.motor_time_constant), TRUTH.transport_delay + 0.05)
    assert clock_suspect(model, preprocess(record(TRUTH, 6.0))) == []


def test_a_delay_too_short_to_measure_accuses_no_clock():
    delay = np.float64(1e-3)
    true = replace(TRUTH, parameters=replace(TRUTH.parameters, transport_delay=delay))
    flight = preprocess(record(true, 12.0))
    for fitted in (0.0, 1e-3):
        model = learned(float(TRUTH.parameters.motor_time_constant), fitted)
        assert clock_suspect(model, flight) == [], fitted
