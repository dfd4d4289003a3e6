"""Plans flown on the twin by a pilot that goes to their start first."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import airpuck
from airpuck import Limits, Table, Twin
from airpuck.control.law import Moment
from airpuck.control.tuning import default_tuning
from airpuck.estimate.estimator import Estimate
from airpuck.flight.loop import check_pilot, fly
from airpuck.planning.tracking import Departing, PlanTracker, least_correction, plan_tracker, rests
from airpuck.twin.settings import default_twin_settings

M3 = airpuck.read_model("paper:M3")


def flyable(start, goal, warm=None):
    """Plan with room for feedback, and without the lower bound, which no pilot needs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("airpuck.planning.plan._bound", lambda *_: None)
        limits = Limits(reserve=0.1, smoothing=2e-4)
        given = {"table": Table(), "limits": limits, "intervals": 20, "warm": warm}
        return airpuck.plan(M3, start, goal, **given)


@pytest.fixture(scope="module")
def planned():
    return flyable((-0.2, 0, 0), (0.2, 0, 0.5))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["lqr", "mpc"])
def test_the_craft_rests_at_the_start_and_reaches_the_goal_on_time(planned, kind):
    tuning = default_tuning().with_law(kind)
    pilot = Departing(plan_tracker(planned, tuning), planned)
    check_pilot(pilot)
    twin = Twin(M3, default_twin_settings(), seed=3, pose=(0.1, 0.1, 1.0))
    fly(pilot, twin, 6.0, tuning.period_s)
    begin = pilot.reference.begin
    assert 1.0 < begin < 4.0
    times, states = twin.truth
    before = (times > begin - 0.9) & (times < begin)
    assert np.hypot(*(states[before, :2] - (-0.2, 0.0)).T).max() < 0.008
    after = times > begin + 1.3 * planned.duration + 0.1
    assert np.hypot(*(states[after, :2] - (0.2, 0.0)).T).max() < 0.03
    assert np.hypot(*(states[times > 5.5, :2] - (0.2, 0.0)).T).max() < 0.01
    assert not twin.contacts


def departure(planned, aside, pause=0.0):
    """Return when a craft departs that is beside the start at each of its steps."""
    pilot, time = Departing(plan_tracker(planned, default_tuning()), planned), 0.0
    for k, off in enumerate(aside):
        time += 0.01 + (pause if k == 60 else 0.0)
        pilot.pose(time, planned.states[0, :3] + off)
        pilot.sent(time, pilot.step(time).command)
    return pilot.reference.begin


def test_a_craft_departs_after_a_second_of_rest_without_a_gap(planned):
    for pause, begins in ((0.0, 1.0), (0.3, 1.9)):
        assert begins - 0.02 < departure(planned, np.zeros((250, 3)), pause) < begins + 0.15
    assert departure(planned, np.tile([0.0, 0.0, 0.2], (130, 1))) == np.inf
    # At rest as before a live flight, though for under a second; then somewhere else.
    aside = np.random.default_rng(0).normal(0, 5e-5, (300, 3))
    aside[90:, 0] += 0.05
    assert departure(planned, aside) == np.inf


@pytest.mark.parametrize(("axis", "rate"), [(3, 0.2), (4, -0.2), (5, 1.5), (5, 0.5)])
def test_a_plan_that_ends_in_motion_does_not_end_at_rest(axis, rate):
    states = np.zeros((2, 12))
    states[-1, axis] = rate
    plan = airpuck.Plan(M3, np.array([0.0, 0.5]), states, np.zeros((1, 6)), lower_bound=None)
    assert rests(plan) == (rate == 0.5)


def test_corrections_match_bounded_least_squares_of_scipy():
    rng = np.random.default_rng(1)
    for m in (6, 60, 300):
        a, missed = rng.normal(0, 2, (6, m)), rng.normal(0, 30, 6)
        low, high = -rng.uniform(0, 0.5, m), rng.uniform(0, 0.5, m)
        expected = lsq_linear(
            np.vstack([a, np.eye(m)]),
            np.concatenate([-missed, np.zeros(m)]),
            (low, high),
            tol=1e-12,
        )
        found = least_correction(a, missed, low, high)
        assert (found >= low).all()
        assert (found <= high).all()
        np.testing.assert_allclose(found, expected.x, atol=1e-4)


@pytest.mark.slow
def test_a_craft_off_its_plan_still_reaches_the_goal_on_time(planned):
    """Late packets, and an initial error of 8 mm and 0.03 rad."""
    tuning, table = default_tuning(), Table()
    flight = planned.starting(0.1)
    for seed in range(2):
        pilot = plan_tracker(flight, tuning, table)
        twin = Twin(M3, default_twin_settings(), seed=seed, pose=(-0.206, 0.005, 0.03))
        fly(pilot, twin, 0.1 + 1.1 * planned.duration, tuning.period_s)
        time, states = twin.truth
        late = time > 0.1 + planned.duration
        error = np.abs(states[late][:, :6] - flight.samples[1][-1, :6])
        near = (error < (0.01, 0.01, 0.1, 0.05, 0.05, 1.0)).all(axis=1)
        assert near.any()


def command_at(plan, time, aside=(0.0,) * 6, delay=0.02):
    """Return the command of a tracker for a craft that is beside its plan when it acts."""
    state = plan.state_at(time + delay, np.zeros(1))[0]
    craft = Estimate(time + delay, state[:6] + aside, state[6:], np.zeros(3))
    moment = Moment(plan, time, delay, lambda *_: (craft, ()))
    return PlanTracker(M3, default_tuning()).step(None, moment)[0].command


def test_the_commands_of_a_plan_are_sent_from_its_first_moment(planned):
    flight = planned.starting(0.5)
    # The LQR would idle the first motor.
    first = command_at(flight, 0.5, delay=0.0)[0]
    assert first == pytest.approx(flight.commands[0, 0], abs=0.1)
    assert first > 0.15


@pytest.mark.parametrize("spin", [20.0, -20.0])
def test_corrections_can_use_full_thrust_where_a_plan_stops_the_motors(spin):
    commands = np.repeat([1.0, M3.vehicle.command_min], (10, 30))[:, None] * np.ones(6)
    start = np.append(np.zeros(6), np.ones(6))
    states = np.vstack([start, M3.simulate(start, commands, 0.01)])
    plan = airpuck.Plan(M3, 0.01 * np.arange(41), states, commands, lower_bound=None)
    # It acts from 94.5 to 104.5 ms, and requires the largest moment.
    command = command_at(plan, 0.0745, (0, 0, 0, 0, 0, spin))
    assert ((command < 0.2) | (command > 0.85)).all()


@pytest.mark.slow
def test_a_plan_may_end_in_motion_and_is_flown_until_then(planned):
    goal = airpuck.Goal(0.2, 0.0, 0.5, (0.6, 0.0, 0.0))
    moving = flyable((-0.2, 0, 0), goal, planned).starting(0.1)
    twin = Twin(M3, default_twin_settings(), seed=1, pose=(-0.2, 0.0, 0.0))
    fly(plan_tracker(moving, default_tuning()), twin, 0.1 + moving.duration, 0.01)
    error = twin.truth[1][-1, :6] - moving.samples[1][-1, :6]
    assert (np.abs(error) < (0.02, 0.02, 0.15, 0.15, 0.15, 3.0)).all()
