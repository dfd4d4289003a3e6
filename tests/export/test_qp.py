"""The exported solver of quadratic programs against the KKT conditions, enumeration and DAQP."""

from dataclasses import replace

import numpy as np
import pytest

from ..apparatus.c_programs import SINGLE
from ..apparatus.quadratic_programs import (
    KINDS,
    SOLVED,
    ExportedSolver,
    Program,
    by_daqp,
    by_enumeration,
    draw,
    residual,
)


@pytest.fixture(scope="module")
def solver(tmp_path_factory) -> ExportedSolver:
    return ExportedSolver(tmp_path_factory.mktemp("qp"))


@pytest.fixture(scope="module")
def single(tmp_path_factory) -> ExportedSolver:
    return ExportedSolver(tmp_path_factory.mktemp("single"), *SINGLE)


def unit_square(**changes: object) -> Program:
    """Return min |x|² / 2 - 2 x_1 with x in the unit square."""
    given = np.eye(2), np.array([-2.0, 0.0]), np.zeros((0, 2)), np.zeros(2), np.ones(2)
    return replace(Program(*given), **changes)


@pytest.mark.parametrize("kind", KINDS)
def test_solutions_satisfy_the_kkt_conditions_and_match_daqp(kind, solver):
    random = np.random.default_rng(KINDS.index(kind))
    for k in range(150):
        program = posed = draw(random, kind)
        units = np.ones(len(program.gradient))
        if kind == "scaled":
            units = 10 ** random.uniform(-8, 8, len(units))
            rows = 10 ** random.uniform(-8, 8, len(program.matrix))
            posed = program.scaled(units, rows)
        start = random.integers(-5, 6, len(program.lower)) if k % 2 else None
        found, (feasible, x) = solver.solve(posed, start), by_daqp(program)
        assert (found.status in SOLVED) == feasible
        if feasible:
            assert residual(posed, found) < 1e-9
            apart = np.linalg.norm(found.x * units - x)
            assert apart <= 1e-9 * np.linalg.cond(program.hessian) * np.linalg.norm(x)


def test_no_other_active_set_is_better(solver):
    random = np.random.default_rng(1)
    verdicts = set()
    for k in range(40):
        program = draw(random, KINDS[k % 5], n=3, r=3)
        found, best = solver.solve(program), by_enumeration(program)
        verdicts.add(found.status)
        assert (found.status == "solved") == (best is not None)
        if best is not None:
            np.testing.assert_allclose(found.x, best, atol=1e-8)
    assert verdicts == {"solved", "infeasible"}


def test_single_precision_is_as_accurate_as_the_condition_allows(single):
    random = np.random.default_rng(2)
    lost = []
    for k in range(200):
        program = draw(random, ("plain", "soft")[k % 2]).rounded()
        found, (feasible, x) = single.solve(program), by_daqp(program)
        assert (found.status in SOLVED) == feasible
        condition = np.linalg.cond(program.hessian)
        lost.append(np.linalg.norm(found.x - x) / np.linalg.norm(x) / condition)
    assert np.quantile(lost, 0.95) < 10 * np.finfo(np.float32).eps


def test_a_warm_start_needs_at_most_two_iterations(solver):
    random = np.random.default_rng(3)
    for kind in ("plain", "soft", "equalities"):
        program = draw(random, kind, n=10, r=10)
        cold = solver.solve(program)
        warm = solver.solve(program, cold.state)
        assert warm.iterations <= 2 < cold.iterations
        np.testing.assert_allclose(warm.x, cold.x, rtol=1e-9, atol=1e-12)


def test_a_soft_row_is_exceeded_at_its_price(solver):
    # min x²/2 - 2x with x ≤ 0 soft: x = e, and 2 - e = penalty (1 + e).
    line = replace(unit_square(), hessian=np.eye(1), gradient=np.array([-2.0]))
    soft = replace(
        line,
        matrix=np.ones((1, 1)),
        lower=np.full(2, -np.inf),
        upper=np.array([np.inf, 0.0]),
        soft=1,
    )
    for penalty, x in ((0.5, 1.0), (1.0, 0.5), (2.0, 0.0), (50.0, 0.0)):
        found = solver.solve(replace(soft, penalty=penalty))
        assert found.status == ("softened" if x > 0 else "solved")
        np.testing.assert_allclose(found.x, x, atol=1e-12)


@pytest.mark.parametrize(
    ("program", "status"),
    [
        (unit_square(), "solved"),
        (unit_square(upper=np.array([1.0, -1.0])), "infeasible"),
        (unit_square(lower=np.array([0.0, np.inf])), "not finite"),
        (unit_square(gradient=np.array([np.nan, 0.0])), "not finite"),
        (unit_square(hessian=np.diag([np.inf, 1.0])), "not finite"),
        (unit_square(hessian=np.diag([1.0, 0.0])), "not convex"),
        (unit_square(hessian=np.diag([1.0, -1.0])), "not convex"),
        (unit_square(hessian=np.ones((2, 2))), "not convex"),
    ],
)
def test_every_outcome_has_its_status(program, status, solver, single):
    assert solver.solve(program).status == status
    assert single.solve(program).status == status


def test_zero_limits_without_a_gradient_are_met_exactly(solver):
    program = unit_square(gradient=np.zeros(2), upper=np.array([0.0, 1.0]))
    for start in ([0, 0], [1, 1]):
        found = solver.solve(program, np.array(start))
        assert found.status == "solved"
        np.testing.assert_array_equal(found.x, 0.0)


@pytest.mark.parametrize("penalty", [1e3, 1e6])
def test_a_hard_limit_takes_precedence_over_a_stiff_soft_row(penalty, solver, single):
    # x = 1 is hard, x ≤ 0 soft: the violation is 1, whatever it costs.
    for one in (solver, single):
        found = one.solve(
            Program(
                np.eye(1),
                np.zeros(1),
                np.ones((1, 1)),
                np.array([1.0, -np.inf]),
                np.array([1.0, 0.0]),
                soft=1,
                penalty=penalty,
            )
        )
        assert found.status == "softened"
        np.testing.assert_allclose(found.x, 1.0, rtol=1e-5)


def test_the_solver_recovers_after_an_infeasible_program(solver):
    random = np.random.default_rng(5)
    for _ in range(20):
        program = draw(random, "plain", n=4, r=4)
        closed = replace(program, lower=program.lower.copy(), upper=program.upper.copy())
        closed.lower[:4], closed.upper[:4] = 5.0, 6.0
        closed.lower[4:], closed.upper[4:] = -1e3, np.minimum(closed.matrix.sum(axis=1) * 5, 0) - 9
        state = solver.solve(closed).state
        again, cold = solver.solve(program, state), solver.solve(program)
        assert again.status == cold.status == "solved"
        np.testing.assert_allclose(again.x, cold.x, rtol=1e-8, atol=1e-10)


def test_iterations_are_bounded(solver):
    program = draw(np.random.default_rng(4), "soft", n=12, r=12)
    needed = solver.solve(program).iterations
    assert solver.solve(program, most=needed).status in SOLVED
    stopped = solver.solve(program, most=needed - 1)
    assert stopped.status == "iteration limit"
    assert np.isfinite(stopped.x).all()
