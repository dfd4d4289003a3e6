"""A hull in water, against the matrices of Fossen's textbook and against conservation laws."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.model.model_file import published_model, read_model
from airpuck.model.rungs import named_rung
from airpuck.physics.hull import Hull
from airpuck.physics.rigid_body import acceleration, acceleration_map, register_pytrees, rollout
from airpuck.physics.thrust import thrust

M3 = published_model("M3")
CENTER = np.array([0.02, -0.013])
WATER = np.array([0.8, 0.2, 0.5, 0.3, 0.4, 1.2, 0.05])


def craft(hull, frame="body"):
    parameters = replace(M3.parameters, center_of_mass=CENTER, hull=np.asarray(hull))
    return replace(M3, parameters=parameters, frame=frame, free=parameters.mask(frozenset()))


def matrices(model):
    """Inertia of the craft alone and of the water, about the geometric centre [kg, kg m, kg m²]."""
    mass, inertia = model.vehicle.mass_kg, float(model.parameters.inertia)
    x, y = CENTER
    moment = inertia + mass * (x**2 + y**2)
    body = np.array([[mass, 0, -mass * y], [0, mass, mass * x], [-mass * y, mass * x, moment]])
    return body, np.diag([0.0, mass * float(model.parameters.hull[0]), 0.0])


def coriolis(matrix, rates):
    """Fossen (2011), theorem 3.2, in the plane: from the momentum, whatever the matrix."""
    px, py, _ = matrix @ rates
    return np.array([[0, 0, -py], [0, 0, px], [py, -px, 0]])


def by_textbook(model, motion, speed):
    """Solve M ν' + C(ν) ν + D(ν) ν = τ, and turn the acceleration into the world."""
    yaw, vx, vy, spin = motion
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    rates = np.append(turn.T @ [vx, vy], spin)
    mass, inertia = model.vehicle.mass_kg, float(model.parameters.inertia)
    drag = model.parameters.hull[1:4] + model.parameters.hull[4:] * np.abs(rates)
    at_center = (model.dynamics.configuration @ thrust(model.dynamics.thrust, speed)) - drag * rates
    force, moment = mass * at_center[:2], inertia * at_center[2]
    load = np.append(force, moment + CENTER[0] * force[1] - CENTER[1] * force[0])
    body, water = matrices(model)
    both = body + water
    change = np.linalg.solve(both, load - coriolis(both, rates) @ rates)
    linear = change[:2] + spin * np.array([-rates[1], rates[0]])
    return np.append(turn @ linear, change[2])


motions = st.tuples(st.floats(-7, 7), st.floats(-3, 3), st.floats(-3, 3), st.floats(-15, 15))


@given(motions, st.integers(0, 99))
def test_a_hull_accelerates_as_in_the_textbook(motion, seed):
    model, speed = craft(WATER), np.random.default_rng(seed).random(6)
    found = acceleration(np, model.dynamics, np.array(motion), speed)
    np.testing.assert_allclose(found, by_textbook(model, motion, speed), atol=1e-9)


def conserved(model, state):
    """Kinetic energy, momentum, and angular momentum about the origin of the world."""
    x, y, yaw, vx, vy, spin = state[:6]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    rates = np.append(turn.T @ [vx, vy], spin)
    momentum = sum(matrices(model)) @ rates
    px, py = turn @ momentum[:2]
    return np.array([rates @ momentum / 2, px, py, momentum[2] + x * py - y * px])


def test_without_thrust_and_drag_energy_and_momentum_are_conserved():
    model = craft([0.8, *[0.0] * 6])
    dynamics = replace(model.dynamics, thrust=0 * model.dynamics.thrust)
    start = np.concatenate([[0.1, 0.2, 0.3, 0.5, -0.2, 3.0], np.zeros(6)])
    path = rollout(np, dynamics, start, np.zeros((4000, 6)), np.full(4000, 1e-3))
    assert np.ptp(np.hypot(path[:, 3], path[:, 4])) > 0.1  # the water pulls on it
    for state in path[::500]:
        np.testing.assert_allclose(conserved(model, state), conserved(model, start), rtol=1e-9)


def test_a_hull_without_water_acts_like_a_craft_on_air():
    motion, speed = np.array([0.4, 1.0, -0.7, 2.0]), np.linspace(0.1, 0.9, 6)
    for frame in ("body", "world"):
        dry = replace(craft(np.zeros(7), frame).dynamics, effects=())
        np.testing.assert_allclose(
            acceleration(np, craft(np.zeros(7), frame).dynamics, motion, speed),
            acceleration(np, dry, motion, speed),
            atol=1e-12,
        )


@pytest.mark.parametrize("frame", ["body", "world"])
def test_the_control_matrix_includes_the_added_mass(frame):
    dynamics, speed = craft([0.8, *[0.0] * 6], frame).dynamics, np.linspace(0.1, 0.9, 6)
    matrix, offset = acceleration_map(np, dynamics, 0.4, 2.0)
    expected = acceleration(np, dynamics, np.array([0.4, 0.0, 0.0, 2.0]), speed)
    np.testing.assert_allclose(matrix @ thrust(dynamics.thrust, speed) + offset, expected)


def test_jax_agrees_with_numpy():
    register_pytrees()
    dynamics, motion, speed = (
        craft(WATER).dynamics,
        np.array([0.4, 1.0, -0.7, 2.0]),
        np.full(6, 0.5),
    )
    expected = np.array(acceleration(np, dynamics, motion, speed))
    compiled = jax.jit(lambda d: jnp.stack(acceleration(jnp, d, motion, speed)))
    np.testing.assert_allclose(compiled(dynamics), expected, rtol=1e-6)


def test_a_model_file_keeps_a_hull(tmp_path):
    model = craft(WATER)
    model.save(tmp_path / "model.toml")
    np.testing.assert_array_equal(read_model(tmp_path / "model.toml").parameters.hull, WATER)


def test_a_hull_has_no_acceleration_bound():
    assert craft(WATER).dynamics.effects[0].acceleration_bound(None) is None
    assert isinstance(craft(WATER).dynamics.effects[0], Hull)
    assert (np.array(named_rung("M3+hull").initial(M3.vehicle).hull) > 0).all()
