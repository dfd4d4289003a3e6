"""No flight is faster than its bound."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog
from studies.bounds import affected, case, missing_at, sharp

import airpuck
from airpuck import Effect, Goal, Limits, Table
from airpuck.physics.effects import Drag, Tilt
from airpuck.planning import certificate
from airpuck.planning import plan as planning
from airpuck.planning.certificate import lower_bound, lower_bound_through, unavoidable_rail
from airpuck.planning.request import Request, checked_request, motor_range
from airpuck.planning.search import search
from airpuck.planning.yaw_program import Fineness, Weight, YawProgram, frontier

from ..apparatus.one_axis_craft import ACCELERATION, one_axis

M3 = airpuck.read_model("paper:M3")
WIDE = Limits(spin=40.0, speed=10.0)


def request(start, state, limits=WIDE):
    velocity = tuple(float(v) for v in state[3:6])
    goal = Goal(*(float(v) for v in state[:3]), velocity=velocity)
    return checked_request(M3, start, goal, (), None, (), limits)


@pytest.mark.parametrize("yaw", [0.0, 0.4, 1.9, 3.3, 5.0])
@pytest.mark.parametrize("redrawn", [False, True])
def test_chords_of_the_frontier_bound_linear_programs_from_above(yaw, redrawn):
    low, high = np.full(6, 0.01), M3.dynamics.thrust.sum(axis=1)
    moments = np.linspace(-280.0, 280.0, 29)
    table = frontier(M3, np.array([yaw]), low, high, moments, (0.0, 0.0), redrawn)[0]
    forward, left, turn = np.asarray(M3.dynamics.configuration)
    push = np.cos(yaw) * forward - np.sin(yaw) * left
    bounds = np.stack([low, high], axis=1)
    for moment in np.linspace(-260.0, 260.0, 23):
        best = -linprog(-push, A_eq=turn[None], b_eq=[moment], bounds=bounds).fun
        assert np.interp(moment, moments, table) >= best - 1e-9
        if redrawn:  # chords as long as a step between moments, from anywhere
            for before in (0.25, 0.5, 0.75):
                ends = moment + 20.0 * np.array([-before, 1 - before])
                shares = np.array([1 - before, before])
                assert shares @ np.interp(ends, moments, table) >= best - 1e-9
        assert np.interp(moment, moments, table) <= best + (1.5 if redrawn else 0.8)


@pytest.mark.parametrize("yaw", [0.4, 3.3])
def test_the_frontier_includes_moments_of_effects(yaw):
    low, high = np.full(6, 0.01), M3.dynamics.thrust.sum(axis=1)
    turn = np.asarray(M3.dynamics.configuration)[2]
    reach = [np.where(side * turn > 0, high, low) @ turn + side * 40.0 for side in (-1, 1)]
    moments = np.linspace(*reach, 41)
    for added, reached in ((0.0, False), (40.0, True)):
        table = frontier(M3, np.array([yaw]), low, high, moments, (0.5, added))[0]
        assert (table > -1e6).all() == reached


@pytest.mark.parametrize(("turning", "velocity"), [(1, (0, 0, 0)), (-1, (0, 0, 0)), (1, None)])
def test_a_few_long_steps_bound_the_push_of_a_spinning_craft(turning, velocity):
    """The weight turns against the craft, so that chords between steps miss most."""
    model, spin, time, nowhere = one_axis(), 3.0 * turning, 0.2, np.zeros((0, 2))
    start = np.array([0, 0, -0.3 * turning, 0, 0, spin, *np.zeros(6)])
    goal = Goal(0.0, 0.0, 0.3 * turning, velocity and (*velocity[:2], spin), turn="exact")
    asked = Request(model, start, goal, nowhere, (np.inf,) * 2, np.zeros((0, 3)), Limits(spin=4.0))
    weight = straight(1.0 + 0.3j * turning, 1.0 - 0.3j * turning, time)
    program = YawProgram(asked, weight, time, Fineness(2, 8, 100, 480), np.zeros(1))
    times = (np.arange(1000) + 0.5) * time / 1000
    pushed = np.conj(weight(times)) * np.exp(1j * (start[2] + spin * times))
    exact = ACCELERATION * time * pushed.real.mean()
    assert exact <= program.most[-1, 0] < 1.06 * exact


@pytest.mark.parametrize("yaw", [0.4, 1.9, 3.3])
def test_chords_between_any_two_points_lie_above_the_frontiers_kinks(yaw):
    low, high = np.full(6, 0.01), M3.dynamics.thrust.sum(axis=1)
    forward, left, turn = np.asarray(M3.dynamics.configuration)
    push = np.cos(yaw) * forward - np.sin(yaw) * left
    prices = np.sort(-push / turn)
    # Between two prices of the moment, the set of motors that run stays the same.
    for price in (prices[1:] + prices[:-1]) / 2:
        forces = np.where(push + price * turn > 0, high, low)
        kink, best = turn @ forces, push @ forces
        moments = kink + 20.0 * np.arange(-14, 15)
        table = frontier(M3, np.array([yaw]), low, high, moments, (0.0, 0.0), redrawn=True)[0]
        assert np.interp([kink - 10, kink + 10], moments, table).mean() >= best - 1e-9


def test_motor_speeds_stay_within_their_proven_range():
    times, speed = np.array([0.0, 0.01, 0.03, 1.0]), np.linspace(0.1, 0.9, 6)
    low, high = motor_range(M3, speed, times)
    for command in (0.03, 0.5, 1.0):
        state = np.concatenate([np.zeros(6), speed])
        flown = M3.simulate(state, np.full((3, 6), command), np.diff(times))[:, 6:]
        assert (flown <= high[:, 1:].T + 1e-12).all()
        assert (flown >= low[:, 1:].T - 1e-12).all()


@pytest.mark.parametrize("seed", range(0, 1000, 100))
def test_no_feasible_flight_is_refuted(seed):
    """Craft with three to eight propellers and every effect; studies/bounds.py has more cases."""
    _, asked, weight, time = case(seed)
    needed, most, scale = missing_at(asked, weight, time)
    assert needed <= most
    assert most < 1.5 * scale


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 21])
def test_no_flight_is_faster_than_its_bound(seed):
    _, asked, weight, time = case(seed)
    assert lower_bound(asked, weight, 1.3 * time) <= time


@pytest.mark.parametrize("seed", [6, 17, 27, 28])
def test_a_bound_two_percent_too_strong_refutes_a_flight(seed):
    """Without this the test above could not notice wrong bounds."""
    _, asked, weight, time = sharp(seed)
    needed, most, _ = missing_at(asked, weight, time)
    assert 0.98 * most < needed <= most


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 17])
def test_the_bound_is_tight_for_the_fastest_flights(seed):
    _, asked, weight, time = sharp(seed)
    assert time < 1.02 * lower_bound(asked, weight, 1.3 * time) <= 1.02 * time


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_craft_that_must_turn_to_brake_certainly_hits_the_rail(direction, axis):
    # Backwards, along its weakest push; without turning, the rail is just far enough.
    state = np.array([0, 0, np.pi * (axis / 2 + (direction > 0)), 0, 0, 0])
    state[axis] = direction * (Table().reach(M3.vehicle.radius_m)[axis] - 0.1)
    for speed, certain in ((1.05, "xy"[axis]), (0.6, None)):
        state[3 + axis] = direction * speed
        asked = checked_request(M3, state, (0.0, 0.0, 0.0), (), Table(), (), Limits())
        assert unavoidable_rail(asked) == certain


def test_effects_that_may_brake_prevent_the_proof_of_a_crash():
    """The slope of the table, and a centre of mass that moves as the craft turns."""
    state = np.array([Table().reach(M3.vehicle.radius_m)[0] - 0.1, 0, np.pi, 1.05, 0, 0])
    aside = replace(M3, parameters=replace(M3.parameters, center_of_mass=np.array([0.01, 0.0])))
    for model in (affected(M3, Tilt(0.05)), aside):
        asked = checked_request(model, state, (0.0, 0.0, 0.0), (), Table(), (), Limits())
        assert unavoidable_rail(asked) is None  # for M3 itself, see above


class Boost(Effect):
    """An effect without bounds."""

    def thrust(self, xp, thrust, motion):
        return 1.5 * thrust


class Wind(Drag):
    """Its bounds are those of drag, which it exceeds."""

    def acceleration(self, xp, motion):
        return 2.0, 0.0, 0.0


class Gust(Wind):
    """Has no method of its own."""


@pytest.mark.parametrize("effect", [Boost(), Wind(), Gust()])
def test_an_effect_without_bounds_gives_no_lower_bound(effect):
    asked = request((0, 0, 0), np.array([0.5, 0, 0, 0, 0, 0.0]))
    unknown = replace(asked, model=affected(M3, effect))
    assert lower_bound(unknown, along_x(0.6), 0.6) is None
    assert lower_bound_through(unknown, np.array([0.6])) is None


def along_x(duration):
    return Weight(duration / 2 + 0j, -1.0 + 0j)


def test_the_bound_does_not_depend_on_the_duration_of_the_plan():
    """The bound stays valid even if a plan claims an impossible duration."""
    asked = request((0, 0, 0), np.array([0.5, 0, 0, 0, 0, 0.0]))
    found = [lower_bound(asked, along_x(time), time) for time in (0.4, 0.6)]
    assert found[0] == pytest.approx(found[1], rel=5e-3)
    assert found[0] > 0.4


@pytest.mark.slow
def test_a_segment_of_a_plan_is_not_faster_than_its_bound():
    """A part of a fastest flight is nearly a fastest flight: its bound comes close to it."""
    asked = checked_request(
        M3, (-0.5, -0.1, 0.3, 0.4, 0.5, 1.0), (0.5, 0.2, -1.0), (), Table(), (), Limits()
    )
    solved, _ = search(asked, 20)
    weight, times = planning._weight(asked, solved), solved.path.times
    time = float(times[16])
    part = request(asked.start[:6], solved.path.states[16], Limits())
    assert 0.8 * time < lower_bound(part, weight, time) <= time


@pytest.mark.slow
def test_the_bound_is_tight_for_moving_start_and_goal():
    # The craft cannot wait here, so short durations must be refuted as well.
    start, goal = (-0.77, 0.11, 1.65, -0.08, 0.57, -3.26), (0.73, -0.35, -0.22, -0.59, -0.06, 2.9)
    found = airpuck.plan(M3, start, goal, table=Table(), intervals=20)
    assert 0.93 * found.duration < found.lower_bound <= found.duration


def test_the_bound_holds_for_any_weight_and_is_zero_for_a_useless_one():
    asked = request((0, 0, 0), np.array([0.5, 0, 0, 0, 0, 0.0]))
    away = Weight(-0.4 + 0j, 1.0 + 0j)
    # Only this limit remains: at most 10 m/s along x.
    assert lower_bound(asked, away, 0.6) == pytest.approx(0.0554, rel=0.1)


@pytest.mark.slow
def test_a_figure_of_eight_has_a_bound_despite_its_curved_legs():
    point = (0.5, 0.25)
    asked = checked_request(M3, (0, 0, 0), (0, 0, 0), (point, (-0.5, 0.25)), None, (), WIDE)
    bound = lower_bound_through(asked, np.array([0.7, 1.5, 0.7]))
    # With all motors that push one way, at any yaw and without lag, each half takes √(2d/a).
    full = np.asarray(M3.propeller_effects)[:2] * M3.dynamics.thrust.sum(axis=1)
    along = np.exp(1j * np.linspace(0, 2 * np.pi, 721))
    pushed = np.maximum(np.outer(along.real, full[0]) + np.outer(along.imag, full[1]), 0)
    assert bound > 0.85 * 2 * np.sqrt(2 * np.hypot(*point) / pushed.sum(axis=1).max())
    assert bound < 0.7 + 0.7


@pytest.mark.slow
def test_a_leg_that_coarse_programs_cannot_refute_ends_the_search(monkeypatch):
    programs, usual = [], certificate.YawProgram
    monkeypatch.setattr(
        certificate, "YawProgram", lambda *args: programs.append(usual(*args)) or programs[-1]
    )
    asked = checked_request(M3, (0, 0, 0), (0.6, 0, 0), ((0.3, 0.3),), None, (), WIDE)
    assert lower_bound_through(asked, np.array([0.446, 0.425])) > 0.66
    assert len(programs) < 60  # 28; five times as many if the search goes on


@pytest.mark.slow
def test_a_moving_goal_is_not_refuted_by_its_legs():
    """Full thrust to the point, then full braking: flown backwards, the last leg begins slowly."""
    fast, slow = 1.0, 0.2  # [m/s], at the point and at the goal
    times = np.array([fast, fast - slow]) / ACCELERATION
    legs = times * [fast / 2, (fast + slow) / 2]
    goal = Goal(float(legs.sum()), 0.0, 0.0, velocity=(slow, 0.0, 0.0), turn="exact")
    nowhere, limits = np.zeros((0, 3)), Limits(spin=0.1, speed=1.05 * fast)
    via = np.array([[legs[0], 0.0]])
    asked = Request(one_axis(), np.zeros(12), goal, via, (np.inf,) * 2, nowhere, limits)
    bound = lower_bound_through(asked, times)
    assert 0.9 * times.sum() < bound <= times.sum()


def drifting(time, motion, yaw=0.4, frame="body", offset=(0.05, 0.02), free=(), tilt=None, **more):
    """Return the request of a flight with hardly any thrust, and its states.

    Whatever its bound assumes wrongly about the motion has no thrust to hide behind.
    """
    thrust = 1e-6 * M3.parameters.thrust
    parameters = replace(M3.parameters, thrust=thrust, center_of_mass=np.array(offset))
    model = replace(M3, parameters=parameters, frame=frame)
    model = affected(model, Tilt(*tilt)) if tilt else model
    start = np.concatenate([(0.1, -0.2, yaw), motion, np.zeros(6)])
    states = model.simulate(start, np.zeros((400, 6)), time / 400)
    goal = Goal(*states[-1, :3], velocity=tuple(states[-1, 3:6]), turn="exact")
    goal = replace(goal, **dict.fromkeys(free), **more)
    limits = Limits(spin=max(0.1, abs(motion[2])), speed=np.abs(states[:, 3:5]).max())
    nothing = np.zeros((0, 2)), (np.inf, np.inf), np.zeros((0, 3))
    return Request(model, start, goal, *nothing, limits), states


def straight(begin, end, time):
    return Weight(begin, (end - begin) / time)


@pytest.mark.parametrize(
    ("motion", "tilt"), [((2.0, 0.5, 0.0), None), ((0.6, -0.3, 3.0), (0.02, -0.01))]
)
def test_the_bound_of_a_coasting_craft_is_nearly_its_time(motion, tilt):
    """In fractions of a step that it has coasted; its place and velocity there are exact."""
    asked, _ = drifting(0.4, motion, tilt=tilt)
    direction = complex(*motion[:2]) / abs(complex(*motion[:2]))
    bound = lower_bound(asked, straight(0.5 * direction, -0.5 * direction, 0.4), 0.4)
    assert 0.997 < bound / 0.4 <= 1.0


@pytest.mark.parametrize("begin", [1.0 + 0j, 0.3 - 0.7j])
@pytest.mark.parametrize("end", [-1j, 0.6 + 0.2j])
@pytest.mark.parametrize("tilt", [None, (0.02, -0.01)])
def test_turning_about_the_centre_of_mass_needs_no_thrust(begin, end, tilt):
    asked, _ = drifting(0.4, (0.5, -0.3, -5.0), tilt=tilt)
    needed, most, _ = missing_at(asked, straight(begin, end, 0.4), 0.4)
    assert -1e-5 < needed <= most < 1e-4


@pytest.mark.parametrize("end", [-1j, 0.6 + 0.2j])
@pytest.mark.parametrize(("spin", "turn"), [(-5.0, "exact"), (2.0, "shorter")])
def test_a_world_fixed_mass_offset_is_accelerated_along_itself(end, spin, turn):
    asked, _ = drifting(0.4, (0.5, -0.3, spin), frame="world", turn=turn)
    needed, most, _ = missing_at(asked, straight(1.0 + 0j, end, 0.4), 0.4)
    pulled = 0.4 * np.dot((0.05, 0.02), ((1 + end.real) / 2, end.imag / 2)) * spin**2
    assert needed == pytest.approx(pulled, abs=1e-5)
    assert needed <= most


def test_a_free_yaw_allows_any_direction_of_the_mass_offset():
    asked, states = drifting(0.4, (0.5, -0.3, 3.0), free=["yaw"])
    arm = complex(0.05, 0.02) * np.exp(1j * states[-1, 2])
    # The weight for which no other final yaw is worse.
    needed, most, _ = missing_at(asked, straight(-0.5j * arm - 0.4 * arm, -0.5j * arm, 0.4), 0.4)
    assert -1e-5 < needed <= most


@pytest.mark.parametrize("turn", ["exact", "shorter"])
def test_a_world_fixed_mass_offset_depends_on_all_turns(turn):
    spin, aside = 2 * np.pi + 0.5, 1j * complex(0.05, 0.02)
    free = ["yaw"] if turn == "exact" else ()
    asked, _ = drifting(1.0, (0.5, -0.3, spin), frame="world", free=free, turn=turn)
    needed, most, _ = missing_at(asked, straight(-1.5 * aside, -0.5 * aside, 1.0), 1.0)
    assert -1e-5 < needed <= most


def test_a_free_velocity_may_reach_the_limit():
    asked, _ = drifting(0.4, (-1.0, -1.0, 0.0), free=["velocity"])
    needed, most, _ = missing_at(asked, straight(-0.3 + 1j, 1.0 + 0.5j, 0.4), 0.4)
    assert -0.01 < needed <= most  # a spin of 0.1 rad/s is allowed, and needs 5 mm/s


def test_the_centre_of_mass_may_be_beyond_the_reach_of_the_craft():
    asked, _ = drifting(0.4, (0.0, 0.5, 0.0), yaw=0.0, offset=(0.05, 0.0))
    asked = replace(asked, reach=(0.1, 1.0))
    weight = Weight(0j, 0j, np.array([0.2]), np.array([-1.0 + 0j]))
    needed, most, _ = missing_at(asked, weight, 0.4)
    assert -1e-5 < needed <= most


def test_a_world_fixed_mass_offset_moves_sideways_with_every_turn():
    # It is accelerated along y; by 1.52 s it has moved 0.15 m along -x.
    asked, _ = drifting(1.6, (0.0, 0.0, 2.0), frame="world", offset=(0.0, 0.05))
    asked = replace(asked, reach=(0.1, 2.0), start=asked.start + np.eye(12)[0] * -0.2)
    asked = replace(asked, goal=replace(asked.goal, x=asked.goal.x - 0.2))
    weight = Weight(0j, 0j, np.array([1.52]), np.array([1.0 + 0j]))
    needed, most, _ = missing_at(asked, weight, 1.6)
    assert -1e-5 < needed <= most < 0.01
