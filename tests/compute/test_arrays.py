"""Array operations under NumPy do what they do under JAX."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from airpuck.compute.arrays import (
    if_any,
    linear_map,
    register_pytree,
    repeat_while,
    scan,
    small_product,
)


def test_small_products_equal_matrix_products():
    random = np.random.default_rng(0)
    matrix, stack = random.normal(size=(3, 4)), random.normal(size=(2, 4, 4))
    np.testing.assert_allclose(small_product(np, matrix, stack), matrix @ stack)
    np.testing.assert_allclose(small_product(np, stack, stack), stack @ stack)
    np.testing.assert_allclose(small_product(np, matrix, stack[0, 0]), matrix @ stack[0, 0])


def test_scan_matches_jax_scan():
    body = lambda carry, x: (carry + x[0] * x[1], carry * 2)  # noqa: E731
    xs = (np.arange(5.0), np.arange(5.0)[::-1])
    with jax.enable_x64(True):
        total, steps = jax.lax.scan(body, 1.0, tuple(map(jnp.asarray, xs)))
        expected = float(total), np.asarray(steps)
    carry, outputs = scan(np, body, 1.0, xs)
    assert carry == expected[0]
    np.testing.assert_array_equal(outputs, expected[1])


@pytest.mark.parametrize("batch", [(), (4,), (4, 2)])
def test_a_linear_map_accepts_one_matrix_or_one_per_vector(batch):
    rng = np.random.default_rng(0)
    matrix, vector = rng.normal(size=(3, 5)), rng.normal(size=(5, *batch))
    expected = np.einsum("ij,j...->i...", matrix, vector)
    np.testing.assert_allclose(linear_map(matrix, vector), expected)
    each = np.broadcast_to(matrix.reshape(3, 5, *(1,) * len(batch)), (3, 5, *batch))
    np.testing.assert_allclose(linear_map(each, vector), expected)


@pytest.mark.parametrize("xp", [np, jnp])
def test_branches_and_loops_match_python(xp):
    assert if_any(xp, xp.array([False, True]), lambda x: x + 1, 1.0) == 2
    assert if_any(xp, xp.array([False, False]), lambda x: x + 1, 1.0) == 1
    assert repeat_while(xp, lambda x: x < 100, lambda x: 2 * x, 1.0) == 128


def test_concurrent_threads_register_a_dataclass_once(monkeypatch):
    @dataclass
    class Pair:
        one: float
        frame: str

    registered = []
    register = "jax.tree_util.register_pytree_node"
    monkeypatch.setattr(register, lambda kind, *_: time.sleep(0.01) or registered.append(kind))
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda _: register_pytree(Pair, static=lambda _: ("frame",)), range(8)))
    assert registered == [Pair]
