"""Quadratic programming solvers for the two problems of an allocation.

`constrained`: min x'Px/2 s.t. lower ≤ (x, Ax) ≤ upper, P = diag(cost).
`nearest`: min |Ax - b|²/2 + x'Dx/2 s.t. lower ≤ x ≤ upper, D = diag(ties).
Both return None where that is infeasible or was not solved. A solver is made for one problem size.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Variables = Float[np.ndarray, " m"]
Rows = Float[np.ndarray, "3 m"]
#: Of the variables, then of the rows.
Bounds = Float[np.ndarray, " m+3"]


class Piqp:
    """PIQP, the paper's solver (Schwan et al. 2023), an interior-point method."""

    # About 16 iterations solve a feasible problem. Where the bounds leave no interior it takes up
    # to 100, and the last digits of the dual are never found: the primal is judged by itself.
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
            # By default one feasible request in twenty is taken for infeasible.
            settings.eps_primal_inf = 1e-10

    def constrained(self, a: Rows, lower: Bounds, upper: Bounds) -> Variables | None:
        """Solve with Ax = b, the last three bounds."""
        lower, upper, b = lower[:-3], upper[:-3], upper[-3:]
        self._constrained.update(A=a, b=b, x_l=lower, x_u=upper)
        solved = self._constrained.solve() == self._solved
        x = np.minimum(np.maximum(self._constrained.result.x, lower), upper)
        return x if solved or np.max(np.abs(a @ x - b)) < self._EQUALITY_HOLDS else None

    def nearest(
        self, a: Rows, b: Float[np.ndarray, " 3"], lower: Variables, upper: Variables
    ) -> Variables | None:
        """Bring Ax as near to b as the bounds allow."""
        self._nearest.update(P=a.T @ a + self._ties, c=-(b @ a), x_l=lower, x_u=upper)
        solved = self._nearest.solve() == self._solved
        return np.array(self._nearest.result.x) if solved else None


class Daqp:
    """DAQP (Arnström, Bemporad and Axehill 2022), a dual active-set method."""

    _OPTIMAL = 1
    # The default, 3.7e-11, takes small requests with nearly parallel columns for infeasible ones.
    _SINGULAR = 1e-14
    # By default, 1e-6, one request in a million is missed by 1e-4 rad/s².
    _FEASIBLE = 1e-9

    def __init__(self, cost: Variables, ties: Variables) -> None:
        import daqp

        m = len(cost)
        self._solve_anew = daqp.solve
        self._ties, self._no_rows = np.diag(ties), np.zeros((0, m))
        self._bounds = np.zeros(m, dtype=np.intc)
        self._with_equality = np.concatenate([self._bounds, np.full(3, 5, dtype=np.intc)])
        # Any feasible numbers will do here: the memory is set up for their sizes.
        lower, upper = np.append(np.zeros(m), np.ones(3)), np.ones(m + 3)
        self._constrained = daqp.Model()
        self._constrained.setup(
            np.diag(cost), np.zeros(m), np.ones((3, m)), upper, lower, self._with_equality
        )
        self._constrained.settings = {"sing_tol": self._SINGULAR, "primal_tol": self._FEASIBLE}

    def constrained(self, a: Rows, lower: Bounds, upper: Bounds) -> Variables | None:
        """Solve with Ax = b, the last three bounds."""
        model = self._constrained
        # With `sense` it begins anew; otherwise from the last active set, so that an answer would
        # depend on the problem before it.
        if model.update(A=a, bupper=upper, blower=lower, sense=self._with_equality) < 0:
            return None
        x, _, flag, _ = model.solve()
        return x if flag == self._OPTIMAL else None

    def nearest(
        self, a: Rows, b: Float[np.ndarray, " 3"], lower: Variables, upper: Variables
    ) -> Variables | None:
        """Bring Ax as near to b as the bounds allow."""
        x, _, flag, _ = self._solve_anew(
            a.T @ a + self._ties, -(b @ a), self._no_rows, upper, lower, self._bounds
        )
        return x if flag == self._OPTIMAL else None


SOLVERS = {"daqp": Daqp, "piqp": Piqp}
