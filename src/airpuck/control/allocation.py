"""Thrust allocation: from accelerations asked for to thrusts (eq. force_qp)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

#: What became of a request. ``exact``: met. ``scaled``: linear or angular acceleration reduced in
#: its direction (s1, s2 < 1). ``nearest``: no scaling of it can be met, the nearest acceleration is
#: given. ``failed``: the solver gave nothing usable, the lowest thrusts are given.
Outcome = Literal["exact", "scaled", "nearest", "failed"]

#: A request counts as met in full if neither slack is further from one than this.
_UNSCALED = 1e-6
#: Weights of slacks and thrusts against the distance in the nearest-acceleration problem: small
#: enough to leave the distance as it is, large enough to choose among equally near solutions.
_TIE_SLACK, _TIE_THRUST = 1e-7, 1e-8


@dataclass(frozen=True)
class Allocated:
    """Result of an allocation.

    Attributes
    ----------
    thrust : array, shape (n,)
        Thrusts within their bounds [N].
    linear_scale, angular_scale : float
        s1 and s2: what was met of the linear and the angular acceleration.
    outcome : {"exact", "scaled", "nearest", "failed"}
        What became of the request.
    """

    thrust: Float[np.ndarray, " n"]
    linear_scale: float
    angular_scale: float
    outcome: Outcome


class Solver(ABC):
    """A quadratic programming solver for one problem size, made once and then updated.

    min x'Px/2 s.t. Ax = b, lower ≤ x ≤ upper (`constrained`), and
    min |Ax - b|²/2 + x'Dx/2 s.t. lower ≤ x ≤ upper (`nearest`).
    """

    @abstractmethod
    def constrained(
        self,
        a: Float[np.ndarray, "3 m"],
        b: Float[np.ndarray, " 3"],
        lower: Float[np.ndarray, " m"],
        upper: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"] | None:
        """Solve with Ax = b; None if that is infeasible or was not solved.

        Parameters
        ----------
        a, b : array, shape (3, m) and (3,)
            The equality.
        lower, upper : array, shape (m,)
            Bounds.

        Returns
        -------
        array, shape (m,), or None
            The minimiser.
        """

    @abstractmethod
    def nearest(
        self,
        a: Float[np.ndarray, "3 m"],
        b: Float[np.ndarray, " 3"],
        lower: Float[np.ndarray, " m"],
        upper: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"] | None:
        """Bring Ax as near to b as the bounds allow; None if that was not solved.

        Parameters
        ----------
        a, b : array, shape (3, m) and (3,)
            What to bring near to what.
        lower, upper : array, shape (m,)
            Bounds.

        Returns
        -------
        array, shape (m,), or None
            The minimiser.
        """


class Piqp(Solver):
    """PIQP, the paper's solver (Schwan et al. 2023), an interior-point method.

    Parameters
    ----------
    cost : array, shape (m,)
        Diagonal of P.
    ties : array, shape (m,)
        Diagonal of D.
    """

    # About 16 iterations solve a feasible problem. Where the bounds leave no interior it takes up
    # to 100, and the last digits of the dual are never found: the primal is judged by itself.
    _MOST_ITERATIONS = 100
    _EQUALITY_HOLDS = 1e-8

    def __init__(self, cost: Float[np.ndarray, " m"], ties: Float[np.ndarray, " m"]) -> None:
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

    def constrained(
        self,
        a: Float[np.ndarray, "3 m"],
        b: Float[np.ndarray, " 3"],
        lower: Float[np.ndarray, " m"],
        upper: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"] | None:
        """Solve with Ax = b; see `Solver.constrained`."""
        self._constrained.update(A=a, b=b, x_l=lower, x_u=upper)
        solved = self._constrained.solve() == self._solved
        x = np.minimum(np.maximum(self._constrained.result.x, lower), upper)
        return x if solved or np.max(np.abs(a @ x - b)) < self._EQUALITY_HOLDS else None

    def nearest(
        self,
        a: Float[np.ndarray, "3 m"],
        b: Float[np.ndarray, " 3"],
        lower: Float[np.ndarray, " m"],
        upper: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"] | None:
        """Bring Ax near to b; see `Solver.nearest`."""
        self._nearest.update(P=a.T @ a + self._ties, c=-(b @ a), x_l=lower, x_u=upper)
        solved = self._nearest.solve() == self._solved
        return np.array(self._nearest.result.x) if solved else None


class Daqp(Solver):
    """DAQP (Arnström, Bemporad and Axehill 2022), a dual active-set method.

    Parameters
    ----------
    cost : array, shape (m,)
        Diagonal of P.
    ties : array, shape (m,)
        Diagonal of D.
    """

    _OPTIMAL = 1
    # The default, 3.7e-11, takes small requests with nearly parallel columns for infeasible ones.
    _SINGULAR = 1e-14
    # By default, 1e-6, one request in a million is missed by 1e-4 rad/s².
    _FEASIBLE = 1e-9

    def __init__(self, cost: Float[np.ndarray, " m"], ties: Float[np.ndarray, " m"]) -> None:
        import daqp

        m = len(cost)
        self._solve = daqp.solve
        self._cost, self._ties, self._zeros = np.diag(cost), np.diag(ties), np.zeros(m)
        self._no_rows = np.zeros((0, m))
        self._bounds_only = np.zeros(m, dtype=np.intc)
        self._with_equality = np.concatenate([self._bounds_only, np.full(3, 5, dtype=np.intc)])

    def constrained(
        self,
        a: Float[np.ndarray, "3 m"],
        b: Float[np.ndarray, " 3"],
        lower: Float[np.ndarray, " m"],
        upper: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"] | None:
        """Solve with Ax = b; see `Solver.constrained`."""
        x, _, flag, _ = self._solve(
            self._cost,
            self._zeros,
            a,
            np.concatenate([upper, b]),
            np.concatenate([lower, b]),
            self._with_equality,
            sing_tol=self._SINGULAR,
            primal_tol=self._FEASIBLE,
        )
        return x if flag == self._OPTIMAL else None

    def nearest(
        self,
        a: Float[np.ndarray, "3 m"],
        b: Float[np.ndarray, " 3"],
        lower: Float[np.ndarray, " m"],
        upper: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"] | None:
        """Bring Ax near to b; see `Solver.nearest`."""
        x, _, flag, _ = self._solve(
            a.T @ a + self._ties, -(b @ a), self._no_rows, upper, lower, self._bounds_only
        )
        return x if flag == self._OPTIMAL else None


SOLVERS: dict[str, type[Piqp] | type[Daqp]] = {"daqp": Daqp, "piqp": Piqp}


class ThrustAllocator:
    """Distributes an acceleration over the propellers.

    The paper's problem (eq. force_qp),

        min |F|² + μ(1 - s1)² + μ(1 - s2)²
        s.t. (s1 vx, s1 vy, s2 v_ω) = M F + g,  lower ≤ F ≤ upper,  0 ≤ s1, s2 ≤ 1,

    scales a request down when it cannot be met. It is not always feasible: the motor lag makes the
    lower bounds positive, and their acceleration may lie off the ray even of s1 = s2 = 0. Then the
    acceleration nearest to a scaled request is given: the limit of an exact penalty on the equality
    as its weight grows. (The limit, because the multiplier of the equality grows like 2μ/|v|: a
    weight above it for every request would leave no digits for |F|².)

    In the solver the slacks are √μ(1 - s): the Hessian becomes the identity, and the tolerance
    means the same for all variables.

    Parameters
    ----------
    n_propellers : int
        Number of propellers.
    arm : float
        Lever at which angular accelerations are compared with linear ones, usually the radius of
        gyration √(I/m) [m].
    slack_weight : float, default 1e6
        μ. Large enough that scaling is the last resort: thrusts are below 1 N, so that |F|² is of
        order one.
    solver : {"daqp", "piqp"}, default "daqp"
        Both give the same answers.
    """

    def __init__(
        self,
        n_propellers: int,
        arm: float,
        slack_weight: float = 1e6,
        solver: Literal["daqp", "piqp"] = "daqp",
    ) -> None:
        n = n_propellers
        self._n = n
        self._root = float(np.sqrt(slack_weight))
        self._rows = np.array([1.0, 1.0, arm])
        ties = np.full(n + 2, _TIE_THRUST)
        ties[n:] = _TIE_SLACK
        self._solver = SOLVERS[solver](np.full(n + 2, 2.0), ties)
        self._a = np.zeros((3, n + 2))
        # From √μ(1 - s) to 1 - s, whose size suits the distance.
        self._unscale = np.ones(n + 2)
        self._unscale[n:] = self._root
        self._lower, self._upper = np.zeros(n + 2), np.full(n + 2, self._root)

    def allocate(
        self,
        request: Float[np.ndarray, " 3"],
        matrix: Float[np.ndarray, "3 n"],
        offset: Float[np.ndarray, " 3"],
        lower: Float[np.ndarray, " n"],
        upper: Float[np.ndarray, " n"],
    ) -> Allocated:
        """Find thrusts for an acceleration.

        Parameters
        ----------
        request : array, shape (3,)
            v: ax, ay [m/s²], ω' [rad/s²].
        matrix : array, shape (3, n)
            M(γ), from thrusts to accelerations.
        offset : array, shape (3,)
            g(ω), acceleration without thrust.
        lower, upper : array, shape (n,)
            Bounds of the thrusts [N].

        Returns
        -------
        Allocated
            Thrusts within the bounds, whatever is asked for.
        """
        n, a, rows = self._n, self._a, self._rows
        scaled = rows * request
        a[:, :n] = rows[:, None] * matrix
        a[0, n], a[1, n] = scaled[0] / self._root, scaled[1] / self._root
        a[2, n + 1] = scaled[2] / self._root
        b = scaled - rows * offset
        self._lower[:n], self._upper[:n] = lower, upper
        outcome: Outcome = "scaled"
        x = None
        if np.isfinite(b).all() and np.isfinite(a).all():
            x = self._solver.constrained(a, b, self._lower, self._upper)
            if x is None:
                outcome = "nearest"
                u = self._unscale
                x = self._solver.nearest(a * u, b, self._lower / u, self._upper / u)
                x = None if x is None else x * u
        if x is None or not np.isfinite(x).all():
            return Allocated(np.array(lower), 0.0, 0.0, "failed")
        linear, angular = 1 - x[n] / self._root, 1 - x[n + 1] / self._root
        if outcome == "scaled" and min(linear, angular) > 1 - _UNSCALED:
            outcome = "exact"
        # Solvers keep bounds to their tolerance; motors keep them to the last digit.
        thrust = np.minimum(np.maximum(x[:n], lower), upper)
        return Allocated(thrust, float(linear), float(angular), outcome)
