"""Cosine and sine, computed once."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from airpuck.model.rotation import cos_sin

ANGLES = np.linspace(-7, 7, 57)


@pytest.mark.parametrize("shape", [(), (57,), (19, 3)])
def test_is_cosine_and_sine_of_any_shape(shape):
    angle = np.resize(ANGLES, shape)
    for xp in (np, jnp):
        with jax.enable_x64(True):
            cos, sin = cos_sin(xp, xp.asarray(angle))
        np.testing.assert_allclose(cos, np.cos(angle), rtol=0, atol=1e-15)
        np.testing.assert_allclose(sin, np.sin(angle), rtol=0, atol=1e-15)


def test_derivatives_of_both_modes():
    with jax.enable_x64(True):
        angle = jnp.asarray(ANGLES)
        for jacobian in (jax.jacfwd, jax.jacrev):
            by_cos, by_sin = jacobian(lambda angle: cos_sin(jnp, angle))(angle)
            np.testing.assert_allclose(by_cos, -np.diag(np.sin(ANGLES)), atol=1e-15)
            np.testing.assert_allclose(by_sin, np.diag(np.cos(ANGLES)), atol=1e-15)


def test_keeps_the_precision():
    assert {value.dtype for value in cos_sin(jnp, jnp.ones(3, np.float32))} == {np.dtype("f4")}


def test_a_compiled_program_has_one_sine_and_one_cosine():
    def turned(angle, first, second):
        cos, sin = cos_sin(jnp, angle)
        return cos * first - sin * second, (sin * first).sum() + (cos * second).max()

    arguments = np.ones(64), np.ones((5, 64)), np.ones((3, 5, 64))
    on_cpu = jax.device_put(arguments, jax.local_devices(backend="cpu")[0])
    program = jax.jit(turned).lower(*on_cpu).compile().as_text()
    assert [len(re.findall(rf" {name}\(", program)) for name in ("sine", "cosine")] == [1, 1]
