"""The filter's equations against Van Loan's integral and Gaussian conditioning."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from airpuck.estimate.axis_filter import correct, spread


@given(st.floats(1e-4, 0.1), st.integers(0, 99))
def test_covariance_grows_by_van_loans_integral(h, seed):
    random = np.random.default_rng(seed)
    roots = random.normal(size=(3, 3, 3))
    covariance = roots @ roots.transpose(0, 2, 1)
    densities = random.uniform(0, 2, (2, 3))
    grown = spread(np, covariance, h, *densities)
    chain = np.eye(3, k=1)
    for i in range(3):
        driving = np.diag([0, densities[0, i], densities[1, i]])
        van_loan = expm(h * np.block([[-chain, driving], [np.zeros((3, 3)), chain.T]]))
        step = van_loan[3:, 3:].T
        expected = step @ covariance[i] @ step.T + step @ van_loan[:3, 3:]
        np.testing.assert_allclose(grown[i], expected, rtol=1e-11, atol=1e-14)


@given(st.integers(0, 2), st.integers(0, 99))
def test_a_correction_is_the_conditional_gaussian(component, seed):
    # Information form: precisions add.
    random = np.random.default_rng(seed)
    roots = random.normal(size=(3, 3, 3))
    covariance = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(3)
    mean, innovation = random.normal(size=(3, 3)), random.normal(size=3)
    variance = np.array([0.5, 2.0, np.inf])
    after, less = correct(mean, covariance, component, innovation, variance)
    unit = np.eye(3)[component]
    for i in range(3):
        precision = np.linalg.inv(covariance[i]) + np.outer(unit, unit) / variance[i]
        expected = np.linalg.inv(precision)
        np.testing.assert_allclose(less[i], expected, atol=1e-9)
        shift = expected @ unit * innovation[i] / variance[i]
        np.testing.assert_allclose(after[i], mean[i] + shift, atol=1e-9)
