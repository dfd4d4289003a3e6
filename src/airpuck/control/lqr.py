"""The linear-quadratic regulator on virtual accelerations."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.control.discretization import point_mass
from airpuck.control.tuning import Weights


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
