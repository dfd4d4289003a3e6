"""Matching of measured effects of propellers with expected ones, by direction.

Effects are columns: two forces and a moment, in one unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

#: Cosine above which a measured and an expected effect agree (26 degrees apart).
AGREES = 0.9
#: An opposite effect is more likely another propeller's effect: cables are swapped more often than
#: propellers are mounted the wrong way round.
_OPPOSITE = 0.5

#: Standard errors that make a deviation certain.
CERTAIN = 2.6
#: Squared size of forces and moments, in squared standard errors, from which their ratio is judged.
_SEEN_SIZE = 4.0


@dataclass(frozen=True)
class EffectMatch:
    """The expected effect that a measured propeller matches."""

    #: The propeller of the model with this effect; None: there is none.
    acts_as: int | None
    #: 1, or -1 for the opposite effect.
    sign: int
    #: Cosine between the measured and the expected effect.
    cosine: float


def rotation(measured: Float[np.ndarray, "3 m"], expected: Float[np.ndarray, "3 m"]) -> float:
    """Find the rotation that maps expected forces to measured ones [rad].

    In complex numbers: the argument of their inner product (two-dimensional Procrustes).
    """
    return float(np.angle(np.vdot(_forces(expected), _forces(measured))))


def rotation_error(
    measured: Float[np.ndarray, "3 m"],
    error: Float[np.ndarray, "3 m"],
    expected: Float[np.ndarray, "3 m"],
) -> float:
    """Return the standard error of `rotation` [rad]."""
    along = abs(np.vdot(_forces(expected), _forces(measured)))
    across = np.abs(_forces(expected)) * np.hypot(*error[:2]) / np.sqrt(2)
    return float(np.linalg.norm(across) / along) if along > 0 else np.inf


def turned(effects: Float[np.ndarray, "3 m"], angle: float) -> Float[np.ndarray, "3 m"]:
    """Rotate forces; moments do not change."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ effects


def cosines(
    measured: Float[np.ndarray, "3 m"], expected: Float[np.ndarray, "3 n"]
) -> Float[np.ndarray, "m n"]:
    """Compare the directions of all measured effects with all expected ones."""
    return unit_columns(measured).T @ unit_columns(expected)


def match_effects(
    measured: Float[np.ndarray, "3 m"],
    expected: Float[np.ndarray, "3 n"],
    motors: Int[np.ndarray, " m"],
) -> dict[int, EffectMatch]:
    """Find the matching effect of each measured propeller.

    A propeller that agrees with its expected effect keeps it. The others are assigned to the
    remaining effects so that as many as possible agree, in the same or the opposite direction.
    """
    from scipy.optimize import linear_sum_assignment

    table = cosines(measured, expected)
    itself = table[np.arange(len(motors)), motors]
    agrees = itself >= AGREES
    found = {
        motor: EffectMatch(motor if stays else None, 1, float(cosine))
        for motor, stays, cosine in zip(motors.tolist(), agrees, itself, strict=True)
    }
    worth = np.where(table >= AGREES, table, 0.0)
    worth = np.where(table <= -AGREES, -_OPPOSITE * table, worth)
    rows = np.flatnonzero(~agrees)
    columns = np.setdiff1d(np.arange(expected.shape[1]), motors[agrees])
    for i, j in zip(*linear_sum_assignment(-worth[np.ix_(rows, columns)]), strict=True):
        row, column = rows[i], columns[j]
        if worth[row, column] > 0:
            sign = 1 if table[row, column] > 0 else -1
            found[int(motors[row])] = EffectMatch(int(column), sign, float(itself[row]))
    return found


def may_agree(
    measured: Float[np.ndarray, "3"], error: Float[np.ndarray, "3"], stated: Float[np.ndarray, "3"]
) -> bool:
    """Return whether an effect may have the stated direction, given its standard errors."""
    unit = stated / np.linalg.norm(stated)
    along = float(unit @ measured)
    across = measured - along * unit
    size = float(np.linalg.norm(across))
    spread = float(np.linalg.norm(across * error)) / max(size, np.finfo(float).tiny)
    return along > 0 and bool(size - CERTAIN * spread < np.tan(np.arccos(AGREES)) * along)


def force_to_moment(
    measured: Float[np.ndarray, "3 n"],
    error: Float[np.ndarray, "3 n"],
    stated: Float[np.ndarray, "3 n"],
) -> float:
    """Return by what factor forces are too large for the moments; 1 if either is not seen."""
    # Noise adds its variance to measured sizes.
    noise = np.array([np.sum(part**2) for part in (error[:2], error[2])])
    size, expected = (np.array([np.sum(p[:2] ** 2), np.sum(p[2] ** 2)]) for p in (measured, stated))
    if (size <= _SEEN_SIZE * noise).any() or expected.min() <= 0:
        return 1.0
    force, moment = np.sqrt((size - noise) / expected)
    return float(force / moment)


def _forces(effects: Float[np.ndarray, "3 m"]) -> np.ndarray:
    """Return forces as complex numbers."""
    return effects[0] + 1j * effects[1]


def unit_columns(columns: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3 n"]:
    """Normalise columns."""
    return columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
