"""Where and when the craft can meet the puck; catching and freeing it."""

import math

import numpy as np
import pytest

from airpuck.control.reference import Rendezvous
from airpuck.craft.table import AirHockey
from airpuck.hockey.all_rounder import AllRounder
from airpuck.hockey.attack import Shoot
from airpuck.hockey.goalkeeper import Guard, Wait
from airpuck.hockey.interception import (
    Meeting,
    Outlook,
    around,
    effort,
    slack,
    stays_inside,
    way_is_free,
)
from airpuck.hockey.player import pitch_of
from airpuck.hockey.possession import Catch, Free, good_place
from airpuck.hockey.prediction import PuckBelief, PuckModel
from airpuck.hockey.shot import unit
from airpuck.hockey.tactic import View
from airpuck.model.model_file import read_model
from airpuck.physics.puck import Disc, strike
from airpuck.planning.minimal_time import read_minimal_times

MODEL, PLAY = read_model("paper:M3"), AirHockey()
PITCH, TIMES, PUCK = pitch_of(MODEL, PLAY), read_minimal_times(), PuckModel(PLAY)
SEEN = np.diag([3e-5, 3e-5, 1e-3, 3e-3, 3e-3, 0.1]) ** 2


def view_of(puck, craft=None, time=0.0, opponent=None):
    craft = np.array([*PITCH.home, 0, 0, 0, 0] if craft is None else craft, dtype=float)
    belief = PuckBelief(time, np.array(puck, dtype=float), SEEN)
    return View(time, craft, belief, PUCK, opponent, PITCH, TIMES)


def decided(strategy, view, periods=4):
    """Ask a strategy for some periods, in which nothing moves; return its last proposal."""
    for k in range(periods):
        view = View(
            view.time + 0.01 * (k > 0), view.craft, view.puck, PUCK, view.opponent, PITCH, TIMES
        )
        found = strategy.propose(view, Outlook(view))
    return found


def test_slack_is_what_the_shortest_times_leave():
    view = view_of((-0.3, 0, 0, 0, 0, 0), craft=(-0.8, 0, 0, 0, 0, 0))
    needed = float(TIMES((0.3, 0.0), (0.0, 0.0), "rest"))
    left = slack(view, np.array([1.0, 1.2]), np.array([[-0.5, 0.0]] * 2), np.zeros((2, 2)))
    assert left[1] - left[0] == pytest.approx(0.2)
    assert 1.0 - PITCH.delay - 1.3 * needed < left[0] < 1.0 - PITCH.delay - needed
    # To arrive with a velocity is to come to rest in a frame that moves with it.
    speed, way, time = 0.9, 0.25, 0.6
    craft = (-0.6, 0, 0, speed, 0, 0)
    moving = slack(
        view_of((0.3, 0, 0, 0, 0, 0), craft),
        np.array([time]),
        np.array([[-0.6 + speed * time + way, 0.0]]),
        np.array([[speed, 0.0]]),
    )
    needed = float(TIMES((way, 0.0), (0.0, 0.0), "rest"))
    assert moving[0] < time - PITCH.delay - needed
    assert moving[0] > time - PITCH.delay - 1.3 * needed


def test_effort_from_rest_to_rest_by_hand():
    # A cubic from rest to rest accelerates by 6 d / T² at its ends.
    view = view_of((-0.3, 0, 0, 0, 0, 0), craft=(-0.8, 0, 0, 0, 0, 0))
    found = effort(view, 0.5 + PITCH.delay, np.array([-0.5, 0.0]), np.zeros(2))
    assert found == pytest.approx(6 * 0.3 / 0.5**2 / PITCH.acceleration)


def test_a_contact_happens_at_its_time_with_its_normal():
    view = view_of((-0.4, 0.1, 0, 0.0, 0, 0))
    meeting = Meeting(0.8, 0.3, 1.0)
    reference = meeting.reference(view, view.puck.mean)
    assert isinstance(reference, Rendezvous)
    # Back from the rendezvous by its velocity: the discs touch when planned.
    place = reference.state[:2] - (reference.time - 0.8) * reference.state[3:5]
    np.testing.assert_allclose(view.puck.mean[:2] - place, PITCH.contact_distance * unit(0.3))
    np.testing.assert_allclose(reference.state[3:5], unit(0.3))


def test_no_contact_needs_the_other_half_or_a_rail():
    view = view_of((-0.1, 0.0, 0, 0, 0, 0))
    fast = np.array([[1.4, 0.0], [0.2, 0.0], [0.0, 1.4]])
    places = np.array([[-0.15, 0.0], [-0.15, 0.0], [-0.5, 0.4]])
    assert stays_inside(view, places, fast).tolist() == [False, True, False]


def test_a_craft_that_is_thrown_back_has_room_for_it():
    puck = Disc(0.0, 0.0, vx=-5.0, radius=0.03165, mass=0.010, inertia=5e-6)
    craft = Disc(0.0, 0.0, radius=0.07, mass=PITCH.craft_mass, inertia=PITCH.craft_inertia)
    strike(puck, craft, 1.0, 0.0, PLAY.puck.craft)
    recoil = np.array([craft.vx, 0.0])
    assert recoil[0] == pytest.approx(-5.0 * PITCH.recoil)
    # It goes on for 80 ms, and then brakes: v (t + v / 2a).
    room = -recoil[0] * (0.08 - recoil[0] / (2 * PITCH.acceleration))
    view = view_of((0, 0, 0, 0, 0, 0))
    for share, fits in ((0.98, False), (1.02, True)):
        place = np.array([PITCH.fence[0, 0] + share * room, 0.0])
        assert stays_inside(view, place, np.zeros(2), recoil) == fits
    # A shot at the goal is met with room behind, on the way forwards.
    view = view_of((0.6, 0.0, 0.0, -5.0, 0.0, 0.0))
    met = Guard().propose(view, Outlook(view)).reference
    assert isinstance(met, Rendezvous)
    assert met.state[0] >= PITCH.home[0] - 1e-9


def test_the_way_round_the_puck_does_not_touch_it():
    # The puck lies between the craft and its own goal.
    view = view_of((-0.8, 0.02, 0, 0, 0, 0), craft=(-0.5, 0, 0, 0, 0, 0))
    outlook, place = Outlook(view), np.array([-0.5, 0.0])
    goal = np.array([-0.98, 0.0])
    nearest = math.inf
    for _ in range(300):
        craft = np.array([*place, 0, 0, 0, 0])
        target = around(view_of(view.puck.mean, craft), outlook, goal)
        way = np.array([target.x, target.y]) - place
        place = place + way * min(1.0, 0.01 / max(np.hypot(*way), 1e-9))
        nearest = min(nearest, float(np.hypot(*(place - view.puck.mean[:2]))))
    assert nearest > PITCH.contact_distance
    np.testing.assert_allclose(place, goal, atol=0.02)
    through = Meeting(0.8, 0.0, 0.5)
    assert not way_is_free(view, outlook, through)


def test_a_resting_puck_before_an_open_goal_is_shot_at_once():
    for y in (-0.2, 0.0, 0.25):
        intention = decided(Shoot(), view_of((-0.45, y, 0, 0, 0, 0)))
        assert intention.kind in ("strike", "bank")
        assert intention.chance > 0.6
        if intention.kind == "strike":  # along a line into the goal
            way = intention.path[-1] - intention.path[0]
            end = intention.path[0, 1] + way[1] / way[0] * (PITCH.goal_line - intention.path[0, 0])
            assert abs(end) < PLAY.table.goal_width_m / 2
        # No shot at the own goal.
        assert intention.reference.state[3] > 0


def test_a_covered_goal_is_shot_at_over_a_bank_or_with_less_chance():
    puck = (-0.45, 0.0, 0, 0, 0, 0)
    free = decided(Shoot(), view_of(puck))
    keeper = np.array([0.95, 0.0, 0.0, 0.0])
    covered = decided(Shoot(least=0.0), view_of(puck, opponent=keeper))
    assert covered.chance < free.chance


def test_a_caught_puck_leaves_the_craft_slowly():
    view = view_of((0.2, 0.1, 0, -1.0, -0.1, 0))
    intention = decided(Catch(), view, 1)
    assert intention.kind == "prepare"
    time, x, y = intention.meet
    # By the law of single discs.
    velocity = intention.reference.state[3:5]
    outlook = Outlook(view)
    vx, vy = outlook.at(time)[3:5].tolist()
    place = intention.reference.state[:2] - (intention.reference.time - time) * velocity
    nx, ny = ((np.array([x, y]) - place) / np.hypot(x - place[0], y - place[1])).tolist()
    body = Disc(0, 0, vx, vy, 0.0, PLAY.puck.radius_m, PLAY.puck.mass_kg, PLAY.puck.inertia)
    craft = Disc(
        0, 0, *velocity.tolist(), 0.0, PITCH.craft_radius, PITCH.craft_mass, PITCH.craft_inertia
    )
    strike(body, craft, nx, ny, PLAY.puck.craft)
    assert math.hypot(body.vx, body.vy) < 0.15 * math.hypot(vx, vy)
    assert PITCH.inside(place)


def test_a_puck_in_a_corner_is_pushed_and_not_into_the_own_goal():
    view = view_of((-1.06, 0.5, 0, 0, 0, 0))
    assert good_place(view, np.array([[-1.06, 0.5], [-0.5, 0.0]])).tolist() == [0.0, 1.0]
    intention = decided(Free(), view, 6)
    assert intention.kind == "free"


def test_a_shot_at_the_own_goal_is_met_and_others_are_not():
    guard = Guard()
    shot = view_of((0.6, 0.1, 0, -3.0, -0.2, 0))
    intention = guard.propose(shot, Outlook(shot))
    assert intention.kind in ("defend", "prepare")
    time, x, y = intention.meet
    np.testing.assert_allclose(Outlook(shot).at(time)[:2], [x, y], atol=0.02)
    away = view_of((0.6, 0.1, 0, 2.0, -0.2, 0))
    assert guard.propose(away, Outlook(away)) is None
    assert Wait().propose(away, Outlook(away)).kind == "home"


def test_without_a_puck_it_defends_blind_and_then_goes_home():
    tactic = AllRounder()
    tactic.decide(view_of((0.6, 0.2, 0, -1.0, 0.0, 0)))

    def blind(time):
        return tactic.decide(View(time, view_of(np.zeros(6)).craft, None, PUCK, None, PITCH, TIMES))

    assert blind(0.2).kind == "defend"
    assert blind(0.2).reference.y == pytest.approx(0.2, abs=0.02)  # where it would have come
    assert blind(2.0).kind == "home"


@pytest.mark.parametrize("puck", [(-0.6, 0.45, 0, 0.1, 0, 0), (-0.7, 0.2, 0, 0, 0, 0)])
def test_one_search_a_decision_and_none_that_waits_for_ever(puck, monkeypatch):
    searched = []

    def counted(strategy, method):
        search = getattr(strategy, method)

        def count(self, *arguments):
            searched[-1].append(self)
            return search(self, *arguments)

        monkeypatch.setattr(strategy, method, count)

    counted(Shoot, "_search")
    counted(Shoot, "_closely")
    counted(Free, "_search")
    tactic, view = AllRounder(), view_of(puck, opponent=np.array([0.9, 0.0, 0.0, 0.0]))
    # Nothing is good enough for it, so that all others are asked.
    shoot, *_, free, clear, _ = tactic.strategies
    shoot.least = 1.1
    for k in range(20):
        searched.append([])
        view = View(0.01 * k, view.craft, view.puck, PUCK, view.opponent, PITCH, TIMES)
        tactic.decide(view)
    assert max(map(len, searched)) == 1
    who = [one[0] for one in searched if one]
    assert {shoot, clear} <= set(who) or free in who


def test_in_play_a_slow_puck_is_shot_and_a_fast_one_is_stopped():
    for speed, kinds in ((0.2, {"strike", "bank", "clear"}), (1.5, {"prepare"})):
        view = view_of((-0.3, 0.1, 0, -speed, 0, 0), opponent=np.array([0.9, 0.0, 0.0, 0.0]))
        tactic = AllRounder(AllRounder().strategies[2:])
        intention = decided(Asked(tactic), view, 12)
        assert intention.kind in kinds


class Asked:
    """A tactic as a strategy."""

    def __init__(self, tactic):
        self.tactic = tactic

    def propose(self, view, _):
        return self.tactic.decide(view)
