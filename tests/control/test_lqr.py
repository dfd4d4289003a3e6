"""The regulator, against python-control and the cost that it should minimise."""

from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import cont2discrete

from airpuck.boundary.errors import InputError
from airpuck.control.lqr import (
    LQRSettings,
    Weights,
    look_ahead,
    lqr,
    lqr_gain,
    motor_lag,
    point_mass,
    rotation_error,
)
from airpuck.control.tuning import default_tuning
from airpuck.model.model_file import published_model

weight = st.floats(0.01, 100)


def weights(**changed: float) -> Weights:
    return default_tuning().of(LQRSettings).weights.model_copy(update=changed)


@given(st.tuples(weight, weight, weight, weight, weight, weight), st.floats(0.002, 0.1))
def test_gain_agrees_with_python_control(six, h):
    names = "position", "speed", "yaw", "spin", "acceleration", "angular_acceleration"
    w = Weights(**dict(zip(names, six, strict=True)))
    q = np.diag([w.position, w.position, w.yaw, w.speed, w.speed, w.spin])
    r = np.diag([w.acceleration, w.acceleration, w.angular_acceleration])
    # Numerical matrices, so that the discretisation is independent of ours, too.
    plant = control.c2d(control.ss(np.eye(6, k=3), np.eye(6, 3, k=-3), np.eye(6), 0), h, "zoh")
    expected, _, _ = control.dlqr(plant, q, r)
    np.testing.assert_allclose(
        lqr_gain(w, h), expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max()
    )


@given(st.integers(0, 2**32 - 1))
def test_gain_of_any_system_agrees_with_python_control(seed):
    random = np.random.default_rng(seed)
    n, m = int(random.integers(1, 5)), int(random.integers(1, 4))
    a, b = random.normal(size=(n, n)), random.normal(size=(n, m))
    root = random.normal(size=(n, n))
    q, r = root @ root.T + np.eye(n), np.diag(random.uniform(0.1, 10, m))
    expected, _, _ = control.dlqr(a, b, q, r)
    np.testing.assert_allclose(lqr(a, b, q, r), expected, rtol=1e-7, atol=1e-9)


def cost(gain, a, b, q, r):
    """Sum of the costs over all time, from every unit state: from the Lyapunov equation."""
    closed = a - b @ gain
    return np.trace(solve_discrete_lyapunov(closed.T, q + gain.T @ r @ gain))


def test_the_gain_is_a_minimum_of_the_cost():
    a, b = point_mass(0.01)
    q, r = np.diag([8.6, 8.6, 24.0, 0.8, 0.8, 1.0]), 0.1 * np.eye(3)
    best = lqr(a, b, q, r)
    least = cost(best, a, b, q, r)
    random = np.random.default_rng(0)
    for _ in range(50):
        away = best + 1e-2 * random.normal(size=best.shape)
        assert cost(away, a, b, q, r) > least


def test_the_packaged_tuning_gives_the_gains_of_the_real_flights():
    tuning = default_tuning()
    k = lqr_gain(tuning.of(LQRSettings).weights, tuning.period_s)
    position, speed, yaw, spin = 9.04, 5.07, 15.0, 6.28
    expected = np.hstack([np.diag([position, position, yaw]), np.diag([speed, speed, spin])])
    np.testing.assert_allclose(k, expected, rtol=0.01, atol=1e-9)


@pytest.mark.parametrize("state", ["position", "yaw"])
def test_a_position_without_weight_is_rejected(state):
    with pytest.raises(InputError, match=r"weights: .*positive weight"):
        lqr_gain(weights(**{state: 0.0}), 0.01)


def test_rates_may_have_zero_weight():
    k = lqr_gain(weights(speed=0.0, spin=0.0), 0.01)
    a, b = point_mass(0.01)
    assert np.abs(np.linalg.eigvals(a - b @ k)).max() < 1


def test_the_step_response_of_the_closed_loop_agrees_with_python_control():
    tuning = default_tuning()
    h, target = tuning.period_s, np.array([0.5, -0.3, 1.2, 0.0, 0.0, 0.0])
    a, b = point_mass(h)
    k = lqr_gain(tuning.of(LQRSettings).weights, h)
    # x⁺ = A x + B (-K (x - target)): ours, step by step.
    steps = 500
    ours = np.zeros((steps, 6))
    for i in range(steps - 1):
        ours[i + 1] = a @ ours[i] - b @ (k @ (ours[i] - target))
    # Theirs: discretisation, gain and simulation.
    double = control.ss(np.eye(6, k=3), np.eye(6, 3, k=-3), np.eye(6), np.zeros((6, 3)))
    plant = control.c2d(double, h, "zoh")
    w = tuning.of(LQRSettings).weights
    theirs, _, _ = control.dlqr(
        plant,
        np.diag([w.position, w.position, w.yaw, w.speed, w.speed, w.spin]),
        np.diag([w.acceleration, w.acceleration, w.angular_acceleration]),
    )
    push = plant.B @ theirs
    loop = control.ss(plant.A - push, push, np.eye(6), np.zeros((6, 6)), dt=h)
    inputs: Any = np.tile(target[:, None], steps)
    response = control.forced_response(loop, np.arange(steps) * h, inputs)
    np.testing.assert_allclose(ours, np.asarray(response.outputs).T, atol=1e-9)
    np.testing.assert_allclose(ours[-1], target, atol=1e-3)


period = st.floats(1e-3, 0.5)


@given(period)
def test_point_mass_agrees_with_scipy(h):
    double = np.eye(6, k=3), np.eye(6, 3, k=-3), np.eye(6), np.zeros((6, 3))
    expected: Any = cont2discrete(double, h, method="zoh")
    for ours, theirs in zip(point_mass(h), expected, strict=False):
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-16)


@given(period)
def test_point_mass_is_uniformly_accelerated_motion(h):
    a, b = point_mass(h)
    start, push = np.array([1.0, -2.0, 0.3, 0.5, -0.7, 4.0]), np.array([0.9, -0.4, 30.0])
    following = a @ start + b @ push
    position = start[:3] + h * start[3:] + h**2 / 2 * push
    np.testing.assert_allclose(following[:3], position, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(following[3:], start[3:] + h * push, rtol=1e-13)


def test_point_mass_matches_a_hand_calculation():
    a, b = point_mass(0.01)
    eye, nothing = np.eye(3), np.zeros((3, 3))
    np.testing.assert_allclose(a, np.block([[eye, 0.01 * eye], [nothing, eye]]), atol=1e-16)
    np.testing.assert_allclose(b, np.vstack([5e-5 * eye, 0.01 * eye]), atol=1e-16)


@given(st.floats(1e-3, 1.0), period)
def test_motor_lag_is_exponential(tau, h):
    a, b = motor_lag(tau, h)
    assert a == pytest.approx(np.exp(-h / tau), rel=1e-11, abs=1e-16)
    assert b == pytest.approx(-np.expm1(-h / tau), rel=1e-11)


def test_a_motor_without_lag_follows_immediately():
    assert motor_lag(0.0, 0.01) == (0.0, 1.0)


@given(st.floats(-40, 40), st.floats(1e-3, 0.1))
def test_rotation_error_is_the_neglected_part_of_the_impulse(spin, h):
    # A unit force along x that turns with the craft, in units of what it would give unturned.
    along = quad(lambda t: np.cos(spin * t), 0, h)[0] / h
    across = quad(lambda t: np.sin(spin * t), 0, h)[0] / h
    expected = np.hypot(along - 1, across)
    error = rotation_error(np.array([spin]), np.array([h]))
    np.testing.assert_allclose(error, [expected], atol=1e-12)


def test_rotation_error_starts_at_half_the_angle():
    spin, h = np.array([1e-3, -1e-3]), np.array([0.01, 0.01])
    np.testing.assert_allclose(rotation_error(spin, h), [5e-6, 5e-6], rtol=1e-6)


def test_a_weak_motor_is_modelled_with_less_thrust():
    rng = np.random.default_rng(0)
    dynamics = published_model("M3").dynamics
    weak = rng.uniform(0.3, 1.0, 6)
    weaker = replace(dynamics, thrust=dynamics.thrust * weak[:, None])
    given_state = rng.uniform(-1, 1, 6), rng.uniform(0.2, 1.0, 6), np.zeros(3)
    following, matrix, offset = look_ahead(np, dynamics, 0.01, *given_state, weak)
    same, full, unchanged = look_ahead(np, weaker, 0.01, *given_state, np.ones(6))
    np.testing.assert_allclose(following, same, rtol=1e-12)
    np.testing.assert_allclose(matrix, full * weak, rtol=1e-12)
    np.testing.assert_allclose(offset, unchanged, rtol=1e-12)
