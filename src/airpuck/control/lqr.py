"""The controller's law (seq:control): a quadratic regulator gives the craft's acceleration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.control.discretization import point_mass
from airpuck.control.tuning import Weights
from airpuck.physics.angle import pose_difference


@dataclass(frozen=True, eq=False)
class LQR:
    """A law of the controller: v = a_ref - K (x - x_ref), with the yaw error the shorter way.

    Any law has the same two members. Where only its numbers differ, laws share compiled programs.
    """

    gain: Float[np.ndarray, "3 6"]

    @property
    def numbers(self) -> tuple[np.ndarray, ...]:
        """Arrays that `acceleration` takes."""
        return (self.gain,)

    @staticmethod
    def acceleration(xp: Any, state: Any, target: Any, feedforward: Any, gain: Any) -> Any:
        """Compute the acceleration to ask for, disturbances left aside; a pure function."""
        return feedforward - gain @ pose_difference(xp, state, target)


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
    from scipy.linalg import LinAlgError, solve_discrete_are

    try:
        p = solve_discrete_are(a, b, q, r)
    except (LinAlgError, ValueError) as error:
        raise InputError(
            "these weights give no stabilising regulator; give position and yaw a positive weight, "
            "and weights that differ less",
            field="weights",
        ) from error
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)


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
    w = weights
    q = np.diag([w.position, w.position, w.yaw, w.speed, w.speed, w.spin])
    r = np.diag([w.acceleration, w.acceleration, w.angular_acceleration])
    return lqr(*point_mass(period), q, r)
