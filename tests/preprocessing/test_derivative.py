"""Derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from airpuck.data.sampling import usual_period
from airpuck.preprocessing.derivative import (
    ACCELERATION_TIME,
    VELOCITY_TIME,
    acceleration,
    shortest_stretch,
    smooth,
    unwrap_yaw,
    velocity,
    window_length,
)


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=50), st.floats(-20, 20))
def test_unwrapping_restores_a_wrapped_angle(steps, start):
    yaw = start + np.cumsum(steps)
    wrapped = (yaw + np.pi) % (2 * np.pi) - np.pi
    restored = unwrap_yaw(wrapped)
    np.testing.assert_allclose(restored - restored[0], yaw - yaw[0], atol=1e-9)
    assert restored[0] == wrapped[0]
    np.testing.assert_allclose(restored, np.unwrap(wrapped), atol=1e-9)


@pytest.mark.parametrize("wanted", [11, 15, 25])
@pytest.mark.parametrize("count", [11, 12, 13, 14, 15, 200])
def test_smoothing_matches_scipy_with_the_longest_odd_window_that_fits(count, wanted):
    window = min(wanted, count - 1 + count % 2)
    values = np.cumsum(np.random.default_rng(0).normal(size=(count, 3)), axis=0)
    expected = savgol_filter(values, window, 3, axis=0)
    smoothed = smooth(times(count, 0.0), values, duration=wanted / 240)
    np.testing.assert_allclose(smoothed, expected, atol=1e-12)


@pytest.mark.parametrize(("count", "window"), [(12, 11), (13, 13), (200, 25)])
@pytest.mark.parametrize(("order", "derive"), [(1, velocity), (2, acceleration)])
def test_longer_smoothing_matches_derivatives_of_scipys_filter(order, derive, count, window):
    values = np.cumsum(np.random.default_rng(0).normal(size=(count, 3)), axis=0)
    velocities = 25 / 240 * (1 if order == 1 else VELOCITY_TIME / ACCELERATION_TIME)
    found = derive(times(count, 0.0), values, duration=velocities)
    expected = savgol_filter(values, window, 3, deriv=order, delta=1 / 240, axis=0)
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("rate", "windows"),
    [(50, (3, 3)), (100, (5, 7)), (120, (5, 7)), (240, (11, 15)), (360, (17, 23))],
)
def test_windows_last_equally_long_at_every_rate(rate, windows):
    found = [window_length(time, 1 / rate) for time in (VELOCITY_TIME, ACCELERATION_TIME)]
    assert tuple(found) == windows
    assert shortest_stretch(1 / rate) == max(windows[1], 5)


def thinned_times(duration, rate=100):
    """Times of a stream of 240 Hz that was thinned to a rate that does not divide it."""
    return np.rint(np.arange(0, duration, 1 / rate) * 240) / 240


def test_cubics_are_unchanged_by_smoothing_at_alternating_steps():
    time = thinned_times(0.5)
    assert len(np.unique(np.diff(time).round(9))) == 2
    cubic = np.stack([time**3 - 2 * time**2, 5 * time], axis=1)
    np.testing.assert_allclose(smooth(time, cubic, duration=15 / 240), cubic, atol=1e-12)


def test_alternating_steps_do_not_change_velocity_and_acceleration():
    # The craft turns within a second at 1 m/s: steps that alternate would move each pose by 2 mm.
    time = thinned_times(3.0)
    path = 0.25 * np.stack([np.cos(4 * time), np.sin(4 * time)], axis=1)
    inner = slice(10, -10)
    exact = np.stack([-np.sin(4 * time), np.cos(4 * time)], axis=1)
    assert np.abs(velocity(time, path) - exact)[inner].max() < 2e-3
    assert np.abs(acceleration(time, path) + 16 * path)[inner].max() < 0.05


def test_the_usual_period_of_alternating_steps_is_their_mean():
    assert usual_period(thinned_times(3.0)) == pytest.approx(0.01, rel=2e-3)
    # Missing frames are pauses, not steps.
    some = np.delete(np.arange(1000) / 240, np.arange(5, 1000, 12))
    assert usual_period(some) == pytest.approx(1 / 240, rel=1e-9)


def times(count, jitter):
    rng = np.random.default_rng(0)
    return (np.arange(count) + jitter * rng.uniform(-0.5, 0.5, count)) / 240


@pytest.mark.parametrize("jitter", [0.0, 0.05])
def test_derivatives_of_parabolas_are_exact(jitter):
    # Smoothing is over sample numbers: exact for cubics of them, so parabolas pass unchanged.
    time = times(60, 0.0)
    values = np.stack([3 + 2 * time, 1 - time + 4 * time**2], axis=1)
    np.testing.assert_allclose(velocity(time, values)[:, 0], 2, atol=1e-9)
    np.testing.assert_allclose(velocity(time, values)[:, 1], -1 + 8 * time, atol=1e-9)
    np.testing.assert_allclose(acceleration(time, values), [[0, 8]] * 60, atol=1e-6)


def test_derivatives_converge_at_second_order():
    errors = []
    for rate in (60, 120, 240):
        time = np.arange(rate) / rate
        # Away from the ends; at 60 Hz nothing is smoothed.
        inner = (time > 0.2) & (time < 0.8)
        found = velocity(time, np.sin(4 * time)[:, None] / 4)[:, 0]
        errors.append(np.abs(found - np.cos(4 * time))[inner].max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.8).all()


def test_uneven_stamps_are_respected():
    # A straight line sampled at uneven times: smoothing over sample numbers bends it a little, the
    # differences use the real times.
    time = times(200, 0.02)
    rate = velocity(time, (2 * time)[:, None])[10:-10, 0]
    assert np.abs(rate - 2).max() < 0.05


def test_one_longer_step_affects_only_its_neighbourhood():
    even = np.arange(200) / 240
    late = even + np.where(np.arange(200) < 100, 0.0, 0.5 / 240)
    cubic = (late**3 - 2 * late**2)[:, None]
    # A cubic stays itself in its actual times, not in numbers of samples.
    np.testing.assert_allclose(smooth(late, cubic), cubic, atol=1e-12)
    noise = np.random.default_rng(0).normal(size=(200, 1))
    changed = np.flatnonzero(smooth(late, noise)[:, 0] != smooth(even, noise)[:, 0])
    np.testing.assert_array_equal(changed, np.arange(95, 105))


def test_stamp_jitter_costs_little_accuracy():
    """Jitter of 3 % of the period; one step in fifty is off by more than 10 %."""
    rng = np.random.default_rng(0)
    even = np.arange(2400) / 240
    time = np.sort(even + rng.normal(0, 0.03 / 240, 2400))
    noise = rng.normal(0, 1e-4, 2400)
    errors = []
    for stamps in (even, time):
        poses = (0.5 * stamps + noise)[:, None]
        errors.append(np.std(acceleration(stamps, poses)[20:-20]))
    assert errors[1] < 1.5 * errors[0]
