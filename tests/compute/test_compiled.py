"""Compiled programs: their results, and when functions share one."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from airpuck.compute import compiled
from airpuck.compute.compiled import double_precision, for_batches, for_samples, lengthened, program
from airpuck.model.model_file import published_model
from airpuck.physics.rigid_body import step

DYNAMICS = published_model("M3").dynamics


def moved(dynamics, duration):
    """A step of some length, of a function within a function."""

    def advance(xp, state, command):
        return step(xp, dynamics, state, command, duration)

    def pair(xp, state, command):
        return advance(xp, state, command), state[0]

    return program(pair, np.zeros(12), np.zeros(6), compiled=True)


def test_the_program_equals_the_function_in_double_precision():
    rng = np.random.default_rng(0)
    state, command = rng.uniform(0.1, 1, 12), rng.uniform(0.1, 1, 6)
    before = jax.config.read("jax_enable_x64")
    after, x = moved(DYNAMICS, 0.01)(state, command)
    np.testing.assert_allclose(after, step(np, DYNAMICS, state, command, 0.01), rtol=1e-13)
    assert after.dtype == np.float64
    assert x == pytest.approx(state[0])
    assert jax.config.read("jax_enable_x64") == before


def test_equal_functions_are_compiled_once():
    alike = replace(DYNAMICS, thrust=np.array(DYNAMICS.thrust))
    assert moved(alike, 0.01).func is moved(DYNAMICS, 0.01).func


def test_bound_functions_share_a_program_whatever_their_numbers():
    def scaled(xp, known, values):
        (factor, name), shift = known
        return (factor * values + (shift[0] if name == "first" else shift[1]),)

    def bound(factor, name, shift):
        known = (factor, name), np.array(shift)
        return program(compiled.Applied(scaled, known), np.ones(2), compiled=True)

    given = (2.0, "first", [1.0, 5.0]), (3.0, "first", [2.0, 5.0]), (2.0, "second", [1.0, 5.0])
    one, two, other = programs = [bound(*numbers) for numbers in given]
    assert one.func is two.func is not other.func
    assert [found(np.ones(2))[0][0] for found in programs] == [3.0, 5.0, 7.0]

    def decided(xp, known, values):
        factor, first = known
        return (values[first] if factor > 2 else -values[first],)

    for factor, result in ((1.0, -1.0), (3.0, 1.0)):
        chosen = compiled.Applied(decided, (factor, np.array([0])))
        assert program(chosen, np.ones(2), compiled=True)(np.ones(2))[0] == result
        multiplied = partial(lambda _, value, gain: (gain * value,), gain=factor)
        assert program(multiplied, 0.0, compiled=True)(1.0)[0] == factor


class Scale:
    def __init__(self, factor):
        self.factor = factor

    def apply(self, xp, values):
        return (self.factor * values,)

    apply.__wrapped__ = lambda self, xp, values: (values,)  # pyright: ignore


def test_methods_of_different_objects_are_different_programs():
    for factor in (2.0, 3.0):
        assert program(Scale(factor).apply, np.ones(1), compiled=True)(np.ones(1))[0] == factor


def test_different_functions_are_compiled_separately():
    programs = {
        moved(DYNAMICS, 0.01).func,
        moved(DYNAMICS, 0.02).func,
        moved(replace(DYNAMICS, thrust=1.01 * np.asarray(DYNAMICS.thrust)), 0.01).func,
        moved(replace(DYNAMICS, center_of_mass=np.array([1e-3, 0.0])), 0.01).func,
    }
    assert len(programs) == 4

    def twice(xp, values):
        return (2 * values,)

    def thrice(xp, values):
        return (3 * values,)

    assert compiled_for(twice, 2).func is not compiled_for(thrice, 2).func
    assert compiled_for(twice, 2).func is not compiled_for(twice, 3).func
    np.testing.assert_array_equal(compiled_for(thrice, 2)(np.ones(2))[0], [3, 3])


def compiled_for(function, size):
    """A program of one vector."""
    return program(function, np.zeros(size), compiled=True)


def through(transform):
    """A program of a function that JAX transformed."""
    inner = transform(lambda values: jnp.sum(values**3))
    return compiled_for(lambda xp, values: (jnp.atleast_1d(inner(values)),), 2)


def test_a_transformed_function_is_a_different_program():
    sums, gradient = through(jax.jit), through(jax.grad)
    np.testing.assert_allclose(sums(np.ones(2))[0], [2.0])
    np.testing.assert_allclose(gradient(np.ones(2))[0], [3.0, 3.0])


def test_defaults_distinguish_functions():
    def times(factor):
        return compiled_for(lambda xp, values, *, factor=factor: (factor * values,), 1)

    assert times(1.0) is not times(2.0)


def test_functions_that_cannot_be_compared_are_always_compiled():
    def add(values, other):
        return (values + other,)

    def adds_one():
        inner = partial(add, other=1.0)
        return compiled_for(lambda xp, values: inner(values), 1)

    first, second = adds_one(), adds_one()
    assert first is not second
    np.testing.assert_array_equal(second(np.ones(1))[0], [2.0])


def test_a_function_receives_its_array_namespace():
    def turned(xp, angle, vector):
        return xp.stack([xp.cos(angle), xp.sin(angle)]) * vector, xp.isfinite(vector).all()

    angle, vector = np.array(0.3), np.array([1.0, 2.0])
    for choice in (True, False):
        result, finite = program(turned, angle, vector, compiled=choice)(angle, vector)
        np.testing.assert_allclose(result, [np.cos(0.3), 2 * np.sin(0.3)], rtol=1e-15)
        assert finite
        result[0] = 5  # the caller's own


@pytest.mark.parametrize(
    "given",
    [
        np.arange(6.0).reshape(2, 3),
        np.arange(6.0).reshape(3, 2).T,
        np.arange(12.0).reshape(2, 6)[:, ::2],
        np.arange(6).reshape(2, 3),
        np.arange(6, dtype=np.float32).reshape(2, 3),
        np.arange(6.0).reshape(2, 3).astype(">f8"),
        np.array([[True, False, True], [False, False, True]]),
        [[1, 2, 3], [4, 5, 6]],
    ],
    ids=["plain", "transposed", "sliced", "integers", "single", "big-endian", "truths", "lists"],
)
def test_arguments_of_any_kind_and_layout_are_accepted(given):
    def weighted(xp, matrix, scale):
        return (scale * matrix @ np.array([1.0, 10.0, 100.0]),)

    run = program(weighted, np.zeros((2, 3)), 0.0, compiled=True)
    expected = 0.5 * np.array(given, dtype=float) @ [1, 10, 100]
    for scale in (0.5, np.float64(0.5), np.array(0.5)):
        np.testing.assert_allclose(run(given, scale)[0], expected, rtol=1e-15)


def test_only_batches_are_forced_to_double_precision():
    before = jax.config.read("jax_enable_x64")
    assert for_batches(lambda x: x / 3)(np.ones(2)).dtype == np.float64
    with double_precision():
        assert jnp.ones(2).dtype == np.float64
    assert jax.config.read("jax_enable_x64") == before


def test_a_scan_is_compiled_once_for_all_lengths():
    traced = []

    def step(known, carry, sample):
        traced.append(sample)
        total, product = carry
        value, weights = sample
        # Padding of the last stretch must not reach the results, not even as nan.
        return (total + known * value, product / weights.sum()), (total, weights)

    run, random = for_samples(step), np.random.default_rng(0)
    for count in (3, 512, 513, 1100):
        value, weights = random.normal(size=count), random.uniform(0.4, 0.6, (count, 2))
        (total, product), (before, same) = run(2.0, (1.0, 1.0), (value, weights))
        np.testing.assert_allclose(total, 1 + 2 * value.sum(), rtol=1e-12)
        np.testing.assert_allclose(product, np.prod(1 / weights.sum(axis=1)), rtol=1e-12)
        np.testing.assert_allclose(before, 1 + 2 * (np.cumsum(value) - value), rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(same, weights)
        assert before.dtype == np.float64
        if count == 3:
            once = len(traced)
    assert len(traced) == once


@pytest.mark.parametrize(("count", "length"), [(1, 4), (4, 4), (5, 8), (8, 8), (9, 16)])
def test_rows_are_padded_to_a_power_of_two(count, length):
    values = np.arange(2 * count).reshape(count, 2)
    longer = lengthened(values, 4)
    assert len(longer) == length
    np.testing.assert_array_equal(longer[:count], values)
    assert (longer[count:] == values[-1]).all()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="mappings are counted on Linux")
def test_compiling_for_many_recordings_keeps_memory_bounded():
    def mappings():
        return len(Path("/proc/self/maps").read_text().splitlines())

    def shifted(values):
        return jax.lax.scan(lambda sum, k: (jnp.sort(sum) + k, None), values, jnp.arange(3.0))[0]

    batch, least = for_batches(shifted), mappings()
    for size in range(2, 132):
        assert batch(np.zeros(size))[0] == 3.0
        least = max(least, mappings()) if size < 62 else least
    assert mappings() <= 1.5 * least
