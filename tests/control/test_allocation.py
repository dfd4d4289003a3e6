"""Thrust allocation, against linear programming, Lawson and Hanson's least distance, and BVLS."""

from functools import cache
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog, lsq_linear, nnls

from airpuck.control.allocation import Daqp, Piqp
from airpuck.control.lqr import motor_lag
from airpuck.model.model_file import read_model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.physics.thrust import thrust

from ..apparatus.allocators import Allocator

MODEL = read_model("paper:M4")
ARM = float(np.sqrt(MODEL.parameters.inertia / MODEL.vehicle.mass_kg))
ROWS = np.array([1.0, 1.0, ARM])
SLACK_WEIGHT = 1e6
SOLVERS: tuple[Literal["daqp", "piqp"], ...] = ("daqp", "piqp")
#: Sum of equality violations [m/s²] below which a problem counts as feasible, or above, infeasible.
FEASIBLE, INFEASIBLE = 1e-10, 1e-6


def random_problem(random: np.random.Generator) -> tuple[np.ndarray, ...]:
    """A state of the published M4, a request, and the bounds that the motor lag leaves."""
    dynamics, least = MODEL.dynamics, MODEL.vehicle.command_min
    speed = random.uniform(least, 1, 6)
    matrix, offset = acceleration_map(
        np, dynamics, random.uniform(-np.pi, np.pi), 3 * random.normal()
    )
    lag, drive = motor_lag(float(dynamics.motor_time_constant), 0.01)
    low = thrust(dynamics.thrust, lag * speed + drive * least)
    high = thrust(dynamics.thrust, lag * speed + drive)
    request = 10 ** random.uniform(-2, 1) * random.normal(size=3) / ROWS
    return request, matrix, offset, low, high


def stacked(problem: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """The same as A (F, s1, s2) = b with bounds on (F, s1, s2); rows in m/s²."""
    request, matrix, offset, low, high = problem
    linear, angular = request * [1, 1, 0], request * [0, 0, 1]
    a = ROWS[:, None] * np.column_stack([matrix, -linear, -angular])
    return a, -ROWS * offset, np.append(low, [0, 0]), np.append(high, [1, 1])


def violation(a, b, lower, upper) -> float:
    """The least sum of |A x - b| within the bounds, by HiGHS."""
    rows, columns = a.shape
    found: Any = linprog(
        np.append(np.zeros(columns), np.ones(2 * rows)),
        A_eq=np.hstack([a, np.eye(rows), -np.eye(rows)]),
        b_eq=b,
        bounds=[*zip(lower, upper, strict=True), *[(0, None)] * (2 * rows)],
        method="highs",
    )
    assert found.status == 0
    return found.fun


def least_distance(a, b, lower, upper) -> np.ndarray:
    """eq. force_qp by Lawson and Hanson (1974), chapter 23: least distance as an NNLS problem."""
    n = len(lower) - 2
    # x = c + T z with |z|² the cost.
    c, t = np.append(np.zeros(n), [1, 1]), np.append(np.ones(n), [-1e-3, -1e-3])
    ends = np.sort([(lower - c) / t, (upper - c) / t], axis=0)
    a_z, b_z = a * t, b - a @ c
    middle = np.linalg.lstsq(a_z, b_z, rcond=None)[0]
    null = np.linalg.svd(a_z)[2][len(a) :].T
    g, h = np.vstack([null, -null]), np.append(ends[0] - middle, middle - ends[1])
    scale = max(1.0, h.max())
    e = np.vstack([g.T, h / scale])
    f = np.append(np.zeros(len(e) - 1), 1.0)
    residual = e @ nnls(e, f)[0] - f
    y = -residual[:-1] / residual[-1] * scale
    return c + t * (middle + null @ y)


@cache
def sample() -> list[tuple[tuple[np.ndarray, ...], float]]:
    """Return random problems and their violations; none at the border of feasibility."""
    random = np.random.default_rng(7)
    problems = [random_problem(random) for _ in range(600)]
    judged = [(problem, violation(*stacked(problem))) for problem in problems]
    clear = [(p, v) for p, v in judged if v < FEASIBLE or v > INFEASIBLE]
    assert len(clear) > 0.99 * len(judged)
    assert 0.25 < np.mean([v < FEASIBLE for _, v in clear]) < 0.75  # enough of each
    return clear


def allocator(solver: Literal["daqp", "piqp"] = "daqp", n: int = 6) -> Allocator:
    return Allocator(n, ARM, SLACK_WEIGHT, solver)


@pytest.fixture(params=SOLVERS)
def solver(request):
    return request.param


@pytest.mark.slow
def test_both_solvers_agree():
    daqp, piqp = (allocator(solver) for solver in SOLVERS)
    for problem, _ in sample():
        one, other = daqp.allocate(*problem), piqp.allocate(*problem)
        assert one.outcome == other.outcome
        np.testing.assert_allclose(one.thrust, other.thrust, atol=1e-6)
        assert one.linear_scale == pytest.approx(other.linear_scale, abs=1e-6)
        assert one.angular_scale == pytest.approx(other.angular_scale, abs=1e-6)


def test_feasible_requests_get_the_papers_solution_which_meets_them(solver):
    ours = allocator(solver)
    outcomes = set()
    for problem, infeasibility in sample():
        if infeasibility > FEASIBLE:
            continue
        request, matrix, offset, _, _ = problem
        found = ours.allocate(*problem)
        asked = request * [found.linear_scale, found.linear_scale, found.angular_scale]
        np.testing.assert_allclose(ROWS * (matrix @ found.thrust + offset - asked), 0, atol=1e-7)
        expected = least_distance(*stacked(problem))
        np.testing.assert_allclose(found.thrust, expected[:-2], atol=1e-6)
        assert (found.linear_scale, found.angular_scale) == pytest.approx(expected[-2:], abs=1e-6)
        outcomes.add(found.outcome)
        assert (found.outcome == "exact") == (expected[-2:].min() > 1 - 1e-6)
    assert outcomes == {"exact", "scaled"}


def test_infeasible_requests_get_the_nearest_acceleration(solver):
    ours = allocator(solver)
    for problem, infeasibility in sample():
        if infeasibility < INFEASIBLE:
            continue
        matrix = problem[1]
        found = ours.allocate(*problem)
        assert found.outcome == "nearest"
        a, b, lower, upper = stacked(problem)
        nearest: Any = lsq_linear(a, b, (lower, upper), method="bvls", tol=1e-15, max_iter=500)
        assert nearest.success
        # The nearest possible; the choice among equally near ones moves the acceleration by 1e-6.
        reached = a @ np.append(found.thrust, [found.linear_scale, found.angular_scale]) - b
        least = a @ nearest.x - b
        tolerance = 1e-10 if solver == "daqp" else 1e-7
        assert np.linalg.norm(reached) <= np.linalg.norm(least) + tolerance
        np.testing.assert_allclose(reached, least, atol=3e-6)
        given = ROWS * (matrix @ (found.thrust - nearest.x[:-2]))
        np.testing.assert_allclose(given, 0, atol=3e-6)


def test_a_request_that_thrusts_within_bounds_can_meet_is_met(solver):
    ours, random, exact = allocator(solver), np.random.default_rng(3), 0
    for _ in range(100):
        _, matrix, offset, low, high = random_problem(random)
        force = random.uniform(low, high)
        request = matrix @ force + offset
        found = ours.allocate(request, matrix, offset, low, high)
        # eq. force_qp trades a fraction |F|²/μ of the request for less thrust.
        assert (found.linear_scale, found.angular_scale) == pytest.approx((1, 1), abs=5e-6)
        np.testing.assert_allclose(ROWS * (matrix @ (found.thrust - force)), 0, atol=2e-5)
        # And with no more thrust than necessary.
        assert np.linalg.norm(found.thrust) <= np.linalg.norm(force) + 1e-9
        exact += found.outcome == "exact"
    assert exact >= 95


def test_without_active_bounds_thrusts_are_the_least_squares_solution(solver):
    ours, random = allocator(solver), np.random.default_rng(4)
    for _ in range(20):
        request, matrix, offset, _, _ = random_problem(random)
        wide = np.full(6, 1e3)
        found = ours.allocate(request, matrix, offset, -wide, wide)
        expected = np.linalg.pinv(matrix) @ (request - offset)
        np.testing.assert_allclose(found.thrust, expected, rtol=1e-5, atol=1e-6)


#: Pushes to the right, left, up and down; the first two turn it left, the others right.
CROSS = np.array([[1.0, -1, 0, 0], [0, 0, 1, -1], [1, 1, -1, -1]])


def test_a_request_twice_too_large_is_halved(solver):
    ours = Allocator(4, 1.0, SLACK_WEIGHT, solver)
    nothing, one = np.zeros(4), np.ones(4)
    found = ours.allocate(np.array([2.0, 0, 0]), CROSS, np.zeros(3), nothing, one)
    assert found.outcome == "scaled"
    assert (found.linear_scale, found.angular_scale) == pytest.approx((0.5, 1), abs=1e-6)
    np.testing.assert_allclose(found.thrust, [1, 0, 0.5, 0.5], atol=1e-6)
    # Turning alone: two propellers of one newton each, four newtons requested.
    found = ours.allocate(np.array([0, 0, -4.0]), CROSS, np.zeros(3), nothing, one)
    assert (found.linear_scale, found.angular_scale) == pytest.approx((1, 0.5), abs=3e-6)
    np.testing.assert_allclose(found.thrust, [0, 0, 1, 1], atol=3e-6)


def test_residual_thrust_gives_the_nearest_acceleration(solver):
    # The right propeller gives at least 1 N, the left one at most 0.5 N. So the craft accelerates
    # to the right by at least 0.5 m/s², the nearest to a request to the left.
    ours = Allocator(4, 1.0, SLACK_WEIGHT, solver)
    low, high = np.array([1, 0, 0, 0.0]), np.array([2, 0.5, 1, 1.0])
    found = ours.allocate(np.array([-3.0, 0, 0]), CROSS, np.zeros(3), low, high)
    assert found.outcome == "nearest"
    np.testing.assert_allclose(CROSS @ found.thrust, [0.5, 0, 0], atol=1e-6)
    assert found.linear_scale == pytest.approx(0, abs=1e-6)
    np.testing.assert_allclose(found.thrust, [1, 0.5, 0.75, 0.75], atol=1e-6)


number = st.floats(-1e3, 1e3)


@st.composite
def crafts(draw):
    """Any request to any craft in any state, even a craft that cannot turn."""
    n = draw(st.sampled_from([3, 4, 6, 8]))
    matrix = draw(st.lists(number, min_size=3 * n, max_size=3 * n))
    low = np.array(draw(st.lists(st.floats(0, 0.5), min_size=n, max_size=n)))
    width = np.array(draw(st.lists(st.floats(0, 0.5), min_size=n, max_size=n)))
    request = draw(st.lists(number, min_size=3, max_size=3))
    offset = draw(st.lists(st.floats(-10, 10), min_size=3, max_size=3))
    return np.array(request), np.array(matrix).reshape(3, n), np.array(offset), low, low + width


@given(crafts(), st.sampled_from(SOLVERS))
def test_thrusts_are_finite_and_within_bounds_for_any_craft(craft, solver):
    _, _, _, low, high = craft
    found = allocator(solver, len(low)).allocate(*craft)
    assert np.isfinite(found.thrust).all()
    assert (low <= found.thrust).all()
    assert (found.thrust <= high).all()
    assert np.isfinite([found.linear_scale, found.angular_scale]).all()


@pytest.mark.parametrize("n", [3, 4, 6, 8])
def test_allocation_matches_the_paper_for_any_number_of_propellers(solver, n):
    ours, random = allocator(solver, n), np.random.default_rng(n)
    feasible = 0
    for _ in range(60):
        angle, push = np.sort(random.uniform(0, 2 * np.pi, n)), random.uniform(0, 2 * np.pi, n)
        matrix = np.stack([np.cos(push), np.sin(push), np.sin(push - angle) / ARM]) * 7
        low = random.uniform(0, 0.02, n)
        problem = random.normal(size=3) / ROWS, matrix, np.zeros(3), low, low + 0.6
        found, infeasibility = ours.allocate(*problem), violation(*stacked(problem))
        if infeasibility > INFEASIBLE:
            assert found.outcome == "nearest"
        elif infeasibility < FEASIBLE:
            feasible += 1
            expected = least_distance(*stacked(problem))
            np.testing.assert_allclose(found.thrust, expected[:-2], atol=1e-6)
    assert feasible >= 5


@pytest.mark.parametrize("where", range(5))
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nan_gives_the_lowest_thrusts_without_side_effects(solver, bad, where):
    ours, fresh = allocator(solver), allocator(solver)
    good = random_problem(np.random.default_rng(11))
    if where < 3:
        problem = tuple(part.copy() for part in good)
        problem[where].flat[1] = bad
        found = ours.allocate(*problem)
        assert found.outcome == "failed"
        np.testing.assert_array_equal(found.thrust, good[3])
    else:
        ours.allocate(np.full(3, bad), *good[1:])
    again, expected = ours.allocate(*good), fresh.allocate(*good)
    assert again.outcome == expected.outcome
    np.testing.assert_allclose(again.thrust, expected.thrust, atol=1e-9)


@pytest.mark.parametrize("answer", [None, np.full(8, np.nan)])
@pytest.mark.parametrize("kind", [Daqp, Piqp])
def test_a_failing_solver_gives_the_lowest_thrusts(monkeypatch, kind, answer):
    solver = "daqp" if kind is Daqp else "piqp"
    problem = random_problem(np.random.default_rng(5))
    ours = allocator(solver)
    with monkeypatch.context() as broken:
        broken.setattr(kind, "constrained", lambda *_: answer)
        broken.setattr(kind, "nearest", lambda *_: answer)
        found = ours.allocate(*problem)
    assert found.outcome == "failed"
    np.testing.assert_array_equal(found.thrust, problem[3])
    assert found.thrust is not problem[3]
    assert ours.allocate(*problem).outcome != "failed"


@pytest.mark.parametrize("kind", [Daqp, Piqp])
def test_crossed_bounds_have_no_solution_and_no_side_effects(kind):
    solver, a = kind(np.full(8, 2.0), np.full(8, 1e-8)), np.eye(3, 8)
    lower, upper = np.zeros(11), np.ones(11)
    lower[8:] = upper[8:] = 0.5
    expected = [0.5, 0.5, 0.5, 0, 0, 0, 0, 0]
    np.testing.assert_allclose(solver.constrained(a, lower, upper), expected, atol=5e-6)
    crossed = upper.copy()
    crossed[1] = -1.0
    assert solver.constrained(a, lower, crossed) is None
    np.testing.assert_allclose(solver.constrained(a, lower, upper), expected, atol=5e-6)


def test_a_solution_does_not_depend_on_the_previous_problem():
    ours, random = allocator(), np.random.default_rng(21)
    for _ in range(50):
        one, other = random_problem(random), random_problem(random)
        first = ours.allocate(*one)
        ours.allocate(*other)
        np.testing.assert_array_equal(ours.allocate(*one).thrust, first.thrust)
