"""Random quadratic programs, the exported solver, and what a solution must satisfy.

A program is min x'Hx/2 + f'x subject to lower ≤ (x, Ax) ≤ upper. Its last `soft` rows may be
violated: a violation e costs penalty (e + e²/2).
"""

from __future__ import annotations

import ctypes
import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from airpuck.export.c import copy_sources

from .c_programs import build

ACCESS = Path(__file__).parent / "qp_access.c"
#: Statuses in the order of `airpuck_qp_status`.
STATUSES = (
    "solved",
    "softened",
    "inexact",
    "infeasible",
    "iteration limit",
    "not convex",
    "not finite",
)
SOLVED = ("solved", "softened")
KINDS = ("plain", "infeasible", "equalities", "dependent", "zero rows", "soft", "scaled")
#: An iteration limit that no solvable problem reaches.
ENOUGH = 2000


@dataclass(frozen=True)
class Program:
    """A quadratic program."""

    hessian: Float[np.ndarray, "n n"]
    gradient: Float[np.ndarray, " n"]
    matrix: Float[np.ndarray, "r n"]
    lower: Float[np.ndarray, " m"]
    upper: Float[np.ndarray, " m"]
    soft: int = 0
    penalty: float = 1.0

    @property
    def rows(self) -> Float[np.ndarray, "m n"]:
        """Return the rows of all constraints."""
        return np.vstack([np.eye(len(self.gradient)), self.matrix])

    @property
    def is_soft(self) -> np.ndarray:
        """Return which constraints are soft."""
        return np.arange(len(self.lower)) >= len(self.lower) - self.soft

    def scaled(self, variables: np.ndarray, rows: np.ndarray) -> Program:
        """Return the same program in other units: x / variables, and rows times a factor each."""
        units = np.concatenate([1 / variables, rows])
        return replace(
            self,
            hessian=self.hessian * np.outer(variables, variables),
            gradient=self.gradient * variables,
            matrix=self.matrix * variables * rows[:, None],
            lower=self.lower * units,
            upper=self.upper * units,
        )

    def rounded(self) -> Program:
        """Return the program with the digits of a float."""
        arrays = ("hessian", "gradient", "matrix", "lower", "upper")
        single = {a: getattr(self, a).astype(np.float32).astype(float) for a in arrays}
        return replace(self, **single)


@dataclass(frozen=True)
class Found:
    """What the exported solver returns."""

    status: str
    x: Float[np.ndarray, " n"]
    multipliers: Float[np.ndarray, " m"]
    state: Int[np.ndarray, " m"]
    iterations: int


class ExportedSolver:
    """The exported solver in a shared library."""

    def __init__(self, folder: Path, *options: str) -> None:
        copy_sources(("airpuck_qp.c", "airpuck_qp.h", "airpuck_real.h"), folder)
        shared = ("-O2", "-shared", "-fPIC")
        self._library: Any = ctypes.CDLL(
            str(build(folder / "qp.so", [folder / "airpuck_qp.c", ACCESS], *shared, *options))
        )

    def solve(self, p: Program, start: np.ndarray | None = None, most: int = ENOUGH) -> Found:
        """Solve a program, from the states of the constraints if given."""
        n, m = len(p.gradient), len(p.lower)
        given = [
            np.ascontiguousarray(array, dtype=float)
            for array in (p.hessian, p.gradient, p.matrix, p.lower, p.upper)
        ]
        state = np.zeros(m, np.int8) if start is None else np.array(start, np.int8)
        x, multipliers, iterations = np.zeros(n), np.zeros(m), ctypes.c_int()
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (*given, state, x, multipliers)]
        sizes = n, m - n, p.soft, most, ctypes.c_double(p.penalty)
        status = self._library.access_solve(*sizes, *pointers, ctypes.byref(iterations))
        return Found(STATUSES[status], x, multipliers, state, iterations.value)


def draw(
    random: np.random.Generator, kind: str, n: int | None = None, r: int | None = None
) -> Program:
    """Draw a program of a kind: up to 12 variables and 12 rows, if n and r are not given."""
    n = int(random.integers(1, 13)) if n is None else n
    r = int(random.integers(0 if kind == "plain" else 2, 13)) if r is None else r
    m = n + r
    root = random.normal(size=(n, n))
    hessian = root @ root.T + 10 ** random.uniform(-4, 0) * np.eye(n)
    gradient = random.normal(size=n) * 10 ** random.uniform(-1, 1.5)
    matrix, inside = random.normal(size=(r, n)), random.normal(size=n)
    if kind == "dependent":
        matrix[0] = matrix[1] * random.choice([-2.0, 0.5, 1.0])
        matrix[random.integers(r)] = matrix[:2].sum(axis=0)
    if kind == "zero rows":
        matrix[random.integers(r)] = 0
    at = np.concatenate([inside, matrix @ inside])
    lower, upper = (at - random.exponential(1, m), at + random.exponential(1, m))
    lower[random.random(m) < 0.3], upper[random.random(m) < 0.3] = -np.inf, np.inf
    program = Program(hessian, gradient, matrix, lower, upper)
    if kind == "dependent":
        # Degenerate: the solution may lie where more than n constraints meet.
        meeting = random.random(m) < 0.3
        return replace(program, lower=np.where(meeting, at, lower))
    if kind == "equalities":
        equal = random.random(m) < min(0.4, 0.7 * n / m)
        return replace(program, lower=np.where(equal, at, lower), upper=np.where(equal, at, upper))
    if kind in ("infeasible", "zero rows"):
        lower = lower + random.normal(size=m) * 2
        return replace(program, lower=lower, upper=np.maximum(upper, lower))
    if kind == "soft":
        soft = int(random.integers(1, r + 1))
        lower[m - soft :] += random.normal(size=soft) * 3
        return replace(
            program,
            upper=np.maximum(upper, lower),
            soft=soft,
            penalty=10 ** random.uniform(-1, 3),
        )
    return program


def residual(p: Program, found: Found) -> float:
    """Return the largest violation of the KKT conditions, in scaled units.

    The gradient of the Lagrangian is relative to its terms. Constraints are relative to the length
    of their row and of the solution in the metric of the Hessian.
    """
    x, multipliers, rows = found.x, found.multipliers, p.rows
    terms = np.abs(p.hessian) @ np.abs(x) + np.abs(p.gradient) + np.abs(rows.T) @ abs(multipliers)
    gradient = p.hessian @ x + p.gradient - rows.T @ multipliers
    stationary = np.max(np.abs(gradient) / np.maximum(terms, 1e-300))
    factor = np.linalg.cholesky(p.hessian).T
    size = np.linalg.norm(factor @ x) + np.linalg.norm(np.linalg.solve(factor.T, p.gradient))
    unit = np.linalg.norm(np.linalg.solve(factor.T, rows.T), axis=0) * size
    value = rows @ x
    violation = np.maximum(np.maximum(p.lower - value, value - p.upper), 0)
    allowed = np.where(p.is_soft, np.maximum(np.abs(multipliers) / p.penalty - 1, 0), 0)
    limit = np.where(multipliers > 0, p.lower, p.upper)
    apart = np.where((multipliers != 0) & (allowed == 0), np.abs(value - limit), 0)
    met = np.maximum(np.abs(violation - allowed), apart)[unit > 0] / unit[unit > 0]
    return float(max(stationary, np.max(met, initial=0)))


def by_enumeration(p: Program) -> np.ndarray | None:
    """Return the solution of a small program without soft rows: try every active set."""
    n, rows, best, lowest = len(p.gradient), p.rows, None, np.inf
    for sides in itertools.product((0, 1, -1), repeat=len(p.lower)):
        active = np.flatnonzero(sides)
        limit = np.where(np.array(sides) > 0, p.lower, p.upper)[active]
        if len(active) > n or not np.isfinite(limit).all():
            continue
        normals = rows[active]
        system = np.block([[p.hessian, -normals.T], [normals, np.zeros((len(active),) * 2)]])
        if np.linalg.matrix_rank(normals, tol=1e-5) < len(active):
            continue
        x = np.linalg.solve(system, np.concatenate([-p.gradient, limit]))[:n]
        value = rows @ x
        if (value < p.lower - 1e-9).any() or (value > p.upper + 1e-9).any():
            continue
        cost = x @ p.hessian @ x / 2 + p.gradient @ x
        if cost < lowest:
            best, lowest = x, cost
    return best


def by_daqp(p: Program) -> tuple[bool, np.ndarray]:
    """Return DAQP's verdict on feasibility, and its solution."""
    import daqp

    m = len(p.lower)
    sense = np.where(p.is_soft, 8, 0).astype(np.intc)
    bounds = np.clip(p.upper, -1e30, 1e30), np.clip(p.lower, -1e30, 1e30)
    model = daqp.Model()
    flag = model.setup(p.hessian, p.gradient, p.matrix, *bounds, sense)
    if (flag[0] if isinstance(flag, tuple) else flag or 0) < 0:
        return False, np.full(len(p.gradient), np.nan)
    model.settings = {"primal_tol": 1e-10, "iter_limit": 10_000}
    linear, curved = np.full(m, p.penalty), np.full(m, 1 / p.penalty)
    model.soft_weights(rho_l=curved, rho_u=curved, w_l=linear, w_u=linear)
    x, _, flag, _ = model.solve()
    return flag > 0, np.array(x)


def by_piqp(p: Program) -> tuple[bool, np.ndarray]:
    """Return PIQP's verdict on feasibility, and its solution; soft rows become variables."""
    import piqp

    n, s = len(p.gradient), p.soft
    hessian = np.block(
        [
            [p.hessian, np.zeros((n, 2 * s))],
            [np.zeros((2 * s, n)), p.penalty * np.eye(2 * s)],
        ]
    )
    gradient = np.concatenate([p.gradient, np.full(2 * s, p.penalty)])
    slack = np.zeros((len(p.matrix), 2 * s))
    slack[len(p.matrix) - s :] = np.hstack([np.eye(s), -np.eye(s)])
    # It warns of rows without a finite bound.
    bounded = np.isfinite(p.lower[n:]) | np.isfinite(p.upper[n:])
    solver = piqp.DenseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-11
    solver.settings.check_duality_gap = False
    solver.settings.max_iter = 500
    solver.setup(
        hessian,
        gradient,
        G=np.hstack([p.matrix, slack])[bounded],
        h_l=p.lower[n:][bounded],
        h_u=p.upper[n:][bounded],
        x_l=np.concatenate([p.lower[:n], np.zeros(2 * s)]),
        x_u=np.concatenate([p.upper[:n], np.full(2 * s, np.inf)]),
    )
    return solver.solve() == piqp.PIQP_SOLVED, np.array(solver.result.x[:n])
