"""Thrust of a propeller as a polynomial of its normalised speed (eq. thrust_poly).

F(φ) = a φ + b φ² + c φ³ + …, with φ in [0, 1] and no constant: a motor that stands pushes nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float


def thrust(coefficients: Any, speed: Any) -> Any:
    """Evaluate the thrust polynomials.

    Parameters
    ----------
    coefficients : array, shape (n, degree)
        Coefficients of φ, φ², …, one row for each propeller [N].
    speed : array, shape (n, ...)
        Normalised motor speeds φ.

    Returns
    -------
    array, shape (n, ...)
        Thrusts [N].
    """
    total = 0.0
    for power in reversed(range(coefficients.shape[1])):
        total = (total + _column(coefficients, power, speed)) * speed
    return total


def thrust_slope(coefficients: Any, speed: Any) -> Any:
    """Evaluate dF/dφ.

    Parameters
    ----------
    coefficients : array, shape (n, degree)
        Thrust coefficients [N].
    speed : array, shape (n, ...)
        Normalised motor speeds φ.

    Returns
    -------
    array, shape (n, ...)
        Slopes [N].
    """
    total = 0.0
    for power in reversed(range(coefficients.shape[1])):
        total = total * speed + (power + 1) * _column(coefficients, power, speed)
    return total


def _column(coefficients: Any, power: int, like: Any) -> Any:
    """Return one column of the coefficients, shaped to broadcast along the batch axes of `like`."""
    return coefficients[:, power].reshape((-1,) + (1,) * (like.ndim - 1))


def lowest_slope(
    coefficients: Float[np.ndarray, "n degree"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Find where each thrust curve is flattest, or falls most, on [0, 1].

    The minimum of dF/dφ lies at an end of the interval or where d²F/dφ² vanishes inside. For a
    cubic this is the argument of Proposition 1 (prop:thrust).

    Parameters
    ----------
    coefficients : array, shape (n, degree)
        Thrust coefficients [N].

    Returns
    -------
    slope : array, shape (n,)
        The lowest slopes [N].
    speed : array, shape (n,)
        Where they are.
    """
    degree = coefficients.shape[1]
    slopes, speeds = [], []
    for row in coefficients:
        slope = np.polynomial.Polynomial(row * np.arange(1, degree + 1))
        stationary = slope.deriv().roots() if degree > 1 else np.zeros(0)
        inside = stationary[np.abs(np.imag(stationary)) < 1e-12].real
        candidates = np.concatenate([[0.0, 1.0], inside[(inside > 0) & (inside < 1)]])
        values = slope(candidates)
        slopes.append(values.min())
        speeds.append(candidates[values.argmin()])
    return np.array(slopes), np.array(speeds)


def is_monotone(coefficients: Float[np.ndarray, "n degree"]) -> Bool[np.ndarray, " n"]:
    """Say whether each thrust curve rises everywhere on [0, 1] (eq. thrust_cond).

    Parameters
    ----------
    coefficients : array, shape (n, degree)
        Thrust coefficients [N].

    Returns
    -------
    array of bool, shape (n,)
        True where dF/dφ ≥ 0 on the whole of [0, 1].
    """
    return lowest_slope(coefficients)[0] >= 0
