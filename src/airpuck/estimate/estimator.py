"""Results of an estimator."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class ActuationEstimate:
    """What the motors really do with their commands."""

    #: Share of the modelled thrust that each motor gives, 1: all.
    effectiveness: Float[np.ndarray, " n"]
    #: Its standard deviation; for an idling motor, which reveals nothing, the prior's.
    deviation: Float[np.ndarray, " n"]
    #: Of each state of the craft by its name (`airpuck.estimate.actuation.PRIORS`).
    probability: dict[str, float] = field(default_factory=dict)
    #: How much longer than the model's the transport delay seems, and the standard deviation [s].
    delay: float = 0.0
    delay_deviation: float = 0.0


@dataclass(frozen=True, eq=False)
class Estimate:
    """The estimated craft at one time."""

    #: [s].
    time: float
    #: x, y, γ (continuous), vx, vy, ω.
    state: Float[np.ndarray, " 6"]
    #: Normalised motor speeds φ.
    motor_speed: Float[np.ndarray, " n"]
    #: Acceleration that the model does not explain [m/s², m/s², rad/s²].
    disturbance: Float[np.ndarray, " 3"]
    #: None where the estimator takes the motors to do what the model says.
    actuation: ActuationEstimate | None = None

    @property
    def effectiveness(self) -> Float[np.ndarray, " n"]:
        """Share of the modelled thrust that each motor gives; ones if it is not estimated."""
        if self.actuation is None:
            return np.ones(len(self.motor_speed))
        return self.actuation.effectiveness
