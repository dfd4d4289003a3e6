"""Planned contacts: how long they are kept, and which strategy searches next."""

from collections import Counter
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from airpuck_hockey.player.all_rounder import Turns
from airpuck_hockey.player.attack import Shoot
from airpuck_hockey.player.defence import Catch, Defend, Free
from airpuck_hockey.player.interception import Outlook, Searcher
from apparatus.situations import PITCH, asked, contact, decided, view_of

RESTS, COMES, STUCK = (
    (-0.45, 0.1, 0, 0, 0, 0),
    (0.2, 0.1, 0, -1.0, -0.1, 0),
    (-0.6, 0.51, 0, 0, 0, 0),
)
PLANS = [(Shoot, RESTS), (Catch, COMES), (Free, STUCK)]


def on_the_way(view, intention, left):
    """The same situation some time before a contact, with the craft on its way there."""
    time, place, velocity, _ = contact(view, intention)
    craft = np.array([*(place - left * velocity), 0.0, *velocity, 0.0])
    return replace(view, time=float(time - left), craft=craft)


@pytest.mark.parametrize(("strategy", "puck"), PLANS)
def test_plans_are_final_in_the_last_0_15_s_and_expire_after_0_03_s(strategy, puck):
    thrown = np.array([-0.95, -0.4, 0.0, -1.0, -1.0, 0.0])
    for left, lost, kept in (
        (0.2, False, True),  # it can be kept
        (0.2, True, False),  # it is too late
        (0.14, True, True),  # there is nothing better to do
        (-0.02, True, True),
        (-0.04, False, False),  # it did not happen
    ):
        made, view = strategy(), view_of(puck)
        found = decided(made, view, 12)
        assert found is not None
        # Ask it all the time, so that the plan does not expire; it never gets a turn to search.
        then = on_the_way(view, found, left)
        for time in np.arange(0.12, then.time, 0.01).tolist():
            now = on_the_way(view, found, found.meet[0] - time)
            made.propose(now, Outlook(now))
        now = replace(then, craft=thrown) if lost else then
        still = made.propose(now, Outlook(now))
        assert (still is not None) == kept
        if still is not None:
            assert still.meet[0] == pytest.approx(found.meet[0])


@pytest.mark.parametrize(("strategy", "puck"), PLANS)
def test_no_plan_survives_an_interruption(strategy, puck):
    made, view = strategy(), view_of(puck)
    found = decided(made, view, 12)
    for time, kept in ((0.15, True), (0.21, False)):
        now = on_the_way(view, found, found.meet[0] - time)
        assert (made.propose(now, Outlook(now)) is not None) == kept


class Waits(Searcher):
    """A searcher that always wants to search, and never finds anything."""

    def __init__(self, every):
        super().__init__()
        self.every = every

    def applies(self, view, outlook):
        return True

    def wants_search(self, view, outlook):
        return True

    def search(self, view, outlook):
        pass


def test_search_turns_do_not_depend_on_the_order_of_strategies():
    view = view_of(RESTS)
    outlook = Outlook(view)
    orders = []
    for searchers in permutations([Waits(every) for every in (1, 2, 3, 5)]):
        turns = Turns()
        orders.append([turns.give(view, outlook, searchers).every for _ in range(100)])
    assert all(order == orders[0] for order in orders)
    # None waits forever, and shorter intervals get more turns.
    count = Counter(orders[0])
    assert count[1] >= count[2] >= count[3] > count[5] > 10


def test_a_searcher_waits_for_its_next_turn():
    view = view_of(RESTS)
    turns, one = Turns(), Waits(3)
    given = [turns.give(view, Outlook(view), [one]) is one for _ in range(7)]
    assert given == [True, False, False, True, False, False, True]
    assert turns.give(view, Outlook(view), []) is None


def test_a_strategy_with_a_plan_searches_only_for_a_better_one():
    view = view_of(COMES)
    catch, turns = Catch(), Turns()
    assert asked(catch, view, turns) is not None
    assert not catch.wants_search(view, Outlook(view))
    rests = view_of(RESTS)
    shoot = Shoot()
    found = decided(shoot, rests)
    assert shoot.wants_search(rests, Outlook(rests))
    near = on_the_way(rests, found, 0.1)
    assert not shoot.wants_search(near, Outlook(near))


def test_only_a_threat_makes_the_keeper_search():
    for puck, wants in (((0.6, 0.1, 0, -3.0, -0.2, 0), True), ((0.6, 0.1, 0, 2.0, 0, 0), False)):
        view = view_of(puck)
        assert Defend().wants_search(view, Outlook(view)) == wants
    assert PITCH.inside(np.array(PITCH.home))
