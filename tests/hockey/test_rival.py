"""What is learned of an opponent: from made-up motion with known limits."""

import numpy as np
import pytest

from airpuck.hockey.rival import Rival, RivalWatcher


def test_stance_speed_and_reaction_are_learned():
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


def test_nobody_moves_before_the_reaction_and_everybody_speeds_up():
    rival = Rival(reaction=0.2, speed=2.0)
    times = np.linspace(0.0, 1.0, 1001)
    reach = rival.reach(times)
    assert (reach[times <= 0.2] == 0).all()
    # 40 m/s² for 50 ms, and then 2 m/s.
    np.testing.assert_allclose(np.diff(reach)[260:] / np.diff(times)[260:], 2.0)
    assert reach[-1] == pytest.approx(0.05 * 1.0 + 0.75 * 2.0)
