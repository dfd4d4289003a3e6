"""What motors and delay have to do with the errors of predictions: a regression."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

#: What is known without a flight: how far motors and delay may lie from the model, standard
#: deviations [1, s].
PRIOR_LOSS, PRIOR_DELAY = 0.3, 0.02
#: Rounds of expectation and maximisation, and the least variance.
_ROUNDS, _LEAST = 5, 1e-10


@dataclass(frozen=True, eq=False)
class Judged:
    """A prediction and what became of it."""

    #: When it ended [s].
    time: float
    #: What was measured less what was predicted: x, y, yaw and their rates.
    error: Float[np.ndarray, " 6"]
    #: What the prediction gains with the effectiveness of each motor, and with the delay [1/s].
    slopes: Float[np.ndarray, "6 m"]
    #: Σ b bᵀ over the packets that mattered, where b is what the prediction loses by the lateness
    #: of one packet [1/s].
    impulses: Float[np.ndarray, "6 6"]


@dataclass(frozen=True, eq=False)
class Deviations:
    """How a craft differs from its model, and what that explains."""

    #: How many there were.
    predictions: int
    #: Root mean square error of x, y [m] and yaw [rad]; NaN without predictions.
    error: Float[np.ndarray, " 3"]
    #: Share of the modelled thrust that each motor gives, and its standard deviation.
    effectiveness: Float[np.ndarray, " n"]
    deviation: Float[np.ndarray, " n"]
    #: By how much the transport delay is longer than the model's, and its standard deviation [s].
    delay: float
    delay_deviation: float
    #: By how much the sum of squared errors of the pose would be smaller, had the model known this
    #: motor, and the delay; yaw counts with the radius of gyration. NaN without predictions.
    share: Float[np.ndarray, " m"]


def deviations(
    judged: Sequence[Judged],
    motors: int,
    *,
    memory: float,
    overlap: float,
    jitter: float,
    radius: float,
) -> Deviations:
    """Estimate what differs by weighted least squares."""
    prior = np.append(np.full(motors, PRIOR_LOSS), PRIOR_DELAY) ** -2.0
    if not judged:
        sd, none = prior**-0.5, np.full(motors + 1, np.nan)
        ones = np.ones(motors)
        return Deviations(0, none[:3], ones, sd[:-1], 0.0, float(sd[-1]), none)
    errors = np.array([one.error for one in judged])
    slopes = np.array([one.slopes for one in judged])
    lateness = jitter**2 * np.array([one.impulses for one in judged])
    weights = np.exp([(one.time - judged[-1].time) / memory for one in judged]) / overlap
    p, covariance = np.zeros(motors + 1), np.diag(1 / prior)
    spread = np.diag(np.median(errors**2, axis=0) + _LEAST)
    for _ in range(_ROUNDS):
        both = spread + lateness
        solved = np.linalg.solve(both, np.concatenate([slopes, errors[..., None]], axis=2))
        information = slopes.transpose(0, 2, 1) @ solved
        inverse = np.linalg.inv(np.diag(prior) + np.tensordot(weights, information[..., :-1], 1))
        p = inverse @ (weights @ information[..., -1])
        seen = overlap * np.tensordot(weights**2, information[..., :-1], 1)
        covariance = inverse @ (np.diag(prior) + seen) @ inverse
        spread = _spread(errors - slopes @ p, lateness, weights, spread)
    sd = np.sqrt(np.diag(covariance))
    metric = np.array([1.0, 1.0, radius])
    pose, changes = errors[:, :3] * metric, slopes[:, :3] * metric[:, None] * p
    left = np.sum((pose[..., None] - changes) ** 2, axis=(0, 1))
    return Deviations(
        len(judged),
        np.sqrt(np.mean(errors[:, :3] ** 2, axis=0)),
        1 + p[:-1],
        sd[:-1],
        float(p[-1]),
        float(sd[-1]),
        1 - left / np.sum(pose**2),
    )


def _spread(
    residual: Float[np.ndarray, "K 6"],
    lateness: Float[np.ndarray, "K 6 6"],
    weights: Float[np.ndarray, " K"],
    spread: Float[np.ndarray, "6 6"],
) -> Float[np.ndarray, "6 6"]:
    """Return the covariance of what jitter does not explain, given the last guess of it."""
    gain = spread @ np.linalg.inv(spread + lateness)
    left = np.einsum("kij,kj->ki", gain, residual)
    found = (weights[:, None] * left).T @ left
    found += np.tensordot(weights, spread - gain @ spread, 1)
    # Residuals are smaller than errors by what the parameters took.
    found = found / weights.sum() * (1 + len(spread) / len(residual))
    return found + np.diag(np.full(6, _LEAST))
