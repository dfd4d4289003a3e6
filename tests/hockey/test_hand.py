"""The scripted human."""

import math

import numpy as np
import pytest

from airpuck.craft.table import AirHockey
from airpuck.hockey.hand import SKILLS, GuidedHand, ScriptedHand, Skill
from airpuck.physics.puck import PuckState
from airpuck.twin.play import HandMallet, World

PLAY = AirHockey()
EXACT = Skill(reaction_s=0.2, noise_m=0.0, aim_rad=0.0, speed_m_s=4.0)


class Frames:
    """An observer that looks when it is told to."""

    due = math.inf

    def observe(self, time: float) -> None:
        self.due = math.inf


def episode(skill: Skill, puck: PuckState, duration: float, start=(-0.85, 0.0), seed=0):
    """Let one hand play a puck alone; return its ways and the world."""
    world, hand = World(PLAY, puck), ScriptedHand(PLAY, skill, seed)
    mallet = HandMallet(PLAY.mallet, PLAY.table, *start)
    world.bodies.append(mallet)
    assert world.puck is not None
    frames = Frames()
    world.observers.append(frames)
    ways, rate = [], 0.01
    for k in range(round(duration / rate)):
        seen = None if world.puck.goal else world.puck.state
        mallet.target = hand.target(k * rate, (mallet.x, mallet.y), seen, (0.9, 0.0))
        frames.due = (k + 1) * rate
        world.run((k + 1) * rate)
        ways.append((mallet.x, mallet.y, mallet.vx, mallet.vy))
    return np.array(ways), world


def test_it_does_not_move_before_it_can_have_seen():
    # The puck rests aside, and is then shot at the goal.
    hand = ScriptedHand(PLAY, EXACT)
    rests = PuckState(0.5, 0.4)
    shot = PuckState(0.5, 0.15, 0.0, -4.0, 0.0)
    own, wanted = (-0.85, 0.2), []
    for k in range(80):
        time = 0.01 * k
        moved = rests if time < 0.4 else shot._replace(x=0.5 - 4.0 * (time - 0.4))
        wanted.append(hand.target(time, own, moved, (0.9, 0.0)))
    changed = np.flatnonzero(np.any(np.diff(wanted, axis=0) != 0, axis=1))
    assert 0.01 * changed[changed >= 20].min() >= 0.4 + EXACT.reaction_s - 0.011
    assert 0.01 * changed[changed >= 20].min() <= 0.4 + EXACT.reaction_s + 0.05


@pytest.mark.parametrize("level", SKILLS)
def test_its_mallet_keeps_to_its_speed_and_acceleration(level):
    # With seed 3 the puck is wedged at a rail, and holds the mallet.
    ways, _ = episode(SKILLS[level], PuckState(-0.3, 0.3, 0, -0.5, 0.4), 2.0, seed=4)
    speed = np.hypot(ways[:, 2], ways[:, 3])
    assert speed.max() <= min(SKILLS[level].speed_m_s, PLAY.mallet.speed_m_s) * 1.05
    assert speed.max() > 0.5
    change = np.hypot(*np.diff(ways[:, 2:], axis=0).T) / 0.01
    # At the border of its half it is stopped.
    inside = (np.abs(ways[1:, 1]) < 0.5) & (ways[1:, 0] > -1.04) & (ways[1:, 0] < -0.06)
    assert change[inside].max() <= PLAY.mallet.acceleration_m_s2 * 1.01


def test_it_strikes_a_resting_puck_at_the_goal():
    scored = 0
    for y in (-0.3, -0.1, 0.0, 0.15, 0.3):
        _, world = episode(EXACT, PuckState(-0.45, y), 3.0)
        assert world.puck is not None
        scored += world.puck.goal == 1
    assert scored >= 4


def test_it_saves_most_shots_that_nobody_could_call_hard():
    saved = dict.fromkeys(SKILLS, 0)
    for level, skill in SKILLS.items():
        for k, y in enumerate(np.linspace(-0.15, 0.15, 10)):
            shot = PuckState(0.8, 0.0, 0.0, -2.0, 2.0 * y / 1.9)
            _, world = episode(skill, shot, 1.4, seed=k)
            assert world.puck is not None
            saved[level] += world.puck.goal != -1
    assert saved["hard"] >= 9
    assert saved["easy"] <= saved["hard"]


def test_its_first_stroke_has_an_error_of_aim_too():
    skill, rests = Skill(0.2, 0.0, 0.3, 4.0), PuckState(-0.45, 0.0)
    starts = set()
    for seed in range(5):
        hand = ScriptedHand(PLAY, skill, seed)
        starts.add(hand.target(0.0, (-0.85, 0.2), rests, (0.9, 0.0)))
    assert len(starts) == 5


def test_a_guided_hand_waits_where_it_is_until_it_is_moved():
    hand = GuidedHand()
    assert hand.target(0.0, (0.1, 0.2), None, (0.0, 0.0)) == (0.1, 0.2)
    hand.wanted = (0.5, -0.25)
    assert hand.target(0.0, (0.1, 0.2), None, (0.0, 0.0)) == (-0.5, 0.25)
