"""Where the search begins, and which flights it accepts."""

import numpy as np
import pytest

import airpuck
from airpuck import Goal, Limits, Table
from airpuck.planning.request import checked_request
from airpuck.planning.search import COARSE, further_starts, guess, refined, starts

M3 = airpuck.read_model("paper:M3")


def asked(start, goal, via=(), discs=(), **limits):
    return checked_request(M3, start, goal, via, Table(), discs, Limits(**limits))


def test_initial_guesses_for_a_free_yaw_cover_the_circle():
    yaws = [yaw for _, _, yaw in starts(asked((0, 0, 0.4), Goal(0.3, 0, yaw=None)), COARSE)]
    around = np.sort(np.mod(yaws, 2 * np.pi))
    assert np.diff(np.append(around, around[0] + 2 * np.pi)).max() < 0.95


def test_the_first_guess_turns_evenly_and_the_next_two_left_and_right():
    straight, left, right = list(starts(asked((0, 0, 0), (0.3, 0, 1.0)), COARSE))
    yaw = straight[1].states[:, 2]
    assert (np.diff(yaw) > 0).all()
    for begun, side in ((left, 1), (right, -1)):
        aside = begun[1].states[:, 2] - yaw
        assert side * aside[COARSE // 2] == pytest.approx(0.5)
        np.testing.assert_allclose(aside[[0, -1]], 0, atol=1e-12)


def test_detours_pass_close_to_their_discs_on_both_sides():
    discs = ((0.15, 0.03, 0.05), (-0.2, 0, 0.05), (0, 0.45, 0.05))
    request = asked((-0.5, 0, 0), (0.5, 0, 0), discs=discs)
    paths = {name: path.states for name, path, _ in starts(request, 100)}
    assert len(paths) == 5
    for name, side in (("round on the left", 1), ("round on the right", -1)):
        for x, y, radius in request.keep_out[:2]:
            away = np.hypot(*(paths[name][:, :2] - (x, y)).T).min()
            assert radius < away < 1.5 * radius
            beside = np.abs(paths[name][:, 0] - x).argmin()
            assert side * (paths[name][beside, 1] - y) > radius
    assert not paths["straight"][:, 1].any()


@pytest.mark.parametrize(("spin", "speed"), [(2.0, 3.0), (15.0, 0.3)])
def test_initial_guesses_respect_the_limits(spin, speed):
    request = asked((-0.4, 0, 0), (0.4, 0, 1.5), spin=spin, speed=speed)
    for _, path, _ in [*starts(request, 40), *further_starts(request, 40)]:
        assert np.abs(path.states[:, 3]).max() < 1.02 * speed
        assert np.abs(path.states[:, 5]).max() < 1.6 * spin
        assert path.durations.sum() < 6.0 * max(0.8 / speed, 3.0 / spin)


def test_time_to_turn_round_equals_two_stops():
    request = asked((0, 0, 0, 0.3, 0, 0), (0.1, 0, 0, 0, -0.6, 0))
    straight = next(iter(starts(request, COARSE)))[1].durations.sum()
    patient = next(iter(further_starts(request, COARSE)))[1].durations.sum()
    assert patient - straight == pytest.approx(2 * (0.3 + 0.6) / request.strongest_push)


def test_a_guess_reaches_each_waypoint_at_the_end_of_a_leg():
    for via in ([(0.2, 0.3)], [(0.2, 0.3), (0.0, 0.3), (-0.3, -0.1)]):
        request = asked((0, 0, 0), (0.4, 0, 0), via)
        path = guess(request, 8, 0.0, 0.0, request.via)
        corners = [(0, 0), *via, (0.4, 0)]
        np.testing.assert_allclose(path.states[::8, :2], corners, atol=1e-9)
        lengths = np.hypot(*np.diff(corners, axis=0).T)
        np.testing.assert_allclose(path.durations**2 / lengths, path.durations[0] ** 2 / lengths[0])


def test_a_refined_flight_passes_a_disc_without_touching_it():
    request = asked((-0.25, 0, 0), (0.25, 0, 0), discs=((0, -0.09, 0.02),))
    begun = next(path for name, path, _ in starts(request, COARSE) if name == "round on the left")
    solved, status = refined(request, begun, 0.0, 16, guessed=True)
    assert solved is not None, status
    x, y, radius = request.keep_out[0]
    _, states = solved.path.simulated(M3, solved.path.times, 5)
    assert -0.003 < np.hypot(*(states[:, :2] - (x, y)).T).min() - radius < 0.005
