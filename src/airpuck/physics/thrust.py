"""Thrust of a propeller as a polynomial of its normalised speed, and its inverse.

F(φ) = a φ + b φ² + c φ³ + …, with φ in [0, 1] (eq. thrust_poly). There is no constant: a propeller
at rest gives no thrust.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Brief
from airpuck.compute.arrays import repeat_while

#: If a thrust curve's lowest slope is below this, its constraint is active [N]; the constraint's
#: bound is 1e-6.
FLAT = 1e-5
#: The iteration has converged when it moves a motor speed by less than this. Rounding of a thrust
#: moves a speed by more only if the slope is below 1e-4 N.
_RESOLVED = 1e-12
#: Newton needs about five iterations, bisection alone 40: this bound is never reached.
_MOST_PASSES = 100


def thrust(coefficients: Any, speed: Any) -> Any:
    """Evaluate the thrust polynomials F(φ) (eq. thrust_poly).

    Parameters
    ----------
    coefficients : array, shape (n, degree) or (n, degree, ...)
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
    """Evaluate dF/dφ, the left side of eq. thrust_cond [N]."""
    total = 0.0
    for power in reversed(range(coefficients.shape[1])):
        total = total * speed + (power + 1) * _column(coefficients, power, speed)
    return total


def thrust_curvature(coefficients: Any, speed: Any) -> Any:
    """Evaluate d²F/dφ² [N]."""
    if coefficients.shape[1] == 1:
        return 0.0 * speed
    total = 0.0
    for power in reversed(range(1, coefficients.shape[1])):
        total = total * speed + power * (power + 1) * _column(coefficients, power, speed)
    return total


def _column(coefficients: Any, power: int, like: Any) -> Any:
    """Return one column of the coefficients, shaped to broadcast along the batch axes of `like`."""
    column = coefficients[:, power]
    alike = column.ndim > 1 or like.ndim == 1
    return column if alike else column.reshape((-1,) + (1,) * (like.ndim - 1))


def lowest_slope(
    coefficients: Float[np.ndarray, "n degree"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Find the lowest slope of each thrust curve on [0, 1], and its speed (eq. thrust_cond).

    The minimum of dF/dφ lies at an end of the interval, or where d²F/dφ² vanishes inside. For a
    cubic this is the argument of Proposition 1 (prop:thrust).
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


def slope_rows(
    free: Bool[np.ndarray, "n degree"], points: Sequence[tuple[int, float]]
) -> Float[np.ndarray, "R entries"]:
    """Return A such that A c are slopes at points (propeller, φ); c are the flat coefficients.

    Slopes that no free coefficient changes, such as the slope of κφ² at 0, are left out.
    """
    power = np.arange(1, free.shape[1] + 1)
    rows = np.zeros((len(points), *free.shape))
    for row, (propeller, speed) in enumerate(points):
        rows[row, propeller] = power * speed ** (power - 1)
    changeable = (np.abs(rows) * free).any(axis=(1, 2))
    return rows[changeable].reshape(-1, free.size)


def is_monotone(coefficients: Float[np.ndarray, "n degree"]) -> Bool[np.ndarray, " n"]:
    """Return whether each thrust curve rises everywhere on [0, 1] (eq. thrust_cond)."""
    return lowest_slope(coefficients)[0] >= 0


class InverseThrust(Brief):
    """Computes the motor speeds that give thrusts, F⁻¹ in seq:control.

    The controller's command follows from them: u = B⁻¹ (F⁻¹(F) - A φ), with the motors' A and B of
    eq. dis_motor_dynamics. Newton's method runs inside a bracket, which is halved whenever Newton
    would leave it. Thrusts outside the curve's range give the nearest end of [0, 1].

    Parameters
    ----------
    coefficients : array, shape (n, degree)
        Thrust coefficients of curves that rise on [0, 1] [N].

    Raises
    ------
    InputError
        If a curve falls somewhere on [0, 1]: it has no inverse.

    Examples
    --------
    >>> speed_for = airpuck.InverseThrust(np.array([[0.0, 2.0]]))  # F = 2 φ² [N]
    >>> speed_for(np.array([0.5])).round(3)
    array([0.5])
    """

    SHOWN = "coefficients_N=_coefficients"

    def __init__(self, coefficients: Float[np.ndarray, "n degree"]) -> None:
        slopes, speeds = lowest_slope(coefficients)
        if (slopes < 0).any():
            worst = int(np.argmin(slopes))
            raise InputError(
                f"the thrust curve of propeller {worst + 1} falls at φ = {speeds[worst]:.3f} "
                f"(slope {slopes[worst]:.3g} N) and has no inverse; identify it with rising curves",
                field="thrust",
            )
        self._coefficients = coefficients

    def __call__(self, force: Float[np.ndarray, "n *batch"]) -> Float[np.ndarray, "n *batch"]:
        """Invert the curves."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(np.isnan(force), np.nan, inverse_thrust(np, self._coefficients, force))


def inverse_thrust(xp: Any, coefficients: Any, force: Any) -> Any:
    """Invert thrust curves that are known to rise, F⁻¹ in seq:control; see `InverseThrust`."""
    top = thrust(coefficients, xp.ones((coefficients.shape[0],) + (1,) * (force.ndim - 1)))
    target = xp.minimum(xp.maximum(force, 0.0), top)

    def better(bracket: Any) -> Any:
        low, high, speed, _, passes = bracket
        error = thrust(coefficients, speed) - target
        low, high = xp.where(error <= 0, speed, low), xp.where(error >= 0, speed, high)
        newton = speed - error / thrust_slope(coefficients, speed)
        # Outside, or not a number: bisect. Exactly met: stay.
        inside = (newton > low) & (newton < high)
        following = xp.where(inside, newton, (low + high) / 2)
        following = xp.where(error == 0, speed, following)
        return low, high, following, xp.max(xp.abs(following - speed), initial=0.0), passes + 1

    def unresolved(bracket: Any) -> Any:
        return (bracket[3] > _RESOLVED) & (bracket[4] < _MOST_PASSES)

    guess = target / xp.maximum(top, 1e-300)
    bracket = xp.zeros_like(target), xp.ones_like(target), guess, 1.0, 0
    return repeat_while(xp, unresolved, better, bracket)[2]
