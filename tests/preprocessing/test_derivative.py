"""Derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from airpuck.preprocessing.derivative import acceleration, smooth, unwrap_yaw, velocity


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=50), st.floats(-20, 20))
def test_unwrapping_restores_what_was_wrapped(steps, start):
    yaw = start + np.cumsum(steps)
    wrapped = (yaw + np.pi) % (2 * np.pi) - np.pi
    restored = unwrap_yaw(wrapped)
    np.testing.assert_allclose(restored - restored[0], yaw - yaw[0], atol=1e-9)
    assert restored[0] == wrapped[0]
    np.testing.assert_allclose(restored, np.unwrap(wrapped), atol=1e-9)


@pytest.mark.parametrize(("count", "window"), [(11, 11), (12, 11), (15, 15), (200, 15)])
def test_smoothing_is_that_of_scipy(count, window):
    values = np.cumsum(np.random.default_rng(0).normal(size=(count, 3)), axis=0)
    expected = savgol_filter(values, window, 3, axis=0)
    np.testing.assert_allclose(smooth(values, window), expected, atol=1e-12)


def times(count, jitter):
    rng = np.random.default_rng(0)
    return (np.arange(count) + jitter * rng.uniform(-0.5, 0.5, count)) / 240


@pytest.mark.parametrize("jitter", [0.0, 0.05])
def test_exact_for_parabolas_of_the_sample_index(jitter):
    # Smoothing is over sample numbers: exact for cubics of them, so parabolas pass unchanged.
    time = times(60, 0.0)
    values = np.stack([3 + 2 * time, 1 - time + 4 * time**2], axis=1)
    np.testing.assert_allclose(velocity(time, values)[:, 0], 2, atol=1e-9)
    np.testing.assert_allclose(velocity(time, values)[:, 1], -1 + 8 * time, atol=1e-9)
    np.testing.assert_allclose(acceleration(time, values), [[0, 8]] * 60, atol=1e-6)


def test_second_order_in_the_sample_period():
    errors = []
    for rate in (60, 120, 240):
        time = np.arange(rate) / rate
        exact = np.cos(4 * time)[20:-20]
        errors.append(
            np.abs(velocity(time, np.sin(4 * time)[:, None] / 4)[20:-20, 0] - exact).max()
        )
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.8).all()


def test_uneven_stamps_are_respected():
    # A straight line sampled at uneven times: smoothing over sample numbers bends it a little, the
    # differences use the real times.
    time = times(200, 0.02)
    rate = velocity(time, (2 * time)[:, None])[10:-10, 0]
    assert np.abs(rate - 2).max() < 0.05
