"""What a controller asks of an estimator: measurements and commands in, estimates out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimator believes."""

    #: When [s].
    time: float
    #: x, y, γ (continuous), vx, vy, ω.
    state: Float[np.ndarray, " 6"]
    #: Normalised motor speeds φ.
    motor_speed: Float[np.ndarray, " n"]
    #: Acceleration that the model does not explain [m/s², m/s², rad/s²].
    disturbance: Float[np.ndarray, " 3"]
    #: What the motors do with their commands; None: as the model says, nobody has looked.
    actuation: ActuationEstimate | None = None

    @property
    def effectiveness(self) -> Float[np.ndarray, " n"]:
        """Share of the modelled thrust that each motor gives; ones where nobody has looked."""
        if self.actuation is None:
            return np.ones(len(self.motor_speed))
        return self.actuation.effectiveness


@dataclass(frozen=True, eq=False)
class ActuationEstimate:
    """What the motors really do with their commands."""

    #: Share of the modelled thrust that each motor gives, 1: all.
    effectiveness: Float[np.ndarray, " n"]
    #: Its standard deviation; that of the prior where a motor idles, since that says nothing.
    deviation: Float[np.ndarray, " n"]
    #: Of each state of the craft by its name (`airpuck.estimate.actuation.PRIORS`).
    probability: dict[str, float] = field(default_factory=dict)
    #: By how much the transport delay seems longer than the model's, and the standard deviation of
    #: that [s].
    delay: float = 0.0
    delay_deviation: float = 0.0


@runtime_checkable
class Estimator(Protocol):
    """Estimates the craft in closed loop; nothing measured later than a time is used for it."""

    @property
    def time(self) -> float | None:
        """Time of the last measurement; None before the first pose [s]."""
        ...

    def command(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Take note of a command that was sent; see `RecursiveFilter.command`."""
        ...

    def run_motors(self, time: float) -> None:
        """Go through commands for the motors only; see `RecursiveFilter.run_motors`."""
        ...

    def pose(
        self,
        time: float,
        pose: Float[np.ndarray, " 3"],
        gate: tuple[float, float, float] | None = None,
    ) -> bool:
        """Use a measured pose, say whether; see `RecursiveFilter.pose`."""
        ...

    def imu(
        self,
        time: float,
        acceleration_body: Float[np.ndarray, " 2"],
        gyro: float,
        noise: tuple[float, float],
    ) -> None:
        """Use an inertial measurement; see `RecursiveFilter.imu`."""
        ...

    def mouse(self, time: float, velocity: Float[np.ndarray, " 2"], noise: float) -> None:
        """Use a measured velocity; see `RecursiveFilter.mouse`."""
        ...

    def predict(self, time: float) -> Estimate:
        """Predict with the commands that are known; see `RecursiveFilter.predict`."""
        ...

    def composed(self, then: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
        """Make one program of prediction and what follows; see `RecursiveFilter.composed`."""
        ...

    def predict_with(
        self, composed: Callable[..., Any], time: float, *more: Any
    ) -> tuple[Estimate, Sequence[Any]]:
        """Predict, and compute what follows; see `RecursiveFilter.predict_with`."""
        ...

    def restart(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Begin anew at a pose, at rest; see `RecursiveFilter.restart`."""
        ...

    def reset(self) -> None:
        """Forget everything."""
        ...
