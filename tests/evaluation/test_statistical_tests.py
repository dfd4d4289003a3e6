"""Statistics that several tests share, against draws from known distributions."""

import numpy as np
import pytest
from scipy.stats import t

from airpuck.deviation.motor_regression import block_regression
from airpuck.evaluation.statistical_tests import (
    FEWEST_BLOCKS,
    blocks,
    log_mean_square_errors,
    redrawn_means,
    rmse_interval,
    rmse_ratio,
)

from ..apparatus.residuals import CORRELATED, SPACING, residuals


def test_regression_errors_hold_with_few_blocks_and_many_coefficients():
    rng = np.random.default_rng(0)
    samples, blocks, coefficients = 120, 12, 10
    inside = []
    for _ in range(200):
        columns = rng.normal(size=(samples, 3, coefficients))
        # Half of the variance is common to a block, in the errors as in the regressors.
        columns += np.repeat(rng.normal(size=(blocks, 3, coefficients)), samples // blocks, axis=0)
        errors = rng.normal(size=(samples, 3))
        errors += np.repeat(rng.normal(size=(blocks, 3)), samples // blocks, axis=0)
        found, covariance, counted = block_regression(columns, errors, 1.0, samples / blocks)
        assert counted == blocks
        inside.append(np.abs(found) < t.ppf(0.975, blocks - 1) * np.sqrt(np.diag(covariance)))
    # 2000 intervals of 95 %; their coverage is known to half a percent.
    assert 0.93 < np.mean(inside) < 0.985


# 400 intervals; a third of the trials would fail 95 % ± 1 point, one in 10 000 fails these bounds.
@pytest.mark.slow
@pytest.mark.parametrize("duration", [15.0, 40.0, 98.0])
def test_intervals_cover_the_true_root_mean_square(duration):
    held = []
    for seed in range(100):
        errors, start = residuals(seed, duration, 4)
        low, high = rmse_interval(errors, start)
        held += ((low <= 1) & (high >= 1)).tolist()
    assert 0.90 < np.mean(held) < 0.985


@pytest.mark.slow
def test_pairwise_tests_have_their_stated_false_alarms_and_coverage():
    alarms, held, widths = [], [], []
    truth = np.sqrt((1.1**2 + 0.3**2) / (1 + 0.3**2))
    for seed in range(300):
        (shared, own, other), start = residuals(seed, 40.0, 3)
        first = (shared + 0.3 * own)[None]
        alarms.append(rmse_ratio(first, (shared + 0.3 * other)[None], start)[2][0] < 0.05)
        _, (low, high), _ = rmse_ratio(first, (1.1 * shared + 0.3 * other)[None], start)
        held.append(low[0] <= truth <= high[0])
        widths.append((high - low)[0])
    assert np.mean(alarms) < 0.09
    assert 0.91 < np.mean(held) < 0.985
    # Common errors cancel: judged separately, the same two models would have far wider intervals.
    low, high = rmse_interval(first, start)
    assert np.mean(widths) < 0.7 * (high - low)[0]


@pytest.mark.slow
def test_the_spread_matches_theory():
    # Var of the mean square of an AR(1) of variance 1: 2 (1 + a²)/(1 − a²)/W, by Isserlis' theorem.
    spreads = []
    for seed in range(40):
        errors, start = residuals(seed, 300.0, 1)
        spreads.append(log_mean_square_errors(errors**2, start)[0][0, 0])
    keep = np.exp(-2 * SPACING / CORRELATED)
    theory = 2 * (1 + keep) / (1 - keep) / len(start)
    assert np.mean(spreads) == pytest.approx(theory, rel=0.15)


def test_units_do_not_matter_and_equal_models_do_not_differ():
    errors, start = residuals(0, 40.0, 3)
    np.testing.assert_allclose(
        rmse_interval(1e-3 * errors, start), 1e-3 * rmse_interval(errors, start)
    )
    ratio, (low, high), p_value = rmse_ratio(errors, errors, start)
    np.testing.assert_array_equal(ratio, 1)
    np.testing.assert_allclose([low, high], 1, atol=1e-9)
    np.testing.assert_allclose(p_value, 1)


def test_too_few_seconds_give_no_interval():
    errors, start = residuals(0, 11.0, 2)
    assert blocks(start) < FEWEST_BLOCKS
    assert np.isnan(rmse_interval(errors, start)).all()
    ratio, interval, p_value = rmse_ratio(errors[:1], 2 * errors[:1], start)
    np.testing.assert_allclose(ratio, 2)
    assert np.isnan(interval).all() and np.isnan(p_value).all()


def test_resampled_means_spread_like_block_means():
    rng = np.random.default_rng(0)
    # Blocks of 3 s of one value each: the standard error matches 30 independent values.
    values = np.repeat(rng.normal(size=(1, 30)), 10, axis=1)
    drawn = redrawn_means(values, 0.3 * np.arange(values.shape[1]))
    assert drawn is not None
    assert drawn.mean() == pytest.approx(values.mean(), abs=0.05)
    assert drawn.std() == pytest.approx(values.std() / np.sqrt(30), rel=0.3)
    assert redrawn_means(values[:, :30], 0.3 * np.arange(30)) is None
