"""The filter's equations against Van Loan's integral and Gaussian conditioning."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from airpuck.estimate.axis_filter import (
    INITIAL_DISTURBANCE,
    INITIAL_VELOCITY,
    IndependentAxes,
    Noise,
    correct,
    propagate,
    spread,
    to_world,
)
from airpuck.model.model_file import read_model
from airpuck.physics.effects import Drag
from airpuck.physics.rigid_body import acceleration

DYNAMICS = read_model("paper:M3").dynamics
NOISE = Noise((1e-4, 1e-4, 1e-3), (0.1, 0.1, 2.0), (0.2, 0.0, 3.0))
AXES = IndependentAxes(DYNAMICS, NOISE)
#: x, y, yaw: position, velocity, disturbance.
MEAN = np.array([[0.1, 0.3, 0.02], [-0.2, -0.5, 0.05], [2.0, 1.5, -0.4]])
SPEED = np.array([0.3, 0.1, 0.5, 0.2, 0.0, 0.4])


def belief():
    roots = np.random.default_rng(1).normal(size=(3, 3, 3))
    return MEAN.copy(), roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(3)


@given(st.floats(1e-4, 0.1), st.integers(0, 99))
def test_covariance_grows_by_van_loans_integral(h, seed):
    random = np.random.default_rng(seed)
    roots = random.normal(size=(3, 3, 3))
    covariance = roots @ roots.transpose(0, 2, 1)
    densities = random.uniform(0, 2, (2, 3))
    grown = spread(np, covariance, h, *densities)
    chain = np.eye(3, k=1)
    for i in range(3):
        driving = np.diag([0, densities[0, i], densities[1, i]])
        van_loan = expm(h * np.block([[-chain, driving], [np.zeros((3, 3)), chain.T]]))
        step = van_loan[3:, 3:].T
        expected = step @ covariance[i] @ step.T + step @ van_loan[:3, 3:]
        np.testing.assert_allclose(grown[i], expected, rtol=1e-11, atol=1e-14)


@given(st.integers(0, 2), st.integers(0, 99))
def test_a_correction_equals_gaussian_conditioning(component, seed):
    # Information form: precisions add.
    random = np.random.default_rng(seed)
    roots = random.normal(size=(3, 3, 3))
    covariance = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(3)
    mean, innovation = random.normal(size=(3, 3)), random.normal(size=3)
    variance = np.array([0.5, 2.0, np.inf])
    after, less = correct(mean, covariance, component, innovation, variance)
    unit = np.eye(3)[component]
    for i in range(3):
        precision = np.linalg.inv(covariance[i]) + np.outer(unit, unit) / variance[i]
        expected = np.linalg.inv(precision)
        np.testing.assert_allclose(less[i], expected, atol=1e-9)
        shift = expected @ unit * innovation[i] / variance[i]
        np.testing.assert_allclose(after[i], mean[i] + shift, atol=1e-9)


def test_the_yaw_rotates_body_vectors_into_the_world():
    for yaw in (0.0, 0.7, -2.0):
        vector = np.array([0.6, -0.3])
        found = complex(*to_world(vector, yaw))
        assert found == pytest.approx(complex(*vector) * np.exp(1j * yaw))


def test_a_new_belief_is_at_rest_and_uncertain():
    pose = np.array([0.3, -0.1, 1.0])
    mean, covariance = AXES.begin(pose, None, 0.0)
    np.testing.assert_array_equal(mean, np.column_stack([pose, np.zeros((3, 2))]))
    drives = np.array([1.0, 0.0, 1.0])  # the second axis has no disturbance
    for axis in range(3):
        deviations = (NOISE.pose[axis], INITIAL_VELOCITY[axis], INITIAL_DISTURBANCE[axis])
        expected = np.diag(np.square(deviations) * [1, 1, drives[axis]])
        np.testing.assert_allclose(covariance[axis], expected)


@pytest.mark.parametrize(("effects", "order"), [((), 2), ((Drag(0.3, 0.5, 0.2, 0.1),), 1)])
def test_the_mean_follows_the_equations_of_motion(effects, order):
    dynamics = replace(DYNAMICS, effects=effects)
    command = np.array([0.5, 0.0, 0.3, 0.6, 0.2, 0.1])
    tau = float(DYNAMICS.motor_time_constant)

    def rate(t, state):
        speeds = command + (SPEED - command) * math.exp(-t / tau)
        yaw, vx, vy, spin = state[2:]
        gained = np.array(acceleration(np, dynamics, (yaw, vx, vy, spin), speeds)) + MEAN[:, 2]
        return [vx, vy, spin, *gained]

    start = np.concatenate([MEAN[:, 0], MEAN[:, 1]])
    errors = []
    for count in (4, 8, 16):
        h = 0.1 / count
        mean, speed = propagate(
            np, dynamics, MEAN, SPEED, np.full(count, h), np.tile(command, (count, 1))
        )
        exact = solve_ivp(rate, (0.0, 0.1), start, rtol=1e-11, atol=1e-12).y[:, -1]
        errors.append(np.abs(np.concatenate([mean[:, 0], mean[:, 1]]) - exact).max())
        np.testing.assert_allclose(speed, command + (SPEED - command) * math.exp(-0.1 / tau))
        np.testing.assert_array_equal(mean[:, 2], MEAN[:, 2])
    # Half the step, a quarter of the error; half with drag, which is evaluated at the step's start.
    assert errors[0] < 0.02
    for coarse, fine in pairwise(errors):
        assert 0.75 * 2**order < coarse / fine < 1.25 * 2**order


def test_an_exact_mouse_determines_the_velocity():
    body = np.array([0.4, 0.1])
    mean, covariance = AXES.use_mouse(belief(), body, 1e-9)
    assert complex(*mean[:2, 1]) == pytest.approx(complex(*body) * np.exp(2j))
    np.testing.assert_allclose(covariance[:2, 1, 1], 0.0, atol=1e-12)
    # The angular velocity is unaffected, and a bad mouse has no effect at all.
    np.testing.assert_array_equal(mean[2], MEAN[2])
    np.testing.assert_allclose(AXES.use_mouse(belief(), body, 1e9)[0], MEAN, atol=1e-9)


def test_an_exact_inertial_sensor_determines_disturbance_and_spin():
    felt, gyro = np.array([0.5, -0.2]), 1.2
    motion = MEAN[2, 0], MEAN[0, 1], MEAN[1, 1], MEAN[2, 1]
    modelled = acceleration(np, DYNAMICS, motion, SPEED)
    mean, covariance = AXES.use_imu(belief(), (SPEED, SPEED), felt, gyro, (1e-9, 1e-9))
    world = complex(*felt) * np.exp(2j)
    # The sensor measures the model's acceleration plus the disturbance.
    assert complex(*mean[:2, 2]) == pytest.approx(world - complex(*modelled[:2]))
    assert mean[2, 1] == pytest.approx(gyro)
    np.testing.assert_allclose(covariance[:2, 2, 2], 0.0, atol=1e-9)
    assert covariance[2, 1, 1] == pytest.approx(0.0, abs=1e-9)
    # A gyro alone does not change x and y, and vice versa.
    mean, _ = AXES.use_imu(belief(), (SPEED, SPEED), felt, gyro, (1e9, 1e-9))
    np.testing.assert_allclose(mean[:2], MEAN[:2], atol=1e-9)
    mean, _ = AXES.use_imu(belief(), (SPEED, SPEED), felt, gyro, (1e-9, 1e9))
    np.testing.assert_allclose(mean[2], MEAN[2], atol=1e-9)


def test_a_pose_is_compared_by_its_shortest_angle_after_predicting_to_it():
    command = np.array([0.5, 0.0, 0.3, 0.6, 0.2, 0.1])
    pieces = np.array([0.004, 0.002]), np.stack([command, SPEED])
    mean, covariance, speed = AXES.advance(np, *belief(), SPEED, *pieces)
    # Two turns further is the same yaw.
    pose = mean[:, 0] + [1e-3, -2e-3, 0.01 + 4 * math.pi]
    after, less, same, innovation = AXES.use_pose(np, *belief(), SPEED, *pieces, pose)
    np.testing.assert_allclose(innovation, [1e-3, -2e-3, 0.01])
    np.testing.assert_array_equal(same, speed)
    expected, smaller = correct(mean, covariance, 0, innovation, np.square(NOISE.pose))
    np.testing.assert_allclose(after, expected)
    np.testing.assert_allclose(less, smaller)
    state, *_ = AXES.predict(np, *belief(), SPEED, *pieces)
    np.testing.assert_allclose(state, np.concatenate([mean[:, 0], mean[:, 1]]))
