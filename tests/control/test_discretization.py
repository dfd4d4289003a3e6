"""Exact discretisation, against scipy, python-control and quadrature."""

from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad
from scipy.signal import cont2discrete

from airpuck.control.discretization import motor_lag, point_mass, rotation_error, zero_order_hold

entry = st.floats(-5, 5).map(lambda x: round(x, 3))
period = st.floats(1e-3, 0.5)


@st.composite
def systems(draw):
    n, m = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    return draw(arrays(float, (n, n), elements=entry)), draw(arrays(float, (n, m), elements=entry))


@given(systems(), period)
def test_hold_agrees_with_scipy(system, h):
    a, b = system
    n, m = b.shape
    a_d, b_d = zero_order_hold(a, b, h)
    expected: Any = cont2discrete((a, b, np.eye(n), np.zeros((n, m))), h, method="zoh")
    size = np.abs(expected[0]).max()
    np.testing.assert_allclose(a_d, expected[0], atol=1e-12 * size)
    np.testing.assert_allclose(b_d, expected[1], atol=1e-11 * size)


@given(systems(), period)
def test_hold_agrees_with_python_control(system, h):
    a, b = system
    n, m = b.shape
    a_d, b_d = zero_order_hold(a, b, h)
    expected = control.c2d(control.ss(a, b, np.eye(n), np.zeros((n, m))), h, method="zoh")
    size = np.abs(expected.A).max()
    np.testing.assert_allclose(a_d, expected.A, atol=1e-12 * size)
    np.testing.assert_allclose(b_d, expected.B, atol=1e-11 * size)


@given(systems(), period)
def test_two_periods_are_one_of_twice_the_length(system, h):
    a, b = system
    a_1, b_1 = zero_order_hold(a, b, h)
    a_2, b_2 = zero_order_hold(a, b, 2 * h)
    size = np.abs(a_1).max() ** 2 + np.abs(a_2).max()
    np.testing.assert_allclose(a_1 @ a_1, a_2, atol=1e-11 * size)
    np.testing.assert_allclose(a_1 @ b_1 + b_1, b_2, atol=1e-10 * size)


@given(period)
def test_point_mass_is_uniformly_accelerated_motion(h):
    a, b = point_mass(h)
    start, push = np.array([1.0, -2.0, 0.3, 0.5, -0.7, 4.0]), np.array([0.9, -0.4, 30.0])
    following = a @ start + b @ push
    position = start[:3] + h * start[3:] + h**2 / 2 * push
    np.testing.assert_allclose(following[:3], position, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(following[3:], start[3:] + h * push, rtol=1e-13)


def test_point_mass_entry_by_entry():
    a, b = point_mass(0.01)
    eye, nothing = np.eye(3), np.zeros((3, 3))
    np.testing.assert_allclose(a, np.block([[eye, 0.01 * eye], [nothing, eye]]), atol=1e-16)
    np.testing.assert_allclose(b, np.vstack([5e-5 * eye, 0.01 * eye]), atol=1e-16)


@given(st.floats(1e-3, 1.0), period)
def test_motor_lag_is_exponential(tau, h):
    a, b = motor_lag(tau, h)
    assert a == pytest.approx(np.exp(-h / tau), rel=1e-11, abs=1e-16)
    assert b == pytest.approx(-np.expm1(-h / tau), rel=1e-11)


def test_a_motor_without_lag_follows_at_once():
    assert motor_lag(0.0, 0.01) == (0.0, 1.0)


@given(st.floats(-40, 40), st.floats(1e-3, 0.1))
def test_rotation_error_is_the_neglected_part_of_the_impulse(spin, h):
    # A unit force along x that turns with the craft, in units of what it would give unturned.
    along = quad(lambda t: np.cos(spin * t), 0, h)[0] / h
    across = quad(lambda t: np.sin(spin * t), 0, h)[0] / h
    expected = np.hypot(along - 1, across)
    error = rotation_error(np.array([spin]), np.array([h]))
    np.testing.assert_allclose(error, [expected], atol=1e-12)


def test_rotation_error_begins_as_half_the_angle():
    spin, h = np.array([1e-3, -1e-3]), np.array([0.01, 0.01])
    np.testing.assert_allclose(rotation_error(spin, h), [5e-6, 5e-6], rtol=1e-6)
