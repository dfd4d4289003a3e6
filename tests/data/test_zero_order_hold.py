"""Held commands: at a time, and on average over a step, by hand and by sums."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.data.trajectory import hold, mean_hold

TIMES = st.lists(st.floats(0, 10), min_size=1, max_size=20).map(sorted)


@given(TIMES, st.lists(st.floats(-1, 11), min_size=1, max_size=20))
def test_hold_is_the_last_value_before(events, times):
    values = np.arange(len(events), dtype=float)[:, None]
    held = hold(np.array(events), values, np.array(times))[:, 0]
    for time, value in zip(times, held, strict=True):
        before = [k for k, event in enumerate(events) if event <= time]
        assert value == (before[-1] if before else 0)


def test_the_mean_by_hand():
    """A step from 0 to 1 at 0.3 and on to 3 at 0.9: in [0, 1] 0.6·1 + 0.1·3, and then 3."""
    events, values = np.array([-1.0, 0.3, 0.9]), np.array([[0.0], [1.0], [3.0]])
    time = np.array([-2.0, -1.5, 0.0, 1.0, 2.0])
    mean, slope = mean_hold(events, values, time)
    np.testing.assert_allclose(mean[:, 0], [0, 0, 0.9, 3, 3])
    # It falls by the whole change of 3 for each second that both events come later.
    np.testing.assert_allclose(slope[:, 0], [0, 0, -3, 0, 0])
    later, _ = mean_hold(events + 0.05, values, time)
    np.testing.assert_allclose(later[:, 0], [0, 0, 0.75, 3, 3])


@given(TIMES, TIMES)
def test_the_mean_is_the_integral(events, times):
    """Of the held values, summed from one event or time to the next."""
    time = np.unique(np.round(times, 3))
    values = np.cos(np.arange(len(events)))[:, None] ** 2
    mean, _ = mean_hold(np.array(events), values, time)
    for k, (begin, end) in enumerate(itertools.pairwise(time)):
        edges = np.array([begin, *(event for event in events if begin < event < end), end])
        integral = np.diff(edges) @ hold(np.array(events), values, edges[:-1])[:, 0]
        assert mean[k, 0] == pytest.approx(integral / (end - begin), abs=1e-12)
    np.testing.assert_array_equal(mean[-1:], hold(np.array(events), values, time[-1:]))


def test_the_slope_is_the_derivative():
    rng = np.random.default_rng(3)
    events, time = np.sort(rng.uniform(0, 1, 40)), np.sort(rng.uniform(0, 1, 30))
    values, step = rng.normal(size=(40, 2)), 1e-8
    forth, back = (mean_hold(events + d, values, time)[0] for d in (step, -step))
    _, slope = mean_hold(events, values, time)
    np.testing.assert_allclose((forth - back) / (2 * step), slope, rtol=1e-5, atol=1e-4)
