"""Results of an estimator."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class ActuationEstimate:
    """Estimated effectiveness of the motors, and of the transport delay."""

    #: Fraction of the modelled thrust that each motor delivers; 1: all of it.
    effectiveness: Float[np.ndarray, " n"]
    #: Its standard deviation; for an idling motor, which reveals nothing, the prior's.
    deviation: Float[np.ndarray, " n"]
    #: Probability of each state of the craft, by name (`airpuck.estimate.actuation.PRIORS`).
    probability: dict[str, float] = field(default_factory=dict)
    #: Estimated transport delay minus the model's, and its standard deviation [s].
    delay: float = 0.0
    delay_deviation: float = 0.0
    #: Fraction that control uses, if not the estimated one: it ignores changes that may be none.
    used: Float[np.ndarray, " n"] | None = None


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
    #: None if the estimator assumes that the motors follow the model.
    actuation: ActuationEstimate | None = None

    @property
    def effectiveness(self) -> Float[np.ndarray, " n"]:
        """Fraction of the modelled thrust of each motor, for control; ones if not estimated."""
        if self.actuation is None:
            return np.ones(len(self.motor_speed))
        used = self.actuation.used
        return self.actuation.effectiveness if used is None else used
