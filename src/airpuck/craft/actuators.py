"""Kinds of actuators: how commands drive them, and how their force follows.

The force of every kind is a thrust curve of a state that follows its drive in [0, 1] with a
first-order lag, a transport delay after the command. An actuator that pushes both ways has two
drives, one for each direction (`Channel`). So the physics is the same for all kinds, each direction
has its own thrust curve, and every thrust is positive. A reaction wheel gives a moment instead of a
force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.boundary.files import NonNegative, Positive, Section

#: Each packet starts a PWM period if the usual interval is this close to it [relative].
_SAME_PERIOD = 0.1
#: Edges of pulses that are closer than this are one event [s].
_ONE_EVENT = 1e-9
#: Longest plausible times of a valve, and of a PWM period [s].
_VALVE_TIME, _PWM_TIME = 0.5, 2.0
#: Shortest and longest lag of a wheel [s]; a fit of propellers has the same bounds.
_LEAST_LAG, _LONGEST_LAG = 1e-4, 1.0
#: Changes of a wheel's speed below this are rounding [fraction of the largest speed].
_NO_SPEED = 1e-12


class Propellers(Section):
    """Propellers: motors that follow any command; the thrust curve is a polynomial."""

    #: This kind.
    kind: Literal["propeller"] = "propeller"

    #: Time from the driver to the force [s], and shortest pulse [s].
    dead_time_s: ClassVar[float] = 0.0
    least_on_s: ClassVar[float] = 0.0
    #: Whether the force is either full or zero, so that only its mean can be commanded.
    pulsed: ClassVar[bool] = False
    #: Standard error of the vehicle file's lag [s]; None: a fit learns the lag.
    lag_error: ClassVar[float | None] = None

    def nominal(self) -> dict[str, float]:
        """Return nominal values of a vehicle that follow from this kind."""
        return {}

    def check_thrust(self, degree: int) -> None:
        """Raise ValueError for a thrust curve of a degree that this kind does not have."""

    def possible(self, command: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Return the nearest command that the actuators can follow exactly."""
        return command

    def drive(
        self, time: Float[np.ndarray, " K"], command: Float[np.ndarray, "K n"]
    ) -> tuple[Float[np.ndarray, " E"], Float[np.ndarray, "E n"]]:
        """Return the drives that commands cause, and their start times."""
        return time, command

    def lag(self, xp: Any, drive: Any, time_constant: Any) -> Any:
        """Return the lag of the force behind a drive; `time_constant` is its mean."""
        return time_constant


class OnOff(Section):
    """Valves: full force (``nominal.thrust_N``) or none, by switches or by duty cycles."""

    #: This kind.
    kind: Literal["on_off"]
    #: From switching to the beginning of the change of the force.
    dead_time_s: Annotated[float, pydantic.Field(ge=0, le=_VALVE_TIME)] = 0.0
    #: First-order lag of the force when the valve opens, and when it closes.
    rise_s: Annotated[float, pydantic.Field(ge=0, le=_VALVE_TIME)] = 0.0
    fall_s: Annotated[float, pydantic.Field(ge=0, le=_VALVE_TIME)] = 0.0
    #: Standard error of their mean; by default as large as the mean. A fit keeps the mean unless
    #: poses determine it more accurately.
    lag_error_s: Annotated[float, pydantic.Field(ge=0, le=_VALVE_TIME)] | None = None
    #: Shortest pulse; an open valve is held open this long.
    least_on_s: NonNegative = 0.0
    #: Commands are duty cycles over this period, which the craft turns into pulses. Without it they
    #: are switches: open from 0.5 on.
    pwm_period_s: Annotated[float, pydantic.Field(ge=1e-3, le=_PWM_TIME)] | None = None

    pulsed: ClassVar[bool] = True

    @pydantic.model_validator(mode="after")
    def _pulse_fits(self) -> OnOff:
        if self.pwm_period_s is not None and self.least_on_s > self.pwm_period_s:
            raise ValueError("least_on_s must not exceed pwm_period_s")
        return self

    @property
    def lag_error(self) -> float | None:
        """Standard error of the mean lag [s]; None: nothing is stated about the lag."""
        return self.lag_error_s if self.lag_error_s is not None else self._mean_lag or None

    @property
    def _mean_lag(self) -> float:
        """Mean of the lags of opening and closing [s]."""
        return (self.rise_s + self.fall_s) / 2

    def nominal(self) -> dict[str, float]:
        """Return mean lag and dead time."""
        return {"motor_time_constant_s": self._mean_lag, "transport_delay_s": self.dead_time_s}

    def check_thrust(self, degree: int) -> None:
        """Raise ValueError unless the curve is linear: F(u) = F u, also for means over pulses."""
        if degree != 1:
            raise ValueError(
                f"the force of on/off thrusters is proportional to their on-time; a thrust curve "
                f"of degree {degree} cannot be identified; use degree 1"
            )

    def possible(self, command: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Return 0 or 1 for switches, otherwise duty cycles without pulses that are too short."""
        if self.pwm_period_s is None:
            return np.where(command >= 0.5, 1.0, 0.0)
        least = self.least_on_s / self.pwm_period_s
        return np.where(command < least, np.where(command < least / 2, 0.0, least), command)

    def drive(
        self, time: Float[np.ndarray, " K"], command: Float[np.ndarray, "K n"]
    ) -> tuple[Float[np.ndarray, " E"], Float[np.ndarray, "E n"]]:
        """Return when the valves are open, or the mean if the times of the pulses are unknown.

        Packets at the rate of the PWM begin one pulse each. At other rates the phase of pulses is
        unknown, so commands act by their mean.
        """
        period = self.pwm_period_s
        if period is None:
            return time, self.possible(command)
        pace = np.median(np.diff(time)) if len(time) > 1 else period
        if abs(pace - period) > _SAME_PERIOD * period:
            return time, command
        # The driver holds an open valve open for the least on-time.
        lasting = np.where(command > 0, np.maximum(command * period, self.least_on_s), 0.0)
        shut = time[:, None] + lasting
        ends = np.append(time[1:], np.inf)
        shuts = (lasting > 0) & (lasting < period) & (shut < ends[:, None] - _ONE_EVENT)
        times = np.concatenate([time, shut[shuts]])
        packet = np.concatenate([np.arange(len(time)), np.nonzero(shuts)[0]])
        order = np.lexsort((times, packet))
        times, packet = times[order], packet[order]
        still = shut[packet] > times[:, None] + _ONE_EVENT
        return times, np.where(still | (command[packet] >= 1), 1.0, 0.0)

    def lag(self, xp: Any, drive: Any, time_constant: Any) -> Any:
        """Return a lag for each valve, (n, 1), which opens and closes at different rates."""
        if self._mean_lag == 0:
            return time_constant
        return (
            time_constant
            / self._mean_lag
            * xp.where(drive > 0.5, self.rise_s, self.fall_s)[:, None]
        )


Actuators = Annotated[Propellers | OnOff, pydantic.Field(discriminator="kind")]


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
        away = command - self.speed
        drive = math.copysign(1.0, away) if self._by_speed else command
        left = away if self._by_speed else math.copysign(1.0, drive) - self.speed
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

    @property
    def _by_speed(self) -> bool:
        return self._wheel.commanded == "speed"


@dataclass(frozen=True)
class Channel:
    """One direction in which an actuator pushes; the model treats it as a propeller."""

    name: str
    #: Column of the command, and the sign of commands that push this way.
    column: int
    sign: int
    #: Position, direction of the force (counter-clockwise from the body's x axis), and a moment per
    #: thrust in addition to the moment of this force.
    position_m: tuple[float, float]
    direction_deg: float
    couple: float = 0.0
    #: Thrust relative to the actuator's nominal one.
    strength: float = 1.0
    #: Its own lag [s]; None: the propellers' lag.
    time_constant_s: float | None = None

    @property
    def is_wheel(self) -> bool:
        """Whether it turns the craft without pushing it."""
        return self.couple != 0


@dataclass(frozen=True)
class ActuatorSet:
    """All actuators of a craft: between the columns of a command and the drives of channels."""

    kind: Propellers | OnOff
    wheels: tuple[Wheel, ...]
    channels: tuple[Channel, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the actuators, by name: ``propeller``, ``on_off``, …."""
        reverses = any(channel.sign < 0 and not channel.is_wheel for channel in self.channels)
        more = {"reversible propeller": reverses, "reaction wheel": bool(self.wheels)}
        return (self.kind.kind, *(name for name, present in more.items() if present))

    @cached_property
    def own_lag(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Mask of channels that share one lag, (n, 1), and the lags of others [s]; or None."""
        own = np.array([[channel.time_constant_s or 0.0] for channel in self.channels])
        return (np.where(own > 0, 0.0, 1.0), own) if own.any() else None

    @property
    def n_columns(self) -> int:
        """Number of columns of a command."""
        return 1 + max(channel.column for channel in self.channels)

    @property
    def two_way(self) -> np.ndarray:
        """Whether each column takes commands in [-1, 1] instead of [0, 1]."""
        return np.isin(np.arange(self.n_columns), [c.column for c in self.channels if c.sign < 0])

    @property
    def _first_wheel(self) -> int:
        return self.n_columns - len(self.wheels)

    def spinning(self) -> tuple[Spinning, ...]:
        """Return the wheels at rest."""
        return tuple(map(Spinning, self.wheels))

    def split(self, command: Float[np.ndarray, "*n c"]) -> Float[np.ndarray, "*n n"]:
        """Return the drives of channels, given one drive in [-1, 1] for each column."""
        if len(self.channels) == self.n_columns:
            return command
        columns, signs = np.array([(c.column, c.sign) for c in self.channels]).T
        return np.maximum(command[..., columns] * signs, 0.0)

    def joined(self, drive: Float[np.ndarray, "*n n"]) -> Float[np.ndarray, "*n c"]:
        """Return one drive for each column: the difference of its two directions."""
        if len(self.channels) == self.n_columns:
            return drive
        joined = np.zeros((*drive.shape[:-1], self.n_columns))
        for k, channel in enumerate(self.channels):
            joined[..., channel.column] += channel.sign * drive[..., k]
        return joined

    def possible(self, command: Float[np.ndarray, "*n c"]) -> Float[np.ndarray, "*n c"]:
        """Return the nearest command that the actuators can follow exactly."""
        first = self._first_wheel
        thrusters = self.kind.possible(command[..., :first])
        return np.concatenate([thrusters, command[..., first:]], axis=-1)

    def drive(
        self,
        time: Float[np.ndarray, " K"],
        command: Float[np.ndarray, "K c"],
        spinning: Sequence[Spinning] | None = None,
    ) -> tuple[Float[np.ndarray, " E"], Float[np.ndarray, "E n"]]:
        """Return the drives that commands cause, and their start times.

        Wheels are at rest before the first command unless `spinning` gives them; it is updated.
        """
        first = self._first_wheel
        times, drives = self.kind.drive(time, command[:, :first])
        if not self.wheels:
            return times, self.split(drives)
        parts = [(times, drives)]
        wheels = spinning or self.spinning()
        for wheel, column in zip(wheels, command[:, first:].T, strict=True):
            changes = [(-math.inf, 0.0)]
            for begins, value in zip(time.tolist(), column.tolist(), strict=True):
                # The next command replaces what is left of the last one.
                while changes[-1][0] >= begins:
                    changes.pop()
                changes += wheel.changes(begins, value)
            begun, values = np.array(changes[1:]).T
            parts.append((begun, values[:, None]))
        every = np.unique(np.concatenate([begun for begun, _ in parts]))
        held = [values[np.searchsorted(begun, every, side="right") - 1] for begun, values in parts]
        return every, self.split(np.hstack(held))
