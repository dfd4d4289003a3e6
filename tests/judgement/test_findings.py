"""Causes of a verdict, each from evidence made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.results import Finding
from airpuck.deviation.effect_errors import effect_errors
from airpuck.judgement.findings import Evidence, first_causes, incomplete, too_quiet, too_wrong
from airpuck.model.model_file import nominal_model, published_model
from airpuck.model.parameters import LAG

from ..apparatus.synthetic_flights import fly

MODEL = replace(published_model("M3"), frame="body", indexing="start")


@pytest.fixture(scope="module")
def flight():
    return fly(MODEL, 8.0, seed=3)


@pytest.fixture(scope="module")
def effects(flight):
    found = effect_errors(MODEL, flight)
    assert found is not None
    return found


def test_a_model_needs_a_lag_or_a_fit_that_may_find_one():
    held = replace(MODEL, free=MODEL.free & ~MODEL.parameters.mask(LAG))
    assert incomplete(MODEL) == [] and incomplete(held) == []
    parameters = replace(MODEL.parameters, motor_time_constant=0.0)
    assert incomplete(replace(MODEL, parameters=parameters)) == []
    (finding,) = incomplete(replace(held, parameters=parameters))
    assert "no motor lag" in finding.cause


def test_a_recording_that_hardly_pushes_one_way_names_that_way(flight, effects, monkeypatch):
    error = np.array([0.1, 0.1, 0.1, 0.5, 0.1, 0.1])
    vague = replace(effects, push_error=error)
    monkeypatch.setattr("airpuck.judgement.findings.effect_errors", lambda *_: vague)
    (finding,) = too_quiet(Evidence(MODEL, flight, None))
    assert "acceleration right only to 50 %" in finding.cause


def test_translation_is_compared_with_translation_and_rotation_with_rotation():
    nominal = MODEL.vehicle.nominal.model_copy(update={"inertia_kg_m2": 1e-6})
    light = nominal_model(MODEL.vehicle.model_copy(update={"nominal": nominal}))
    assert Evidence(light, None, None).able.all()
    nominal = nominal.model_copy(update={"inertia_kg_m2": 1e2})
    heavy = nominal_model(MODEL.vehicle.model_copy(update={"nominal": nominal}))
    assert Evidence(heavy, None, None).able.all()


@pytest.mark.parametrize(("low", "size"), [(0.5, "large"), (-0.5, "small")])
def test_low_thrusts_are_too_large_or_too_small(effects, low, size):
    bent = replace(effects, low=np.full(6, low))
    (finding,) = too_wrong(MODEL, np.zeros(6), 0.0, bent)
    assert f"accelerations are 50 % too {size}" in finding.cause


def test_only_the_first_cause_of_a_suspect_recording_counts():
    clock, other = Finding("clock", "late", "", ""), Finding("clock", "early", "", "")
    physics, control = Finding("physics", "drag", "", ""), Finding("control", "noise", "", "")
    assert first_causes([control, physics]) == (physics, control)
    assert first_causes([control, other, physics, clock]) == (other, clock)
    assert first_causes([]) == ()
