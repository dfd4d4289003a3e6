"""Thrust allocation: from requested accelerations to thrusts (eq. force_qp).

An allocation has two quadratic programs:

`constrained`: min x'Px/2 s.t. lower ≤ (x, Ax) ≤ upper, P = diag(cost).
`nearest`: min |Ax - b|²/2 + x'Dx/2 s.t. lower ≤ x ≤ upper, D = diag(ties).
Both return None where that is infeasible or was not solved. A solver is made for one problem size.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

Variables = Float[np.ndarray, " m"]
Constraints = Float[np.ndarray, "3 m"]
#: Bounds of the variables, then of the rows.
Bounds = Float[np.ndarray, " m+3"]
#: Status of a request. ``exact``: met. ``scaled``: the linear or angular acceleration is reduced
#: along its direction (s1, s2 < 1). ``nearest``: no scaled request is feasible; the thrusts give
#: the nearest acceleration. ``failed``: the solver found no solution; the thrusts are the lowest
#: allowed.
AllocationStatus = Literal["exact", "scaled", "nearest", "failed"]
#: A request counts as fully met if both slacks are this close to 1.
UNSCALED = 1e-6
#: Weights of slacks and thrusts relative to the distance in the nearest-acceleration problem: small
#: enough not to change the distance, large enough to choose among equally near solutions.
TIE_SLACK, TIE_THRUST = 1e-7, 1e-8


class Piqp:
    """PIQP, the paper's solver (Schwan et al. 2023), an interior-point method."""

    # About 16 iterations solve a feasible problem. If the bounds leave no interior it takes up to
    # 100, and the dual never reaches full precision: convergence is judged by the primal alone.
    _MOST_ITERATIONS = 100
    _EQUALITY_HOLDS = 1e-8

    def __init__(self, cost: Variables, ties: Variables) -> None:
        import piqp

        m = len(cost)
        self._ties = np.diag(ties)
        self._solved = piqp.PIQP_SOLVED
        # Any feasible numbers will do here: the solvers are set up for their sizes.
        a, zeros, ones = np.ones((3, m)), np.zeros(m), np.ones(m)
        self._constrained = piqp.DenseSolver()
        self._constrained.setup(np.diag(cost), zeros, a, np.ones(3), x_l=zeros, x_u=ones)
        self._nearest = piqp.DenseSolver()
        self._nearest.setup(a.T @ a + self._ties, zeros, x_l=zeros, x_u=ones)
        for solver in (self._constrained, self._nearest):
            settings = solver.settings
            settings.max_iter = self._MOST_ITERATIONS
            # Less regularisation than by default: the problems are small and well scaled.
            settings.rho_init = settings.delta_init = 1e-8
            settings.eps_abs = settings.eps_rel = 1e-11
            settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = 1e-11
            # With the default, one feasible request in twenty is reported infeasible.
            settings.eps_primal_inf = 1e-10

    def constrained(self, a: Constraints, lower: Bounds, upper: Bounds) -> Variables | None:
        """Solve with Ax = b; the last three bounds are b."""
        lower, upper, b = lower[:-3], upper[:-3], upper[-3:]
        self._constrained.update(A=a, b=b, x_l=lower, x_u=upper)
        solved = self._constrained.solve() == self._solved
        x = np.minimum(np.maximum(self._constrained.result.x, lower), upper)
        return x if solved or np.max(np.abs(a @ x - b)) < self._EQUALITY_HOLDS else None

    def nearest(
        self, a: Constraints, b: Float[np.ndarray, " 3"], lower: Variables, upper: Variables
    ) -> Variables | None:
        """Bring Ax as near to b as the bounds allow."""
        self._nearest.update(P=a.T @ a + self._ties, c=-(b @ a), x_l=lower, x_u=upper)
        solved = self._nearest.solve() == self._solved
        return np.array(self._nearest.result.x) if solved else None


class Daqp:
    """DAQP (Arnström, Bemporad and Axehill 2022), a dual active-set method."""

    _OPTIMAL = 1
    # The default, 3.7e-11, reports small requests with nearly parallel columns as infeasible.
    _SINGULAR = 1e-14
    # The default, 1e-6, misses one request in a million by 1e-4 rad/s².
    _FEASIBLE = 1e-9

    def __init__(self, cost: Variables, ties: Variables) -> None:
        import daqp

        m = len(cost)
        self._solve_anew = daqp.solve
        self._ties, self._no_rows = np.diag(ties), np.zeros((0, m))
        self._bounds = np.zeros(m, dtype=np.intc)
        self._with_equality = np.concatenate([self._bounds, np.full(3, 5, dtype=np.intc)])
        # Any feasible numbers will do here: DAQP allocates its memory for their sizes.
        lower, upper = np.append(np.zeros(m), np.ones(3)), np.ones(m + 3)
        self._constrained = daqp.Model()
        self._constrained.setup(
            np.diag(cost), np.zeros(m), np.ones((3, m)), upper, lower, self._with_equality
        )
        self._constrained.settings = {"sing_tol": self._SINGULAR, "primal_tol": self._FEASIBLE}

    def constrained(self, a: Constraints, lower: Bounds, upper: Bounds) -> Variables | None:
        """Solve with Ax = b; the last three bounds are b."""
        model = self._constrained
        # With `sense` it starts cold; otherwise it starts from the last active set, so an answer
        # would depend on the previous problem.
        if model.update(A=a, bupper=upper, blower=lower, sense=self._with_equality) < 0:
            return None
        x, _, flag, _ = model.solve()
        return x if flag == self._OPTIMAL else None

    def nearest(
        self, a: Constraints, b: Float[np.ndarray, " 3"], lower: Variables, upper: Variables
    ) -> Variables | None:
        """Bring Ax as near to b as the bounds allow."""
        x, _, flag, _ = self._solve_anew(
            a.T @ a + self._ties, -(b @ a), self._no_rows, upper, lower, self._bounds
        )
        return x if flag == self._OPTIMAL else None


SOLVERS = {"daqp": Daqp, "piqp": Piqp}


def problem(
    xp: Any,
    arm: float,
    slack_weight: float,
    request: Any,
    matrix: Any,
    offset: Any,
    lower: Any,
    upper: Any,
) -> tuple[Any, Any, Any, Any]:
    """Write eq. force_qp for a solver; x contains the thrusts and the scaled slacks √μ(1 - s).

    This makes the Hessian the identity, so the tolerance means the same for all variables.
    """
    rows, root = xp.array([1.0, 1.0, arm]), math.sqrt(slack_weight)
    asked = rows * request
    turns = np.array([False, False, True])
    slacks = xp.stack([xp.where(turns, 0.0, asked), xp.where(turns, asked, 0.0)], axis=1) / root
    a = xp.concatenate([rows[:, None] * matrix, slacks], axis=1)
    b = asked - rows * offset
    lower = xp.concatenate([lower, np.zeros(2), b])
    upper = xp.concatenate([upper, np.full(2, root), b])
    finite = xp.isfinite(a).all() & xp.isfinite(lower).all() & xp.isfinite(upper).all()
    return a, lower, upper, finite


def all_finite(values: Float[np.ndarray, " k"]) -> bool:
    """Return whether a few numbers are all finite, faster than any NumPy call."""
    return all(map(math.isfinite, values.tolist()))


class ThrustAllocator:
    """Allocates thrusts to the propellers to give a requested acceleration.

    The paper's problem (eq. force_qp),

        min |F|² + μ(1 - s1)² + μ(1 - s2)²
        s.t. (s1 vx, s1 vy, s2 v_ω) = M F + g,  lower ≤ F ≤ upper,  0 ≤ s1, s2 ≤ 1,

    scales a request down when it cannot be met. It is not always feasible: the motor lag makes the
    lower bounds positive, so even zero acceleration (s1 = s2 = 0) may be out of reach. The
    allocator then gives the acceleration nearest to a scaled request. This is the limit of an exact
    penalty on the equality as its weight grows. (A finite weight does not work: the multiplier of
    the equality grows like 2μ/|v|, and a weight above it for every request would leave no digits
    for |F|².)

    Parameters
    ----------
    n_propellers : int
        Number of propellers.
    arm : float
        Length that makes angular accelerations comparable with linear ones, usually the radius of
        gyration √(I/m) [m].
    slack_weight : float, default 1e6
        μ. Large enough that scaling is the last resort: thrusts are below 1 N, so |F|² is of order
        1.
    solver : {"daqp", "piqp"}, default "daqp"
        Both solvers give the same answers.
    """

    def __init__(
        self,
        n_propellers: int,
        arm: float,
        slack_weight: float = 1e6,
        solver: Literal["daqp", "piqp"] = "daqp",
    ) -> None:
        self.arm, self.slack_weight = arm, slack_weight
        self._n, self._root = n_propellers, math.sqrt(slack_weight)
        sizes = n_propellers, 2
        ties = np.repeat([TIE_THRUST, TIE_SLACK], sizes)
        self._solver = SOLVERS[solver](np.full(len(ties), 2.0), ties)
        # Scale √μ(1 - s) back to 1 - s, whose size suits the distance.
        self._unscale = np.repeat([1.0, self._root], sizes)

    def solve(
        self, a: Constraints, lower: Bounds, upper: Bounds, finite: Any
    ) -> tuple[Variables | None, AllocationStatus]:
        """Solve the program that `problem` wrote.

        Parameters
        ----------
        a, lower, upper, finite : array
            The problem.

        Returns
        -------
        x : array, shape (n + 2,), or None
            Thrusts [N], within their bounds up to the solver's tolerance, and √μ(1 - s); None if
            the solver failed.
        status : {"exact", "scaled", "nearest", "failed"}
            Status of the request.
        """
        if not finite:
            return None, "failed"
        status: AllocationStatus = "scaled"
        x = self._solver.constrained(a, lower, upper)
        if x is None:
            status, u = "nearest", self._unscale
            x = self._solver.nearest(a * u, upper[-3:], lower[:-3] / u, upper[:-3] / u)
            x = None if x is None else x * u
        if x is None or not all_finite(x):
            return None, "failed"
        if status == "scaled" and 1 - max(x[self._n :].tolist()) / self._root > 1 - UNSCALED:
            status = "exact"
        return x, status
