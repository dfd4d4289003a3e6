"""Exact discretisation, against scipy and quadrature."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.signal import cont2discrete

from airpuck.control.lqr import motor_lag, point_mass, rotation_error

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
