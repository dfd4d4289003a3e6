"""Presentation of a model."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.evaluation.presentation import largest_acceleration, main_quantities, present
from airpuck.model.model_file import published_model
from airpuck.model.quantities import QUANTITIES

from ..apparatus.beliefs import believed

MODEL = published_model("M3")


@pytest.fixture
def known():
    return believed(MODEL)


def test_the_bandwidth_and_its_error_follow_from_the_lag(known):
    tau = MODEL.parameters.motor_time_constant
    found = {value.label: value for value in present(known).derived}
    bandwidth = found["bandwidth of the motors 1/(2πτ)"]
    assert bandwidth.value == pytest.approx(1 / (2 * np.pi * tau))
    assert bandwidth.standard_error == pytest.approx(0.01 * bandwidth.value, rel=1e-4)
    assert bandwidth.interval is not None
    low, high = bandwidth.interval
    assert high - low == pytest.approx(4 * bandwidth.standard_error)


def test_the_largest_acceleration_uses_the_best_commands():
    # Motors are independent, so the best corner of the command range is optimal.
    matrix, vehicle = MODEL.dynamics.configuration, MODEL.vehicle
    thrusts = np.array(
        [
            np.polyval(np.append(MODEL.parameters.thrust[i][::-1], 0.0), command)
            for command in (vehicle.command_min, vehicle.command_max)
            for i in range(6)
        ]
    ).reshape(2, 6)
    corners = np.array([[int(bit) for bit in f"{k:06b}"] for k in range(64)])
    forces = np.where(corners == 1, thrusts[1], thrusts[0])
    reached = forces @ matrix.T
    best = [sign * (sign * reached[:, row]).max() for row in range(3) for sign in (1, -1)]
    np.testing.assert_allclose(largest_acceleration(MODEL), np.abs(best))


def test_a_model_changed_after_its_fit_has_no_errors(known):
    shown = present(known.with_delay(0.03))
    assert shown.notes == ("no standard errors: the parameters were changed after the fit",)
    assert "blocks of time behind the errors" in dict(present(known).conditions)
    assert "blocks of time behind the errors" not in dict(shown.conditions)
    assert all(np.isnan(value.quantile) for value in (*shown.parameters, *shown.derived))


def test_the_structure_lists_free_and_fixed_parameters():
    shown = present(published_model("M0"))
    lines = "\n".join(shown.structure)
    assert "motors follow at once" in lines
    assert "free: coefficients" in lines
    assert "fixed: moment of inertia" in lines
    assert "no standard errors" in shown.notes[0]
    assert all(value.interval is None for value in shown.parameters)


@pytest.mark.parametrize("quantity", [*QUANTITIES[1:]], ids=lambda quantity: quantity.name)
def test_every_number_is_shown_in_its_stated_unit(quantity):
    entries = len(quantity.entries(MODEL.vehicle.propeller_names, 3))
    values = 1e-3 * np.arange(1.0, entries + 1)
    value = values if entries > 1 else values[0]
    if quantity.name == "configuration_matrix":
        value = values.reshape(3, 6)
    model = replace(MODEL, parameters=replace(MODEL.parameters, **{quantity.name: value}))
    unit, factor, _ = quantity.shown or (None, 1.0, "")
    shown = [one for one in main_quantities(model) if one.parameter == quantity.name]
    assert len(shown) in (0, entries)
    for k, one in enumerate(shown):
        assert one.value(model) == pytest.approx(factor * values[k])
        assert one.unit == (unit or quantity.of_entry(min(k, quantity.symbol.count(",")))[1])
