"""Exact discretisation of point mass and motors, with held inputs (seq:control)."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float


def point_mass(period: float) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 3"]]:
    """Discretise the craft as a point mass driven by accelerations (eq. point_mass_subsystem)."""
    a, b = np.eye(6), np.zeros((6, 3))
    a[:3, 3:] = b[3:] = period * np.eye(3)
    b[:3] = period**2 / 2 * np.eye(3)
    return a, b


def motor_lag(time_constant: float, period: float) -> tuple[float, float]:
    """Discretise a motor (eq. dis_motor_dynamics): its next speed is A φ + B u."""
    if time_constant == 0:
        return 0.0, 1.0
    return math.exp(-period / time_constant), -math.expm1(-period / time_constant)


def rotation_error(
    spin: Float[np.ndarray, "*shape"], period: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape"]:
    """Quantify the error of the discretisation: the craft turns while the force is held.

    The discretisation applies R(γ_k) F for a whole period, but the force turns with the craft. The
    velocity gained is |∫ R(γ_k + ω t) F dt| = h F e^{iθ/2} sinc(θ/2), θ = ωh, instead of h F.
    """
    half = spin * period / 2
    return np.abs(np.exp(1j * half) * np.sinc(half / np.pi) - 1)
