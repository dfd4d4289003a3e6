"""No flight is faster than its bound."""

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.optimize import linprog

import airpuck
from airpuck.craft.table import Table
from airpuck.planning import plan as planning
from airpuck.planning.attainable import YAWS, frontier, motor_range, pushes
from airpuck.planning.certificate import Weight, lower_bound, lower_bound_through
from airpuck.planning.request import Goal, Limits, checked_request
from airpuck.planning.search import search

from ..apparatus.examples import examples

M3 = airpuck.read_model("paper:M3")
WIDE = Limits(spin=40.0, speed=10.0)


def request(start, state, limits=WIDE):
    velocity = tuple(float(v) for v in state[3:6])
    goal = Goal(*(float(v) for v in state[:3]), velocity=velocity)
    return checked_request(M3, start, goal, (), None, (), limits)


@pytest.mark.parametrize("yaw", range(0, YAWS, 61))
def test_the_frontier_is_that_of_linear_programs(yaw):
    low, high = np.full(6, 0.01), M3.dynamics.thrust.sum(axis=1)
    moments = np.linspace(-200.0, 200.0, 9)
    table = frontier(M3, low, high, moments, (0.0, 0.0))
    push, turn = pushes(M3)[yaw], np.asarray(M3.dynamics.configuration)[2]
    for k, moment in enumerate(moments):
        best = linprog(-push, A_eq=turn[None], b_eq=[moment], bounds=np.stack([low, high], axis=1))
        assert table[yaw, k] == pytest.approx(-best.fun, rel=1e-4)


def test_motors_cannot_have_other_speeds():
    times, speed = np.array([0.0, 0.01, 0.03, 1.0]), np.linspace(0.1, 0.9, 6)
    low, high = motor_range(M3, speed, times)
    for command in (0.03, 0.5, 1.0):
        state = np.concatenate([np.zeros(6), speed])
        flown = M3.simulate(state, np.full((3, 6), command), np.diff(times))[:, 6:]
        assert (flown <= high[:, 1:].T + 1e-12).all()
        assert (flown >= low[:, 1:].T - 1e-12).all()


@pytest.mark.slow
@example(576)  # these are so short that the steps of time are coarse
@example(321)
@example(355)
@examples(40)
@given(st.integers(0, 10_000))
def test_no_random_flight_is_faster_than_its_bound(seed):
    random = np.random.default_rng(seed)
    start = np.concatenate([random.uniform(-1, 1, 5), random.uniform(-8, 8, 1)])
    state = np.concatenate([start, np.full(6, M3.vehicle.command_min)])
    # Full on or off, for some hundredths of a second each: what a switching control does.
    commands = np.where(random.random((random.integers(1, 7), 6)) < 0.5, 0.03, 1.0)
    periods = random.uniform(0.02, 0.2, len(commands))
    fine = np.repeat(commands, 20, axis=0)
    end = M3.simulate(state, fine, np.repeat(periods / 20, 20))[-1]
    assume(abs(end[5]) < WIDE.spin)
    duration = float(periods.sum())
    asked = request(start, end)
    # Any weight must do; these are near to those of plans.
    stop, direction = random.uniform(0.2, 0.8), np.exp(1j * random.uniform(0, 2 * np.pi))
    gained = complex(*(end[:2] - start[:2] - duration * start[3:5]))
    if random.random() < 0.5:
        direction = np.exp(1j * np.angle(gained))
    none = np.zeros(0)
    weight = Weight(direction * stop * duration, -direction, none, none.astype(complex), 3.0, 0.3)
    assert lower_bound(asked, weight, 2 * duration) <= duration * (1 + 1e-6)


@pytest.mark.slow
def test_parts_of_plans_are_not_faster_than_their_bounds():
    """Parts of a fastest flight are nearly fastest flights: bounds come close to them."""
    asked = checked_request(
        M3, (-0.5, -0.1, 0.3, 0.4, 0.5, 1.0), (0.5, 0.2, -1.0), (), Table(), (), Limits()
    )
    solved, _ = search(asked, 40)
    weight, times = planning._weight(asked, solved), solved.path.times
    shares = []
    for node in (18, 25, 32, 40):
        time = float(times[node])
        part = request(asked.start[:6], solved.path.states[node], Limits())
        bound = lower_bound(part, weight, 1.05 * time)
        assert bound <= time
        shares.append(bound / time)
    assert shares[-1] > 0.95


def test_the_bound_holds_for_any_weight_and_is_zero_for_a_useless_one():
    asked = request((0, 0, 0), np.array([0.5, 0, 0, 0, 0, 0.0]))
    none = np.zeros(0)
    away = Weight(-0.4 + 0j, 1.0 + 0j, none, none.astype(complex), 1.0, 0.1)
    assert lower_bound(asked, away, 0.6) == 0.0


@pytest.mark.slow
def test_a_figure_of_eight_has_a_bound_though_its_legs_are_curved():
    point = (0.5, 0.25)
    asked = checked_request(M3, (0, 0, 0), (0, 0, 0), (point, (-0.5, 0.25)), None, (), WIDE)
    bound = lower_bound_through(asked, np.array([0.7, 1.5, 0.7]))
    # All motors that push one way at once, at any yaw, without lag: each way takes √(2d/a).
    full = np.asarray(M3.propeller_effects)[:2] * M3.dynamics.thrust.sum(axis=1)
    along = np.exp(1j * np.linspace(0, 2 * np.pi, 721))
    pushed = np.maximum(np.outer(along.real, full[0]) + np.outer(along.imag, full[1]), 0)
    assert bound > 0.85 * 2 * np.sqrt(2 * np.hypot(*point) / pushed.sum(axis=1).max())
    assert bound < 0.7 + 0.7
