"""What preparing data with an estimate does to it, against preparing them anew."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.identification import feedback
from airpuck.identification.feedback import preparation_feedback
from airpuck.identification.fit import identify
from airpuck.identification.packet_delays import PacketDelays
from airpuck.identification.refinement import refined

from .flown import flown


@pytest.fixture(scope="module")
def flight():
    return flown(0.007, 40.0).trajectory


@pytest.fixture(scope="module")
def fit(flight):
    return identify(flight, faults="keep")


def found(fit, flight, delays=None):
    delays = fit.packet_delays if delays is None else delays
    errors = fit.uncertainty.standard_errors
    return preparation_feedback(fit.objective, [flight], fit.model, delays, errors)


def test_the_lag_s_is_that_of_data_prepared_with_another_lag(flight, fit):
    """The whole preparation again, with all that it decides anew, at a lag two errors away."""
    parameters, windows = fit.model.parameters, fit.objective.windows
    lag = parameters.mask(frozenset({"motor_time_constant"}))
    step = 2 * fit.uncertainty.standard_errors[lag][0]

    def gradient(lag):
        other = replace(fit.model, parameters=replace(parameters, motor_time_constant=lag))
        (prepared,), _ = refined([flight], other)
        there = replace(windows, state=prepared.state, trajectories=(prepared,))
        return replace(fit.objective, windows=there).quadratic(parameters).gradient

    tau = float(parameters.motor_time_constant)
    expected = (gradient(tau + step) - gradient(tau - step)) / (2 * step)
    hessian = fit.objective.quadratic(parameters).hessian
    scale = np.where(fit.model.free, 1 / np.sqrt(np.maximum(np.diag(hessian), 1e-12)), 0.0)
    ours, expected = scale * found(fit, flight)[:, lag][:, 0], scale * expected
    cosine = ours @ expected / (np.linalg.norm(ours) * np.linalg.norm(expected))
    assert cosine > 0.85
    assert np.linalg.norm(ours) == pytest.approx(np.linalg.norm(expected), rel=0.4)


def growth(fit, feedback):
    """By how much standard errors grow if an error goes round once."""
    known = fit.model.free & np.isfinite(fit.uncertainty.standard_errors)
    hessian = fit.objective.quadratic(fit.model.parameters).hessian
    covariance, hessian, feedback = (
        matrix[np.ix_(known, known)] for matrix in (fit.uncertainty.covariance, hessian, feedback)
    )
    factor = np.eye(len(hessian)) - np.linalg.solve(hessian, feedback)
    grown = np.full(len(known), np.nan)
    grown[known] = np.sqrt(np.diag(factor @ covariance @ factor.T) / np.diag(covariance))
    return grown


def test_it_makes_estimates_less_certain(flight, fit):
    """Packets that may come when they like explain some of what a wrong lag does."""
    grown = growth(fit, found(fit, flight))
    lag = fit.model.parameters.mask(frozenset({"motor_time_constant"}))
    assert 1.05 < grown[lag][0] < 1.4
    assert (grown[np.isfinite(grown)] > 0.99).all()
    assert np.nanmedian(grown) < 1.1


def test_without_packets_only_smoothing_is_left(flight, fit):
    nothing = PacketDelays(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    without = found(fit, flight, [nothing])
    grown = growth(fit, without)
    np.testing.assert_allclose(grown[np.isfinite(grown)], 1.0, atol=0.03)
    # What has no standard error moves nothing.
    unknown = ~np.isfinite(fit.uncertainty.standard_errors)
    assert not without[:, unknown].any()


def test_a_part_of_a_long_recording_says_enough(flight, fit, monkeypatch):
    whole = growth(fit, found(fit, flight))
    monkeypatch.setattr(feedback, "_ENOUGH", 30.0)
    part = growth(fit, found(fit, flight))
    np.testing.assert_allclose(part, whole, rtol=0.25)
    assert not np.array_equal(part, whole, equal_nan=True)
