"""Exact discretisation of the point mass and of the motors (sec:control)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def zero_order_hold(
    a: Float[np.ndarray, "n n"], b: Float[np.ndarray, "n m"], period: float
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n m"]]:
    """Discretise x' = A x + B u with u held over each period.

    By the exponential of the block matrix [[A, B], [0, 0]] (DeCarlo, "Linear Systems", 1989,
    chapter 14).

    Parameters
    ----------
    a : array, shape (n, n)
        Continuous-time A.
    b : array, shape (n, m)
        Continuous-time B.
    period : float
        Sample time h [s].

    Returns
    -------
    a_d, b_d : array, shape (n, n) and (n, m)
        x(t + h) = A_d x(t) + B_d u.
    """
    from scipy.linalg import expm

    n, m = b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a, b
    exponential = np.asarray(expm(block * period))
    return exponential[:n, :n], exponential[:n, n:]


def point_mass(period: float) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 3"]]:
    """Discretise the craft as a point mass with accelerations as inputs (eq. point_mass_subsystem).

    Parameters
    ----------
    period : float
        Sample time h [s].

    Returns
    -------
    a, b : array, shape (6, 6) and (6, 3)
        For the state x, y, γ, vx, vy, ω and the virtual inputs ax, ay, ω'.
    """
    a, b = np.zeros((6, 6)), np.zeros((6, 3))
    a[:3, 3:] = np.eye(3)
    b[3:] = np.eye(3)
    return zero_order_hold(a, b, period)


def motor_lag(time_constant: float, period: float) -> tuple[float, float]:
    """Discretise a motor (eq. dis_motor_dynamics).

    Parameters
    ----------
    time_constant : float
        Lag τ ≥ 0 [s]; 0: the motor follows at once.
    period : float
        Sample time h [s].

    Returns
    -------
    a, b : float
        φ(t + h) = a φ(t) + b u; the diagonal entries of A^φ and B^φ.
    """
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

    Parameters
    ----------
    spin : array
        ω [rad/s].
    period : array
        Sample time h [s], of the same shape.

    Returns
    -------
    array
        Relative error of the velocity gained in a period, |e^{iθ/2} sinc(θ/2) - 1|; about θ/2.
    """
    half = spin * period / 2
    return np.abs(np.exp(1j * half) * np.sinc(half / np.pi) - 1)
