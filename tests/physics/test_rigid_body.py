"""The planar rigid body, against physics and independent formulas."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.craft.vehicle import default_vehicle
from airpuck.model.model_file import published_model
from airpuck.model.parameters import nominal_parameters
from airpuck.physics.rigid_body import (
    acceleration,
    acceleration_map,
    configuration_matrix,
    derivative,
    pose_difference,
    wrapped,
)
from airpuck.physics.thrust import thrust

from ..apparatus.examples import examples

speeds = st.lists(st.floats(0, 1), min_size=6, max_size=6).map(np.array)
motions = st.tuples(*[st.floats(-4, 4)] * 4).map(np.array)


def rotate(angle, vectors):
    """Turn row vectors counter-clockwise."""
    cos, sin = np.cos(angle), np.sin(angle)
    return vectors @ np.array([[cos, sin], [-sin, cos]])


def general_parameters():
    return replace(
        published_model("M3").parameters, center_of_mass=np.array([3e-3, -2e-3]), angle_offset=0.4
    )


@given(st.floats(-1e4, 1e4))
def test_a_wrapped_angle_points_in_the_same_direction(angle):
    near = wrapped(np, np.array([angle]))
    assert np.abs(near) <= np.pi + 1e-9
    np.testing.assert_allclose(np.exp(1j * near), np.exp(1j * angle), atol=1e-9)


def test_only_the_yaw_of_a_state_is_periodic():
    state = np.array([10.0, -10.0, 3 * np.pi + 0.1, 10.0, 10.0, 10.0])
    expected = [10, -10, -np.pi + 0.1, 10, 10, 10]
    np.testing.assert_allclose(pose_difference(np, state, np.zeros(6)), expected)
    many = pose_difference(np, np.stack([state, state], axis=1), np.zeros((6, 1)))
    np.testing.assert_allclose(many, np.stack([expected, expected], axis=1))


def test_the_configuration_matrix_matches_a_hand_calculation():
    # One propeller 0.1 m ahead, pushing left: a force forward never, left 1/m, moment 0.1/I.
    matrix = configuration_matrix(
        np, np.array([[0.1, 0.0]]), np.array([[0.0, 1.0]]), 2.0, 0.5, 0.0, np.zeros(2)
    )
    np.testing.assert_allclose(matrix, [[0], [0.5], [0.2]])


def test_an_angle_offset_rotates_forces_and_positions():
    vehicle = default_vehicle()
    nominal = nominal_parameters(vehicle)
    turned = replace(nominal, angle_offset=2 * np.pi / 3).dynamics(np, vehicle).configuration
    # A third of a turn carries each pair onto the next one.
    straight = nominal.dynamics(np, vehicle).configuration
    np.testing.assert_allclose(turned, np.roll(straight, -2, axis=1), atol=1e-7)


def test_it_matches_the_published_matrix():
    # params.json holds the matrix that the authors' code computed for nominal parameters.
    matrix = nominal_parameters(default_vehicle()).dynamics(np, default_vehicle()).configuration
    np.testing.assert_allclose(matrix[0, 2:], np.array([-1, 1, 1, -1]) * 6.289218, rtol=1e-6)
    np.testing.assert_allclose(matrix[1, :2], [7.26216364, -7.26216364], rtol=1e-6)
    np.testing.assert_allclose(np.abs(matrix[2]), 130.70626, rtol=1e-6)


@given(speeds, motions)
def test_first_principles_equal_the_direct_matrix(speed, motion):
    vehicle, parameters = default_vehicle(), general_parameters()
    direct = replace(
        parameters, configuration_matrix=parameters.dynamics(np, vehicle).configuration
    )
    np.testing.assert_array_equal(
        acceleration(np, parameters.dynamics(np, vehicle), motion, speed),
        acceleration(np, direct.dynamics(np, vehicle), motion, speed),
    )


@given(speeds, motions)
def test_newton_and_euler_hold_about_the_centre_of_mass(speed, motion):
    """Sum forces and moments propeller by propeller, then move to the geometric centre."""
    vehicle, parameters = default_vehicle(), general_parameters()
    dynamics = parameters.dynamics(np, vehicle)
    forces = thrust(parameters.thrust, speed)
    yaw, _, _, spin = motion
    body = rotate(parameters.angle_offset, vehicle.directions * forces[:, None])
    arms = rotate(parameters.angle_offset, vehicle.positions) - parameters.center_of_mass
    moments = arms[:, 0] * body[:, 1] - arms[:, 1] * body[:, 0]
    spin_rate = moments.sum() / parameters.inertia
    center = rotate(yaw, body).sum(axis=0) / vehicle.mass_kg
    # The centre sits at -R r from the centre of mass: a = a_com + ω' × (-Rr) + ω²Rr.
    offset = rotate(yaw, parameters.center_of_mass)
    expected = center - spin_rate * np.array([-offset[1], offset[0]]) + spin**2 * offset
    result = acceleration(np, dynamics, motion, speed)
    np.testing.assert_allclose(result, [*expected, spin_rate], rtol=1e-10, atol=1e-9)


def test_the_papers_frame_does_not_rotate_the_mass_offset():
    vehicle, parameters = default_vehicle(), general_parameters()
    speed, motion = np.full(6, 0.3), np.array([1.0, 0.0, 0.0, 2.0])
    body = acceleration(np, parameters.dynamics(np, vehicle, "body"), motion, speed)
    world = acceleration(np, parameters.dynamics(np, vehicle, "world"), motion, speed)
    motion[0] = 0.0
    upright = acceleration(np, parameters.dynamics(np, vehicle, "world"), motion, speed)
    assert abs(body[0] - world[0]) > 1e-3
    # Without rotation both are the same.
    np.testing.assert_allclose(
        upright, acceleration(np, parameters.dynamics(np, vehicle, "body"), motion, speed)
    )


@examples(20)
@given(speeds, motions, speeds)
def test_numpy_and_jax_agree(speed, motion, command):
    dynamics = general_parameters().dynamics(np, default_vehicle())
    state = np.concatenate([[0.1, -0.2], motion, speed])
    with jax.enable_x64(True):
        traced = jax.jit(lambda z, u: derivative(jnp, dynamics, z, u))(state, command)
    # XLA flushes denormal numbers to zero.
    np.testing.assert_allclose(
        derivative(np, dynamics, state, command), traced, rtol=1e-12, atol=1e-300
    )


def test_coasting_conserves_momentum():
    # Without thrust the centre of mass moves straight, whatever the craft's spin.
    dynamics = general_parameters().dynamics(np, default_vehicle())
    motion = np.array([0.3, 0.5, -0.2, 5.0])
    ax, ay, spin_rate = acceleration(np, dynamics, motion, np.zeros(6))
    assert spin_rate == 0
    # d/dt (v + ω × R r) = a - ω² R r.
    c, s = np.cos(0.3), np.sin(0.3)
    offset = np.array([c * 3e-3 + s * 2e-3, s * 3e-3 - c * 2e-3])
    np.testing.assert_allclose([ax, ay], 25 * offset, atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 4, 8])
def test_any_number_of_propellers_is_accepted(n):
    rng = np.random.default_rng(n)
    matrix = configuration_matrix(
        np, rng.normal(size=(n, 2)), rng.normal(size=(n, 2)), 1.0, 1.0, 0.1, np.zeros(2)
    )
    assert matrix.shape == (3, n)


def test_the_control_offset_includes_the_table_slope():
    model = published_model("M3")
    sloping = replace(model.parameters, tilt=np.array([2e-3, -1e-3]))
    dynamics = sloping.dynamics(np, model.vehicle)
    yaw, spin, speed = 0.7, 2.0, np.linspace(0.2, 0.8, 6)
    matrix, offset = acceleration_map(np, dynamics, yaw, spin)
    motion = (np.array(yaw), np.array(0.0), np.array(0.0), np.array(spin))
    expected = np.stack(acceleration(np, dynamics, motion, speed))
    np.testing.assert_allclose(matrix @ thrust(dynamics.thrust, speed) + offset, expected)
