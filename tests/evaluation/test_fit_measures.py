"""Fit percentages and information criteria."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from airpuck.estimate.axis_filter import Noise
from airpuck.evaluation.fit_measures import fit_percent, fit_text, fitted_parameters, measure_fit
from airpuck.evaluation.innovations import free_run, innovations

from ..apparatus.noisy_flights import POSE_NOISE, TRUTH, noisy


def test_fit_percent_matches_a_hand_calculation():
    measured = np.array([[0.0], [1.0], [2.0], [3.0]])
    predicted = measured + np.array([[0.5], [-0.5], [0.5], [-0.5]])
    # ‖error‖ = 1, ‖y − mean‖ = √5.
    np.testing.assert_allclose(fit_percent(predicted, measured), [100 * (1 - 1 / np.sqrt(5))])
    np.testing.assert_allclose(fit_percent(np.full((4, 1), 1.5), measured), [0], atol=1e-12)


def test_a_fit_worse_than_the_mean_is_shown_as_below_zero():
    assert fit_text(np.array([98.765, 0.04, -20079.5])) == ["98.8", "0.0", "below 0"]


def test_the_likelihood_matches_normal_innovations():
    flight = noisy(duration=2.0)
    found = innovations(TRUTH, flight, Noise(POSE_NOISE, (0.1, 0.1, 1.0), (0.0, 0.0, 0.0)))
    e, s = found.values[found.used], found.deviation[found.used]
    assert found.log_likelihood == pytest.approx(stats.norm.logpdf(e, 0, s).sum())
    fit = measure_fit(TRUTH, flight, filtered=found)
    d = fitted_parameters(TRUTH)
    assert fit.parameters == d == 23
    assert fit.aic == pytest.approx(2 * d - 2 * found.log_likelihood)
    assert fit.bic == pytest.approx(d * np.log(len(e)) - 2 * found.log_likelihood)


def test_a_prediction_ahead_uses_no_later_pose():
    flight = noisy(duration=2.0)
    found = innovations(TRUTH, flight, Noise(POSE_NOISE, (0.1, 0.1, 1.0), (0.0, 0.0, 0.0)))
    fit = measure_fit(TRUTH, flight, filtered=found, horizon=0.3)
    starts = np.arange(found.starts(0, len(flight))[0], len(flight) - fit.steps, fit.steps + 1)
    ends = starts + fit.steps
    alone = [free_run(TRUTH, flight, found, np.array([one]))[one + fit.steps] for one in starts]
    expected = fit_percent(np.array(alone), flight.state[ends, :3])
    np.testing.assert_allclose(fit.k_step, expected, rtol=1e-6)


@pytest.mark.slow
def test_the_truth_fits_better_than_a_wrong_model():
    flight = noisy(duration=6.0, seed=4)
    wrong = replace(TRUTH.parameters, inertia=1.1 * TRUTH.parameters.inertia)
    true, off = (measure_fit(m, flight) for m in (TRUTH, replace(TRUTH, parameters=wrong)))
    for kind in ("k_step", "free_run", "whole"):
        assert getattr(true, kind)[2] > max(getattr(off, kind)[2], 90)
    assert true.aic < off.aic - 50
    assert true.bic < off.bic - 50
    assert set(true.to_json()["fit_percent"]) == {"k_step", "free_run", "whole"}
