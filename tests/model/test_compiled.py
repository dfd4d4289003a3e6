"""Compiled programs: what they compute, and when one serves another function."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from airpuck.model import compiled
from airpuck.model.compiled import for_real_time
from airpuck.model.rollout import step
from airpuck.model_file import published_model

DYNAMICS = published_model("M3").dynamics


def moved(dynamics, duration):
    """A step of some length, of a function within a function."""

    def advance(state, command):
        return step(jnp, dynamics, state, command, duration)

    def program(state, command):
        return advance(state, command), state[0]

    return for_real_time(program, np.zeros(12), np.zeros(6))


def test_the_program_is_the_function_in_double_precision():
    rng = np.random.default_rng(0)
    state, command = rng.uniform(0.1, 1, 12), rng.uniform(0.1, 1, 6)
    before = jax.config.read("jax_enable_x64")
    after, x = moved(DYNAMICS, 0.01)(state, command)
    np.testing.assert_allclose(after, step(np, DYNAMICS, state, command, 0.01), rtol=1e-13)
    assert after.dtype == np.float64
    assert x == pytest.approx(state[0])
    assert jax.config.read("jax_enable_x64") == before


def test_what_computes_the_same_is_compiled_once():
    alike = replace(DYNAMICS, thrust=np.array(DYNAMICS.thrust))
    assert moved(alike, 0.01) is moved(DYNAMICS, 0.01)


def test_what_computes_something_else_is_not():
    programs = {
        moved(DYNAMICS, 0.01),
        moved(DYNAMICS, 0.02),
        moved(replace(DYNAMICS, thrust=1.01 * np.asarray(DYNAMICS.thrust)), 0.01),
        moved(replace(DYNAMICS, center_of_mass=np.array([1e-3, 0.0])), 0.01),
    }
    assert len(programs) == 4

    def twice(values):
        return (2 * values,)

    def thrice(values):
        return (3 * values,)

    assert for_real_time(twice, np.zeros(2)) is not for_real_time(thrice, np.zeros(2))
    assert for_real_time(twice, np.zeros(2)) is not for_real_time(twice, np.zeros(3))
    np.testing.assert_array_equal(for_real_time(thrice, np.zeros(2))(np.ones(2))[0], [3, 3])


def through(transform):
    """A program of a function that JAX transformed."""
    inner = transform(lambda values: jnp.sum(values**3))
    return for_real_time(lambda values: (jnp.atleast_1d(inner(values)),), np.zeros(2))


def test_a_transformed_function_is_another_one():
    sums, gradient = through(jax.jit), through(jax.grad)
    np.testing.assert_allclose(sums(np.ones(2))[0], [2.0])
    np.testing.assert_allclose(gradient(np.ones(2))[0], [3.0, 3.0])


def test_defaults_are_part_of_a_function():
    def times(factor):
        def program(values, *, factor=factor):
            return (factor * values,)

        return for_real_time(program, np.zeros(1))

    assert times(1.0) is not times(2.0)


def test_what_cannot_be_compared_is_compiled_each_time():
    def add(values, other):
        return (values + other,)

    def program():
        inner = partial(add, other=1.0)
        return for_real_time(lambda values: inner(values), np.zeros(1))

    first, second = program(), program()
    assert first is not second
    np.testing.assert_array_equal(second(np.ones(1))[0], [2.0])


def test_the_oldest_is_let_go(monkeypatch):
    monkeypatch.setattr(compiled, "_kept", {})
    monkeypatch.setattr(compiled, "_MOST_KEPT", 2)

    def times(factor):
        return for_real_time(lambda values: (factor * values,), np.zeros(1))

    first, second = times(1.0), times(2.0)
    assert times(1.0) is first  # and the second is now the oldest
    times(3.0)
    assert times(1.0) is first
    assert times(2.0) is not second
