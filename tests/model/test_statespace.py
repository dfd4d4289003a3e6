"""Linear models against the equations of motion and python-control."""

from dataclasses import replace

import control
import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import default_vehicle
from airpuck.model.model_file import published_model
from airpuck.model.statespace import linearize, trim
from airpuck.physics.rigid_body import acceleration, derivative, rollout


@pytest.mark.parametrize("name", ["M0", "M3", "M4"])
def test_a_trimmed_craft_stays_at_rest(name):
    dynamics = published_model(name).dynamics
    command = trim(dynamics)
    assert ((command > 0) & (command < 1)).all()
    np.testing.assert_allclose(acceleration(np, dynamics, np.zeros(4), command), 0, atol=1e-9)


def test_a_craft_with_effects_on_a_tilted_table_is_trimmed_too():
    truth = published_model("M3").parameters
    effects = {"inflow": 0.2, "pair_interaction": 5.0, "voltage_sag": 0.1}
    parameters = replace(truth, **effects, tilt=np.array([0.004, -0.002]))
    dynamics = parameters.dynamics(np, default_vehicle())
    command = trim(dynamics, yaw=0.7)
    assert ((command > 0) & (command < 1)).all()
    motion = np.array([0.7, 0, 0, 0])
    np.testing.assert_allclose(acceleration(np, dynamics, motion, command), 0, atol=1e-9)


def test_the_matrices_are_those_of_central_differences():
    dynamics = published_model("M3").dynamics
    command = trim(dynamics)
    a, b = linearize(dynamics, 0.7, command)
    at = np.concatenate([[0, 0, 0.7, 0, 0, 0], command])
    h = 1e-6
    for j, direction in enumerate(np.eye(12)):
        ahead = derivative(np, dynamics, at + h * direction, command)
        behind = derivative(np, dynamics, at - h * direction, command)
        np.testing.assert_allclose(a[:, j], (ahead - behind) / (2 * h), atol=1e-7)
    np.testing.assert_allclose(b[6:], np.eye(6) / float(dynamics.motor_time_constant))
    np.testing.assert_array_equal(b[:6], 0)


def test_small_steps_of_the_commands_give_the_response_of_the_linear_model():
    model = published_model("M4")
    system = model.to_statespace(yaw=0.4)
    command = trim(model.dynamics)
    step = np.array([1.0, -0.5, 0.3, 0.8, -1.0, 0.2])
    steps, h = 48, 1 / 240
    time = np.arange(steps + 1) * h
    start = np.concatenate([[0, 0, 0.4, 0, 0, 0], command])

    def error(size):
        response = control.forced_response(
            system, time, np.tile(size * step, (steps + 1, 1)).T
        ).outputs
        held = np.tile(command + size * step, (steps, 1))
        flown = rollout(np, model.dynamics, start, held, np.full(steps, h))
        return np.abs(flown[:, :3] - start[:3] - np.asarray(response)[:, 1:].T).max()

    # The remainder of a linearisation is of second order.
    assert error(1e-3) < 1e-5
    assert error(1e-3) / error(1e-4) == pytest.approx(100, rel=0.05)


def test_without_motor_lag_the_motors_are_no_states():
    system = published_model("M0").to_statespace()
    assert (system.nstates, system.ninputs, system.noutputs) == (6, 6, 3)
    assert published_model("M3").to_statespace().nstates == 12


def test_the_discrete_model_is_the_continuous_one_with_held_inputs():
    model = published_model("M3")
    discrete, continuous = model.to_statespace(period=0.01), model.to_statespace()
    assert discrete.dt == 0.01
    assert discrete.input_labels == list(model.vehicle.propeller_names)
    by_control = control.c2d(continuous, 0.01, "zoh")
    np.testing.assert_allclose(discrete.A, by_control.A, atol=1e-14)
    np.testing.assert_allclose(discrete.B, by_control.B, atol=1e-14)


def test_a_wrong_number_of_commands_is_refused():
    with pytest.raises(InputError, match="6 numbers"):
        published_model("M3").to_statespace(command=np.zeros(4))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("period", value) for value in (0.0, -1.0, np.nan, np.inf)),
        *(("yaw", value) for value in (np.nan, np.inf)),
        *(("command", np.full(6, value)) for value in (np.nan, -0.1, 1.1)),
    ],
)
def test_a_number_out_of_range_is_refused(field, value):
    with pytest.raises(InputError) as caught:
        published_model("M3").to_statespace(**{field: value})
    assert caught.value.field == field
