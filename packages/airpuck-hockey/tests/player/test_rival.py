"""What is learned of an opponent: from made-up motion with known limits."""

import numpy as np
import pytest

from airpuck_hockey.player.rival import Rival, RivalWatcher


def test_stance_speed_and_reaction_time_are_learned():
    watcher, y, speed = RivalWatcher(1.1), 0.0, 0.0
    for k in range(4000):
        time = k / 200
        # It stands 0.1 m from its goal line at half of the puck's y, and reacts after 0.25 s.
        puck, since = (-0.4, 0.3), time % 2.0
        speed = 3.0 if 0.25 <= since < 0.3 else 0.0
        y = 0.15 if speed == 0.0 else 0.0
        opponent = np.array([1.0, y, 0.0, speed])
        watcher.seen(time, opponent, puck)
        if k % 400 == 0:
            watcher.shot(time, np.array([1.0, y, 0.0, 0.0]))
    # A pose that jumps says nothing.
    watcher.seen(20.0, np.array([1.0, 0.15, 300.0, 0.0]), (-0.4, 0.3))
    rival = watcher.rival
    assert rival.speed == 3.0
    assert rival.reaction == pytest.approx(0.25, abs=0.02)
    assert rival.waits == pytest.approx(0.1, abs=0.01)
    assert rival.follows == pytest.approx(0.5, abs=0.02)


def test_an_opponent_accelerates_only_after_its_reaction_time():
    rival = Rival(reaction=0.2, speed=2.0)
    times = np.linspace(0.0, 1.0, 1001)
    reach = rival.reach(times)
    assert (reach[times <= 0.2] == 0).all()
    # 40 m/s² for 50 ms, and then 2 m/s.
    np.testing.assert_allclose(np.diff(reach)[260:] / np.diff(times)[260:], 2.0)
    assert reach[-1] == pytest.approx(0.05 * 1.0 + 0.75 * 2.0)


def test_return_times_are_measured_from_centre_line_to_goal():
    watcher = RivalWatcher(1.1)
    # Away at 2 m/s, 0.3 s in the other half, back at 4 m/s; then away again, and lost in the goal.
    for k in range(100):
        time = k / 100
        x = min(2.0 * (time - 0.2), 0.2, 4.0 * (0.5 - time))
        watcher.puck(time, x, 2.0 if time < 0.4 else -4.0)
    watcher.puck(2.0, -0.3, 0.0)
    watcher.puck(2.01, 0.3, 0.0)
    watcher.puck(4.0, 0.3, 0.0)  # a serve of the opponent is no return
    watcher.puck(4.01, -0.01, -4.0)
    rival = watcher.rival
    assert rival.returns == pytest.approx([0.3 + 1.1 / 4.0], abs=0.02)
    # One return counts against the assumption of slow ones.
    assert rival.is_quicker(np.array([0.5, 0.7])).tolist() == pytest.approx([0.0, 1 / 3])


def test_bank_shots_that_never_score_get_a_lower_expected_chance():
    watcher, time, shares = RivalWatcher(1.1), 0.0, []
    for scores in (False,) * 6 + (True,) * 6:
        watcher.shot(time, np.zeros(4), banked=0.2 * watcher.rival.banks)
        # A goal is a puck that vanishes at the line; otherwise it comes back, and vanishes later.
        for x in (0.5, 1.05) if scores else (0.5, 1.05, 0.4, -0.5):
            time += 0.01
            watcher.puck(time, x, 1.0)
        time += 1.0
        watcher.puck(time, -0.3, 0.0)
        # A direct shot does not count.
        watcher.shot(time, np.zeros(4))
        shares.append(watcher.rival.banks)
    assert shares[:6] == sorted(shares[:6], reverse=True)
    assert shares[5] == pytest.approx(0.2 / 1.4)
    assert shares[6:] == sorted(shares[6:])
    assert shares[-1] == 1.5
