"""Packets moved to their arrival times, their jitter, and velocities smoothed with the model."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from airpuck.campaigns.items import thrust_error
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.packet_delays import PacketDelays
from airpuck.identification.fit import identify
from airpuck.identification.retiming import (
    delay_jitter,
    error_growth,
    retimed,
    smoothed_along,
    variance_of_mean,
)
from airpuck.identification.settings import Preparation
from airpuck.preprocessing.derivative import velocity

from ..apparatus.excited_flights import TRUTH, fit_of_flown, flown


def packets(numbers, deviation, error=0.0) -> PacketDelays:
    deviation = np.array(deviation, dtype=float)
    error = np.broadcast_to(error, deviation.shape).astype(float)
    return PacketDelays(np.array(numbers), deviation, error)


def some(deviation, error) -> PacketDelays:
    """Packets with arbitrary contents."""
    return packets(np.arange(len(deviation)), deviation, error)


def sent(count: int = 40) -> Trajectory:
    """Packets at 100 Hz."""
    return Trajectory(
        time=np.arange(100) / 240,
        state=np.zeros((100, 6)),
        acceleration=np.zeros((100, 3)),
        command_time=0.01 * np.arange(count),
        command=np.zeros((count, 2)),
        propellers=("a", "b"),
    )


def test_retimed_packets_shift_their_neighbours():
    """Packet 10 comes 15 ms late, packet 20 15 ms early: 11 waits for 10, and 20 waits for 19."""
    moved = retimed(sent(), packets([10, 20], [0.015, -0.015]), 0.01).command_time
    np.testing.assert_allclose(moved[[9, 10, 11, 12]], [0.09, 0.115, 0.115, 0.12], atol=1e-12)
    np.testing.assert_allclose(moved[[18, 19, 20, 21]], [0.18, 0.185, 0.185, 0.21], atol=1e-12)


def test_uncertain_delays_are_barely_changed():
    """Half of an estimate with the variance of the delays, a fifth with four times as much."""
    for error, share in ((0.01, 0.5), (0.02, 0.2)):
        moved = retimed(sent(), packets([10, 20], [0.005, -0.005], error), 0.01).command_time
        assert moved[10] - 0.1 == pytest.approx(share * 0.005, abs=1e-12)


@given(st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=3))
def test_packets_do_not_overtake_each_other(deviation):
    moved = retimed(sent(), packets([5, 12, 16], deviation), 0.01).command_time
    assert (np.diff(moved) >= 0).all()


def test_without_jitter_no_packet_is_retimed():
    trajectory = sent()
    assert retimed(trajectory, packets([10, 20], [0.015, -0.015]), 0.0) is trajectory
    nothing = PacketDelays(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    assert retimed(trajectory, nothing, 0.01) is trajectory


def test_segments_too_short_to_smooth_are_unchanged():
    """Two long pauses, five samples apart: preprocessing excludes the samples in between."""
    time = np.delete(np.arange(190), [*range(60, 96), *range(101, 137)]) / 240
    state = np.zeros((118, 6))
    state[60:65, 3:] = 7.0
    trajectory = Trajectory(
        time=time,
        state=state,
        acceleration=np.zeros((118, 3)),
        command_time=np.zeros(1),
        command=np.zeros((1, 6)),
        propellers=TRUTH.vehicle.propeller_names,
    )
    smoothed = smoothed_along(trajectory, TRUTH)
    assert (smoothed.state[60:65, 3:] == 7.0).all()
    assert (smoothed.state[:60, 3:] == 0.0).all()
    assert (smoothed.state[65:, 3:] == 0.0).all()


@pytest.mark.slow
def test_velocities_are_not_smoothed_across_switching_times():
    """With perfect cameras the only error is smoothing; the true model removes nearly all of it."""
    flight = flown(0.0, 10.0, noise=False)
    known = replace(TRUTH, free=TRUTH.parameters.mask(frozenset({"transport_delay"})))
    inner = slice(10, -10)  # derivatives differ at the ends

    def errors(trajectory):
        return np.std((trajectory.state[:, 3:] - flight.rates)[inner], axis=0)

    blurred = errors(flight.trajectory)
    assert (errors(smoothed_along(flight.trajectory, known)) < 0.15 * blurred).all()


def test_smoothing_along_a_model_equals_plain_smoothing_if_motors_stand():
    """Without a model, velocities equal preprocessed velocities, with or without a gap."""
    rng = np.random.default_rng(0)
    time = np.concatenate([np.arange(60), np.arange(80, 140)]) / 240
    poses = np.cumsum(rng.normal(0, 1e-4, (120, 3)), axis=0)
    rates = np.concatenate(
        [velocity(time[part], poses[part]) for part in (slice(60), slice(60, 120))]
    )
    trajectory = Trajectory(
        time=time,
        state=np.concatenate([poses, rates], axis=1),
        acceleration=np.zeros((120, 3)),
        command_time=np.array([-1.0]),
        command=np.zeros((1, 6)),
        propellers=TRUTH.vehicle.propeller_names,
        delay=0.02,
    )
    still = replace(TRUTH, parameters=replace(TRUTH.parameters, center_of_mass=np.zeros(2)))
    again = smoothed_along(trajectory, still)
    np.testing.assert_allclose(again.state, trajectory.state, atol=1e-12)


@pytest.mark.study
def test_retiming_makes_a_fit_several_times_more_accurate():
    """Against a fit on the same flight that assumes the mean delay for every packet."""
    trajectory = flown(0.007, 40.0).trajectory
    retimed_fit = fit_of_flown(0.007, 40.0)
    plain = identify(trajectory, preparation=Preparation(retimings=0))
    wrong = [thrust_error(fit.model, TRUTH).max() for fit in (plain, retimed_fit)]
    assert wrong[1] < 0.5 * wrong[0]
    assert wrong[1] < 0.01
    assert retimed_fit.loss < 0.2 * plain.loss


def test_jitter_with_equal_errors_matches_a_hand_calculation():
    """σ² = s² - v, s² with N - 1 degrees of freedom; of s², the error by the fourth moment."""
    deviation = 1e-3 * np.array([-6.0, -3, -2, -1, 0, 0, 1, 2, 3, 6])
    jitter = delay_jitter([some(deviation, 1e-3)])
    assert jitter.standard_deviation_s == pytest.approx(1e-3 * np.sqrt(100 / 9 - 1), rel=1e-9)
    fourth = (2 * (6.0**4 + 3.0**4 + 2.0**4 + 1)) / 10
    expected = np.sqrt((fourth - 10.0**2) / 10) * 1e-6 / (2 * jitter.standard_deviation_s)
    assert jitter.standard_error_s == pytest.approx(expected, rel=1e-9)
    assert jitter.packets == 10


@pytest.mark.parametrize("spread", [1e-3, 6e-3])
def test_the_spread_is_recovered_from_unequal_errors(spread):
    rng = np.random.default_rng(0)
    error = rng.uniform(0.2e-3, 4e-3, 4000)
    deviation = rng.normal(0, np.hypot(spread, error))
    jitter = delay_jitter([some(deviation, error)])
    assert jitter.standard_deviation_s == pytest.approx(spread, rel=0.06)


@pytest.mark.slow
def test_the_standard_error_matches_the_spread_of_estimates():
    rng = np.random.default_rng(1)
    found = [delay_jitter([some(rng.normal(0, 6e-3, 150), 1e-3)]) for _ in range(400)]
    spread = np.std([jitter.standard_deviation_s for jitter in found])
    assert np.mean([j.standard_error_s for j in found]) == pytest.approx(spread, rel=0.1)


def test_errors_that_explain_the_spread_leave_no_jitter():
    deviation = np.random.default_rng(2).normal(0, 1e-3, 200)
    jitter = delay_jitter([some(deviation, 2e-3)])
    assert jitter.standard_deviation_s < 1e-9
    assert 0 < jitter.standard_error_s < 1e-3


def test_equally_late_packets_have_no_jitter():
    jitter = delay_jitter([some(np.full(20, 2e-3), 1e-3)])
    assert jitter.standard_deviation_s == pytest.approx(0, abs=1e-12)
    assert jitter.standard_error_s == pytest.approx(0, abs=1e-12)


@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_differences_between_recordings_are_not_jitter(first, second):
    deviation = 6e-3 * np.random.default_rng(3).normal(size=60)
    plain = delay_jitter([some(deviation, 1e-3), some(deviation, 1e-3)])
    moved = delay_jitter([some(deviation + first, 1e-3), some(deviation + second, 1e-3)])
    assert moved.standard_deviation_s == pytest.approx(plain.standard_deviation_s, rel=1e-9)


def test_the_weighted_sum_of_squares_equals_its_expectation():
    """Paule and Mandel's equation, mean and all, for errors that differ by a factor of twenty."""
    rng = np.random.default_rng(4)
    error = rng.uniform(0.2e-3, 4e-3, 40)
    deviation = rng.normal(0, np.hypot(3e-3, error))

    def excess(variance):
        weight = 1 / (variance + error**2)
        return weight @ (deviation - np.average(deviation, weights=weight)) ** 2 - 39

    jitter = delay_jitter([some(deviation, error)])
    expected = np.sqrt(brentq(excess, 1e-9, 1e-3, xtol=1e-18))
    assert jitter.standard_deviation_s == pytest.approx(expected, rel=1e-6)


def test_errors_diverge_only_if_preparation_dominates():
    basis, hessian = np.eye(3), np.eye(3)
    mixed = -np.diag([0.5, 3.0, 0.0])  # K has the eigenvalues 0.5, 3 and 0
    growth = np.diag(error_growth(mixed, hessian, basis, rounds=100))
    assert np.isfinite(growth).all()
    assert 1.9 < growth[0] <= 2.0
    assert growth[1] > 1e3
    assert growth[2] == 1.0
    # The estimate that agrees with its own preparation has errors even where the sum diverges.
    settled = np.diag(error_growth(mixed, hessian, basis, None))
    np.testing.assert_allclose(settled, [2.0, -0.5, 1.0])


def test_too_few_packets_determine_nothing():
    assert delay_jitter([some([1e-3], 1e-3)] * 12) is None
    assert delay_jitter([]) is None
    assert delay_jitter([some(np.zeros(9), 1e-3)]) is None


def test_the_variance_of_a_mean_matches_many_samples():
    rng = np.random.default_rng(4)
    error = rng.uniform(0.2e-3, 4e-3, 120)
    delays = [some(np.zeros(70), error[:70]), some(np.zeros(50), error[70:])]
    weight = 1 / (6e-3**2 + error**2)
    means = [np.average(rng.normal(0, 6e-3, 120), weights=weight) for _ in range(4000)]
    assert np.sqrt(variance_of_mean(delays, 6e-3)) == pytest.approx(np.std(means), rel=0.04)
    assert variance_of_mean([some(np.zeros(90), 1e-4)], 6e-3) == pytest.approx(6e-3**2 / 90)


def test_without_packets_or_jitter_a_mean_has_no_error():
    assert variance_of_mean([], 6e-3) == variance_of_mean([some([], 1e-3)], 6e-3) == 0
    assert variance_of_mean([some(np.zeros(90), 1e-4)], 0.0) == 0
