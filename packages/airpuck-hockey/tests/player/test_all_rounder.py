"""The package's own tactic: the order of strategies, and limits on their searches."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, SetPoint
from airpuck.planning.minimal_time import MinimalTimes
from airpuck_hockey import AllRounder, Intention
from airpuck_hockey.player.all_rounder import Strategy
from apparatus.situations import PITCH, PLAY, TIMES, decided, later, view_of


class Says:
    """A strategy that proposes a place, or nothing."""

    def __init__(self, x=None):
        self.x, self.asked = x, 0

    def propose(self, view, outlook):
        self.asked += 1
        return None if self.x is None else Intention("wait", SetPoint(self.x, 0.0, 0.0))


class Asked:
    """A tactic as a strategy."""

    def __init__(self, tactic):
        self.tactic = tactic

    def propose(self, view, _):
        return self.tactic.decide(view)


def test_the_first_strategy_with_a_proposal_is_followed():
    strategies = Says(), Says(-0.5), Says(-0.6)
    assert all(isinstance(one, Strategy) for one in strategies)
    found = AllRounder(strategies).decide(view_of((0.3, 0, 0, 0, 0, 0)))
    assert found.reference.x == -0.5
    assert [one.asked for one in strategies] == [1, 1, 0]


@pytest.mark.parametrize("strange", [3, "wait", [Says(), "wait"]])
def test_an_object_that_is_not_a_strategy_is_rejected(strange):
    with pytest.raises(InputError, match=r"strategies: must be .*Strategy"):
        AllRounder(strange)


def test_without_a_proposal_it_guards_its_goal():
    tactic = AllRounder([Says()])
    found = tactic.decide(view_of((0.6, 0.2, 0, -1.0, 0.0, 0)))
    assert found.kind == "defend"
    assert found.reference.y == pytest.approx(0.2, abs=0.02)


def test_without_a_puck_it_defends_blindly_and_then_goes_home():
    tactic = AllRounder()
    tactic.decide(view_of((0.6, 0.2, 0, -1.0, 0.0, 0)))

    def blind(time):
        return tactic.decide(replace(view_of(np.zeros(6)), time=time, puck=None))

    assert blind(0.2).kind == "defend"
    assert blind(0.2).reference.y == pytest.approx(0.2, abs=0.02)  # where it would have come
    assert blind(2.0).kind == "home"


class Counted(MinimalTimes):
    """Shortest times that record the size of each request."""

    def __call__(self, away, velocity, arrival="rest"):
        asked.append(np.asarray(away)[0].size)
        return super().__call__(away, velocity, arrival)


asked: list[int] = []


@pytest.mark.parametrize("puck", [(-0.6, 0.45, 0, 0.1, 0, 0), (-0.7, 0.2, 0, 0, 0, 0)])
def test_each_decision_has_one_search_and_every_strategy_gets_its_turn(puck):
    tactic = AllRounder()
    # No shot is good enough, so that all other strategies are asked.
    tactic.strategies[0].least = 1.1
    times = Counted(**vars(TIMES))
    view = replace(view_of(puck, opponent=np.array([0.9, 0.0, 0.0, 0.0])), times=times)
    kinds, searched = [], []
    for k in range(20):
        asked.clear()
        kinds.append(tactic.decide(replace(view, time=0.01 * k)).kind)
        searched.append(sum(size > 10 for size in asked))
    assert max(searched) == 1
    assert sum(searched) > 3
    assert {"free", "clear"} & set(kinds)


def test_a_slow_puck_in_play_is_shot_and_a_fast_one_stopped():
    for speed, kinds in ((0.2, {"strike", "bank", "clear"}), (1.5, {"prepare"})):
        view = view_of((-0.3, 0.1, 0, -speed, 0, 0), opponent=np.array([0.9, 0.0, 0.0, 0.0]))
        tactic = AllRounder(AllRounder().strategies[2:])
        intention = decided(Asked(tactic), view)
        assert intention.kind in kinds


def test_the_action_depends_on_where_the_puck_is():
    # On the other half: go home. Too fast to shoot: stop it. At rest in front of the craft: shoot.
    expected = {
        (0.7, 0.2, 0, 0.5, 0, 0): {"home"},
        (0.6, 0.1, 0, -7.0, -0.2, 0): {"defend", "prepare"},
        (-0.45, 0.1, 0, 0, 0, 0): {"strike", "bank"},
    }
    for puck, kinds in expected.items():
        assert decided(Asked(AllRounder()), view_of(puck), 8).kind in kinds


def test_repeated_decisions_keep_the_craft_in_its_half():
    tactic, view = AllRounder(), view_of((0.4, 0.3, 0, -1.2, 0.6, 0))
    for _ in range(60):
        intention = tactic.decide(view)
        state = intention.reference.at(view.time, 0.0).state
        assert PITCH.inside(state[:2]) or intention.meet is not None
        assert abs(state[1]) < PLAY.table.width_m / 2
        view = later(view, 0.01)
