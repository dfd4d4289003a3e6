"""Contacts with the puck: against hand calculations, dense grids and the twin's puck."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from airpuck.control.reference import Rendezvous, SetPoint
from airpuck.physics.puck import Disc, PuckState, strike
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck_hockey.player.defence import Defend
from airpuck_hockey.player.interception import (
    Outlook,
    PlannedContact,
    around,
    effort,
    path_is_clear,
    slack,
    stays_inside,
)
from airpuck_hockey.player.shot import unit
from apparatus.situations import PITCH, PLAY, SEEN, TIMES, view_of


def test_slack_is_the_time_beyond_the_shortest_flight():
    view = view_of((-0.3, 0, 0, 0, 0, 0), craft=(-0.8, 0, 0, 0, 0, 0))
    needed = float(TIMES((0.3, 0.0), (0.0, 0.0), "rest"))
    left = slack(view, np.array([1.0, 1.2]), np.array([[-0.5, 0.0]] * 2), np.zeros((2, 2)))
    assert left[1] - left[0] == pytest.approx(0.2)
    assert left[0] == pytest.approx(1.0 - PITCH.delay - 1.1 * needed - 0.03)
    # Arriving with a velocity means coming to rest in a frame that moves with it.
    speed, way, time = 0.9, 0.25, 0.6
    craft = (-0.6, 0, 0, speed, 0, 0)
    moving = slack(
        view_of((0.3, 0, 0, 0, 0, 0), craft),
        np.array([time]),
        np.array([[-0.6 + speed * time + way, 0.0]]),
        np.array([[speed, 0.0]]),
    )
    needed = float(TIMES((way, 0.0), (0.0, 0.0), "rest"))
    assert moving[0] == pytest.approx(time - PITCH.delay - 1.1 * needed - 0.03, abs=2e-3)


def test_slack_is_smaller_where_the_shortest_times_are_uncertain():
    view = view_of((-0.3, 0, 0, 0, 0, 0), craft=(-0.8, 0, 0, 0, 0, 0))
    unsure = replace(view, times=replace(TIMES, error={"p95": 0.136}))
    there = np.array([1.0]), np.array([[-0.5, 0.0]]), np.zeros((1, 2))
    assert slack(view, *there) - slack(unsure, *there) == pytest.approx(0.1, abs=1e-3)


def test_effort_is_the_largest_acceleration_of_a_cubic():
    rng = np.random.default_rng(0)
    for _ in range(20):
        craft = np.array([*rng.uniform(-0.9, -0.3, 2), 0, *rng.normal(0, 0.4, 2), 0])
        place, velocity, time = rng.uniform(-0.8, -0.2, 2), rng.normal(0, 0.6, 2), 0.7
        # The propellers act later; until then the craft continues.
        begin = craft[:2] + PITCH.delay * craft[3:5]
        spline = CubicHermiteSpline(
            [PITCH.delay, time], [begin, place], [craft[3:5], velocity]
        ).derivative(2)
        most = max(np.hypot(*spline(t)) for t in np.linspace(PITCH.delay, time, 50))
        found = effort(view_of((0, 0, 0, 0, 0, 0), craft, time=0.0), time, place, velocity)
        assert found == pytest.approx(most / PITCH.acceleration)


def test_a_contact_happens_at_its_time_with_its_normal():
    view = view_of((-0.4, 0.1, 0, 0.0, 0, 0))
    meeting = PlannedContact(0.8, 0.3, 1.0)
    reference = meeting.reference(view, view.puck.mean)
    assert isinstance(reference, Rendezvous)
    # Extrapolated back from the rendezvous, the discs touch when planned.
    place = reference.state[:2] - (reference.time - 0.8) * reference.state[3:5]
    np.testing.assert_allclose(view.puck.mean[:2] - place, PITCH.contact_distance * unit(0.3))
    np.testing.assert_allclose(reference.state[3:5], unit(0.3))


def test_no_contact_reaches_the_other_half_or_a_rail():
    view = view_of((-0.1, 0.0, 0, 0, 0, 0))
    fast = np.array([[1.4, 0.0], [0.2, 0.0], [0.0, 1.4]])
    places = np.array([[-0.15, 0.0], [-0.15, 0.0], [-0.5, 0.4]])
    assert stays_inside(view, places, fast).tolist() == [False, True, False]


def test_a_craft_has_room_to_recoil():
    puck = Disc(0.0, 0.0, vx=-5.0, radius=0.03165, mass=0.010, inertia=5e-6)
    craft = Disc(0.0, 0.0, radius=0.07, mass=PITCH.craft_mass, inertia=PITCH.craft_inertia)
    strike(puck, craft, 1.0, 0.0, PLAY.puck.craft)
    recoil = np.array([craft.vx, 0.0])
    assert recoil[0] == pytest.approx(-5.0 * PITCH.recoil)
    # It continues for 80 ms, and then brakes: v (t + v / 2a).
    room = -recoil[0] * (0.08 - recoil[0] / (2 * PITCH.acceleration))
    view = view_of((0, 0, 0, 0, 0, 0))
    for share, fits in ((0.98, False), (1.02, True)):
        place = np.array([PITCH.fence[0, 0] + share * room, 0.0])
        assert stays_inside(view, place, np.zeros(2), recoil) == fits
    # A shot at the goal is met while moving forwards, with room behind.
    view = view_of((0.6, 0.0, 0.0, -5.0, 0.0, 0.0))
    met = Defend().propose(view, Outlook(view)).reference
    assert isinstance(met, Rendezvous)
    assert met.state[0] >= PITCH.home[0] - 1e-9


def test_the_path_round_the_puck_does_not_touch_it():
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
    through = PlannedContact(0.8, 0.0, 0.5)
    assert not path_is_clear(view, outlook, through)


def test_the_outlook_matches_the_path_of_the_twins_puck():
    for puck in ((0.2, 0.3, 0.1, 2.0, 1.5, 4.0), (0.5, 0.1, 0, -3.0, 0.5, 0), (0, 0, 0, 0, 0, 0)):
        view = view_of(puck, time=3.0)
        outlook, alone = Outlook(view), PuckOnTable(PLAY, PuckState(*puck), 3.0)
        assert outlook.speed == pytest.approx(math.hypot(*puck[3:5]))
        for time in (3.0, 3.1, 3.26, 3.5, 4.0, 4.98):
            alone.run(time)
            np.testing.assert_allclose(outlook.at(time)[:2], alone.state[:2], atol=0.02)
            np.testing.assert_allclose(outlook.places[round((time - 3) / 0.02)], alone.state[:2])
        comes = (outlook.places[:, 0] < PITCH.fence[1, 0] + 0.1).any()
        assert outlook.is_reachable == comes
        assert (outlook.threat is not None) == (alone.goal < 0)
    # Between two steps the path is straight; beyond the ends it continues.
    view = view_of((0.0, 0.1, 0, 1.0, 0.0, 0))
    outlook = Outlook(view)
    first, second = outlook.at(np.array([0.02, 0.04]))
    np.testing.assert_allclose(outlook.at(0.025), 0.75 * first + 0.25 * second)


def test_the_threat_is_the_arrival_of_the_puck_at_the_own_goal():
    for y, vy in ((0.0, 0.0), (0.3, -0.45), (-0.35, 0.6), (0.4, 1.0)):
        outlook = Outlook(view_of((0.3, y, 0, -2.0, vy, 0)))
        puck = PuckOnTable(PLAY, PuckState(0.3, y, 0.0, -2.0, vy))
        while (
            puck.time < 2 and puck.state.x > -PITCH.goal_line + PLAY.puck.radius_m and not puck.goal
        ):
            puck.run(puck.time + 1e-3)
        if puck.goal or abs(puck.state.y) < 0.15:
            assert outlook.threat == pytest.approx(puck.time, abs=0.04)
        elif abs(puck.state.y) > 0.25:
            assert outlook.threat is None
    # Not towards the other goal, not beside the own one, and not at rest in front of it.
    for puck in ((0.3, 0, 0, 2.0, 0, 0), (0.3, 0.4, 0, -2.0, 0, 0), (-0.9, 0, 0, 0, 0, 0)):
        assert Outlook(view_of(puck)).threat is None


def test_a_path_is_valid_until_the_opponent_can_touch_the_puck():
    end = Outlook(view_of((0.0, 0, 0, 0, 0, 0))).times[-1]
    beside, away, still = (0.5, 0.2, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.4, 0.0, 0, 0, 0, 0)
    for puck, opponent, until in (
        ((-0.5, 0, 0, 1.0, 0, 0), away, 0.53),  # crosses the centre line
        ((0.3, 0, 0, 1.0, 0, 0), away, 0.0),
        ((0.3, 0, 0, -3.0, 0, 0), away, 0.47),  # faster than the opponent, and then at the goal
        (still, beside, 0.29),  # 0.2 s, 30 ms to speed up, and 14 cm at 2.5 m/s
        ((0.3, 0, 0, 1.0, 0, 0), None, end),
        ((-0.5, 0, 0, 0, 0, 0), beside, end),
    ):
        opponent = opponent and np.array(opponent)
        assert Outlook(view_of(puck, opponent=opponent)).until == pytest.approx(until, abs=0.03)


def test_a_puck_that_will_hit_a_post_is_a_threat():
    # Within one step of the path it comes, touches the post, and is 4 cm away again.
    for shift in np.linspace(0.0, 0.1, 11):
        outlook = Outlook(view_of((-0.3 + shift, 0.19, 0, -5.0, 0, 0)))
        assert outlook.threat == pytest.approx((0.758 + shift) / 5, abs=0.02)


def test_a_velocity_counts_as_known_below_a_deviation():
    view = view_of((0.3, 0, 0, -1.0, 0, 0))
    for deviation, known in ((0.02, True), (0.04, False)):
        covariance = SEEN + np.diag([0, 0, 0, deviation, deviation, 0]) ** 2
        belief = replace(view.puck, covariance=covariance)
        assert Outlook(replace(view, puck=belief)).known == known


def test_a_path_is_clear_if_a_craft_on_a_cubic_misses_the_puck():
    rng, free, blocked = np.random.default_rng(4), 0, 0
    for _ in range(300):
        craft = np.array([*rng.uniform([-0.95, -0.3], [-0.2, 0.3]), 0, *rng.normal(0, 0.3, 2), 0])
        puck = np.array([*rng.uniform([-0.8, -0.3], [-0.3, 0.3]), 0, *rng.normal(0, 0.3, 2), 0])
        view = view_of(puck, craft)
        if np.hypot(*(craft[:2] - puck[:2])) < PITCH.contact_distance + 0.02:
            continue
        outlook, meeting = Outlook(view), PlannedContact(0.8, rng.uniform(-1.4, 1.4), 1.0)
        at = outlook.at(0.8)
        place = at[:2] - PITCH.contact_distance * unit(meeting.normal)
        way = CubicHermiteSpline([0.0, 0.8], [craft[:2], place], [craft[3:5], unit(meeting.normal)])
        times = np.linspace(0.04, 0.76, 200)
        apart = np.linalg.norm(way(times) - outlook.at(times)[:, :2], axis=1)
        nearest = (apart - PITCH.contact_distance)[times < 0.6].min()
        found = path_is_clear(view, outlook, meeting)
        # Nine places are checked, with a margin.
        if nearest < -0.01:
            assert not found
            blocked += 1
        elif nearest > 0.04 and (apart > PITCH.contact_distance).all():
            assert found
            free += 1
    assert min(free, blocked) > 20


def test_a_detour_leads_to_the_nearer_side_and_is_straight_if_unobstructed():
    goal = np.array([-0.9, 0.0])
    for y, side in ((0.05, -1), (-0.05, 1)):
        view = view_of((-0.7, y, 0, 0, 0, 0), craft=(-0.5, 0, 0, 0, 0, 0))
        target = around(view, Outlook(view), goal)
        assert PITCH.contact_distance < side * (target.y - y) < PITCH.contact_distance + 0.1
    # At a rail there is no room beyond the puck.
    view = view_of((-0.7, -0.4, 0, 0, 0, 0), craft=(-0.5, -0.38, 0, 0, 0, 0))
    assert around(view, Outlook(view), np.array([-0.9, -0.39])).y > -0.4 + PITCH.contact_distance
    for puck in ((-0.3, 0.0), (-0.7, 0.3), (-1.05, 0.0)):
        view = view_of((*puck, 0, 0, 0, 0), craft=(-0.5, 0, 0, 0, 0, 0))
        near = np.array([-0.75, 0.0])
        assert around(view, Outlook(view), near) == SetPoint(-0.75, 0.0, 0.0)


def test_a_run_up_starts_behind_the_contact():
    view = view_of((-0.4, 0.1, 0, 0, 0, 0), craft=(-0.8, 0.0, 0, 0, 0, 0))
    found = PlannedContact(1.0, 0.3, 1.0, "strike").approach(view, Outlook(view))
    expected = np.array([-0.4, 0.1]) - (PITCH.contact_distance + 0.1) * unit(0.3)
    np.testing.assert_allclose([found.reference.x, found.reference.y], expected)
    np.testing.assert_allclose(found.meet, (1.0, -0.4, 0.1))
    assert found.kind == "strike"
    np.testing.assert_allclose(found.avoid, (-0.4, 0.1, PITCH.contact_distance + 0.01))


def test_the_craft_aims_slightly_beyond_the_contact_with_a_receding_puck():
    for puck, speed in (((0, 0, 0), 1.0), ((-1.0, 0.2, 0), -0.3), ((-0.5, 0, 0), 0.2)):
        view = view_of((-0.4, 0.1, 0, *puck))
        meeting = PlannedContact(0.0, 0.3, speed)
        found = meeting.reference(view, view.puck.mean)
        later = found.time - meeting.time
        assert 0 < later <= 0.03
        # By then the discs would overlap by 6 mm if they could.
        closing = speed - np.array(puck[:2]) @ unit(0.3)
        assert later == pytest.approx(min(0.006 / closing, 0.03))
        np.testing.assert_allclose(found.state[3:5], speed * unit(0.3))
        assert (found.then.x, found.then.y) == PITCH.home
