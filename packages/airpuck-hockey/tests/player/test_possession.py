"""Slowing the puck down and freeing it: the effect on the puck, by the twin's physics."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from airpuck_hockey.player.all_rounder import Turns
from airpuck_hockey.player.defence import Catch, Free, good_place
from airpuck_hockey.player.interception import Outlook, slack
from airpuck_hockey.player.shot import unit
from apparatus.situations import (
    PITCH,
    PLAY,
    after_contact,
    asked,
    assert_mirrored,
    contact,
    decided,
    later,
    mirrored,
    view_of,
)

INCOMING = [
    (0.2, 0.1, 0, -1.0, -0.1, 0),
    (0.5, -0.3, 0, -1.4, 0.5, 5.0),
    (0.0, 0.3, 0, -0.6, -0.6, 0),
    (-0.2, 0.0, 0, -0.5, 0.1, -8.0),
    (0.6, 0.0, 0, -2.0, 0.9, 0),
]
STUCK = [(-1.06, 0.5), (-0.6, 0.51), (-0.9, -0.5), (-1.05, -0.25), (-0.3, 0.5)]


@pytest.mark.parametrize("puck", INCOMING)
def test_a_caught_puck_barely_moves(puck):
    view = view_of(puck)
    intention = decided(Catch(), view, 1)
    assert intention.kind == "prepare"
    time, place, velocity, before = contact(view, intention)
    np.testing.assert_allclose(intention.meet[1:], before[:2], atol=2e-3)
    assert math.dist(place, before[:2]) == pytest.approx(PITCH.contact_distance, abs=2e-3)
    assert PITCH.inside(place)
    # The craft recedes from a puck that comes nearer.
    normal = (np.array(before[:2]) - place) / PITCH.contact_distance
    assert velocity @ normal < 0 < (velocity - [before.vx, before.vy]) @ normal
    after, _ = after_contact(view, intention)
    left = np.array([after.state.vx, after.state.vy])
    # Along the normal it leaves with 5 cm/s.
    assert (left - 0.0) @ normal == pytest.approx(0.05, abs=0.02)
    assert np.hypot(*left) < 0.25 * math.hypot(before.vx, before.vy)
    assert slack(view, np.array([time]), place[None], velocity[None])[0] > 0


@pytest.mark.parametrize("puck", INCOMING)
def test_a_catch_is_kept_while_the_puck_moves_as_predicted(puck):
    strategy, view = Catch(), view_of(puck)
    first = decided(strategy, view, 1)
    for _ in range(10):
        # The craft is moving there.
        place = 0.97 * view.craft[:2] + 0.03 * first.reference.state[:2]
        view = later(view, 0.01, craft=[*place, 0, 0, 0, 0])
        found = decided(strategy, view, 1)
        assert found.meet == pytest.approx(first.meet, abs=5e-3)
        np.testing.assert_allclose(
            found.reference.state[3:5], first.reference.state[3:5], atol=0.02
        )


def test_a_catch_is_abandoned_if_the_puck_is_deflected_stopped_or_lost():
    view = view_of((0.2, 0.1, 0, -1.0, -0.1, 0))
    for puck in ((0.19, 0.1, 0, 0.9, 0.4, 0), (0.19, 0.1, 0, -0.01, 0, 0), (0.19, 0.1, 0, 0, 0, 0)):
        strategy = Catch()
        assert decided(strategy, view, 1) is not None
        changed = view_of(puck, time=0.01)
        assert strategy.propose(changed, Outlook(changed)) is None


def test_only_a_moving_puck_in_the_own_half_is_caught():
    assert decided(Catch(), view_of((-0.5, 0.1, 0, -0.03, 0, 0))) is None
    assert decided(Catch(slowest=0.5), view_of((-0.3, 0.1, 0, -0.4, 0, 0))) is None
    assert decided(Catch(slowest=0.3), view_of((-0.3, 0.1, 0, -0.4, 0, 0))) is not None
    assert decided(Catch(), view_of((0.3, 0.1, 0, 1.0, 0, 0))) is None
    # If it requires ever more time to spare, there is no catch.
    found = [decided(Catch(reserve), view_of(INCOMING[0]), 1) for reserve in (0.0, 0.2, 3.0)]
    assert found[0] is not None
    assert found[-1] is None


@pytest.mark.parametrize("puck", INCOMING)
def test_a_mirrored_puck_is_caught_by_a_mirrored_craft(puck):
    view = view_of(puck, craft=(-0.8, 0.1, 0, 0.1, -0.1, 0))
    assert_mirrored(decided(Catch(), view, 1), decided(Catch(), mirrored(view), 1), 1e-6)


def test_a_good_place_has_room_for_the_craft_on_all_sides():
    def good(x, y):
        return float(good_place(view_of((0, 0, 0, 0, 0, 0)), np.array([[x, y]]))[0])

    radius, craft = PLAY.puck.radius_m, 2 * PITCH.craft_radius
    side = PLAY.table.width_m / 2 - radius - craft
    back = -PITCH.goal_line + radius + craft
    front = -2 * PITCH.contact_distance
    assert good(-0.5, 0.0) == 1.0
    # 0 where the craft does not fit behind it, 1 from 12 cm further on, one half in between.
    for off, expected in ((-0.01, 0.0), (0.06, 0.5), (0.13, 1.0)):
        assert good(-0.5, side - off) == pytest.approx(expected)
        assert good(-0.5, -side + off) == pytest.approx(expected)
        assert good(back + off, 0.0) == pytest.approx(expected)
        assert good(front - off, 0.0) == pytest.approx(expected)
    assert good(0.5, 0.0) == 0.0
    assert good(back + 0.06, side - 0.06) == pytest.approx(0.25)


@pytest.mark.parametrize("place", STUCK)
def test_a_stuck_puck_is_pushed_to_a_better_place_not_into_the_own_goal(place):
    view = view_of((*place, 0, 0, 0, 0), craft=(-0.7, 0.0, 0, 0, 0, 0))
    assert good_place(view, np.array([place]))[0] < 0.25
    found = None
    strategy, turns = Free(), Turns()
    for k in range(40):
        now = view_of(view.puck.mean, view.craft, 0.01 * k)
        intention = asked(strategy, now, turns)
        assert intention is None or intention.kind == "free"
        if intention is not None and intention.avoid is None:
            found = now, intention
            break
        # The path to the start of the push avoids the puck.
        if intention is not None:
            np.testing.assert_allclose(intention.avoid[:2], place)
            goal = np.array([intention.reference.x, intention.reference.y])
            way = goal - view.craft[:2]
            view = view_of(view.puck.mean, [*(view.craft[:2] + 0.2 * way), 0, 0, 0, 0])
    assert found is not None
    _, at, velocity, _ = contact(*found)
    assert PITCH.inside(at)
    assert np.hypot(*velocity) == pytest.approx(0.3)
    after, _ = after_contact(*found)
    places = []
    for _ in range(12):
        after.run(after.time + 0.15)
        places.append(after.state[:2])
    assert after.goal == 0
    assert good_place(view, np.array(places)).max() > good_place(view, np.array([place]))[0] + 0.1


def test_only_a_slow_badly_placed_puck_within_reach_is_freed():
    assert decided(Free(), view_of((-0.5, 0.0, 0, 0, 0, 0)), 6) is None  # a good place
    assert decided(Free(), view_of((-0.6, 0.51, 0, 0.6, 0, 0)), 6) is None  # fast
    assert decided(Free(), view_of((0.6, 0.51, 0, 0, 0, 0)), 6) is None  # not ours
    assert decided(Free(), view_of((-0.6, 0.51, 0, 0, 0, 0)), 6) is not None


def test_a_push_waits_until_its_path_is_clear():
    kinds = []
    for place in STUCK:
        for angle in np.arange(0.0, 6.0, 0.5):
            x, y = np.array(place) + 0.13 * unit(angle)
            view = view_of((*place, 0, 0, 0, 0), craft=(x, y, 0, 0, 0, 0))
            if not PITCH.inside(view.craft[:2]):
                continue
            intention = decided(Free(), view, 1)
            if intention is None:
                continue
            if intention.avoid is not None:
                kinds.append("round")
                continue
            time, at, velocity, _ = contact(view, intention)
            way = CubicHermiteSpline([0.0, time], [(x, y), at], [(0.0, 0.0), velocity])
            apart = np.linalg.norm(way(np.linspace(0.1, 0.8, 50) * time) - place, axis=1)
            assert apart.min() > PITCH.contact_distance - 0.01
            kinds.append("straight")
    assert {"round", "straight"} == set(kinds)


def test_no_push_aims_at_or_narrowly_past_the_own_goal():
    pushed = 0
    for aside in (-0.15, 0.0, 0.12):
        for craft in ((-0.85, 0.3), (-0.9, 0.0), (-0.95, 0.25)):
            view = view_of((-1.0, aside, 0, 0, 0.06, 0), craft=(*craft, 0, 0, 0, 0))
            intention = decided(Free(), view, 6)
            if intention is None or intention.avoid is not None:
                continue
            _, place, _, puck = contact(view, intention)
            assert place[0] - puck[0] < 0.4 * PITCH.contact_distance
            pushed += 1
    assert pushed > 0
