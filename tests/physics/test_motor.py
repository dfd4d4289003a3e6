"""The motor lag."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from airpuck.physics.motor import motor_speeds, motor_step

unit = st.floats(0, 1)


@given(unit, unit, st.floats(1e-4, 0.1), st.floats(1e-3, 0.2))
def test_a_motor_step_matches_the_matrix_exponential(speed, command, duration, tau):
    # Zero-order hold of φ' = (u - φ)/τ: the exponential of [[-1/τ, 1/τ], [0, 0]] h.
    step = expm(np.array([[-1 / tau, 1 / tau], [0, 0]]) * duration)
    expected = step[0] @ [speed, command]
    assert motor_step(np, speed, command, duration, tau) == pytest.approx(expected, abs=1e-12)


@given(unit, unit, st.floats(1e-4, 0.05), st.floats(1e-4, 0.05), st.floats(1e-3, 0.2))
def test_two_half_steps_equal_one_step(speed, command, first, second, tau):
    halfway = motor_step(np, speed, command, first, tau)
    assert motor_step(np, halfway, command, second, tau) == pytest.approx(
        motor_step(np, speed, command, first + second, tau), abs=1e-12
    )


@given(
    st.integers(0, 2**32 - 1), st.integers(1, 300), st.sampled_from([0.0, 1e-4, 0.03, 5.0]),
    st.sampled_from([0.0, 2.0]),
)  # fmt: skip
def test_filtering_all_samples_at_once_equals_stepping(seed, count, tau, idle_lag):
    rng = np.random.default_rng(seed)
    time, command = np.cumsum(rng.uniform(1e-3, 9e-3, count)), rng.random((count, 2))
    expected = command[:1]
    for k, duration in enumerate(np.diff(time)):
        last = motor_step(np, expected[-1], command[k], duration, tau, idle_lag)
        expected = np.concatenate([expected, last[None]])
    found = motor_speeds(time, command, tau, idle_lag)
    np.testing.assert_allclose(found, expected, atol=1e-8 if idle_lag else 1e-13)


def idle_motor(speed, command, duration, tau, longer):
    """φ' = (u - φ)/(τ (1 + c exp(-φ/0.1))), by SciPy."""

    def rate(_, speed):
        return (command - speed) / (tau * (1 + longer * np.exp(-speed / 0.1)))

    found = solve_ivp(rate, (0, duration), [speed], rtol=1e-10, atol=1e-12)
    return found.y[0, -1]


@pytest.mark.parametrize(("speed", "command"), [(0.03, 1.0), (0.03, 0.3), (1.0, 0.03), (0.5, 0.6)])
def test_a_motor_with_idle_lag_follows_its_differential_equation(speed, command):
    errors = []
    for steps in (6, 12):  # 25 ms in steps of a sample of the motion capture, and of half
        found = speed
        for _ in range(steps):
            found = motor_step(np, found, command, 0.025 / steps, 0.028, 2.0)
        errors.append(abs(found - idle_motor(speed, command, 0.025, 0.028, 2.0)))
    assert errors[0] < 2e-3
    # Of second order: half the step, a quarter of the error.
    assert errors[1] < 0.35 * errors[0] + 1e-9


def test_zero_idle_lag_changes_nothing():
    assert motor_step(np, 0.2, 0.7, 0.01, 0.03, 0.0) == motor_step(np, 0.2, 0.7, 0.01, 0.03)


def test_without_lag_a_motor_follows_immediately():
    assert motor_step(np, 0.2, 0.7, 0.01, 0.0) == 0.7


@pytest.mark.parametrize("tau", [0.0, 0.03])
def test_derivatives_are_finite(tau):
    with jax.enable_x64(True):
        gradient = jax.grad(lambda tau: motor_step(jnp, 0.2, 0.7, 0.01, tau))(tau)
    assert np.isfinite(gradient)
