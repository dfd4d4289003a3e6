"""Drivers of actuators on the craft: from the command in force to the drive of each actuator.

A driver of on/off thrusters simulates every switching instant, between any samples: PWM periods,
pulses no shorter than the least on-time, dead time. Rise and fall belong to the plant.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from airpuck.craft.actuators import ActuatorSet, OnOff, Propellers

Command = Float[np.ndarray, " n"]
#: A packet that is late by less than this at the end of a PWM period counts as in time, since time
#: stamps are rounded [s].
_IN_TIME = 1e-9
#: Fraction of a PWM period after which a new packet begins the next one. Earlier ones wait.
_RESTARTS = 0.5


class Direct:
    """Passes commands on: the driver of propellers."""

    def __init__(self, actuators: Propellers, n: int) -> None: ...

    def next_change(self, now: float, command: Callable[[float], Command]) -> float:
        """Return when a drive next changes under the current command."""
        return math.inf

    def drive(self, now: float, command: Command) -> Command:
        """Return the drives now."""
        return command


class Valves:
    """Switches valves: the driver of on/off thrusters."""

    def __init__(self, actuators: OnOff, n: int) -> None:
        self._kind = actuators
        #: Electrical state, when it last rose, and the drives a dead time later.
        self._open = np.zeros(n, dtype=bool)
        self._since = np.full(n, -math.inf)
        self._force = np.zeros(n)
        self._pending: deque[tuple[float, Command]] = deque()
        #: Duty cycles of the present PWM period, and its start.
        self._duty, self._begun = np.zeros(n), -math.inf
        #: Whether a packet began the period; otherwise the previous period is repeated.
        self._fresh = False

    def next_change(self, now: float, command: Callable[[float], Command]) -> float:
        """Return when a drive next changes under the current command."""
        self.drive(now, command(now))
        times = [time for time, _ in self._pending]
        times += (self._since + self._kind.least_on_s)[self._open].tolist()
        period = self._kind.pwm_period_s
        if period is not None:
            times += (self._begun + self._duty * period).tolist()
            times += [self._begun + period * _RESTARTS, self._begun + period + _IN_TIME]
        return min((time for time in times if time > now), default=math.inf)

    def drive(self, now: float, command: Command) -> Command:
        """Return the drives now; times must not decrease."""
        wanted = self._wanted(now, command)
        opens = wanted & ~self._open
        shuts = ~wanted & self._open & (now >= self._since + self._kind.least_on_s)
        if opens.any() or shuts.any():
            self._open = (self._open | opens) & ~shuts
            self._since[opens] = now
            self._pending.append((now + self._kind.dead_time_s, self._open.astype(float)))
        while self._pending and self._pending[0][0] <= now:
            _, self._force = self._pending.popleft()
        return self._force

    def _wanted(self, now: float, command: Command) -> Bool[np.ndarray, " n"]:
        """Return which valves the command opens now."""
        period = self._kind.pwm_period_s
        if period is None:
            return command >= 0.5
        news = not np.array_equal(command, self._duty)
        early = self._fresh and now < self._begun + _RESTARTS * period
        if (news and not early) or now >= self._begun + period + _IN_TIME:
            self._duty, self._begun, self._fresh = command, now, news
        return (self._duty >= 1) | (now < self._begun + self._duty * period)


class TwoWayDriver:
    """Driver for wheels and for actuators that push both ways, around the thrusters' own driver."""

    def __init__(self, actuation: ActuatorSet, thrusters: Direct | Valves) -> None:
        self._split, self._thrusters = actuation.split, thrusters
        self._first_wheel = actuation.n_columns - len(actuation.wheels)
        self._wheels = actuation.spinning()

    def next_change(self, now: float, command: Callable[[float], Command]) -> float:
        """Return when a drive next changes under the current command."""
        self.drive(now, command(now))
        changes = [wheel.ends for wheel in self._wheels if wheel.ends > now]
        first = self._first_wheel
        event = self._thrusters.next_change(now, lambda time: command(time)[:first])
        return min([event, *changes])

    def drive(self, now: float, command: Float[np.ndarray, " c"]) -> Command:
        """Return the drives now; times must not decrease."""
        drives = list(self._thrusters.drive(now, command[: self._first_wheel]))
        commanded = command[self._first_wheel :].tolist()
        for wheel, value in zip(self._wheels, commanded, strict=True):
            if value != wheel.command:
                wheel.follow(now, value)
            drives.append(wheel.drive()[0] if now < wheel.ends else 0.0)
        return self._split(np.array(drives))


#: Drivers of thrusters by kind.
_DRIVERS: dict[str, Callable[..., Direct | Valves]] = {"propeller": Direct, "on_off": Valves}


def driver_of(actuation: ActuatorSet) -> Direct | Valves | TwoWayDriver:
    """Return the driver of a craft's actuators at rest."""
    kind = actuation.kind
    thrusters = _DRIVERS[kind.kind](kind, actuation.n_columns - len(actuation.wheels))
    return TwoWayDriver(actuation, thrusters) if actuation.two_way.any() else thrusters
