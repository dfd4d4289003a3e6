"""Kinds of actuators: how commands drive them, and how their force follows.

The force of every kind is a thrust curve of a state that follows its drive in [0, 1] with a
first-order lag, a transport delay after the command. An actuator that pushes both ways has two
drives, one for each direction (`Channel`). So the physics is the same for all kinds, each direction
has its own thrust curve, and every thrust is positive.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from jaxtyping import Float
from pydantic_core import core_schema

from airpuck.boundary.extensions import added, loaded
from airpuck.boundary.files import NonNegative, Section
from airpuck.craft.wheel import Spinning, Wheel

#: Each packet starts a PWM period if the usual interval is this close to it [relative].
_SAME_PERIOD = 0.1
#: Edges of pulses that are closer than this are one event [s].
_ONE_EVENT = 1e-9
#: Longest plausible times of a valve, and of a PWM period [s].
_VALVE_TIME, _PWM_TIME = 0.5, 2.0


class ActuatorKind(Section):
    """Base of all kinds of thrusters: its physics, for recordings, controllers and the twin alike.

    A subclass names itself by the default of `kind`. It overrides `possible` if its actuators can
    follow only some commands, and `changes` if a command causes several drives, one after another.

    Examples
    --------
    >>> from typing import Literal
    >>> class Stepped(airpuck.ActuatorKind):
    ...     kind: Literal["stepped"] = "stepped"
    ...     levels: int = 8
    ...     def possible(self, command):
    ...         return np.round(command * self.levels) / self.levels
    ...
    >>> Stepped(levels=4).possible(np.array([0.3]))
    array([0.25])
    """

    #: This kind.
    kind: Any
    #: Time from the driver to the force.
    dead_time_s: NonNegative = 0.0
    #: Shortest pulse; an open valve is held open this long.
    least_on_s: NonNegative = 0.0
    #: A driver with a clock of its own takes a new command once in this period.
    pwm_period_s: Annotated[float, pydantic.Field(ge=1e-3, le=_PWM_TIME)] | None = None

    #: Whether the force is either full or zero, so that only its mean can be commanded.
    pulsed: ClassVar[bool] = False

    @property
    def lag_error(self) -> float | None:
        """Standard error of the vehicle file's lag [s]; None: a fit learns the lag."""
        return None

    def nominal(self) -> dict[str, float]:
        """Return nominal values of a vehicle that follow from this kind.

        Returns
        -------
        dict
            By name.
        """
        return {}

    def check_thrust(self, degree: int) -> None:
        """Raise ValueError for a thrust curve of a degree that this kind does not have.

        Parameters
        ----------
        degree : int
            Degree of the polynomial.
        """

    def possible(self, command: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Return the nearest command that the actuators can follow exactly.

        Parameters
        ----------
        command : array
            In [0, 1].

        Returns
        -------
        array
            In the same shape.
        """
        return command

    def changes(
        self, time: float, command: Float[np.ndarray, " n"], since: Float[np.ndarray, " n"]
    ) -> Sequence[tuple[float, Float[np.ndarray, " n"]]]:
        """Return the drives that a command causes, until the next one replaces them.

        Parameters
        ----------
        time : float
            When the driver takes the command [s].
        command : array, shape (n,)
            In [0, 1].
        since : array, shape (n,)
            When each drive last rose from zero; -inf where it is zero [s].

        Returns
        -------
        sequence of (float, array of shape (n,))
            Start times, the first of which is `time`, and the drives from then on.
        """
        return [(time, self.possible(command))]

    def drive(
        self, time: Float[np.ndarray, " K"], command: Float[np.ndarray, "K n"]
    ) -> tuple[Float[np.ndarray, " E"], Float[np.ndarray, "E n"]]:
        """Return the drives that recorded commands cause, and their start times; see `changes`.

        Parameters
        ----------
        time : array, shape (K,)
            When the commands arrive [s].
        command : array, shape (K, n)
            In [0, 1].

        Returns
        -------
        time, drive : array, shape (E,) and (E, n)
            Each drive holds until the next.
        """
        if type(self).changes is ActuatorKind.changes:
            return time, self.possible(command)
        driven, found = Driven(self, command.shape[1]), []
        for begins, one in zip(time.tolist(), command, strict=True):
            found += driven.until(begins - _ONE_EVENT)
            driven.take(begins, one)
        times, drives = zip(*found, *driven.until(math.inf), strict=True)
        return np.array(times), np.array(drives)

    def lag(self, xp: Any, drive: Any, time_constant: Any) -> Any:
        """Return the lag of the force behind a drive.

        Parameters
        ----------
        xp : module
            Array namespace.
        drive : array, shape (n,)
            The drive now.
        time_constant : array
            The mean lag [s].

        Returns
        -------
        array
            One lag for all, or one for each, of shape (n, 1).
        """
        return time_constant


class Driven:
    """The drives of actuators under their commands, from rest on; times must not decrease."""

    def __init__(self, kind: ActuatorKind, n: int) -> None:
        self._kind, self.drive = kind, np.zeros(n)
        self._since = np.full(n, -math.inf)
        #: Drives that the last command causes from now on.
        self.ahead: deque[tuple[float, Float[np.ndarray, " n"]]] = deque()

    def take(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Take a command, which replaces what is left of the last one."""
        self.ahead = deque(self._kind.changes(time, command, self._since))

    def until(self, time: float) -> list[tuple[float, Float[np.ndarray, " n"]]]:
        """Pass the changes up to a time, and return them."""
        passed = []
        while self.ahead and self.ahead[0][0] <= time:
            passed.append(self.ahead.popleft())
            begun, self.drive = passed[-1]
            rising = np.where(np.isinf(self._since), begun, self._since)
            self._since = np.where(self.drive > 0, rising, -math.inf)
        return passed


class Propellers(ActuatorKind):
    """Propellers: motors that follow any command; the thrust curve is a polynomial."""

    #: This kind.
    kind: Literal["propeller"] = "propeller"


class OnOff(ActuatorKind):
    """Valves: full force (``nominal.thrust_N``) or none, by switches or by duty cycles.

    With a PWM period, commands are duty cycles over it, which the craft turns into pulses. Without
    it they are switches: open from 0.5 on.
    """

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

    def changes(
        self, time: float, command: Float[np.ndarray, " n"], since: Float[np.ndarray, " n"]
    ) -> Sequence[tuple[float, Float[np.ndarray, " n"]]]:
        """Return when the valves open and shut; see `ActuatorKind.changes`."""
        period = self.pwm_period_s
        opens = command > 0 if period else command >= 0.5
        lasts = np.where(command < 1, command * period, math.inf) if period else math.inf
        # An open valve is held open for the least on-time.
        held = np.where(opens & np.isinf(since), time, since) + self.least_on_s
        shut = np.maximum(np.where(opens, time + lasts, -math.inf), held)
        later = shut[(shut > time + _ONE_EVENT) & (shut < math.inf)]
        return [(t, (shut > t + _ONE_EVENT) * 1.0) for t in (time, *np.unique(later).tolist())]

    def drive(
        self, time: Float[np.ndarray, " K"], command: Float[np.ndarray, "K n"]
    ) -> tuple[Float[np.ndarray, " E"], Float[np.ndarray, "E n"]]:
        """Return when the valves are open, or the mean if the times of the pulses are unknown.

        Packets at the rate of the PWM begin one pulse each. At other rates the phase of pulses is
        unknown, so commands act by their mean.
        """
        period = self.pwm_period_s
        pace = np.median(np.diff(time)) if len(time) > 1 else period
        if period is not None and abs((pace or period) - period) > _SAME_PERIOD * period:
            return time, command
        return super().drive(time, command)

    def lag(self, xp: Any, drive: Any, time_constant: Any) -> Any:
        """Return a lag for each valve, (n, 1), which opens and closes at different rates."""
        if self._mean_lag == 0:
            return time_constant
        own = xp.where(drive > 0.5, self.rise_s, self.fall_s)[:, None]
        return time_constant / self._mean_lag * own


def _of_kind(value: Any, packaged: Callable[[Any], ActuatorKind]) -> ActuatorKind:
    """Return actuators of a kind in this package, or of a user's subclass that is imported."""
    name = value.get("kind") if isinstance(value, dict) else None
    if isinstance(value, ActuatorKind):
        return value
    if isinstance(name, str) and name in added("airpuck.actuators"):
        loaded("airpuck.actuators", name)
    for kind in ActuatorKind.__subclasses__():
        if kind not in (Propellers, OnOff) and kind.model_fields["kind"].default == name:
            return kind.model_validate_json(json.dumps(value), strict=True)
    if isinstance(name, str) and name not in ("propeller", "on_off"):
        raise ValueError(
            f"there is no kind {name!r}; choose propeller or on_off, or append +FILE.py:NAME to "
            "the name of the file"
        )
    return packaged(value)


class _OpenKinds:
    """The schema of actuators, for the kinds of this package and of users."""

    def __get_pydantic_core_schema__(self, _source: Any, handler: Any) -> Any:
        union = Annotated[Propellers | OnOff, pydantic.Field(discriminator="kind")]
        dump = core_schema.plain_serializer_function_ser_schema(
            lambda kind: kind.model_dump(mode="json")
        )
        return core_schema.no_info_wrap_validator_function(
            _of_kind, handler.generate_schema(union), serialization=dump
        )


Actuators = Annotated[ActuatorKind, _OpenKinds()]


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

    kind: ActuatorKind
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
