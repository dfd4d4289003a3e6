"""Residual tests: rates under the truth, power against errors, and the arithmetic."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from airpuck import InputError, Model
from airpuck.deviation.significance import holm

# Rounding rarely affects a verdict, so check the matrix itself.
from airpuck.evaluation.residuals import BODY_CHANNELS, _effects, cross_correlations, resid
from airpuck.evaluation.statistical_tests import LEAST_SHARE, beyond_least, ljung_box

from ..apparatus.models import scaled
from ..apparatus.noisy_flights import TRUTH, noisy


def test_ljung_box_matches_a_hand_calculation():
    values = np.array([1.0, -2.0, 3.0, 0.5, -1.0, 2.0])
    r1 = (-2 - 6 + 1.5 - 0.5 - 2) / 19.25
    r2 = (3 - 1 - 3 + 1) / 19.25
    test = ljung_box("x", values, np.ones(6, dtype=bool), 2, 1)
    np.testing.assert_allclose(test.autocorrelation, [r1, r2])
    statistic = 6 * 8 * (r1**2 / 5 + r2**2 / 4)
    assert test.statistic == pytest.approx(statistic)
    assert test.degrees == 1
    assert test.p_value == pytest.approx(stats.ncx2.sf(statistic, 1, 6 * LEAST_SHARE))
    assert test.share == pytest.approx((statistic - 1) / 6)


def test_only_correlation_above_the_threshold_is_rejected():
    # r(1) = a of an autoregressive process explains a² of the variance: half and 4 times the least.
    rng, rejected = np.random.default_rng(4), []
    for share in (0.5 * LEAST_SHARE, 4 * LEAST_SHARE):
        tests = []
        for _ in range(100):
            noise, values = rng.normal(size=5000), np.zeros(5000)
            for k in range(1, 5000):
                values[k] = np.sqrt(share) * values[k - 1] + noise[k]
            tests.append(ljung_box("x", values, np.ones(5000, dtype=bool), 10, 0))
        rejected.append(np.mean([not test.passed for test in tests]))
        assert np.mean([test.share for test in tests]) == pytest.approx(share, rel=0.15)
    assert rejected[0] <= 0.01 and rejected[1] == 1.0


def test_the_threshold_test_is_noncentral():
    # At the least share itself the rejection rate equals the level.
    rng, count, degrees = np.random.default_rng(5), 2000, 6
    statistics = rng.noncentral_chisquare(degrees, LEAST_SHARE * count, size=4000)
    rejected = np.mean([beyond_least(q, degrees, count)[0] < 0.05 for q in statistics])
    assert rejected == pytest.approx(0.05, abs=0.015)


def test_autocorrelation_does_not_span_pauses():
    values = np.array([1.0, 2.0, 7.0, 8.0, 3.0, 4.0])
    used = np.array([True, True, False, False, True, True])
    test = ljung_box("x", values, used, 3, 0)
    np.testing.assert_allclose(test.autocorrelation, [(2 + 12) / 30, 0, 0], atol=1e-15)


@pytest.mark.slow
def test_false_alarm_rates_are_nominal():
    # White innovations and a held input: 600 tests of each kind at the 1 % level.
    rng, alarms, beyond, lags = np.random.default_rng(1), np.zeros(2), 0.0, 10
    for _ in range(300):
        values = rng.normal(size=800)
        command = np.repeat(rng.uniform(size=(20, 2)), 40, axis=0)
        used = np.ones(800, dtype=bool)
        alarms[0] += ljung_box("x", values, used, lags, 0).p_value < 0.01
        tests = cross_correlations("x", values, used, command, "ab", np.ones(2), lags)
        alarms[1] += min(test.p_value for test in tests) < 0.01
        beyond += np.mean([np.abs(t.correlation) > t.band for t in tests])
    assert (alarms <= 10).all()  # P(more than 10) = 0.0003
    assert 0.004 < beyond / 300 < 0.02


def test_a_negligible_share_is_white_and_states_the_threshold():
    # An AR(1) of 0.05: the past explains 0.05² = 0.25 % of the variance; the threshold is 1 %.
    rng = np.random.default_rng(4)
    values = rng.normal(size=40_001)
    values = values[1:] + 0.05 * values[:-1]
    found = ljung_box("x", values, np.ones(len(values), dtype=bool), 10, 0)
    assert found.statistic > 60 and found.passed
    assert re.search(
        r"white \(past innovations explain 0\.[23] % of the variance \(thr", found.verdict
    )


def test_bands_account_for_the_smoothness_of_both_signals():
    rng, lags, beyond = np.random.default_rng(2), 30, []
    for _ in range(200):
        values = np.convolve(rng.normal(size=1004), np.ones(5), "valid")
        command = np.repeat(rng.uniform(size=(25, 1)), 40, axis=0)
        used = np.ones(1000, dtype=bool)
        (test,) = cross_correlations("x", values, used, command, "a", np.ones(1), lags)
        beyond.append(np.mean(np.abs(test.correlation) > test.band))
    # With the band of white noise, ±2.58/√N, a quarter would lie outside.
    assert np.mean(beyond) < 0.03


@pytest.mark.slow
def test_the_true_model_passes():
    p_values = []
    for seed in range(4):
        tests = resid(TRUTH, noisy(seed=seed))
        p_values += [test.p_value for test in tests.whiteness]
        for channel in BODY_CHANNELS:
            p_values.append(min(t.p_value for t in tests.correlations if t.channel == channel))
    assert np.sum(np.array(p_values) < 0.01) <= 1  # of 24; P(more than 1) = 0.02


@pytest.mark.slow
def test_a_motor_that_is_modelled_too_strong_is_named():
    tests = resid(scaled(TRUTH, [1, 1, 1, 1, 1.25, 1]), noisy(duration=8.0, seed=1))
    assert not tests.passed
    motor = TRUTH.vehicle.propeller_names[4]
    (named,) = [error for error in tests.errors if not error.passed]
    assert named.name == motor
    assert named.value == pytest.approx(-0.2, abs=4 * named.standard_error)
    assert any(line.startswith(f"{motor} gives 2") for line in tests.verdicts)
    assert {test.motor for test in tests.correlations if not test.passed} <= {motor}


@pytest.mark.slow
@pytest.mark.parametrize(("change", "word"), [(0.01, "large"), (-0.01, "small")])
def test_a_wrong_lag_is_reported_as_a_timing_error(change, word):
    parameters = TRUTH.parameters
    wrong = replace(parameters, motor_time_constant=parameters.motor_time_constant + change)
    # A model that has learned its delay does not use the recording's.
    free = TRUTH.free | parameters.mask(frozenset({"transport_delay"}))
    wrong = replace(TRUTH, parameters=wrong, free=free)
    tests = resid(wrong, noisy(duration=10.0, seed=2))
    assert not tests.passed
    delay, lag = tests.errors[:2]
    assert not lag.passed
    assert delay.value == pytest.approx(-change, abs=0.003)
    assert lag.value == pytest.approx(-change, abs=0.003)
    assert any(f"delay or lag too {word}" in line for line in tests.verdicts)
    assert not tests.to_json()["passed"]


def test_holm_matches_a_hand_calculation():
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.9, 0.8])), [1, 1])


def test_a_motor_that_never_moved_is_not_tested():
    values, used = np.random.default_rng(0).normal(size=500), np.ones(500, dtype=bool)
    command = np.column_stack([np.full(500, 0.1), np.tile([0.1, 0.9], 250)])
    tests = cross_correlations("x", values, used, command, "ab", np.ones(2), 5)
    assert [test.motor for test in tests] == ["b"]


def test_motors_that_commands_do_not_distinguish_are_not_accused():
    rng, used = np.random.default_rng(3), np.ones(4000, dtype=bool)
    command = np.repeat(rng.uniform(size=(1000, 2)), 4, axis=0)
    values = np.roll(command.sum(axis=1), 1) + rng.normal(size=4000)
    given = "x", values, used, command, "ab", np.ones(2), 10
    assert [test.passed for test in cross_correlations(*given)] == [False, False]
    one, other = cross_correlations(*given, told={"b"})
    assert (one.tested, one.passed, one.p_value) == (False, True, 1.0)
    assert other.tested and not other.passed


@pytest.mark.slow
def test_larger_variance_at_command_changes_is_not_correlation():
    # As with jitter, the variance depends on the command and the mean does not.
    rng, alarms = np.random.default_rng(6), 0
    for _ in range(200):
        command = np.repeat(rng.uniform(size=(40, 2)), 25, axis=0)
        values = rng.normal(size=1000) * (0.1 + 3 * command[:, 0] ** 4)
        used = np.ones(1000, dtype=bool)
        tests = cross_correlations("x", values, used, command, "ab", np.ones(2), 10)
        alarms += min(test.p_value for test in tests) < 0.01
    assert alarms <= 6  # P(more than 6 at 1 %) = 0.004


def test_a_push_due_to_rounding_is_zero(monkeypatch):
    # The configuration matrix of propellers that push forward only, at 1e-17 to the left.
    matrix = np.array([[7.0, 7.0], [4e-16, -4e-16], [40.0, -40.0]])
    monkeypatch.setattr(Model, "propeller_effects", matrix)
    assert (_effects(TRUTH) == [[7.0, 7.0], [0.0, 0.0], [40.0, -40.0]]).all()


def test_too_many_lags_for_the_data_are_rejected():
    with pytest.raises(InputError, match="lags"):
        resid(TRUTH, noisy(seed=0), lags=200)
