"""Reaction wheels, which give a moment instead of a force."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import pydantic

from airpuck.boundary.files import Positive, Section

#: Shortest and longest lag of a wheel [s]; a fit of propellers has the same bounds.
_LEAST_LAG, _LONGEST_LAG = 1e-4, 1.0
#: Changes of a wheel's speed below this are rounding [fraction of the largest speed].
_NO_SPEED = 1e-12


class Wheel(Section):
    """A reaction wheel: a pure moment, until the wheel reaches its largest speed."""

    #: The column of a command that drives it.
    name: str = pydantic.Field(min_length=1)
    #: Torque at full command; if speeds are commanded, torque while the wheel changes its speed.
    torque_Nm: Positive
    #: Moment of inertia of the wheel about its axis, and its largest speed.
    inertia_kg_m2: Positive
    max_speed_rad_s: Positive
    #: Whether a command in [-1, 1] is a fraction of `torque_Nm` or of `max_speed_rad_s`.
    commanded: Literal["torque", "speed"] = "torque"
    #: Which way a positive command turns the craft: against the wheel.
    turns_craft: Literal["left", "right"] = "right"
    #: First-order lag of its torque; by default the propellers' lag.
    time_constant_s: Annotated[float, pydantic.Field(ge=_LEAST_LAG, le=_LONGEST_LAG)] | None = None
    #: Standard error of that lag; by default as large as the lag.
    lag_error_s: Annotated[float, pydantic.Field(ge=0, le=_LONGEST_LAG)] | None = None

    @property
    def lag_error(self) -> float:
        """Standard error of its own lag [s]; 0 if it has none."""
        if self.time_constant_s is None:
            return 0.0
        return self.time_constant_s if self.lag_error_s is None else self.lag_error_s

    def slower(self, by: float) -> Wheel:
        """Return the wheel with its own lag longer by a time [s], within the plausible range."""
        if self.time_constant_s is None:
            return self
        lag = min(max(self.time_constant_s + by, _LEAST_LAG), _LONGEST_LAG)
        return self.model_copy(update={"time_constant_s": lag})

    @property
    def spin_up_s(self) -> float:
        """Time from rest to the largest speed at full torque."""
        return self.inertia_kg_m2 * self.max_speed_rad_s / self.torque_Nm

    @property
    def couple(self) -> float:
        """Moment on the craft per torque of a positive command."""
        return 1.0 if self.turns_craft == "left" else -1.0


class Spinning:
    """The speed of a wheel under its commands, starting at rest."""

    def __init__(self, wheel: Wheel) -> None:
        self._wheel = wheel
        #: Fraction of the largest speed, at the time of the last command.
        self.speed = 0.0
        self._since, self.command = -math.inf, 0.0

    def follow(self, time: float, command: float) -> None:
        """Receive a command; times must not decrease."""
        drive, lasts = self.drive()
        if drive:
            elapsed = min(max(time - self._since, 0.0), lasts)
            self.speed += drive * elapsed / self._wheel.spin_up_s
        self._since, self.command = time, command

    def drive(self) -> tuple[float, float]:
        """Return the torque from the last command on, as a fraction, and how long it lasts [s]."""
        command, full = self.command, self._wheel.spin_up_s
        away, by_speed = command - self.speed, self._wheel.commanded == "speed"
        drive = math.copysign(1.0, away) if by_speed else command
        left = away if by_speed else math.copysign(1.0, drive) - self.speed
        # A wheel at its largest speed cannot be accelerated.
        lasting = drive * left > _NO_SPEED
        return (drive, full * left / drive) if lasting else (0.0, math.inf)

    @property
    def ends(self) -> float:
        """Time at which the current torque ends [s]."""
        return self._since + self.drive()[1]

    def changes(self, time: float, command: float) -> list[tuple[float, float]]:
        """Receive a command; return the drives that it causes, with their start times."""
        self.follow(time, command)
        drive, lasts = self.drive()
        return [(time, drive)] if lasts == math.inf else [(time, drive), (time + lasts, 0.0)]
