"""The score from poses alone: games with known scores, and events that are not goals."""

import math

import numpy as np
import pytest

from airpuck import AirHockey, PuckState
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck.twin.settings import default_twin_settings
from airpuck_hockey import Game, Rules
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.game.scorekeeper import Scorekeeper
from tests.apparatus.changes import changed

PLAY = AirHockey()
FRAME = 1 / 240


class Cameras:
    """Feeds a scorekeeper with camera frames."""

    def __init__(self, rules=None, seed=0):
        self.keeper = Scorekeeper(PLAY, rules)
        self.random = np.random.default_rng(seed)
        self.time, self.said = 0.0, []
        self.pose = np.zeros(3)

    def see(self, *place, puck=True, frames=1):
        """Frames with a puck at a place, or without one."""
        for _ in range(frames):
            self.time += FRAME
            self.keeper.frame(self.time)
            if puck:
                self.pose = np.array([*place, 0.3]) + self.random.normal(0.0, 5e-5, 3)
                self.keeper.puck(self.time, self.pose)
            self.said += self.keeper.judge()

    def rest(self, x, y, frames=60):
        self.see(x, y, frames=frames)

    def fly(self, state, seconds, visible=lambda x: True):
        """An untouched puck, until it is in a goal."""
        puck = PuckOnTable(PLAY, PuckState(*state[:2], 0.0, *state[2:]), logs=False)
        for k in range(round(seconds / FRAME)):
            puck.run(k * FRAME)
            x, y = puck.state[:2]
            self.see(x, y, puck=not puck.goal and visible(abs(x)))
        return puck

    def shoot(self, *state, seconds, visible=lambda x: True):
        """A puck that has rested where it is shot from."""
        self.rest(*state[:2])
        return self.fly(state, seconds, visible)

    def repeat(self, pose, frames):
        """Frames that repeat a pose."""
        for _ in range(frames):
            self.time += FRAME
            self.keeper.frame(self.time)
            self.keeper.puck(self.time, pose)
            self.said += self.keeper.judge()

    def nothing(self, seconds):
        self.see(puck=False, frames=round(seconds / FRAME))

    @property
    def score(self):
        return self.keeper.score


@pytest.mark.parametrize("speed", [0.3, 1.0, 5.0, 12.0])
@pytest.mark.parametrize("goal", [-1, 1])
def test_a_puck_that_crosses_the_goal_line_and_vanishes_is_a_goal(goal, speed):
    cameras = Cameras()
    puck = cameras.shoot(0.9 * goal, 0.1, speed * goal, -0.05 * speed, seconds=0.25 / speed + 0.3)
    assert puck.goal == goal
    assert cameras.said == [("goal", -goal)]
    assert cameras.score == ((0, 1) if goal < 0 else (1, 0))
    cameras.nothing(5.0)
    assert len(cameras.said) == 1


@pytest.mark.parametrize(("speed", "seen"), [(3.0, 1.09), (4.0, 1.06)])
def test_a_goal_counts_if_cameras_do_not_see_the_line(speed, seen):
    cameras = Cameras()
    cameras.shoot(0.5, 0.0, speed, 0.0, seconds=1.0, visible=lambda x: x < seen)
    assert cameras.said == [("goal", -1)]


@pytest.mark.parametrize("after", [1, 3, 30])
def test_a_puck_put_back_immediately_still_counts_as_a_goal(after):
    cameras = Cameras()
    cameras.shoot(-0.9, 0.0, -3.0, 0.0, seconds=0.0775)
    cameras.see(puck=False, frames=after)
    assert cameras.score == (0, 0)
    cameras.rest(0.3, 0.1)
    assert cameras.said == [("goal", 1)]
    # And the next one counts again.
    cameras.fly((0.3, 0.1, 4.0, -0.5), 1.0)
    assert cameras.said == [("goal", 1), ("goal", -1)]


def test_a_puck_that_rattles_in_the_goal_counts_once():
    cameras = Cameras()
    cameras.shoot(0.9, 0.0, 3.0, 0.0, seconds=0.4)
    for _ in range(5):
        cameras.see(1.12, 0.05, frames=10)
        cameras.nothing(0.3)
        cameras.see(1.2, -0.05, frames=10)
        cameras.fly((1.1, 0.0, 0.5, 0.0), 0.5)
    assert cameras.said == [("goal", -1)]


def test_a_shot_saved_out_of_sight_is_not_a_goal():
    """A hand covers the puck in front of the line for a while; then the puck reappears."""
    for hidden in (0.1, 0.3, 2.0):
        cameras = Cameras()
        cameras.shoot(0.5, 0.0, 3.0, 0.0, seconds=0.4 / 3)
        cameras.nothing(hidden)
        cameras.fly((0.9, 0.0, -2.0, 0.3), 0.4)
        assert cameras.said == []


@pytest.mark.parametrize("x", np.arange(-1.05, 1.06, 0.15))
def test_a_puck_that_vanishes_on_its_way_is_not_a_goal(x):
    cameras = Cameras()
    cameras.shoot(x, 0.0, math.copysign(0.5, x), 0.0, seconds=0.02)
    cameras.nothing(3.0)
    cameras.rest(x, 0.0)
    assert cameras.said == []


def test_a_puck_that_hits_the_rail_or_a_post_is_not_a_goal():
    for y in (0.25, 0.2, 0.19):
        cameras = Cameras()
        puck = cameras.shoot(0.7, y, 4.0, 0.0, seconds=0.5)
        assert puck.goal == 0
        assert cameras.said == []


def test_frozen_poses_are_not_a_goal():
    """The last pose is repeated, anywhere in front of the goal."""
    for seconds in (0.02, 0.06, 0.1):
        cameras = Cameras()
        cameras.shoot(0.6, 0.0, 4.0, 0.0, seconds=seconds)
        frozen = np.array([0.6 + 4.0 * seconds, 0.0, 0.3])
        cameras.repeat(frozen, 500)
        cameras.rest(0.6, 0.2)
        assert cameras.said == []


def test_frozen_poses_of_a_slow_puck_are_neither_goal_nor_foul():
    """Repeated poses are not a resting puck: neither for a goal nor for a foul."""
    for x, said in ((1.05, [("goal", -1)]), (0.5, [])):
        cameras = Cameras(Rules(foul_s=2.0))
        cameras.shoot(x, 0.0, 0.4, 0.0, seconds=0.1)
        cameras.repeat(cameras.pose, round(3.0 / FRAME))
        assert cameras.said == said


@pytest.mark.parametrize("place", [(1.1, 0.0), (1.12, 0.1), (1.3, 0.0), (-1.11, 0.0), (5.0, 5.0)])
@pytest.mark.parametrize("frames", [1, 2, 3, 50])
def test_poses_that_jump_into_a_goal_do_not_count(place, frames):
    cameras = Cameras()
    cameras.rest(0.2, 0.1)
    for _ in range(5):
        cameras.see(*place, frames=frames)
        cameras.rest(0.2, 0.1, frames=20)
    cameras.see(*place, frames=frames)
    cameras.nothing(2.0)
    assert cameras.said == []


@pytest.mark.slow
def test_random_and_missing_poses_are_not_goals():
    cameras = Cameras()
    for k in range(2000):
        x, y = cameras.random.uniform((-1.2, -0.6), (1.2, 0.6))
        cameras.see(x, y, puck=bool(k % 3))
        cameras.keeper.puck(cameras.time, np.full(3, math.nan))
        cameras.keeper.puck(cameras.time - 0.5, np.array([1.12, 0.0, 0.0]))
        cameras.keeper.puck(math.nan, np.array([1.12, 0.0, 0.0]))
        cameras.keeper.puck(cameras.time, np.array([1e300, 0.0, math.inf]))
        if k % 500 == 0:
            cameras.nothing(0.5)
    assert [ruling for ruling in cameras.said if ruling.kind == "goal"] == []


@pytest.mark.parametrize("gap", [0.25, 2.0])
def test_a_puck_lost_just_before_the_line_is_not_a_goal(gap):
    cameras = Cameras()
    cameras.shoot(0.9, 0.0, 3.0, 0.0, seconds=0.0775)
    cameras.time += gap
    # The cameras see other objects before they see the puck again.
    cameras.nothing(0.5)
    cameras.rest(0.7, 0.0)
    assert cameras.said == []


@pytest.mark.slow
def test_fouls_and_stuck_pucks_are_called():
    cameras = Cameras()
    cameras.rest(-0.5, 0.0, frames=round(15.2 / FRAME))
    assert cameras.said == [("foul", -1)]
    assert cameras.keeper.calls["foul", -1] == 1
    cameras.said.clear()
    cameras.rest(0.0, 0.2, frames=round(3.2 / FRAME))
    assert cameras.said == [("stuck", 0)]
    # A puck that is taken off the table and returned starts a new path.
    cameras.said.clear()
    cameras.rest(0.5, 0.0, frames=round(10 / FRAME))
    cameras.nothing(60.0)
    cameras.rest(0.5, 0.0, frames=round(10 / FRAME))
    assert cameras.said == []


def test_after_the_end_the_next_puck_starts_another_game():
    cameras = Cameras(Rules(goals=2))
    for _ in range(3):
        cameras.shoot(0.9, 0.0, 3.0, 0.0, seconds=0.5)
    assert cameras.said == [("goal", -1), ("goal", -1), ("over", -1), ("goal", -1)]
    assert cameras.keeper.games == 2
    assert cameras.score == (1, 0)
    assert cameras.keeper.calls["goal", -1] == 3


@pytest.mark.slow
def test_the_scorekeeper_agrees_with_the_referee_of_a_game():
    """Two scripted humans play; the cameras lose frames and have noise."""
    rules = Rules(goals=100, limit_s=50.0)
    settings = changed(default_twin_settings(), motion_capture={"dropped": 0.05})
    players = contestant("human:hard"), contestant("human:easy")
    game = Game(*players, rules=rules, settings=settings, seed=0)
    game.play()
    poses, frames = (game.recording()[name] for name in ("puck", "pose"))
    keeper, said = Scorekeeper(PLAY, rules), []
    heard = [(stamp, 1, pose) for stamp, pose in zip(poses.stamp_ns, poses.values, strict=True)]
    heard += [(stamp, 0, None) for stamp in frames.stamp_ns]
    heard.sort(key=lambda one: one[:2])
    for stamp, is_puck, pose in heard:
        time = float(stamp) / 1e9
        keeper.puck(time, pose) if is_puck else keeper.frame(time)
        said += keeper.judge()
    goals = [event for event in game.events if event.kind == "goal"]
    assert len(goals) > 2
    assert [r for r in said if r.kind == "goal"] == [("goal", event.side) for event in goals]
