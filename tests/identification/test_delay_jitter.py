"""The random-effects model, against hand calculation and made-up packets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from airpuck.identification.delay_jitter import delay_jitter, variance_of_mean
from airpuck.identification.packet_delays import PacketDelays


def packets(deviation, error) -> PacketDelays:
    deviation = np.asarray(deviation, dtype=float)
    return PacketDelays(
        np.arange(len(deviation)), deviation, np.broadcast_to(error, deviation.shape).astype(float)
    )


def test_equal_errors_by_hand():
    """σ² = s² - v, s² with N - 1 degrees of freedom; of s², the error by the fourth moment."""
    deviation = 1e-3 * np.array([-6.0, -3, -2, -1, 0, 0, 1, 2, 3, 6])
    jitter = delay_jitter([packets(deviation, 1e-3)])
    assert jitter.standard_deviation_s == pytest.approx(1e-3 * np.sqrt(100 / 9 - 1), rel=1e-9)
    fourth = (2 * (6.0**4 + 3.0**4 + 2.0**4 + 1)) / 10
    expected = np.sqrt((fourth - 10.0**2) / 10) * 1e-6 / (2 * jitter.standard_deviation_s)
    assert jitter.standard_error_s == pytest.approx(expected, rel=1e-9)
    assert jitter.packets == 10


@pytest.mark.parametrize("spread", [1e-3, 6e-3])
def test_spread_is_found_below_unequal_errors(spread):
    rng = np.random.default_rng(0)
    error = rng.uniform(0.2e-3, 4e-3, 4000)
    deviation = rng.normal(0, np.hypot(spread, error))
    jitter = delay_jitter([packets(deviation, error)])
    assert jitter.standard_deviation_s == pytest.approx(spread, rel=0.06)


def test_standard_error_is_the_spread_of_estimates():
    rng = np.random.default_rng(1)
    found = [delay_jitter([packets(rng.normal(0, 6e-3, 150), 1e-3)]) for _ in range(400)]
    spread = np.std([jitter.standard_deviation_s for jitter in found])
    assert np.mean([j.standard_error_s for j in found]) == pytest.approx(spread, rel=0.1)


def test_errors_that_explain_the_spread_leave_no_jitter():
    deviation = np.random.default_rng(2).normal(0, 1e-3, 200)
    jitter = delay_jitter([packets(deviation, 2e-3)])
    assert jitter.standard_deviation_s < 1e-9
    assert 0 < jitter.standard_error_s < 1e-3


@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_means_of_recordings_are_no_jitter(first, second):
    deviation = 6e-3 * np.random.default_rng(3).normal(size=60)
    plain = delay_jitter([packets(deviation, 1e-3), packets(deviation, 1e-3)])
    moved = delay_jitter([packets(deviation + first, 1e-3), packets(deviation + second, 1e-3)])
    assert moved.standard_deviation_s == pytest.approx(plain.standard_deviation_s, rel=1e-9)


def test_the_weighted_sum_of_squares_is_its_expectation():
    """Paule and Mandel's equation, mean and all, for errors that differ by a factor of twenty."""
    rng = np.random.default_rng(4)
    error = rng.uniform(0.2e-3, 4e-3, 40)
    deviation = rng.normal(0, np.hypot(3e-3, error))

    def excess(variance):
        weight = 1 / (variance + error**2)
        return weight @ (deviation - np.average(deviation, weights=weight)) ** 2 - 39

    jitter = delay_jitter([packets(deviation, error)])
    expected = np.sqrt(brentq(excess, 1e-9, 1e-3, xtol=1e-18))
    assert jitter.standard_deviation_s == pytest.approx(expected, rel=1e-6)


def test_few_packets_say_nothing():
    assert delay_jitter([packets([1e-3], 1e-3)] * 12) is None
    assert delay_jitter([]) is None
    assert delay_jitter([packets(np.zeros(9), 1e-3)]) is None


def test_the_variance_of_a_mean_is_that_of_many_samples():
    rng = np.random.default_rng(4)
    error = rng.uniform(0.2e-3, 4e-3, 120)
    delays = [packets(np.zeros(70), error[:70]), packets(np.zeros(50), error[70:])]
    weight = 1 / (6e-3**2 + error**2)
    means = [np.average(rng.normal(0, 6e-3, 120), weights=weight) for _ in range(4000)]
    assert np.sqrt(variance_of_mean(delays, 6e-3)) == pytest.approx(np.std(means), rel=0.04)
    assert variance_of_mean([packets(np.zeros(90), 1e-4)], 6e-3) == pytest.approx(6e-3**2 / 90)


def test_without_packets_or_jitter_a_mean_has_no_error():
    assert variance_of_mean([], 6e-3) == variance_of_mean([packets([], 1e-3)], 6e-3) == 0
    assert variance_of_mean([packets(np.zeros(90), 1e-4)], 0.0) == 0
