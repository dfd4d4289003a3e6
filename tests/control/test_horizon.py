"""The predicted problem: against the rollout, finite differences and the cost itself."""

from dataclasses import replace
from itertools import pairwise, product

import casadi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.compute.compiled import program
from airpuck.control.authority import control_authority

# The stages contain the assumed braking acceleration, but mixed with other numbers.
# The same problem is written down by hand, with the same damping.
from airpuck.control.horizon import _DAMPING, Blocks, Condensed, Stages, braking, linearised, stages
from airpuck.control.limits import KeepOut
from airpuck.control.predictive import PredictiveSettings, SoftLimits
from airpuck.control.tuning import default_tuning
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.model.model_file import published_model
from airpuck.physics.effects import Drag
from airpuck.physics.rigid_body import acceleration, rollout, step

from ..apparatus.examples import examples
from ..apparatus.models import scaled

MODEL = published_model("M3")
RANDOM = np.random.default_rng(2)
STATE = np.array([0.1, -0.2, 0.7, 0.8, -0.5, 3.0])
SPEED = RANDOM.uniform(0.2, 0.8, 6)
START = np.concatenate([STATE, SPEED])
COMMANDS = RANDOM.uniform(0.1, 0.9, (8, 6))
#: [m/s²].
BRAKE = float(braking(np, MODEL.dynamics, MODEL.vehicle.command_max))
PUSH = np.array([0.3, -0.2, 1.5])
DRAGGED = replace(MODEL.dynamics, effects=(Drag(0.4),))


def test_without_a_disturbance_the_states_match_the_rollout():
    states, *_ = linearised(np, DRAGGED, 0.02, START, COMMANDS, np.zeros(3))
    expected = rollout(np, DRAGGED, START, COMMANDS, np.full(len(COMMANDS), 0.02))
    np.testing.assert_allclose(states, expected, rtol=1e-13)


def test_a_constant_disturbance_moves_a_resting_craft_by_half_a_t_squared():
    idle = np.concatenate([np.zeros(6), np.zeros(6)])
    states, felt, *_ = linearised(np, MODEL.dynamics, 0.02, idle, np.zeros((8, 6)), PUSH)
    time = 0.02 * np.arange(1, 9)[:, None]
    # An offset centre of mass swings by the spin; nothing else accelerates.
    np.testing.assert_allclose(states[:, 3:6], PUSH * time, rtol=1e-4)
    np.testing.assert_allclose(states[:, :3], PUSH * time**2 / 2, rtol=1e-4)
    np.testing.assert_allclose(felt, np.tile(PUSH, (8, 1)), atol=1e-4)


def test_derivatives_equal_finite_differences():
    states, _, onward, felt = linearised(np, DRAGGED, 0.02, START, COMMANDS, PUSH)
    before, tiny = np.concatenate([START[None], states[:-1]]), 1e-6
    for k in range(len(COMMANDS)):
        point = np.concatenate([before[k], COMMANDS[k]])

        def ends(point: np.ndarray) -> np.ndarray:
            return step(np, DRAGGED, point[:12], point[12:], 0.02)

        def pushes(state: np.ndarray) -> np.ndarray:
            return np.array(acceleration(np, DRAGGED, state[2:6], state[6:]))

        for j in range(2, 18):
            d = tiny * np.eye(18)[j]
            slope = (ends(point + d) - ends(point - d)) / (2 * tiny)
            np.testing.assert_allclose(onward[k, :, j - 2], slope, atol=2e-8)
        for j in range(2, 12):
            d = tiny * np.eye(12)[j]
            slope = (pushes(states[k] + d) - pushes(states[k] - d)) / (2 * tiny)
            np.testing.assert_allclose(felt[k, :, j - 2], slope, atol=2e-7)


@pytest.mark.slow
def test_the_compiled_program_gives_the_same_result():
    given = START, COMMANDS, PUSH

    def all_of(xp, start, commands, push):
        return linearised(xp, DRAGGED, 0.02, start, commands, push)

    compiled = program(all_of, *given, compiled=True)(*given)
    for one, other in zip(compiled, all_of(np, *given), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


SETTINGS = default_tuning().of(PredictiveSettings)


def posed(
    plan, wanted, *, state=STATE, model=MODEL, blocks=None, way=0.0, shares=(1,) * 6, **limits
):
    """Pose a problem with equal weights, and a fence of ± 1 m and ± 0.4 m."""
    settings = SETTINGS.model_copy(update={"limits": SoftLimits(**limits)})
    blocks = blocks or Blocks(0.02, (2, 2, 2))
    count = len(blocks.times)
    ask = np.tile(wanted, (count, 1)), np.zeros((count, 3)), np.ones((count, 6)), np.eye(6)
    fence = np.array([[-1.0, -0.4], [1.0, 0.4]])
    believed = state, SPEED, np.zeros(3), np.array(shares)
    rows = [KeepOut(*disc).row for disc in settings.limits.keep_out_m]
    discs = np.array(rows).reshape(-1, 5)
    pose = stages(model, blocks, settings, True)
    return pose(np, *believed, np.array(way), plan, *ask, fence, discs)


PLAN = RANDOM.uniform(0.2, 0.8, (3, 6))


@given(st.integers(-20, 20), st.floats(-3, 3))
def test_adding_whole_turns_to_target_or_craft_changes_nothing(turns, yaw):
    wanted, turned = np.zeros(6), np.zeros(6)
    wanted[2], turned[2] = yaw, yaw + 2 * np.pi * turns
    one, other = (posed(PLAN, each).error for each in (wanted, turned))
    np.testing.assert_allclose(one, other, atol=1e-9)
    assert abs(one[0, 2]) < np.pi + 0.1


def test_near_half_a_turn_the_direction_of_rotation_is_kept():
    wanted = np.zeros(6)
    wanted[2] = STATE[2] - np.pi + 0.01  # a little more than half a turn to the left
    assert posed(PLAN, wanted).way > 3
    assert posed(PLAN, wanted, way=-3.1).way == pytest.approx(-np.pi - 0.01)
    assert posed(PLAN, wanted, way=3.1).way > 3
    # The direction is kept near half a turn only: the rest of one turn does not affect the next.
    wanted[2] = STATE[2] - np.pi + 0.4
    assert posed(PLAN, wanted, way=-1e-4).way == pytest.approx(np.pi - 0.4)
    # A quarter of a turn is unambiguous.
    wanted[2] = STATE[2] - np.pi / 2
    assert posed(PLAN, wanted, way=-3.1).way == pytest.approx(np.pi / 2)


def test_braking_is_half_of_the_weakest_full_push():
    strongest = control_authority(MODEL).together
    weakest = min(strongest[way] for way in ("forward", "back", "left", "right"))
    assert 0.4 * weakest < BRAKE < 0.505 * weakest


@pytest.mark.parametrize("motor", range(6))
def test_a_nearly_dead_motor_does_not_contribute_to_braking(motor):
    shares = np.where(np.arange(6) == motor, 0.05, 1.0)
    # The same craft, made of weak propellers.
    weak = scaled(MODEL, shares)
    # The most that any of them at full speed give together, all others still, in any direction.
    chosen = np.array(list(product([0.0, 1.0], repeat=6))).T
    x, y, _ = acceleration(np, weak.dynamics, np.zeros((4, 64)), chosen)
    ways = np.linspace(0, 2 * np.pi, 500)[:, None]
    weakest = (np.cos(ways) * x + np.sin(ways) * y).max(axis=1).min()
    s = posed(PLAN, np.zeros(6), shares=shares)
    headway = SoftLimits().headway_s + np.abs(s.states[:, 3:5]) / weakest
    rows = s.limited[:, [0, 1], [3, 4]]
    np.testing.assert_allclose(rows, headway, rtol=0.03)  # to a moment of the offset mass
    assert weakest < 0.6 * 2 * BRAKE


def test_a_craft_without_thrust_has_finite_limits():
    assert np.isfinite(posed(PLAN, np.zeros(6), shares=np.zeros(6)).limited).all()


def test_limits_are_expressed_in_command_changes():
    s = posed(PLAN, np.zeros(6), speed_m_s=0.5, spin_rad_s=2.0, keep_out_m=((0.5, 0.1, 0.2),))
    change = RANDOM.normal(size=(6, 6))
    reached = s.states[:, :6] + change
    moved = np.einsum("kci,ki->kc", s.limited, change)
    # It can still brake with half of what its propellers give that way: at v, over v²/2a.
    headway = SoftLimits().headway_s + np.abs(s.states[:, 3:5]) / (2 * BRAKE)
    room = np.minimum(8e-4 * np.abs(s.states[:, 5]), 0.015)  # 0.8 mm for each rad/s
    assert room.max() > 1e-3
    for i in (0, 1):
        later = reached[:, i] + headway[:, i] * reached[:, 3 + i]
        side = (-1.0, 1.0) if i == 0 else (-0.4, 0.4)
        np.testing.assert_allclose(moved[:, i] - s.lower[:, i], later - side[0] - room, atol=1e-12)
        np.testing.assert_allclose(s.upper[:, i] - moved[:, i], side[1] - room - later, atol=1e-12)
    planned = s.states[:, 3:5] / np.linalg.norm(s.states[:, 3:5], axis=1)[:, None]
    along = np.sum(planned * reached[:, 3:5], axis=1)
    np.testing.assert_allclose(s.upper[:, 2] - moved[:, 2], 0.5 - along, atol=1e-12)
    np.testing.assert_allclose(s.upper[:, 3] - moved[:, 3], 2.0 - reached[:, 5], atol=1e-12)
    # The distance from a disc's middle is at least its share along the way from it in the plan.
    share = moved[:, 4] - s.lower[:, 4] + 0.2
    assert (share <= np.linalg.norm(reached[:, :2] - (0.5, 0.1), axis=1) + 1e-12).all()


def test_the_hessian_includes_the_curvature_of_the_thrust_curves():
    # One short step: only the thrusts are nonlinear, so the Hessian of the cost is known.
    blocks, h = Blocks(0.01, (1,)), 0.01
    settings = SETTINGS
    w = settings.weights
    effort = h * np.array([w.acceleration, w.acceleration, w.angular_acceleration])
    wanted = np.array([3.0, 1.0, 0.7, 0.0, 0.0, 0.0])

    def cost(plan: np.ndarray) -> float:
        s = posed(plan, wanted, blocks=blocks)
        return (s.error[-1] @ s.error[-1] + s.excess[0] @ (effort * s.excess[0])) / 2

    plan, tiny = np.full((1, 6), 0.9), 1e-3
    s = posed(plan, wanted, blocks=blocks)
    drive = s.onward[0, 6:, 10:].diagonal()
    left_out = np.zeros((2, 6))
    for motor in range(6):
        d = tiny * np.eye(6)[motor][None]
        curved = (cost(plan + d) - 2 * cost(plan) + cost(plan - d)) / tiny**2
        by_u = s.onward[0, :6, 10 + motor]
        felt = s.felt[0, :, 4 + motor] * drive[motor]
        gauss_newton = by_u @ by_u + felt @ (effort * felt)
        left_out[0, motor] = curved - gauss_newton
        left_out[1, motor] = left_out[0, motor] - s.bend[0, motor] * drive[motor] ** 2
    # Terms that would make it less convex are left out on purpose.
    wanted_less = left_out[0] < 0
    assert not s.bend[0, wanted_less & (left_out[0] < -0.02)].any()
    assert left_out[0].max() > 0.05
    assert np.abs(left_out[1, ~wanted_less]).max() < left_out[0].max() / 2


def test_the_curvature_is_weighted_by_the_effect_on_all_later_steps():
    blocks, step = Blocks(0.01, (12,)), 0.01
    settings = SETTINGS
    w = settings.weights
    effort = step * np.array([w.acceleration, w.acceleration, w.angular_acceleration])
    plan, wanted, tiny = np.full((1, 6), 0.9), np.array([3.0, 1.0, 0.7, 0.0, 0.0, 0.0]), 1e-3
    s = posed(plan, wanted, blocks=blocks)

    def weighted(one: np.ndarray, other: np.ndarray, pushed: np.ndarray, pull: np.ndarray) -> float:
        inner = np.sum(s.weights[:-1] * one[:-1] * other[:-1])
        return inner + one[-1] @ s.terminal @ other[-1] + np.sum(effort * pushed * pull)

    def cost(stages) -> float:
        return weighted(stages.error, stages.error, stages.excess, stages.excess) / 2

    throughout = np.flatnonzero((s.bend > 0).all(axis=0))
    assert len(throughout)
    for motor in throughout:
        change = tiny * np.eye(6)[motor][None]
        more, less = (posed(plan + d, wanted, blocks=blocks) for d in (change, -change))
        curvature = (cost(more) - 2 * cost(s) + cost(less)) / tiny**2
        error, excess = (
            (getattr(more, n) - getattr(less, n)) / 2 / tiny for n in ("error", "excess")
        )
        speed = (more.states[:, 6 + motor] - less.states[:, 6 + motor]) / 2 / tiny
        bent = curvature - weighted(error, error, excess, excess)
        assert s.bend[:, motor] @ speed**2 == pytest.approx(bent, rel=0.02)


def test_linear_thrust_curves_add_no_curvature():
    straight = MODEL.parameters.thrust * [1.0, 0.0, 0.0]
    model = replace(MODEL, parameters=replace(MODEL.parameters, thrust=straight))
    assert not posed(PLAN, np.zeros(6), model=model).bend.any()


@examples(50)
@given(st.floats(0, 0.11), st.lists(st.integers(1, 4), min_size=2, max_size=6))
def test_a_shifted_plan_keeps_the_means_of_the_old_one(elapsed, lengths):
    blocks = Blocks(0.02, tuple(lengths))
    plan = np.random.default_rng(len(lengths)).uniform(size=(len(lengths), 2))
    shifted = blocks.shifted(plan, elapsed)
    # By brute force: the mean of the old plan, the last command held, in small pieces.
    edges = 0.02 * np.concatenate([[0], np.cumsum(lengths)])
    for b, (begin, end) in enumerate(pairwise(edges)):
        times = begin + elapsed + (end - begin) * (np.arange(4000) + 0.5) / 4000
        old = np.minimum(np.searchsorted(edges, times, side="right") - 1, len(lengths) - 1)
        np.testing.assert_allclose(shifted[b], plan[old].mean(axis=0), atol=2e-3)


def test_a_horizon_is_divided_into_blocks():
    settings = SETTINGS
    blocks = Blocks.of(settings.model_copy(update={"horizon_s": 0.22, "block": (4,)}))
    assert blocks.lengths == (4, 4, 3)
    np.testing.assert_array_equal(blocks.owner, [0] * 4 + [1] * 4 + [2] * 3)
    np.testing.assert_allclose(blocks.times[[0, -1]], [0.02, 0.22])


N_MOTORS, SIZE = 4, 10


def regulator(**limits):
    weights = SETTINGS.weights.model_copy(update={"command": 0.1})
    given = {"weights": weights, "limits": SoftLimits(**limits), "iterations": 2000}
    return SETTINGS.model_copy(update=given)


def problem(seed: int, blocks: Blocks, *, tight: float = np.inf) -> Stages:
    """Return a random linear-quadratic problem with two limits: the tighter, the further away."""
    random, count = np.random.default_rng(seed), len(blocks.times)
    root, middle = random.normal(size=(6, 6)), 0.0
    onward = 0.35 * random.normal(size=(count, SIZE, SIZE - 2 + N_MOTORS))
    # A motor's speed depends on its own speed and command alone.
    onward[:, 6:] *= np.hstack([np.zeros((N_MOTORS, 4)), np.eye(N_MOTORS), np.eye(N_MOTORS)])
    if np.isfinite(tight):
        middle = random.normal(size=(count, 2)) / tight
    return Stages(
        states=random.normal(size=(count, SIZE)),
        accelerations=random.normal(size=(count, 3)),
        onward=onward,
        felt=random.normal(size=(count, 3, SIZE - 2)),
        error=random.normal(size=(count, 6)),
        excess=random.normal(size=(count, 3)),
        weights=random.uniform(0.1, 2, (count, 6)),
        terminal=root @ root.T,
        bend=random.uniform(0, 0.5, (count, N_MOTORS)),
        way=np.zeros(()),
        plan=random.uniform(0.2, 0.8, (len(blocks.lengths), N_MOTORS)),
        limited=random.normal(size=(count, 2, 6)),
        lower=middle + np.full((count, 2), -tight),
        upper=middle + tight * random.uniform(0.5, 1, (count, 2)),
    )


def craft(least: float, most: float) -> Vehicle:
    """Return a vehicle with nothing but commands, which may be unbounded."""
    propellers = default_vehicle().propellers[:N_MOTORS]
    return Vehicle.model_construct(propellers=propellers, command_min=least, command_max=most)


def solver_of(blocks: Blocks, bounds: tuple[float, float], **limits) -> Condensed:
    return Condensed(craft(*bounds), blocks, regulator(**limits), (False, False))


def riccati(s: Stages, effort: np.ndarray, used: np.ndarray, least: float) -> np.ndarray:
    """Return the best change of the plan by dynamic programming, a command for each step."""
    count = len(s.error)
    value, slope = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    gains = []
    for k in reversed(range(count)):
        ends = s.terminal if k == count - 1 else np.diag(s.weights[k])
        felt = np.hstack([np.zeros((3, 2)), s.felt[k]])
        value = value + felt.T @ np.diag(effort) @ felt
        value[:6, :6] += ends
        value[6:, 6:] += np.diag(s.bend[k])
        slope = slope + felt.T @ (effort * s.excess[k])
        slope[:6] += ends @ s.error[k]
        a = np.hstack([np.eye(SIZE, 2), s.onward[k, :, : SIZE - 2]])
        b = s.onward[k, :, SIZE - 2 :]
        r = used * (s.plan[k] - least)
        inside = np.diag(used + _DAMPING) + b.T @ value @ b
        feedback = -np.linalg.solve(inside, b.T @ value @ a)
        fixed = -np.linalg.solve(inside, b.T @ slope + r)
        gains.append((a, b, feedback, fixed))
        slope = a.T @ (value @ (b @ fixed) + slope)
        value = a.T @ value @ (a + b @ feedback)
    state, changes = np.zeros(SIZE), []
    for a, b, feedback, fixed in reversed(gains):
        changes.append(feedback @ state + fixed)
        state = a @ state + b @ changes[-1]
    return np.array(changes)


@pytest.mark.parametrize("seed", range(5))
def test_without_limits_the_solution_equals_the_riccati_regulator(seed):
    blocks = Blocks(0.02, (1,) * 12)
    s, condensed = problem(seed, blocks), solver_of(blocks, (-1e6, 1e6))
    found = condensed.solve(condensed.form(np, s))
    expected = riccati(s, condensed.effort, condensed.used[:N_MOTORS], -1e6)
    assert not found.binding.any()
    np.testing.assert_allclose(
        found.change, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max()
    )


def penalised(solver: Condensed, formed, change: np.ndarray) -> float:
    """Return the cost of a change, including exceeded limits."""
    hessian, gradient, rows, lower, upper, _ = formed
    x = change.ravel()
    beyond = np.maximum(np.maximum(lower[x.size :] - rows @ x, rows @ x - upper[x.size :]), 0)
    paid = solver.penalty * (beyond + beyond**2 / 2).sum()
    return float(x @ hessian @ x / 2 + gradient @ x + paid)


@pytest.mark.parametrize(("seed", "tight"), [(1, 9.0), (2, 3.0), (3, 1.0), (4, 0.1), (5, 0.02)])
def test_the_solution_agrees_with_highs(seed, tight):
    blocks = Blocks(0.02, (2, 3, 3))
    s, condensed = problem(seed, blocks, tight=tight), solver_of(blocks, (0.0, 1.0))
    formed = condensed.form(np, s)
    answer = condensed.solve(formed)
    # The predicted states follow step by step from the linearisation.
    moved = np.zeros((len(blocks.owner) + 1, SIZE))
    for k, block in enumerate(blocks.owner):
        given = np.concatenate([moved[k, 2:], answer.change[block]])
        moved[k + 1] = np.eye(SIZE, 2) @ moved[k, :2] + s.onward[k] @ given
    np.testing.assert_allclose(answer.moved, moved[1:, :6], atol=3e-4)
    assert answer.binding.any()
    # HiGHS, with a slack for every limit.
    hessian, gradient, rows, lower, upper, _ = formed
    m, slacks = len(gradient), len(rows)
    p = condensed.penalty
    a = np.block([[rows, np.eye(slacks)], [rows, -np.eye(slacks)]])
    solver = casadi.conic(
        "highs",
        "highs",
        {"h": casadi.Sparsity.dense(m + slacks, m + slacks), "a": casadi.Sparsity.dense(*a.shape)},
        {"highs": {"output_flag": False}},
    )
    big, curved = np.full(slacks, 1e9), np.zeros((m + slacks, m + slacks))
    curved[:m, :m], curved[m:, m:] = hessian, p * np.eye(slacks)
    found = solver(
        h=curved,
        g=np.concatenate([gradient, np.full(slacks, p)]),
        a=a,
        lba=np.concatenate([lower[m:], -big]),
        uba=np.concatenate([big, upper[m:]]),
        lbx=np.concatenate([lower[:m], np.zeros(slacks)]),
        ubx=np.concatenate([upper[:m], big]),
    )
    best = float(found["cost"])
    cost = penalised(condensed, formed, answer.change)
    assert cost == pytest.approx(best, rel=1e-5, abs=1e-5)


def test_a_feasible_limit_is_met_exactly():
    blocks = Blocks(0.02, (2, 3, 3))
    for seed in range(6):
        s, condensed = problem(seed, blocks, tight=4.0), solver_of(blocks, (0.0, 1.0))
        formed = condensed.form(np, s)
        found = condensed.solve(formed)
        if found.exceeded:
            continue
        rows, lower, upper = formed[2:5]
        m, reached = found.change.size, rows @ found.change.ravel()
        assert (reached >= lower[m:] - 1e-5).all()
        assert (reached <= upper[m:] + 1e-5).all()


def test_non_finite_numbers_give_no_solution():
    blocks = Blocks(0.02, (2, 2))
    s = problem(0, blocks)._replace(error=np.full((4, 6), np.nan))
    solver = solver_of(blocks, (0.0, 1.0))
    assert solver.solve(solver.form(np, s)) is None


def test_an_unconverged_solution_is_not_used():
    blocks = Blocks(0.02, (1,) * 8)
    s, short = problem(4, blocks, tight=0.02), regulator().model_copy(update={"iterations": 1})
    solver = Condensed(craft(0.0, 1.0), blocks, short, (False, False))
    assert solver.solve(solver.form(np, s)) is None
