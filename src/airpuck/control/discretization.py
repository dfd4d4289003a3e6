"""Exact discretisation of the point mass and of the motors (seq:control)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def zero_order_hold(
    a: Float[np.ndarray, "n n"], b: Float[np.ndarray, "n m"], period: float
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n m"]]:
    """Discretise x' = A x + B u with u held over each period.

    By the exponential of the block matrix [[A, B], [0, 0]] (DeCarlo, "Linear Systems", 1989,
    chapter 14).
    """
    from scipy.linalg import expm

    n, m = b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a, b
    exponential = np.asarray(expm(block * period))
    return exponential[:n, :n], exponential[:n, n:]


def point_mass(period: float) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 3"]]:
    """Discretise the craft as a point mass driven by accelerations (eq. point_mass_subsystem)."""
    a, b = np.zeros((6, 6)), np.zeros((6, 3))
    a[:3, 3:] = np.eye(3)
    b[3:] = np.eye(3)
    return zero_order_hold(a, b, period)


def motor_lag(time_constant: float, period: float) -> tuple[float, float]:
    """Discretise a motor (eq. dis_motor_dynamics)."""
    if time_constant == 0:
        return 0.0, 1.0
    a, b = zero_order_hold(
        np.array([[-1 / time_constant]]), np.array([[1 / time_constant]]), period
    )
    return float(a[0, 0]), float(b[0, 0])


def rotation_error(
    spin: Float[np.ndarray, "*shape"], period: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape"]:
    """Quantify what the discretisation neglects: the craft turns while the force is held.

    The discretisation applies R(γ_k) F for a whole period, but the force turns with the craft. The
    velocity gained is |∫ R(γ_k + ω t) F dt| = h F e^{iθ/2} sinc(θ/2), θ = ωh, instead of h F.
    """
    half = spin * period / 2
    return np.abs(np.exp(1j * half) * np.sinc(half / np.pi) - 1)
