"""Statistics that several tests share: against draws whose distribution is known."""

import numpy as np
from scipy.stats import t

from airpuck.evaluation.statistical_tests import block_regression


def test_errors_of_a_regression_hold_with_few_blocks_and_many_coefficients():
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
