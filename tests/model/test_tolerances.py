"""Tolerances of a vehicle file widen the bars of what depends on them."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.evaluation.presentation import largest_acceleration
from airpuck.model.model_file import nominal_model, published_model
from airpuck.model.rungs import named_rung
from airpuck.model.tolerances import geometry_shifts

MODEL = replace(published_model("M3"), frame="body", indexing="start")
FREE = named_rung("M3").mask(MODEL.parameters)


def file(**tolerances):
    none = {"position_error_m": 0.0, "direction_error_deg": 0.0, "mass_error": 0.0}
    return MODEL.vehicle.model_copy(update=none | tolerances)


def test_a_wrong_mass_changes_thrusts_and_inertia_alike_and_nothing_else():
    shifts = geometry_shifts(MODEL.parameters, file(mass_error=0.02), FREE)
    relative = np.sqrt((shifts**2).sum(axis=0)) / np.abs(MODEL.parameters.to_vector()).clip(1e-12)
    heavy = MODEL.parameters.mask(frozenset({"thrust", "inertia"})) & FREE
    heavy &= MODEL.parameters.to_vector() != 0
    np.testing.assert_allclose(relative[heavy], 0.02, rtol=0.03)
    assert (np.abs(shifts[:, ~heavy]) < 1e-4).all()


def test_a_file_without_tolerances_adds_nothing():
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
