"""The law of the paper's controller (seq:control): regulator, thrust allocation, inverse thrust."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.compute.compiled import program
from airpuck.control.allocation import ThrustAllocator, all_finite
from airpuck.control.discretization import point_mass
from airpuck.control.law import Law, LawOptions, Moment, Step
from airpuck.control.stages import AllocationProblem, command_stage, plan_stage
from airpuck.control.tuning import Tuning, Weights
from airpuck.model.model_file import Model
from airpuck.physics.thrust import InverseThrust


def lqr(
    a: Float[np.ndarray, "n n"],
    b: Float[np.ndarray, "n m"],
    q: Float[np.ndarray, "n n"],
    r: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "m n"]:
    """Solve the infinite-horizon discrete-time regulator problem.

    u = -K x minimises Σ xᵀQx + uᵀRu over x⁺ = A x + B u; K = (R + BᵀPB)⁻¹BᵀPA with P from the
    discrete algebraic Riccati equation.
    """
    p = cost_to_go(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)


def cost_to_go(
    a: Float[np.ndarray, "n n"],
    b: Float[np.ndarray, "n m"],
    q: Float[np.ndarray, "n n"],
    r: Float[np.ndarray, "m m"],
) -> Float[np.ndarray, "n n"]:
    """Return P of xᵀPx, what the regulator's way from x to zero costs."""
    from scipy.linalg import LinAlgError, solve_discrete_are

    try:
        return solve_discrete_are(a, b, q, r)
    except (LinAlgError, ValueError) as error:
        raise InputError(
            "these weights give no stabilising regulator; give position and yaw a positive weight, "
            "and weights that differ less",
            field="weights",
        ) from error


def regulator(weights: Weights, period: float) -> Float[np.ndarray, "3 6"]:
    """Compute the gain of the point mass.

    Parameters
    ----------
    weights : Weights
        Weights of errors and accelerations.
    period : float
        Sample time [s].

    Returns
    -------
    array, shape (3, 6)
        K of v = -K x, for the state x, y, γ, vx, vy, ω.

    Raises
    ------
    InputError
        If the weights give no stabilising regulator.
    """
    return lqr(*point_mass(period), np.diag(weights.errors), np.diag(weights.efforts))


class LQR(Law):
    """A quadratic regulator of the accelerations, and the allocation of thrusts to give them.

    Moves the state one period on with the accelerations that the motors already determine; asks for
    v_{k+1} = a_ref - K (x_{k+1} - x_ref), the yaw error the shorter way; takes off the disturbance,
    and finds the commands that make the motors give it (eq. force_qp).

    Parameters
    ----------
    model : Model
        The craft; its thrust curves must rise.
    tuning : Tuning
        Weights, period and allocation.
    options : LawOptions, optional
        Among them the gain K for the state x, y, γ, vx, vy, ω.

    Raises
    ------
    InputError
        If a thrust curve falls somewhere.
    """

    def __init__(self, model: Model, tuning: Tuning, options: LawOptions | None = None) -> None:
        options = options or LawOptions()
        InverseThrust(model.dynamics.thrust)  # refuses curves that fall
        n, period, allocation = model.vehicle.n_propellers, tuning.period_s, tuning.allocation
        slack_weight = allocation.slack_weight
        #: May be exchanged at any time.
        self.gain = regulator(tuning.weights, period) if options.gain is None else options.gain
        self.stage = plan_stage(model, period, slack_weight, options.reject_disturbance)
        self.inputs = np.zeros(6), np.zeros(3), self.gain
        self._period, self._idle = period, np.full(n, model.vehicle.command_min)
        self._allocator = ThrustAllocator(
            n, model.radius_of_gyration, slack_weight, allocation.solver
        )
        command, motors, bounds = command_stage(model, period), np.zeros(n), np.zeros(n + 5)
        given = np.zeros(n + 2), bounds, bounds, motors
        self._command = program(command, *given, compiled=options.compiled)

    def step(self, state: Any, moment: Moment) -> tuple[Step, Any]:
        """Allocate thrusts for the accelerations that lead to the target, and invert them."""
        # The target is that of one period after the command begins to act.
        target = moment.reference.at(moment.now, moment.delay + self._period)
        estimate, results = moment.foresee(target.state, target.acceleration, self.gain)
        plan = AllocationProblem(*results)
        solution, outcome = self._allocator.solve(plan.a, plan.lower, plan.upper, plan.finite)
        if solution is not None:
            (command,) = self._command(solution, plan.lower, plan.upper, plan.coasting)
            if all_finite(command):
                return Step(command, outcome, plan.request, estimate), state
        return Step(self._idle.copy(), "failed", plan.request, estimate), state
