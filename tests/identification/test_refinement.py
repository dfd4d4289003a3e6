"""Data prepared anew: packets as they arrived, velocities that switching motors do not blur."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.campaigns.items import thrust_error
from airpuck.data.trajectory import Trajectory
from airpuck.identification import fit as fit_module
from airpuck.identification.fit import identify
from airpuck.identification.packet_delays import PacketDelays
from airpuck.identification.refinement import retimed, smoothed_along
from airpuck.preprocessing.derivative import velocity

from .flown import TRUTH, flown


def packets(numbers, deviation, error=0.0) -> PacketDelays:
    deviation = np.array(deviation, dtype=float)
    return PacketDelays(np.array(numbers), deviation, np.full(len(deviation), float(error)))


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


def test_known_packets_move_and_take_the_others_along():
    """Packet 10 comes 15 ms late, 20 as much early: 11 waits for 10, and 19 was there before 20."""
    moved = retimed(sent(), packets([10, 20], [0.015, -0.015]), 0.01).command_time
    np.testing.assert_allclose(moved[[9, 10, 11, 12]], [0.09, 0.115, 0.115, 0.12], atol=1e-12)
    np.testing.assert_allclose(moved[[18, 19, 20, 21]], [0.18, 0.185, 0.185, 0.21], atol=1e-12)


def test_what_is_hardly_known_hardly_moves():
    """Half of an estimate whose variance is that of the delays; a fifth where it is four times."""
    for error, share in ((0.01, 0.5), (0.02, 0.2)):
        moved = retimed(sent(), packets([10, 20], [0.005, -0.005], error), 0.01).command_time
        assert moved[10] - 0.1 == pytest.approx(share * 0.005, abs=1e-12)


@given(st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=3))
def test_no_packet_overtakes(deviation):
    moved = retimed(sent(), packets([5, 12, 16], deviation), 0.01).command_time
    assert (np.diff(moved) >= 0).all()


def test_without_jitter_nothing_moves():
    trajectory = sent()
    assert retimed(trajectory, packets([10, 20], [0.015, -0.015]), 0.0) is trajectory
    nothing = PacketDelays(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    assert retimed(trajectory, nothing, 0.01) is trajectory


def test_stretches_too_short_to_smooth_are_left_alone():
    """Two frames lost, five samples apart: preprocessing has left what lies between out."""
    time = np.delete(np.arange(120), [60, 66]) / 240
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


def test_velocities_are_not_smoothed_across_switches():
    """With perfect cameras smoothing is all that is wrong; along the true model hardly any is."""
    flight = flown(0.0, 10.0, noise=False)
    known = replace(TRUTH, free=TRUTH.parameters.mask(frozenset({"transport_delay"})))
    inner = slice(10, -10)  # the ends of a derivative are its own

    def errors(trajectory):
        return np.std((trajectory.state[:, 3:] - flight.rates)[inner], axis=0)

    blurred = errors(flight.trajectory)
    assert (errors(smoothed_along(flight.trajectory, known)) < 0.15 * blurred).all()


def test_smoothing_along_a_model_is_smoothing_where_motors_stand():
    """Nothing is modelled then: velocities are those of preprocessing, gap or not."""
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


def test_a_refined_fit_is_several_times_more_accurate(monkeypatch):
    """Against one that takes every packet to arrive after the mean delay, on the same flight."""
    trajectory = flown(0.007, 40.0).trajectory
    refined_fit = identify(trajectory)
    monkeypatch.setattr(fit_module, "_REFINEMENTS", 0)
    plain = identify(trajectory)
    wrong = [thrust_error(fit.model, TRUTH).max() for fit in (plain, refined_fit)]
    assert wrong[1] < 0.5 * wrong[0]
    assert wrong[1] < 0.01
    assert refined_fit.loss < 0.2 * plain.loss
