"""The motor lag."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from airpuck.physics.motor import motor_speeds, motor_step

unit = st.floats(0, 1)


@given(unit, unit, st.floats(1e-4, 0.1), st.floats(1e-3, 0.2))
def test_agrees_with_the_matrix_exponential(speed, command, duration, tau):
    # Zero-order hold of φ' = (u - φ)/τ: the exponential of [[-1/τ, 1/τ], [0, 0]] h.
    step = expm(np.array([[-1 / tau, 1 / tau], [0, 0]]) * duration)
    expected = step[0] @ [speed, command]
    assert motor_step(np, speed, command, duration, tau) == pytest.approx(expected, abs=1e-12)


@given(unit, unit, st.floats(1e-4, 0.05), st.floats(1e-4, 0.05), st.floats(1e-3, 0.2))
def test_two_steps_are_one(speed, command, first, second, tau):
    halfway = motor_step(np, speed, command, first, tau)
    assert motor_step(np, halfway, command, second, tau) == pytest.approx(
        motor_step(np, speed, command, first + second, tau), abs=1e-12
    )


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.sampled_from([0.0, 1e-4, 0.03, 5.0]))
def test_all_samples_at_once_are_one_after_another(seed, count, tau):
    rng = np.random.default_rng(seed)
    time, command = np.cumsum(rng.uniform(1e-3, 9e-3, count)), rng.random((count, 2))
    expected = command[:1]
    for k, duration in enumerate(np.diff(time)):
        last = motor_step(np, expected[-1], command[k], duration, tau)
        expected = np.concatenate([expected, last[None]])
    np.testing.assert_allclose(motor_speeds(time, command, tau), expected, atol=1e-13)


def test_no_lag_follows_at_once():
    assert motor_step(np, 0.2, 0.7, 0.01, 0.0) == 0.7


@pytest.mark.parametrize("tau", [0.0, 0.03])
def test_derivatives_are_finite(tau):
    with jax.enable_x64(True):
        gradient = jax.grad(lambda tau: motor_step(jnp, 0.2, 0.7, 0.01, tau))(tau)
    assert np.isfinite(gradient)
