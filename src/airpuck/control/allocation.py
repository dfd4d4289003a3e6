"""Thrust allocation: from accelerations asked for to thrusts (eq. force_qp)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from airpuck.control.qp_solvers import SOLVERS, Bounds, Rows, Variables

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
    """Result of an allocation."""

    #: Thrusts within their bounds [N].
    thrust: Float[np.ndarray, " n"]
    #: s1 and s2: what was met of the linear and the angular acceleration.
    linear_scale: float
    angular_scale: float
    #: What became of the request.
    outcome: Outcome


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
    """Write eq. force_qp for a solver, with thrusts and slacks √μ(1 - s) as x.

    So the Hessian is the identity, and the tolerance means the same for all variables.
    """
    rows, root = np.array([1.0, 1.0, arm]), math.sqrt(slack_weight)
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
    """Return whether a few numbers are all finite, in less time than any NumPy call takes."""
    return all(map(math.isfinite, values.tolist()))


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
        self.arm, self.slack_weight = arm, slack_weight
        self._n, self._root = n_propellers, math.sqrt(slack_weight)
        sizes = n_propellers, 2
        ties = np.repeat([_TIE_THRUST, _TIE_SLACK], sizes)
        self._solver = SOLVERS[solver](np.full(len(ties), 2.0), ties)
        # From √μ(1 - s) to 1 - s, whose size suits the distance.
        self._unscale = np.repeat([1.0, self._root], sizes)

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
            Bounds of the thrusts, finite [N].

        Returns
        -------
        Allocated
            Thrusts within the bounds, whatever is asked for.
        """
        n = self._n
        x, outcome = self.solve(
            *problem(np, self.arm, self.slack_weight, request, matrix, offset, lower, upper)
        )
        if x is None:
            return Allocated(np.array(lower), 0.0, 0.0, outcome)
        linear, angular = (1 - x[n:] / self._root).tolist()
        # Solvers keep bounds to their tolerance; motors keep them to the last digit.
        return Allocated(np.minimum(np.maximum(x[:n], lower), upper), linear, angular, outcome)

    def solve(
        self, a: Rows, lower: Bounds, upper: Bounds, finite: Any
    ) -> tuple[Variables | None, Outcome]:
        """Solve what `problem` has written.

        Parameters
        ----------
        a, lower, upper, finite : array
            The problem.

        Returns
        -------
        x : array, shape (n + 2,), or None
            Thrusts [N], within the bounds to the solver's tolerance, and √μ(1 - s); None: failed.
        outcome : {"exact", "scaled", "nearest", "failed"}
            What became of the request.
        """
        if not finite:
            return None, "failed"
        outcome: Outcome = "scaled"
        x = self._solver.constrained(a, lower, upper)
        if x is None:
            outcome, u = "nearest", self._unscale
            x = self._solver.nearest(a * u, upper[-3:], lower[:-3] / u, upper[:-3] / u)
            x = None if x is None else x * u
        if x is None or not all_finite(x):
            return None, "failed"
        if outcome == "scaled" and 1 - max(x[self._n :].tolist()) / self._root > 1 - _UNSCALED:
            outcome = "exact"
        return x, outcome
