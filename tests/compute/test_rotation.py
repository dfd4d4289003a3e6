"""Cosine and sine, computed once."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.compute.rotation import cos_sin, polynomials

ANGLES = np.linspace(-7, 7, 57)


@pytest.mark.parametrize("shape", [(), (57,), (19, 3)])
def test_cos_sin_matches_numpy_for_any_shape(shape):
    angle = np.resize(ANGLES, shape)
    for xp in (np, jnp):
        with jax.enable_x64(True):
            cos, sin = cos_sin(xp, xp.asarray(angle))
        np.testing.assert_allclose(cos, np.cos(angle), rtol=0, atol=1e-15)
        np.testing.assert_allclose(sin, np.sin(angle), rtol=0, atol=1e-15)


def test_forward_and_reverse_derivatives_are_correct():
    with jax.enable_x64(True):
        angle = jnp.asarray(ANGLES)
        for jacobian in (jax.jacfwd, jax.jacrev):
            by_cos, by_sin = jacobian(lambda angle: cos_sin(jnp, angle))(angle)
            np.testing.assert_allclose(by_cos, -np.diag(np.sin(ANGLES)), atol=1e-15)
            np.testing.assert_allclose(by_sin, np.diag(np.cos(ANGLES)), atol=1e-15)


@pytest.mark.parametrize("double", [True, False])
def test_single_precision_is_kept(double):
    angle = ANGLES.astype("f4")
    with jax.enable_x64(double):
        found = jnp.stack(cos_sin(jnp, jnp.asarray(angle)))
    assert found.dtype == np.dtype("f4")
    expected = np.cos(angle, dtype="f8"), np.sin(angle, dtype="f8")
    np.testing.assert_allclose(found, expected, rtol=0, atol=1.5e-7)


def test_second_derivatives_are_correct():
    with jax.enable_x64(True):
        second = jax.hessian(lambda angle: cos_sin(jnp, angle)[1].sum())(jnp.asarray(ANGLES))
    np.testing.assert_allclose(second, -np.diag(np.sin(ANGLES)), atol=1e-14)


def test_integer_angles_are_accepted():
    for found in zip(cos_sin(jnp, jnp.arange(4)), cos_sin(np, np.arange(4)), strict=True):
        np.testing.assert_allclose(*found, atol=1e-6)


def test_low_matmul_precision_does_not_affect_accuracy():
    with jax.enable_x64(True), jax.default_matmul_precision("BF16_BF16_F32"):
        found = cos_sin(jnp, jnp.asarray(ANGLES))
    np.testing.assert_allclose(found, [np.cos(ANGLES), np.sin(ANGLES)], atol=1e-15)


@pytest.mark.parametrize("huge", [1e12, 1e18, 1e100, 1e300])
def test_huge_angles_give_values_within_one(huge):
    with jax.enable_x64(True):
        found = np.array(cos_sin(jnp, jnp.array([huge, -huge])))
    assert (np.abs(found) <= 1 + 1e-15).all()


def test_gpu_programs_use_no_matrix_product():
    def turned(angle):
        return cos_sin(jnp, angle)

    lowered = {
        device: str(jax.export.export(jax.jit(turned), platforms=[device])(ANGLES).mlir_module())
        for device in ("cpu", "cuda")
    }
    assert {device: "dot_general" in text for device, text in lowered.items()} == {
        "cpu": True,
        "cuda": False,
    }


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_polynomials_are_exact_to_rounding(angles):
    angle = np.array(angles)
    cos, sin = polynomials(np, angle)
    np.testing.assert_allclose(cos, np.cos(angle), rtol=0, atol=2.3e-16)
    np.testing.assert_allclose(sin, np.sin(angle), rtol=0, atol=2.3e-16)
    # Also where they are small.
    np.testing.assert_allclose(sin, np.sin(angle), rtol=1e-11, atol=1e-300)


def test_polynomials_are_accurate_at_quarter_turns():
    turns = np.arange(-8, 9)
    cos, sin = polynomials(np, turns * (np.pi / 2))
    np.testing.assert_allclose(cos + 1j * sin, 1j ** turns.astype(float), atol=1e-14)


def test_non_finite_angles_give_non_finite_results():
    with jax.enable_x64(True):
        assert not jnp.isfinite(jnp.stack(cos_sin(jnp, jnp.array([np.nan, np.inf])))).any()


@pytest.mark.parametrize("double", [True, False])
def test_a_compiled_program_computes_sines_once(double):
    def turned(angle, first, second):
        cos, sin = cos_sin(jnp, angle)
        return cos * first - sin * second, (sin * first).sum() + (cos * second).max()

    arguments = np.ones(64), np.ones((5, 64)), np.ones((3, 5, 64))
    on_cpu = jax.device_put(arguments, jax.local_devices(backend="cpu")[0])
    with jax.enable_x64(double):
        program = jax.jit(turned).lower(*on_cpu).compile().as_text()
    # Polynomials begin by rounding.
    begins = ("round-nearest-even",) if double else ("sine", "cosine")
    assert all(len(re.findall(rf" {name}\(", program)) == 1 for name in begins)
