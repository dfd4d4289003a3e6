"""Tolerances of a vehicle file widen the bars of what depends on them."""

from dataclasses import replace

import numpy as np
import pytest

import airpuck
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.model.model_file import nominal_model, published_model
from airpuck.model.rungs import named_rung
from airpuck.model.tolerances import geometry_shifts

MODEL = replace(published_model("M3"), frame="body", indexing="start")
FREE = named_rung("M3").mask(MODEL.parameters)


def file(**tolerances):
    none = {"position_error_m": 0.0, "direction_error_deg": 0.0, "mass_error": 0.0}
    return MODEL.vehicle.model_copy(update=none | tolerances)


def test_a_wrong_mass_scales_only_thrusts_and_inertia():
    shifts = geometry_shifts(MODEL.parameters, file(mass_error=0.02), FREE)
    relative = np.sqrt((shifts**2).sum(axis=0)) / np.abs(MODEL.parameters.to_vector()).clip(1e-12)
    heavy = MODEL.parameters.mask(frozenset({"thrust", "inertia"})) & FREE
    heavy &= MODEL.parameters.to_vector() != 0
    np.testing.assert_allclose(relative[heavy], 0.02, rtol=0.03)
    assert (np.abs(shifts[:, ~heavy]) < 1e-4).all()


def test_a_file_without_tolerances_adds_no_uncertainty():
    assert not geometry_shifts(MODEL.parameters, file(), FREE).any()


@pytest.mark.parametrize("name", ["position_error_m", "direction_error_deg"])
def test_accelerations_do_not_depend_on_the_geometry_in_the_file(name):
    wrong = file(**{name: {"position_error_m": 1e-3, "direction_error_deg": 1.0}[name]})
    model = replace(MODEL, free=FREE, vehicle=wrong)
    vector = model.parameters.to_vector()
    moved = [
        largest_acceleration(replace(model, parameters=model.parameters.with_vector(vector + s)))
        for s in geometry_shifts(model.parameters, wrong, FREE)
    ]
    change = np.abs(np.array(moved) / largest_acceleration(model) - 1)
    assert change.max() < 0.03
    assert nominal_model(wrong).vehicle == wrong


@pytest.mark.slow
@pytest.mark.parametrize("three", [False, True])
def test_a_wrong_file_shifts_a_fit_as_stated(three):
    vehicle = MODEL.vehicle
    if three:  # two-way propellers, of which each turns either way half of the time
        ring = [p.model_copy(update={"reverse": 0.8}) for p in vehicle.propellers[::2]]
        vehicle = vehicle.model_copy(update={"propellers": tuple(ring), "pairs": ()})
    truth = nominal_model(vehicle)
    flight = airpuck.excite(truth, 10.0, seed=4)
    right = airpuck.identify(airpuck.preprocess(flight, vehicle), "M3").model
    turned = [p.model_copy() for p in vehicle.propellers]
    turned[1] = turned[1].model_copy(update={"direction_deg": turned[1].direction_deg + 3.0})
    wrong = vehicle.model_copy(update={"propellers": tuple(turned)})
    found = airpuck.identify(airpuck.preprocess(flight, wrong), "M3").model
    # Positions come first, by x and y, then the direction, for each propeller.
    shift = -3.0 * geometry_shifts(right.parameters, right.vehicle, right.free)[5]
    expected = right.parameters.with_vector(right.parameters.to_vector() + shift)
    before, stated, after = (
        np.append(np.asarray(p.thrust).sum(axis=1), p.inertia)
        for p in (right.parameters, expected, found.parameters)
    )
    moved, said = after / before - 1, stated / before - 1
    assert np.abs(moved).max() > 0.01
    assert np.linalg.norm(said - moved) < 0.5 * np.linalg.norm(moved)
