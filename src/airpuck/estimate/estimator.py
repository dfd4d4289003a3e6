"""What an estimator knows of commands, and its results."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Brief
from airpuck.craft.wheel import Spinning
from airpuck.model.model_file import Model
from airpuck.model.quantities import QUANTITIES

#: How the names of a controller's figures about its motors begin.
FOUND = "found: "
#: Entries of quantities (`airpuck.model.quantities`) that a craft that learns also finds, beyond
#: its model, and standard deviations of the prior in their units. The centre of mass of the paper's
#: craft moves by 2 mm with 4 g at its edge; a table that was levelled by hand falls by a few mrad.
BEYOND = {
    "drag linear": 0.2,
    "center_of_mass x": 2e-3,
    "center_of_mass y": 2e-3,
    "tilt x": 5e-3,
    "tilt y": 5e-3,
}


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
    #: What a craft that learns finds beyond its model: name (`BEYOND`) → value and standard
    #: deviation.
    beyond: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def figures(self, propellers: Sequence[str]) -> dict[str, str]:
        """Return what was found in words: thrust of each propeller, delay, and `beyond`."""
        thrusts = zip(propellers, 100 * self.effectiveness, 100 * self.deviation, strict=True)
        found = {f"{FOUND}{name}": f"{e:.0f} ± {sd:.0f} %" for name, e, sd in thrusts}
        later = f"{1e3 * self.delay:+.1f} ± {1e3 * self.delay_deviation:.1f} ms"
        found |= {f"{FOUND}delay": later}
        for name, (value, deviation) in self.beyond.items():
            [quantity] = [one for one in QUANTITIES if one.name == name.split()[0]]
            unit, factor, _ = quantity.shown or (quantity.of_entry(0)[1], 1.0, "")
            words = f"{FOUND}{name.replace('_', ' ')}"
            found[words] = f"{factor * value:+.2g} ± {factor * deviation:.2g} {unit}"
        return found


@dataclass(frozen=True, eq=False)
class Estimate(Brief):
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


class HeldCommands:
    """Motor commands, each in force until the next one begins to act."""

    def __init__(self, idle: Float[np.ndarray, " n"]) -> None:
        self._begun: deque[tuple[float, Float[np.ndarray, " n"]]] = deque([(-math.inf, idle)])
        #: How much later than the model says all commands begin to act [s].
        self.later = 0.0
        #: Reaction wheels; None before the first command.
        self._wheels: tuple[Spinning, ...] | None = None

    def __len__(self) -> int:
        return len(self._begun)

    def add(self, begins: float, command: Float[np.ndarray, " n"]) -> None:
        """Record the command that was sent last."""
        # Earlier commands that would begin later had wrong times.
        while self._begun and self._begun[-1][0] >= begins:
            self._begun.pop()
        self._begun.append((begins, np.array(command, dtype=float)))

    def send(self, time: float, command: Float[np.ndarray, " c"], model: Model) -> None:
        """Record the drives that a command causes, sent last."""
        actuation = model.vehicle.actuation
        if self._wheels is None:
            self._wheels = actuation.spinning()
        times, drives = actuation.drive(np.array([time]), command[None], self._wheels)
        for begins, drive in zip(times.tolist(), drives, strict=True):
            self.add(begins + model.transport_delay, drive)

    def drop(self, time: float) -> None:
        """Drop commands older than the command that acts at a time."""
        while len(self._begun) > 1 and self._begun[1][0] + self.later <= time:
            self._begun.popleft()

    def until(self, time: float) -> list[tuple[float, Float[np.ndarray, " n"]]]:
        """Return the commands that have begun to act by a time, with their start times."""
        begun = ((begins + self.later, command) for begins, command in self._begun)
        return [entry for entry in begun if entry[0] <= time]

    def cut(self, start: float, stop: float) -> list[tuple[float, Float[np.ndarray, " n"]]]:
        """Split a time span where commands change; return durations [s] and commands."""
        pieces, acting = [], self._begun[0][1]
        now, stop = start - self.later, stop - self.later
        for begins, command in self._begun:
            if begins > stop:
                break
            if begins > now:
                pieces.append((begins - now, acting))
                now = begins
            acting = command
        return [*pieces, (stop - now, acting)]
