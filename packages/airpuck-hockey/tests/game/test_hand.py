"""The scripted human."""

import math

import numpy as np
import pytest

from airpuck.physics.puck import PuckState
from airpuck_hockey.game.hand import HUMANS, Dexterity, GuidedHand, Keeper, ScriptedHand, Striker
from apparatus.hands import PLAY, played_alone

EXACT = Dexterity(reaction_s=0.2, noise_m=0.0, aim_rad=0.0, speed_m_s=4.0)


def episode(
    skill: Dexterity,
    puck: PuckState,
    duration: float,
    start=(-0.85, 0.0),
    seed=0,
    hand=ScriptedHand,
    opponent=(0.9, 0.0),
):
    """Let one hand play a puck alone; return its path and the world."""
    return played_alone(hand(PLAY, skill, seed), puck, duration, start, lambda time: opponent)


def test_it_does_not_move_before_its_reaction_time():
    # The puck first rests on one side, and is then shot at the goal.
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


@pytest.mark.parametrize("level", HUMANS)
def test_its_mallet_respects_speed_and_acceleration_limits(level):
    # With seed 3 the puck is wedged at a rail, and holds the mallet.
    ways, _ = episode(HUMANS[level], PuckState(-0.3, 0.3, 0, -0.5, 0.4), 2.0, seed=4)
    speed = np.hypot(ways[:, 2], ways[:, 3])
    assert speed.max() <= min(HUMANS[level].speed_m_s, PLAY.mallet.speed_m_s) * 1.05
    assert speed.max() > 0.5
    change = np.hypot(*np.diff(ways[:, 2:], axis=0).T) / 0.01
    # At the border of its half it is stopped.
    inside = (np.abs(ways[1:, 1]) < 0.5) & (ways[1:, 0] > -1.04) & (ways[1:, 0] < -0.06)
    assert change[inside].max() <= PLAY.mallet.acceleration_m_s2 * 1.01


def test_it_shoots_a_resting_puck_at_the_goal():
    scored = 0
    for y in (-0.3, -0.1, 0.0, 0.15, 0.3):
        _, world = episode(EXACT, PuckState(-0.45, y), 3.0)
        assert world.puck is not None
        scored += world.puck.goal == 1
    assert scored >= 4


def test_it_saves_most_easy_shots():
    saved = dict.fromkeys(HUMANS, 0)
    for level, skill in HUMANS.items():
        for k, y in enumerate(np.linspace(-0.15, 0.15, 10)):
            shot = PuckState(0.8, 0.0, 0.0, -2.0, 2.0 * y / 1.9)
            _, world = episode(skill, shot, 1.4, seed=k)
            assert world.puck is not None
            saved[level] += world.puck.goal != -1
    assert saved["hard"] >= 9
    assert saved["easy"] <= saved["hard"]


def test_its_first_stroke_has_an_aiming_error_too():
    skill, rests = Dexterity(0.2, 0.0, 0.3, 4.0), PuckState(-0.45, 0.0)
    starts = set()
    for seed in range(5):
        hand = ScriptedHand(PLAY, skill, seed)
        starts.add(hand.target(0.0, (-0.85, 0.2), rests, (0.9, 0.0)))
    assert len(starts) == 5


def test_a_guided_hand_stays_where_it_is_until_it_is_moved():
    hand = GuidedHand()
    assert hand.target(0.0, (0.1, 0.2), None, (0.0, 0.0)) == (0.1, 0.2)
    hand.wanted = (0.5, -0.25)
    assert hand.target(0.0, (0.1, 0.2), None, (0.0, 0.0)) == (-0.5, 0.25)


def wanted(puck, own=(-0.85, 0.0), skill=EXACT):
    """Return a hand's target for its mallet after it has seen a puck for a while."""
    hand = ScriptedHand(PLAY, skill)
    for k in range(40):
        motion = puck._replace(
            x=puck.x + puck.vx * (k - 39) / 100, y=puck.y + puck.vy * (k - 39) / 100
        )
        found = hand.target(k / 100, own, motion, (0.9, 0.0))
    return np.array(found)


def test_it_waits_before_its_goal_on_the_side_of_the_puck():
    # A quarter of a metre from its line, within the goal's width; the target is within reach.
    half, home = PLAY.table.goal_width_m / 2, 0.25 - PLAY.table.length_m / 2
    for y, waits in ((0.2, 0.1), (-0.1, -0.05), (0.5, half), (-0.5, -half)):
        found = wanted(PuckState(0.5, y))
        np.testing.assert_allclose(found, (home, np.clip(waits, -half, half)))
    # The same for a puck that approaches, but takes longer than 0.8 s.
    np.testing.assert_allclose(wanted(PuckState(0.5, 0.2, 0.0, -0.4, 0.0)), (home, 0.1), atol=1e-3)


@pytest.mark.parametrize(
    "puck",
    [
        PuckState(0.5, 0.3),
        PuckState(0.3, 0.1, 0.0, -3.0, -0.2),
        PuckState(-0.45, 0.2),
        PuckState(-0.6, 0.4, 0.0, 0.2, -0.1),
        PuckState(-0.95, 0.3),
    ],
)
def test_a_mirrored_hand_goes_to_the_mirrored_place(puck):
    other = puck._replace(y=-puck.y, vy=-puck.vy)
    np.testing.assert_allclose(wanted(puck, (-0.8, 0.1)) * [1, -1], wanted(other, (-0.8, -0.1)))


def test_it_covers_the_point_where_a_fast_puck_will_pass():
    for y, vy in ((0.1, 0.0), (0.0, 0.2), (0.3, -0.7)):
        puck = PuckState(0.3, y, 0.0, -3.0, vy)
        found = wanted(puck)
        # Extrapolated from its present state to the line of the mallet.
        at = y + vy * (0.3 - found[0]) / 3.0
        assert found[1] == pytest.approx(at, abs=0.03)
        assert -PLAY.table.length_m / 2 < found[0] <= -PLAY.table.length_m / 2 + 0.25


def test_it_goes_round_a_puck_behind_it():
    # Between the hand and its goal: sideways first, and back.
    for y in (0.02, -0.02):
        found = wanted(PuckState(-0.8, 0.0), own=(-0.6, y))
        assert found[0] < -0.6
        assert abs(found[1]) > PLAY.mallet.radius_m
        assert found[1] * y > 0


@pytest.mark.parametrize("y", [0.3, -0.2])
def test_a_stroke_goes_through_the_puck_towards_the_goal(y):
    puck = PuckState(-0.45, y)
    angle = math.atan2(-y, PLAY.table.length_m / 2 - puck.x)
    way = np.array([math.cos(angle), math.sin(angle)])
    together = PLAY.mallet.radius_m + PLAY.puck.radius_m
    # From the start of a stroke, and on the path to the puck.
    for behind in (0.1, 0.05, 0.02):
        own = np.array(puck[:2]) - (together + behind) * way
        towards = wanted(puck, tuple(own.tolist())) - own
        assert towards @ way > 0.05
        np.testing.assert_allclose(towards, (towards @ way) * way, atol=1e-6)


@pytest.mark.parametrize("hand", [Keeper, Striker])
def test_a_keeper_stands_in_its_goal_where_a_puck_will_pass(hand):
    line, half = -PLAY.table.length_m / 2, PLAY.table.goal_width_m / 2
    for y, vy in ((0.05, 0.0), (0.1, -0.3), (0.0, 0.2)):
        keeper = hand(PLAY, EXACT)
        for k in range(40):
            puck = PuckState(0.6 - 3.0 * k / 100, y + vy * k / 100, 0.0, -3.0, vy)
            x, wanted = keeper.target(k / 100, (line + 0.1, 0.0), puck, (0.9, 0.0))
        assert line < x < line + 0.15
        passes = y + vy * (0.6 - x) / 3.0
        assert wanted == pytest.approx(np.clip(passes, -half, half), abs=0.03)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_striker_aims_at_the_open_corner_and_a_keeper_does_not_shoot(side):
    rests, opponent = PuckState(-0.5, 0.0), (0.9, 0.1 * side)
    ends = [
        episode(EXACT, rests, 3.0, (-0.9, 0.0), hand=hand, opponent=opponent)[1].puck
        for hand in (Keeper, Striker)
    ]
    assert not ends[0].goal and ends[0].state.x == rests.x
    assert ends[1].goal == 1
    assert ends[1].state.y * side < 0


def test_a_hand_without_delay_acts_on_the_newest_frame():
    hand = Keeper(PLAY, Dexterity(reaction_s=0.0, noise_m=0.0, aim_rad=0.0, speed_m_s=4.0))
    for time, y in ((0.0, 0.1), (0.1, -0.1), (0.2, 0.05)):
        # It covers the goal on the side of a resting puck, at half its distance from the axis.
        assert hand.target(time, (-1.0, 0.0), PuckState(0.5, y), (0.9, 0.0))[1] == y / 2


def test_a_hand_that_has_seen_only_one_frame_acts_on_it():
    hand = Keeper(PLAY, EXACT)
    assert hand.target(0.0, (-1.0, 0.0), PuckState(0.5, 0.1), (0.9, 0.0))[1] == 0.05
    # The second frame counts when the reaction time has passed.
    assert hand.target(0.1, (-1.0, 0.0), PuckState(0.5, -0.1), (0.9, 0.0))[1] == 0.05
    assert hand.target(0.35, (-1.0, 0.0), PuckState(0.5, -0.1), (0.9, 0.0))[1] == -0.05


@pytest.mark.parametrize("side", [-1, 1])
def test_a_stroke_without_room_behind_starts_at_the_border_of_the_half(side):
    reach_x, reach_y = PLAY.table.reach(PLAY.mallet.radius_m)
    # Behind a puck near the own line, the start is moved onto the line, on the same side.
    line = wanted(PuckState(-0.93, side * 0.1), own=(-1.04, side * 0.25))
    assert line[0] == -reach_x
    assert 0.1 < side * line[1] < 0.13
    # Behind one near a rail it is at the rail.
    puck = PuckState(-0.2, side * 0.455)
    rail = wanted(puck, own=(-0.36, side * 0.44))
    assert rail[1] == side * reach_y
    assert rail[0] == pytest.approx(-0.37, abs=0.01)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_hand_passes_a_puck_at_a_rail_on_the_inner_side(side):
    # On the outer side there is no room between the puck and the rail.
    puck, own = PuckState(-0.6, side * 0.47), (-0.5, side * 0.5)
    found = wanted(puck, own)
    assert found[0] < own[0]
    assert side * found[1] < side * puck.y
    inner = puck.y - side * 2 * (PLAY.mallet.radius_m + PLAY.puck.radius_m)
    way = found - own
    assert (inner - own[1]) / way[1] == pytest.approx(-0.15 / way[0])


def test_it_clears_a_puck_off_a_rail():
    for y in (0.51, -0.51):
        _, world = episode(EXACT, PuckState(-0.6, y), 2.5)
        assert world.puck is not None
        assert world.puck.goal >= 0
        assert world.puck.goal or world.puck.state.x > 0 or abs(world.puck.state.y) < 0.4
