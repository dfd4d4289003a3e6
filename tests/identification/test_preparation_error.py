"""Errors in data that were prepared with the estimate, against preparing them again."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.deviation.packet_delays import PacketDelays
from airpuck.identification import retiming
from airpuck.identification.fit import identify
from airpuck.identification.retiming import (
    error_growth,
    retime_packets,
    score_derivatives,
    variance_of_mean,
)
from airpuck.identification.settings import Preparation
from airpuck.identification.uncertainty import grown, sandwich, shared_at_borders, varying, widened

from ..apparatus.excited_flights import TRUTH, fit_of_flown, flown

NOTHING = PacketDelays(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
LAG, DELAY, ANGLE = (
    np.flatnonzero(TRUTH.parameters.mask(frozenset({name})))[0]
    for name in ("motor_time_constant", "transport_delay", "angle_offset")
)


@pytest.fixture(scope="module")
def flight():
    return flown(0.007, 40.0).trajectory


@pytest.fixture(scope="module")
def fit():
    return fit_of_flown(0.007, 40.0)


def found(fit, flights, delays=None):
    delays = fit.packet_delays if delays is None else delays
    errors = fit.uncertainty.standard_errors
    return score_derivatives(fit.objective, flights, fit.model, delays, errors)


@pytest.fixture(scope="module")
def derivatives(flight, fit):
    """Of the fit with its own weights and packets."""
    return found(fit, [flight])


def growth_of(fit, mixed, hessian):
    """Return the factor by which standard errors grow."""
    known = np.isfinite(fit.uncertainty.standard_errors)
    factor = error_growth(mixed, hessian, np.eye(len(known))[:, known], 2)
    covariance = np.where(np.outer(known, known), fit.uncertainty.covariance, 0.0)
    growth = np.ones(len(known))
    after = np.diag(factor @ covariance @ factor.T)
    growth[known] = np.sqrt(after[known] / np.diag(covariance)[known])
    return growth


def test_repeated_preparation_sums_a_geometric_series():
    """K = 1/2: an error, half of it again, and a quarter."""
    one = np.eye(3)
    np.testing.assert_allclose(error_growth(-one, 2 * one, one, 2), 1.75 * one)
    np.testing.assert_allclose(error_growth(-one, 2 * one, one, 0), one)
    part = np.diag([1.0, 1.0, 0.0])
    np.testing.assert_allclose(error_growth(-part, 2 * part, one, 2), np.diag([1.75, 1.75, 1.0]))


@pytest.mark.slow
def test_errors_beyond_all_bounds_keep_parameters_within_them(flight, fit):
    errors = fit.uncertainty.standard_errors.copy()
    errors[[LAG, DELAY]] = 1e6
    packets = fit.packet_delays
    mixed, _ = score_derivatives(fit.objective, [flight], fit.model, packets, errors)
    assert np.isfinite(mixed).all()


@pytest.mark.slow
@pytest.mark.parametrize("entry", [LAG, pytest.param(ANGLE, marks=pytest.mark.study)])
def test_the_error_matches_data_prepared_with_other_parameters(flight, fit, entry, monkeypatch):
    """Prepare everything again, with all decisions, two standard errors away."""
    monkeypatch.setattr(retiming, "_DENSITY", 6)
    parameters, windows = fit.model.parameters, fit.objective.windows
    known = np.flatnonzero(np.isfinite(fit.uncertainty.standard_errors))
    step = 2 * fit.uncertainty.standard_errors[entry]

    def gradient(sign):
        vector = parameters.to_vector()
        vector[entry] += sign * step
        other = replace(fit.model, parameters=parameters.with_vector(vector))
        (prepared,), _ = retime_packets([flight], other)
        there = replace(windows, state=prepared.state, trajectories=(prepared,))
        return replace(fit.objective, windows=there).quadratic(parameters).gradient[known]

    mixed = (gradient(1) - gradient(-1)) / (2 * step)
    hessian = fit.objective.quadratic(parameters).hessian[np.ix_(known, known)]
    our_mixed, our_hessian = found(fit, [flight])
    # The change of the estimate, in standard errors.
    moved = [
        np.linalg.solve(curvature, scores) / fit.uncertainty.standard_errors[known]
        for curvature, scores in (
            (hessian, mixed),
            (our_hessian[np.ix_(known, known)], our_mixed[known, entry]),
        )
    ]
    cosine = moved[0] @ moved[1] / np.prod(np.linalg.norm(moved, axis=1))
    assert cosine > 0.88
    assert np.linalg.norm(moved[1]) == pytest.approx(np.linalg.norm(moved[0]), rel=0.2)


@pytest.mark.slow
def test_preparation_error_makes_estimates_less_certain(fit, derivatives):
    """Free packet delays explain part of the effect of a wrong lag."""
    growth = growth_of(fit, *derivatives)
    assert 1.05 < growth[LAG] < 1.4
    assert (growth > 0.99).all()
    assert np.median(growth) < 1.1


@pytest.mark.slow
def test_without_packets_only_smoothing_contributes(flight, fit):
    np.testing.assert_allclose(growth_of(fit, *found(fit, [flight], [NOTHING])), 1.0, atol=0.05)


@pytest.mark.slow
def test_window_weights_count(flight, fit, derivatives):
    """The mean of those of the first half and of the second is that of the whole."""
    starts = fit.objective.windows.starts
    first = np.where(starts < np.median(starts), 1.0, 0.0)
    early, late = (
        np.diag(
            found(replace(fit, objective=replace(fit.objective, multiplicity=weight)), [flight])[1]
        )
        for weight in (first, 1.0 - first)
    )
    np.testing.assert_allclose((early + late) / 2, np.diag(derivatives[1]), rtol=0.02)
    assert (np.abs(early / late - 1) > 0.2).sum() > 5


@pytest.mark.slow
def test_delaying_all_packets_only_lengthens_the_delay(flight, fit, derivatives):
    """Prepared data keep the mean of the packets' delays, whatever constant is added."""
    (own,) = fit.packet_delays
    later = PacketDelays(own.packet, own.deviation + 0.003, own.standard_error)
    other = found(fit, [flight], [later])
    np.testing.assert_allclose(derivatives[1], other[1], rtol=1e-6)


@pytest.mark.slow
def test_the_errors_of_a_fit_include_all_sources(flight, fit):
    """Blocks, shared samples, data prepared with the estimate, and sampled packets."""
    loss, parameters = fit.objective, fit.model.parameters
    quadratic = loss.quadratic(parameters)
    shared = shared_at_borders(loss)
    assert shared > 0.05
    space = varying(quadratic.hessian, parameters, fit.model.free)
    plain = sandwich(quadratic, parameters, space, shared)
    errors = plain.standard_errors
    mixed, hessian = score_derivatives(loss, [flight], fit.model, fit.packet_delays, errors)
    all_but = grown(plain, error_growth(mixed, hessian, space.basis, 2))
    variance = variance_of_mean(fit.packet_delays, fit.model.delay_jitter.standard_deviation_s)
    delay = parameters.mask(frozenset({"transport_delay"}))
    expected = widened(all_but, delay, variance)
    np.testing.assert_allclose(fit.uncertainty.standard_errors, expected.standard_errors, rtol=1e-6)
    assert expected.standard_errors[DELAY] > 1.2 * errors[DELAY]


@pytest.mark.slow
def test_a_single_block_has_no_errors(flight):
    short = identify(flight.slice(0.2, 0.25), preparation=Preparation(faults="keep"))
    assert np.isnan(short.uncertainty.standard_errors).all()
