"""The integrator: order, and agreement with diffrax."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from airpuck.model.model_file import published_model
from airpuck.physics.rigid_body import derivative, rollout, step

RNG = np.random.default_rng(0)
STATE = np.concatenate([[0.1, -0.2, 0.4, 0.5, -0.3, 6.0], RNG.uniform(0.05, 0.6, 6)])
COMMAND = RNG.uniform(0.03, 1, 6)


@pytest.fixture(scope="module")
def dynamics():
    return published_model("M3").dynamics


@pytest.fixture(scope="module")
def reference(dynamics):
    """State after 0.1 s by an adaptive method of eighth order at tight tolerance."""
    with jax.enable_x64(True):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, z, u: derivative(jnp, dynamics, z, u)),
            diffrax.Dopri8(),
            t0=0.0,
            t1=0.1,
            dt0=1e-3,
            y0=jnp.asarray(STATE),
            args=jnp.asarray(COMMAND),
            stepsize_controller=diffrax.PIDController(rtol=1e-13, atol=1e-14),
            max_steps=100_000,
        )
        return np.asarray(solution.ys[-1])


def after(dynamics, steps):
    states = rollout(np, dynamics, STATE, np.tile(COMMAND, (steps, 1)), np.full(steps, 0.1 / steps))
    return states[-1]


def test_the_rollout_converges_at_fourth_order(dynamics, reference):
    errors = [np.abs(after(dynamics, n) - reference)[:6].max() for n in (4, 8, 16, 32)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4, atol=0.35)


def test_motors_are_exact_at_any_step(dynamics, reference):
    np.testing.assert_allclose(after(dynamics, 1)[6:], reference[6:], atol=1e-12)


def test_at_240_hz_the_integration_error_is_negligible(dynamics, reference):
    assert np.abs(after(dynamics, 24) - reference)[:3].max() < 1e-6


def test_without_lag_a_new_command_acts_from_the_start():
    dynamics = published_model("M0").dynamics
    moved = step(np, dynamics, STATE, COMMAND, 0.01)
    other = step(np, dynamics, np.concatenate([STATE[:6], np.zeros(6)]), COMMAND, 0.01)
    np.testing.assert_array_equal(moved, other)
    np.testing.assert_array_equal(moved[6:], COMMAND)


def test_numpy_and_jax_agree(dynamics):
    state = np.stack([STATE, STATE * 1.1], axis=1)
    commands = RNG.uniform(0.03, 1, (20, 6, 2))
    durations = np.full((20, 2), 1 / 240)
    with jax.enable_x64(True):
        traced = rollout(jnp, dynamics, jnp.asarray(state), commands, durations)
    np.testing.assert_allclose(
        rollout(np, dynamics, state, commands, durations), traced, rtol=1e-11, atol=1e-12
    )
