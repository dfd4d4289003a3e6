"""Shooting: whether predicted goals score on the twin's table."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from airpuck_hockey.player import attack, interception
from airpuck_hockey.player.all_rounder import Turns
from airpuck_hockey.player.attack import Shoot
from airpuck_hockey.player.interception import Outlook, stays_inside
from airpuck_hockey.player.rival import Rival
from airpuck_hockey.player.shot import ArrivalError
from apparatus.situations import (
    PITCH,
    SEEN,
    after_contact,
    asked,
    contact,
    decided,
    mirrored,
    view_of,
)

RESTING = [(-0.45, y, 0, 0, 0, 0) for y in (-0.2, 0.0, 0.25)]
MOVING = [
    (-0.2, 0.1, 0, -0.3, -0.1, 0),
    (-0.3, -0.2, 0, -0.1, 0.2, 3.0),
    (0.1, 0.1, 0, -0.6, 0.0, 0),
    (-0.5, 0.3, 0, 0.1, -0.3, 0),
]


def distance_to_path(place, path):
    """Return how far a place is from a path of straight pieces."""
    start, along = path[:-1], np.diff(path, axis=0)
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(((place - start) * along).sum(axis=1) / square, 0, 1)
    return np.hypot(*(start + share[:, None] * along - place).T).min()


@pytest.mark.parametrize("puck", RESTING + MOVING)
def test_a_shot_with_a_good_chance_scores(puck):
    view = view_of(puck)
    intention = decided(Shoot(), view)
    assert intention.kind in ("strike", "bank")
    assert intention.chance > 0.45
    time, place, velocity, before = contact(view, intention)
    # The discs touch, in the own half, at one of the candidate speeds.
    np.testing.assert_allclose(intention.meet[1:], before[:2], atol=2e-3)
    assert np.hypot(*(place - before[:2])) == pytest.approx(PITCH.contact_distance, abs=2e-3)
    away = (before[:2] - place) / PITCH.contact_distance
    assert stays_inside(
        view, place, velocity, -PITCH.recoil * (away @ (velocity - before[3:5])) * away
    )
    assert np.abs(np.hypot(*velocity) - [0.6, 1.5, 2.3]).min() < 1e-9
    assert 0.05 < time - view.time < 1.75
    flown, _ = after_contact(view, intention)
    for t in np.arange(0.0, 1.0, 0.025):
        flown.run(time + t)
        assert distance_to_path(flown.state[:2], intention.path) < 0.03
    flown.run(time + 4.0)
    assert flown.goal == 1
    rails = [touch.met for touch in flown.touches].count("rail")
    assert (intention.kind == "bank") == (rails > 0)


@pytest.mark.parametrize("puck", RESTING + MOVING)
def test_mirrored_shots_have_the_same_chance(puck):
    view = view_of(puck, opponent=np.array([0.9, 0.1, 0.0, 0.0]))
    one, other = (decided(Shoot(least=0.0), seen) for seen in (view, mirrored(view)))
    assert one is not None
    assert other is not None
    assert one.chance == pytest.approx(other.chance, abs=0.1)


def test_only_a_defender_in_the_way_lowers_the_chance():
    puck = (-0.45, 0.0, 0, 0, 0, 0)
    free = decided(Shoot(), view_of(puck)).chance
    chances = [
        decided(Shoot(least=0.0), view_of(puck, opponent=np.array([0.85, y, 0.0, 0.0]))).chance
        for y in (0.0, 0.5)
    ]
    assert chances[0] < free - 0.05
    assert chances[1] <= free + 0.05


def test_a_less_accurate_craft_has_a_lower_chance():
    view = view_of((-0.6, 0.2, 0, 0, 0, 0))
    found = [
        decided(Shoot(least=0.0, error=ArrivalError(place, 20 * place)), view).chance
        for place in (0.001, 0.01, 0.03)
    ]
    assert found[0] > found[1] > found[2]


def test_an_impossible_shot_is_not_attempted():
    nothing = [
        view_of((0.6, 0.0, 0, 0, 0, 0)),  # on the other half
        view_of((-0.4, 0.0, 0, 3.0, 0, 0)),  # too fast to catch up with
        view_of((-1.05, 0.5, 0, 0, 0, 0)),  # no room behind it
    ]
    unknown = view_of((-0.45, 0.0, 0, 0, 0, 0))
    rough = SEEN + np.diag([0, 0, 0, 0.04, 0.04, 0.0]) ** 2
    nothing.append(replace(unknown, puck=replace(unknown.puck, covariance=rough)))
    for view in nothing:
        assert decided(Shoot(least=0.0), view, 8) is None
    assert decided(Shoot(least=0.999), view_of((-0.7, 0.3, 0, 0, 0, 0)), 8) is None
    assert decided(Shoot(least=0.0, clears=True), unknown).kind == "clear"


def test_a_shot_in_progress_is_kept_unless_it_was_interrupted():
    strategy, view = Shoot(), view_of((-0.45, 0.1, 0, 0, 0, 0))
    first = decided(strategy, view)
    for k in range(4, 8):
        now = replace(view, time=0.01 * k)
        assert strategy.propose(now, Outlook(now)).meet == first.meet
    # Others had their turn: it searches again, and its first result comes later.
    now = replace(view, time=0.3)
    assert strategy.propose(now, Outlook(now)) is None


def test_a_shot_is_abandoned_when_the_puck_leaves():
    strategy, view = Shoot(), view_of((-0.45, 0.1, 0, 0, 0, 0))
    assert decided(strategy, view) is not None
    gone = view_of((0.3, 0.1, 0, 1.0, 0, 0), time=0.04)
    assert strategy.propose(gone, Outlook(gone)) is None


def test_the_craft_goes_round_a_puck_in_its_way():
    # The craft is on the far side of the puck: from there it can only shoot at its own goal.
    view = view_of((-0.6, 0.0, 0, 0, 0, 0), craft=(-0.35, 0.02, 0, 0, 0, 0))
    intention = decided(Shoot(least=0.0), view, 6)
    assert intention is not None
    if intention.avoid is not None:
        np.testing.assert_allclose(intention.avoid[:2], (-0.6, 0.0))
        assert intention.avoid[2] > PITCH.contact_distance


def test_a_later_contact_is_chosen_if_the_sooner_one_is_too_unlikely(monkeypatch):
    # A puck that rolls along the table: where it is met says when.
    view = view_of((-0.6, -0.3, 0, 0.0, 0.35, 0))
    seen = []

    def chances(pitch, model, contacts, *_):
        y = contacts.place[:, 1]
        seen.append(y)
        # The sooner one is worth more, because waiting costs, but it is too unlikely.
        return np.where(y > y.min() + 0.01, 0.27, 0.24), np.zeros(len(y))

    monkeypatch.setattr(attack, "chances", chances)
    monkeypatch.setattr(interception, "path_is_clear", lambda *_: True)
    intention = decided(Shoot(least=0.25), view, 2)
    assert np.ptp(seen[0]) > 0.02
    assert intention.chance == 0.27
    assert intention.meet[2] > seen[0].min() + 0.01


def test_an_opponent_is_assumed_to_return_home_when_the_puck_is_gone(monkeypatch):
    seen = []
    known = attack.chances

    def chances(*given):
        seen.append(given)
        return known(*given)

    monkeypatch.setattr(attack, "chances", chances)
    # It stops before its goal, on the side of the puck.
    rival = Rival(reaction=0.2, speed=1.5, waits=0.25, follows=0.5)
    home = np.array([PITCH.goal_line - 0.25, 0.05])
    for here in ([-0.2, 0.5], [0.8, -0.3]):
        view = view_of((-0.45, 0.1, 0, 0, 0, 0), opponent=np.array([*here, 0.0, 0.0]))
        view = replace(view, rival=rival)
        intention = decided(Shoot(least=0.0), view, 2)
        places, radius, limits = seen[-1][-1]
        assert (radius, limits) == (PITCH.opponent_radius, rival)
        # Until then on a straight line at 1.5 m/s, from 0.2 s on, after speeding up at 40 m/s².
        length = np.hypot(*(home - here))
        gone = min(1.5 * (intention.meet[0] - 0.01 - 0.2 - 1.5 / 40 / 2), length)
        expected = here + gone * (home - here) / length
        assert np.linalg.norm(places.reshape(-1, 2) - expected, axis=1).min() < 1e-6


def test_a_late_shot_is_abandoned_until_just_before_the_contact():
    view = view_of((-0.45, 0.1, 0, 0, 0, 0))
    for left, given_up in ((0.3, True), (0.1, False)):
        strategy = Shoot()
        first = decided(strategy, view, 2)
        begin, end = view.time + PITCH.delay, first.reference.time
        target = first.reference.state
        way = CubicHermiteSpline(
            [begin, end],
            [view.craft[:2], target[:2]],
            [[0.0, 0.0], target[3:5]],
        )
        now = first.meet[0] - left
        assert now > 0.1
        # Nothing better turns up. Asking it all the time keeps the plan from expiring.
        strategy.least = 1.1
        for time in np.arange(0.03, now, 0.04):
            moved = max(float(time), begin)
            craft = np.array([*way(moved), 0.0, *way(moved, 1), 0.0])
            still = replace(view, time=float(time), craft=craft)
            assert strategy.propose(still, Outlook(still)).meet == first.meet
        thrown = np.array([-0.9, -0.4, 0.0, -0.5, -0.5, 0.0])
        late = replace(view, time=float(now), craft=thrown)
        assert (strategy.propose(late, Outlook(late)) is None) == given_up


def test_a_planned_shot_is_replaced_by_one_better_by_0_04(monkeypatch):
    view, strategy, turns = view_of((-0.2, 0.1, 0, 0, 0, 0)), Shoot(), Turns()
    known, found = attack.chances, []

    def best_is(best):
        def chances(*given):
            chance, bounces = known(*given)
            return chance * best / chance.max(), bounces

        return chances

    for k in range(12):
        # It searches every fourth decision, and evaluates what it has found in the next.
        monkeypatch.setattr(attack, "chances", best_is(0.5 if k < 4 else 0.52 if k < 8 else 0.6))
        found.append(asked(strategy, replace(view, time=0.01 * k), turns))
    assert found[0] is None
    assert [one.meet for one in found[2:11]] == [found[1].meet] * 9
    assert [one.chance for one in found[1:]] == pytest.approx([0.5] * 10 + [0.6], abs=0.02)


def test_if_shots_are_returned_quickly_the_craft_is_home_sooner():
    def home_after(returns):
        puck = (-0.35, 0.0, 0, 0, 0, 0)
        view = view_of(puck, (-0.6, 0, 0, 0, 0, 0), opponent=np.array([0.9, 0.0, 0.0, 0.0]))
        view = replace(view, rival=Rival(returns=returns))
        intention = decided(Shoot(least=0.0, clears=True), view)
        place = contact(view, intention)[1]
        flown, craft = after_contact(view, intention)
        crosses = 0.35 / flown.state.vx
        return float(view.times(PITCH.home - place, craft, "rest")) - crosses

    quick = home_after((0.6,) * 12)
    assert quick < home_after(())
