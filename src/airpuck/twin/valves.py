"""Drivers of actuators on the craft: from the command in force to the drive of each actuator.

A driver simulates every change of a drive, between any samples: pulses, PWM periods, dead time. The
changes come from the kind of actuator; rise and fall belong to the plant.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from airpuck.craft.actuators import ActuatorKind, ActuatorSet, Driven

Command = Float[np.ndarray, " n"]
#: A packet that is late by less than this at the end of a PWM period counts as in time, since time
#: stamps are rounded [s].
_IN_TIME = 1e-9
#: Fraction of a PWM period after which a new packet begins the next one. Earlier ones wait.
_RESTARTS = 0.5


class Driver:
    """Drives actuators of one kind: takes commands, and their changes a dead time later."""

    def __init__(self, kind: ActuatorKind, n: int) -> None:
        self._kind, self._driven, self._force = kind, Driven(kind, n), np.zeros(n)
        self._later: deque[tuple[float, Command]] = deque()
        #: The command that was taken, when, and whether a packet brought it; otherwise the previous
        #: PWM period is repeated.
        self._command, self._begun, self._fresh = np.zeros(n), -math.inf, False

    def next_change(self, now: float, command: Callable[[float], Command]) -> float:
        """Return when a drive next changes under the current command."""
        self.drive(now, command(now))
        times = [time for time, _ in (*self._later, *self._driven.ahead)]
        if (period := self._kind.pwm_period_s) is not None:
            times += [self._begun + period * _RESTARTS, self._begun + period + _IN_TIME]
        return min((time for time in times if time > now), default=math.inf)

    def drive(self, now: float, command: Command) -> Command:
        """Return the drives now; times must not decrease."""
        changed = self._driven.until(now)
        if self._takes(now, command):
            self._driven.take(now, command)
            changed += self._driven.until(now)
        self._later.extend((time + self._kind.dead_time_s, drive) for time, drive in changed)
        while self._later and self._later[0][0] <= now:
            _, self._force = self._later.popleft()
        return self._force

    def _takes(self, now: float, command: Command) -> bool:
        """Return whether the driver takes a command now, and remember it."""
        news, period = not np.array_equal(command, self._command), self._kind.pwm_period_s or 0.0
        early = self._fresh and now < self._begun + _RESTARTS * period
        again = math.isinf(self._begun) or 0 < period <= now - _IN_TIME - self._begun
        if takes := (news and not early) or again:
            self._command, self._begun, self._fresh = command, now, news
        return takes


class TwoWayDriver:
    """Driver for wheels and for actuators that push both ways, around the thrusters' own driver."""

    def __init__(self, actuation: ActuatorSet, thrusters: Driver) -> None:
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


def driver_of(actuation: ActuatorSet) -> Driver | TwoWayDriver:
    """Return the driver of a craft's actuators at rest."""
    thrusters = Driver(actuation.kind, actuation.n_columns - len(actuation.wheels))
    return TwoWayDriver(actuation, thrusters) if actuation.two_way.any() else thrusters
