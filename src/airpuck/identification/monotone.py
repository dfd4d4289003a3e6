"""Thrust must rise with motor speed (subsec:reg_force_model): as a penalty and as a constraint."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.physics.thrust import lowest_slope, thrust_slope


def monotone_penalty(xp: Any, coefficients: Any) -> Any:
    """Compute the paper's regulariser without its weight.

    The sum over propellers of max(0, -F'(φ)) at φ = 0, at φ = 1 and, by Proposition 1
    (prop:thrust), at the minimum of F' where that lies in between. The minimum is exact for degrees
    up to three; for higher ones it is searched on a grid of 41 points.
    """
    n, degree = coefficients.shape
    ends = xp.broadcast_to(xp.array([0.0, 1.0]), (n, 2))
    penalty = xp.sum(xp.maximum(-thrust_slope(coefficients, ends), 0.0))
    if degree < 3:
        return penalty  # F' is linear: its minimum is at an end.
    if degree > 3:
        grid = xp.broadcast_to(xp.linspace(0.0, 1.0, 41)[1:-1], (n, 39))
        lowest = xp.min(thrust_slope(coefficients, grid), axis=1)
        return penalty + xp.sum(xp.maximum(-lowest, 0.0))
    a, b, c = coefficients[:, 0], coefficients[:, 1], coefficients[:, 2]
    divisor = xp.where(c > 0, c, 1.0)
    stationary = -b / (3 * divisor)
    inside = (c > 0) & (stationary >= 0) & (stationary <= 1)
    return penalty + xp.sum(xp.where(inside, xp.maximum(b**2 / (3 * divisor) - a, 0.0), 0.0))


class SlopeConstraints:
    """Linear inequalities that keep thrust curves rising, made where they are needed.

    F'(φ) ≥ 0 for all φ in [0, 1] is one linear inequality in the coefficients for every φ. The
    ones at the ends are there from the start; `cut` adds the one at the minimum of a curve that
    falls somewhere. A few cuts suffice, since a polynomial's slope has few minima.
    """

    def __init__(self, free: Bool[np.ndarray, "n degree"], margin: float = 1e-6) -> None:
        self.margin = margin
        self._free = free
        self._points = [(i, speed) for i in range(len(free)) for speed in (0.0, 1.0)]

    def rows(self) -> Float[np.ndarray, "R entries"]:
        """Return A such that the constraints read A c ≥ margin, c the flat coefficients."""
        n, degree = self._free.shape
        power = np.arange(1, degree + 1)
        rows = np.zeros((len(self._points), n, degree))
        for row, (propeller, speed) in zip(rows, self._points, strict=True):
            row[propeller] = power * speed ** (power - 1)
        # A slope that no free coefficient can change, such as that of κφ² at 0, is not ours to
        # constrain.
        changeable = (np.abs(rows) * self._free).any(axis=(1, 2))
        return rows[changeable].reshape(-1, n * degree)

    def cut(self, coefficients: Float[np.ndarray, "n degree"]) -> bool:
        """Add constraints where curves fall."""
        slopes, speeds = lowest_slope(coefficients)
        new = [
            (propeller, float(speeds[propeller]))
            for propeller in np.flatnonzero(slopes < 0)
            if 0 < speeds[propeller] < 1
        ]
        self._points += new
        return bool(new)
