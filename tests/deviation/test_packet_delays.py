"""Delays of single packets, against the twin's radio."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from airpuck.deviation.packet_delays import PacketDelays, delay_response, packet_delays
from airpuck.identification.fit import identify
from airpuck.identification.retiming import modelled_acceleration, retimed
from airpuck.identification.settings import Preparation
from airpuck.model.model_file import read_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.read import read_recording
from airpuck.twin.radio import queued_delay

from ..apparatus.excited_flights import TRUTH, fit_of_flown, flown, settings
from ..apparatus.public_recordings import BLUE

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def flight():
    return flown(0.007, 40.0)


@pytest.fixture(scope="module")
def fit():
    return fit_of_flown(0.007, 40.0)


def test_every_packet_delay_is_estimated_within_its_error(flight):
    """With the true model, only the noise of the cameras remains."""
    known = replace(TRUTH, free=TRUTH.parameters.mask(frozenset({"transport_delay"})))
    found = packet_delays(flight.trajectory, known)
    assert len(found) > 100
    wrong = TRUTH.transport_delay + found.deviation - flight.delay[found.packet]
    assert np.median(found.standard_error) < 0.7e-3
    score = wrong / found.standard_error
    assert 0.8 < score.std() < 1.25
    assert np.mean(np.abs(score) < 3) > 0.98


def test_a_long_recording_needs_little_more_memory_than_a_short_one(flight):
    """Eight times the packets: their own results, but not eight times the regressions."""

    def peak(repeats):
        short = flight.trajectory
        both = np.concatenate([short.time, short.command_time])
        shift = (np.ptp(both) + short.sample_period) * np.arange(repeats)[:, None]
        long = replace(
            short,
            time=np.ravel(short.time + shift),
            state=np.tile(short.state, (repeats, 1)),
            acceleration=np.tile(short.acceleration, (repeats, 1)),
            command_time=np.ravel(short.command_time + shift),
            command=np.tile(short.command, (repeats, 1)),
        )
        tracemalloc.start()
        found = packet_delays(long, TRUTH)
        return tracemalloc.get_traced_memory()[1], found, tracemalloc.stop()

    (little, once, _), (much, often, _) = peak(1), peak(8)
    assert len(often) > 7 * len(once)
    _, one, other = np.intersect1d(once.packet, often.packet, return_indices=True)
    assert len(one) > 0.95 * len(once)
    # The noise is fitted to the whole recording.
    moved = np.abs(often.deviation[other] - once.deviation[one]) / once.standard_error[one]
    assert np.median(moved) < 0.1
    assert moved.max() < 2
    assert much < 3 * little


def test_estimated_delays_decrease_if_the_model_expects_packets_later(flight, fit):
    """If the model's delay is longer by e, each packet's estimated delay is shorter by e."""
    (delays,) = fit.packet_delays
    arrived = retimed(flight.trajectory, delays, fit.model.delay_jitter.standard_deviation_s)
    later = np.random.default_rng(0).normal(0, 1e-4, len(delays))
    time = arrived.command_time.copy()
    time[delays.packet] += later
    moved = replace(arrived, command_time=np.maximum.accumulate(time))
    change = modelled_acceleration(moved, fit.model) - modelled_acceleration(arrived, fit.model)
    response = delay_response(flight.trajectory, fit.model, delays, change[None])[0]
    assert np.corrcoef(response, later)[0, 1] < -0.95
    assert np.polyfit(later, response, 1)[0] == pytest.approx(-1, abs=0.06)


def test_packets_beyond_the_poses_have_no_derivative(flight, fit):
    """Windows move with the model's delay: the last one of a recording may leave it."""
    trajectory, packet = flight.trajectory, fit.packet_delays[0].packet
    change = np.ones((1, len(trajectory), 3))

    def response(packet):
        known = PacketDelays(packet, np.zeros(len(packet)), np.ones(len(packet)))
        return delay_response(trajectory, fit.model, known, change)[0]

    last = len(trajectory.command_time) - 1
    assert last not in packet
    found = response(np.append(packet, last))
    assert found[-1] == 0
    np.testing.assert_array_equal(found[:-1], response(packet))


def test_the_jitter_of_a_fit_matches_its_packets(flight, fit):
    jitter = fit.model.delay_jitter
    own = flight.delay[fit.packet_delays[0].packet]
    # These packets are a sample; its spread is not an error of the estimate.
    assert jitter.standard_deviation_s == pytest.approx(own.std(), rel=0.08)
    mean, spread = queued_delay(settings(0.007).with_usual_delay(TRUTH.transport_delay).radio, 0.01)
    assert abs(jitter.standard_deviation_s - spread) < 3 * jitter.standard_error_s
    assert jitter.standard_error_s < 0.1 * spread
    assert fit.model.transport_delay == pytest.approx(mean, abs=2e-3)


def test_a_flight_without_jitter_has_none():
    found = identify(flown(0.0, 12.0, seed=1).trajectory)
    assert found.model.delay_jitter.standard_deviation_s < 0.7e-3


def test_jitter_is_in_the_model_file_and_in_the_figures(fit, tmp_path):
    fit.model.save(tmp_path / "model.toml")
    again = read_model(tmp_path / "model.toml").delay_jitter
    assert again == fit.model.delay_jitter
    assert fit.to_json()["delay_jitter"] == again.model_dump()


def test_a_fixed_delay_has_no_jitter(flight):
    found = identify(flight.trajectory, preparation=Preparation(delay="fixed", faults="keep"))
    assert found.model.delay_jitter is None
    assert found.packet_delays == ()


@pytest.mark.study
@pytest.mark.data
def test_the_jitter_of_a_real_flight_matches_another_method(experiments):
    """Median and quartiles of the delays were found by another method: 21, 15.7 and 25.2 ms."""
    trajectory = preprocess(read_recording(experiments / BLUE / BLUE))
    found = identify(trajectory)
    jitter = found.model.delay_jitter
    assert 6e-3 < jitter.standard_deviation_s < 9e-3
