"""What preparing data with an estimate does to it, against preparing them anew."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.data.trajectory import Span
from airpuck.identification import feedback
from airpuck.identification.feedback import Feedback, preparation_feedback
from airpuck.identification.fit import identify
from airpuck.identification.packet_delays import PacketDelays
from airpuck.identification.problem import Preparation
from airpuck.identification.retiming import retime_packets, variance_of_mean
from airpuck.identification.uncertainty import sandwich, shared_at_borders, widened

from .flown import TRUTH, flown

NOTHING = PacketDelays(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
LAG, DELAY, ANGLE = (
    np.flatnonzero(TRUTH.parameters.mask(frozenset({name})))[0]
    for name in ("motor_time_constant", "transport_delay", "angle_offset")
)


@pytest.fixture(scope="module")
def flight():
    return flown(0.007, 40.0).trajectory


@pytest.fixture(scope="module")
def fit(flight):
    return identify(flight, preparation=Preparation(faults="keep"))


def found(fit, flights, delays=None):
    delays = fit.packet_delays if delays is None else delays
    errors = fit.uncertainty.standard_errors
    return preparation_feedback(fit.objective, flights, fit.model, delays, errors, 2)


def grown(fit, feedback):
    """By how much standard errors grow."""
    known = np.flatnonzero(np.isfinite(fit.uncertainty.standard_errors))
    factor = feedback.growth(np.eye(len(fit.model.free))[:, known])
    covariance = fit.uncertainty.covariance[np.ix_(known, known)]
    growth = np.ones(len(fit.model.free))
    growth[known] = np.sqrt(np.diag(factor @ covariance @ factor.T) / np.diag(covariance))
    return growth


def test_rounds_add_up():
    """K = 1/2: an error, half of it again, and a quarter."""
    half = Feedback(-np.eye(3), 2 * np.eye(3), 2)
    np.testing.assert_allclose(half.growth(np.eye(3)), 1.75 * np.eye(3))
    blind = Feedback(np.diag([-1.0, -1.0, 0.0]), np.diag([2.0, 2.0, 0.0]), 2)
    np.testing.assert_allclose(blind.growth(np.eye(3)), np.diag([1.75, 1.75, 1.0]))
    np.testing.assert_allclose(replace(half, rounds=0).growth(np.eye(3)), np.eye(3))


@pytest.mark.parametrize("entry", [LAG, ANGLE])
def test_it_is_that_of_data_prepared_with_something_else(flight, fit, entry, monkeypatch):
    """The whole preparation again, with all that it decides anew, two errors away."""
    monkeypatch.setattr(feedback, "_DENSE", 6)
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
    ours = found(fit, [flight])
    # The change of the estimate, in standard errors.
    moved = [
        np.linalg.solve(curvature, scores) / fit.uncertainty.standard_errors[known]
        for curvature, scores in (
            (hessian, mixed),
            (ours.hessian[np.ix_(known, known)], ours.mixed[known, entry]),
        )
    ]
    cosine = moved[0] @ moved[1] / np.prod(np.linalg.norm(moved, axis=1))
    assert cosine > 0.88
    assert np.linalg.norm(moved[1]) == pytest.approx(np.linalg.norm(moved[0]), rel=0.2)


def test_it_makes_estimates_less_certain(flight, fit):
    """Packets that may come when they like explain some of what a wrong lag does."""
    growth = grown(fit, found(fit, [flight]))
    assert 1.05 < growth[LAG] < 1.4
    assert (growth > 0.99).all()
    assert np.median(growth) < 1.1


def test_without_packets_only_smoothing_is_left(flight, fit):
    np.testing.assert_allclose(grown(fit, found(fit, [flight], [NOTHING])), 1.0, atol=0.05)


def test_all_packets_later_is_a_longer_delay_and_nothing_else(flight, fit):
    """Prepared data keep the mean of the packets' delays, whatever is added to all of them."""
    (own,) = fit.packet_delays
    later = PacketDelays(own.packet, own.deviation + 0.003, own.standard_error)
    one, other = (found(fit, [flight], [delays]) for delays in (own, later))
    np.testing.assert_allclose(one.hessian, other.hessian, rtol=1e-6)


def test_a_part_of_long_recordings_says_enough(flight, fit, monkeypatch):
    """Of each its middle, with its own packets; a stretch of it where that has no window."""
    (own,) = fit.packet_delays
    whole = grown(fit, found(fit, [flight, flight], [own, own]))
    np.testing.assert_allclose(whole, grown(fit, found(fit, [flight])), rtol=1e-6)
    monkeypatch.setattr(feedback, "_ENOUGH", 48.0)
    part = grown(fit, found(fit, [flight, flight], [own, own]))
    np.testing.assert_allclose(part, whole, rtol=0.2)
    middle = flight.leave_out([Span(flight.time[100], flight.time[-3000], "radio out")])
    monkeypatch.setattr(feedback, "_ENOUGH", 8.0)
    assert np.isfinite(found(fit, [middle]).mixed).all()


def test_a_fit_has_all_of_it(flight, fit):
    """Blocks, what they share, what goes round, and packets that are a sample: put together."""
    loss, parameters = fit.objective, fit.model.parameters
    quadratic = loss.quadratic(parameters)
    shared = shared_at_borders(loss)
    assert shared > 0.05
    plain = sandwich(quadratic, parameters, fit.model.free, shared=shared)
    errors = plain.standard_errors
    round_ = preparation_feedback(loss, [flight], fit.model, fit.packet_delays, errors, 2)
    all_but = sandwich(quadratic, parameters, fit.model.free, shared=shared, feedback=round_)
    variance = variance_of_mean(fit.packet_delays, fit.model.delay_jitter.standard_deviation_s)
    delay = parameters.mask(frozenset({"transport_delay"}))
    expected = widened(all_but, delay, variance)
    np.testing.assert_allclose(fit.uncertainty.standard_errors, expected.standard_errors, rtol=1e-6)
    assert expected.standard_errors[DELAY] > 1.2 * errors[DELAY]


def test_a_single_block_has_no_errors_and_no_feedback(flight):
    short = identify(flight.slice(0.2, 0.25), preparation=Preparation(faults="keep"))
    assert np.isnan(short.uncertainty.standard_errors).all()
