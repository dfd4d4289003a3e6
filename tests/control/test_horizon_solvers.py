"""The solver of the predicted problem: against Riccati's recursion and HiGHS."""

import casadi
import numpy as np
import pytest

# The same problem is written down by hand, with the same damping.
from airpuck.control.horizon import _DAMPING, Blocks, Condensed, Stages
from airpuck.control.tuning import SoftLimits, default_tuning
from airpuck.craft.vehicle import Vehicle

N_MOTORS, SIZE = 4, 10


def regulator(**limits):
    weights = default_tuning().regulator.weights.model_copy(update={"command": 0.1})
    given = {"weights": weights, "limits": SoftLimits(**limits), "iterations": 2000}
    return default_tuning().regulator.model_copy(update=given)


def problem(seed: int, blocks: Blocks, *, tight: float = np.inf) -> Stages:
    """Return a random linear-quadratic problem with two limits: the tighter, the further away."""
    random, count = np.random.default_rng(seed), len(blocks.times)
    root, middle = random.normal(size=(6, 6)), 0.0
    if np.isfinite(tight):
        middle = random.normal(size=(count, 2)) / tight
    return Stages(
        states=random.normal(size=(count, SIZE)),
        accelerations=random.normal(size=(count, 3)),
        onward=0.35 * random.normal(size=(count, SIZE, SIZE - 2 + N_MOTORS)),
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
    """Return a vehicle of which only the commands are known; they may be without bounds."""
    propellers = (None,) * N_MOTORS
    return Vehicle.model_construct(propellers=propellers, command_min=least, command_max=most)


def solver_of(blocks: Blocks, bounds: tuple[float, float], **limits) -> Condensed:
    return Condensed(craft(*bounds), blocks, regulator(**limits), 2)


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
def test_without_limits_it_is_the_riccati_solution(seed):
    blocks = Blocks(0.02, (1,) * 12)
    s, condensed = problem(seed, blocks), solver_of(blocks, (-1e6, 1e6))
    found = condensed.solve(condensed.form(np, s))
    expected = riccati(s, condensed.effort, condensed.used[:N_MOTORS], -1e6)
    assert not found.binding.any()
    np.testing.assert_allclose(
        found.change, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max()
    )


def penalised(solver: Condensed, formed, change: np.ndarray) -> float:
    """Return what a change costs, limits that it exceeds included."""
    hessian, gradient, rows, lower, upper, _ = formed
    x = change.ravel()
    beyond = np.maximum(np.maximum(lower[x.size :] - rows @ x, rows @ x - upper[x.size :]), 0)
    paid = solver.penalty * (beyond + beyond**2 / 2).sum()
    return float(x @ hessian @ x / 2 + gradient @ x + paid)


@pytest.mark.parametrize(("seed", "tight"), [(1, 9.0), (2, 3.0), (3, 1.0), (4, 0.1), (5, 0.02)])
def test_it_agrees_with_highs(seed, tight):
    blocks = Blocks(0.02, (2, 3, 3))
    s, condensed = problem(seed, blocks, tight=tight), solver_of(blocks, (0.0, 1.0))
    formed = condensed.form(np, s)
    answer = condensed.solve(formed)
    # It says where the change leads: step after step by the slopes.
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


def test_a_limit_that_can_be_kept_is_kept_to_the_last_digit():
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


def test_numbers_that_are_not_finite_have_no_answer():
    blocks = Blocks(0.02, (2, 2))
    s = problem(0, blocks)._replace(error=np.full((4, 6), np.nan))
    solver = solver_of(blocks, (0.0, 1.0))
    assert solver.solve(solver.form(np, s)) is None


def test_an_answer_that_takes_too_long_is_none():
    blocks = Blocks(0.02, (1,) * 8)
    s, short = problem(4, blocks, tight=0.02), regulator().model_copy(update={"iterations": 1})
    solver = Condensed(craft(0.0, 1.0), blocks, short, 2)
    assert solver.solve(solver.form(np, s)) is None
