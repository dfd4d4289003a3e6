"""Keeping the goal, against geometry, momentum and the puck of the twin."""

import math
from dataclasses import replace

import numpy as np
import pytest

from airpuck import PuckState, Rendezvous, SetPoint
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck_hockey import AllRounder
from airpuck_hockey.player.defence import Blind, Defend, Wait, block
from airpuck_hockey.player.interception import Outlook, slack
from apparatus.situations import (
    PITCH,
    PLAY,
    after_contact,
    assert_mirrored,
    contact,
    decided,
    mirrored,
    view_of,
)

HALF = PLAY.table.goal_width_m / 2


def shots(count, speeds=(0.8, 4.0), seed=0):
    """Situations in which the puck is about to enter the own goal."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        x, y, angle = rng.uniform([0.0, -0.4, -0.5], [0.8, 0.4, 0.5])
        speed = rng.uniform(*speeds)
        state = PuckState(x, y, 0.0, -speed * math.cos(angle), speed * math.sin(angle), 0.0)
        puck = PuckOnTable(PLAY, state)
        puck.run(1.9)
        # Shots that touch a post are ignored.
        if puck.goal < 0 and all(touch.met != "post" for touch in puck.touches):
            craft = [*(np.array(PITCH.home) + rng.uniform(-0.05, 0.15, 2)), 0, 0, 0, 0]
            found.append(view_of(state, craft))
    return found


@pytest.mark.parametrize(("aside", "brakes"), [(0.0, True), (0.04, True), (0.2, False)])
def test_a_returning_craft_brakes_if_a_shot_will_hit_it_squarely_anyway(aside, brakes):
    craft = np.array([-0.45, 0.0, 0.0, -1.3, 0.0, 0.0])
    for sign in (-1, 1):
        puck = PuckState(0.35, sign * aside, 0.0, -7.5, -sign * aside)
        view = view_of(puck, craft)
        intention = Defend().propose(view, Outlook(view))
        assert intention.kind == "defend"
        assert isinstance(intention.reference, SetPoint) == brakes
        if brakes:
            # Where full thrust stops it, once a command acts.
            stop = -0.45 - 1.3 * PITCH.delay - 1.3**2 / (2 * PITCH.acceleration)
            assert intention.reference.x == pytest.approx(stop)
            # The discs touch before that, while it slows down.
            assert stop + PITCH.contact_distance - 0.1 < intention.meet[1] < 0.0


def test_a_block_stands_in_the_path_of_the_puck_and_moves_against_it():
    for view in shots(20):
        intention = block(view, Outlook(view))
        assert intention.kind == "defend"
        assert isinstance(intention.reference, Rendezvous)
        time, _, velocity, puck = contact(view, intention)
        # The puck is at the planned contact, in front of the goal.
        np.testing.assert_allclose(intention.meet[1:], puck[:2], atol=2e-3)
        assert puck.x > -PITCH.goal_line
        motion = np.array([puck.vx, puck.vy])
        stands = intention.reference.state[:2]
        assert PITCH.inside(stands)
        # The recoil, unnoticed for 80 ms, does not throw it against the rail.
        back = PITCH.recoil * max(-motion[0], 0.0)
        most = min(back * 0.08 + back**2 / (2 * PITCH.acceleration), PITCH.home[0] + 1.02)
        assert stands[0] - most >= PITCH.fence[0, 0] - 1e-9
        # The craft is in its path: beyond it, and aside by at most the sum of the radii.
        ahead = stands - np.array(puck[:2])
        assert ahead @ motion > 0
        aside = abs(ahead[0] * motion[1] - ahead[1] * motion[0]) / np.hypot(*motion)
        assert aside < PITCH.contact_distance
        assert velocity @ motion < 0
        np.testing.assert_allclose(velocity[0] * motion[1], velocity[1] * motion[0], atol=1e-9)
        # It does not turn.
        assert intention.reference.state[2] == view.craft[2]
        assert intention.reference.state[5] == 0.0
        # And then it stays there.
        after = intention.reference.then
        np.testing.assert_allclose([after.x, after.y], stands)
        assert time < Outlook(view).threat


def test_a_block_returns_as_fast_as_it_came():
    # Forwards by half of the recoil R v: then v R / 2 becomes - v R / 2 (1 + R).
    for view in shots(10, seed=1):
        intention = block(view, Outlook(view))
        _, _, velocity, _ = contact(view, intention)
        _, craft = after_contact(view, intention)
        np.testing.assert_allclose(craft, -velocity, atol=0.15 * np.hypot(*velocity) + 0.02)


def test_a_block_takes_the_nearest_place_that_it_reaches_in_time():
    for view in shots(20, speeds=(0.5, 1.2), seed=2):
        outlook = Outlook(view)
        intention = block(view, outlook)
        stands = intention.reference.state[:2]
        # Every place on the path at which the craft can touch the puck, and its distance.
        times = np.arange(view.time + 0.02, outlook.threat, 0.02)
        pucks = outlook.at(times)
        ways = pucks[:, 3:5] / np.hypot(pucks[:, 3], pucks[:, 4])[:, None]
        places = pucks[:, :2] + PITCH.contact_distance * ways
        fits = PITCH.inside(places) & (places[:, 0] >= PITCH.home[0])
        fits &= slack(view, times, places, np.zeros_like(places)) > 0.1
        if not fits.any():
            continue
        nearest = np.linalg.norm(places[fits] - view.craft[:2], axis=1).min()
        assert np.linalg.norm(stands - view.craft[:2]) < nearest + 0.03


def test_a_shot_that_leaves_no_time_is_still_intercepted():
    view = view_of((-0.3, 0.1, 0, -5.0, -0.5, 0), craft=(-0.95, -0.2, 0, 0, 0, 0))
    intention = block(view, Outlook(view))
    assert intention.reference.state[1] > -0.1  # towards where it comes
    assert -PITCH.goal_line < intention.meet[1] < -0.3


@pytest.mark.parametrize("strategy", [Defend, Wait, AllRounder])
def test_a_mirrored_table_has_a_mirrored_keeper(strategy):
    for view in shots(12, seed=3):
        one, other = (
            made.decide(seen) if isinstance(made := strategy(), AllRounder) else decided(made, seen)
            for seen in (view, mirrored(view))
        )
        assert_mirrored(one, other)


def test_slow_pucks_are_caught_and_fast_ones_blocked():
    slow = view_of((0.3, 0.05, 0, -1.0, 0.0, 0))
    assert decided(Defend(), slow, 1).kind == "prepare"
    fast = view_of((0.3, 0.05, 0, -5.0, 0.0, 0))
    assert decided(Defend(), fast, 1).kind == "defend"
    # The more time to spare it needs, the more often it only blocks.
    kinds = [decided(Defend(reserve), slow, 1).kind for reserve in (0.05, 0.3, 3.0)]
    assert kinds == sorted(kinds, reverse=True)
    assert kinds[-1] == "defend"


def waiting(puck):
    view = view_of(puck)
    return Wait().propose(view, Outlook(view))


def test_a_waiting_player_stands_between_puck_and_goal():
    for x, y in ((0.6, 0.3), (0.2, -0.4), (-0.3, 0.2), (1.0, 0.05)):
        intention = waiting((x, y, 0, 0.8, 0, 0))
        stands = np.array([intention.reference.x, intention.reference.y])
        assert stands[0] == pytest.approx(PITCH.home[0])
        # On the line from the puck to the middle of the goal.
        line = np.array([x + PITCH.goal_line, y])
        away = stands - [-PITCH.goal_line, 0.0]
        assert line[0] * away[1] == pytest.approx(line[1] * away[0])
        assert intention.kind == ("home" if x >= 0 else "wait")
    # A puck behind the player leaves nothing to stand between.
    assert waiting((-1.05, 0.35, 0, 0.8, 0, 0)).reference == SetPoint(*PITCH.home, 0.0)


def test_a_waiting_player_stays_clear_of_a_resting_puck():
    for x, y in ((PITCH.home[0] + 0.04, 0.03), (PITCH.home[0] + 0.09, 0.0), (-0.6, 0.2)):
        intention = waiting((x, y, 0, 0, 0, 0))
        stands = np.array([intention.reference.x, intention.reference.y])
        apart = np.linalg.norm(stands - [x, y])
        assert apart > PITCH.contact_distance
        # Near to home it only steps aside.
        assert apart < PITCH.contact_distance + 0.06 or x == -0.6
        np.testing.assert_allclose(intention.avoid[:2], [x, y])
        assert PITCH.contact_distance < intention.avoid[2] < PITCH.contact_distance + 0.05
    # It need not avoid a fast puck, or one in the other half.
    for puck in ((-0.5, 0.2, 0, 0.6, 0, 0), (0.2, 0.2, 0, 0.1, 0, 0)):
        assert waiting(puck).avoid is None


def test_without_a_puck_it_defends_where_the_puck_was_heading():
    for y, vy in ((0.2, 0.0), (-0.3, 0.15), (0.1, -0.3)):
        blind = Blind()
        view = view_of((0.3, y, 0, -1.5, vy, 0))
        blind.seen(view, Outlook(view))
        # Where the twin's puck crosses the line through home; within the width of the goal.
        puck = PuckOnTable(PLAY, PuckState(*view.puck.mean.tolist()))
        while puck.state.x > PITCH.home[0]:
            puck.run(puck.time + 1e-3)
        found = blind.propose(replace(view, time=0.5, puck=None))
        assert found.kind == "defend"
        assert found.reference.x == PITCH.home[0]
        assert found.reference.y == pytest.approx(np.clip(puck.state.y, -HALF, HALF), abs=0.02)
        assert blind.propose(replace(view, time=0.99, puck=None)).kind == "defend"
        home = blind.propose(replace(view, time=1.01, puck=None))
        assert (home.kind, home.reference) == ("home", SetPoint(*PITCH.home, 0.0))


def test_without_a_puck_it_waits_in_the_middle_of_its_goal():
    for y, vy, line in ((0.5, 0.0, HALF), (-0.5, 0.0, -HALF)):
        blind = Blind()
        view = view_of((-0.6, y, 0, -1.5, vy, 0))
        blind.seen(view, Outlook(view))
        assert blind.propose(replace(view, puck=None)).reference.y == pytest.approx(line)
    blind = Blind()
    view = view_of((0.6, 0.3, 0, 0.1, 0.0, 0))
    blind.seen(view, Outlook(view))
    assert blind.propose(replace(view, puck=None)).reference.y == 0.0
    # Without ever seeing a puck, the craft waits at home.
    assert Blind().propose(replace(view, puck=None)).kind == "home"


def test_only_shots_at_the_own_goal_are_intercepted():
    guard = Defend()
    shot = view_of((0.6, 0.1, 0, -3.0, -0.2, 0))
    intention = guard.propose(shot, Outlook(shot))
    assert intention.kind in ("defend", "prepare")
    time, x, y = intention.meet
    np.testing.assert_allclose(Outlook(shot).at(time)[:2], [x, y], atol=0.02)
    away = view_of((0.6, 0.1, 0, 2.0, -0.2, 0))
    assert guard.propose(away, Outlook(away)) is None
    assert Wait().propose(away, Outlook(away)).kind == "home"
