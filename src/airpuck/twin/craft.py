"""A craft on the simulated table: from the command that was sent to the craft's motion."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError, nearest
from airpuck.craft.actuators import ActuatorKind, ActuatorSet, Driven
from airpuck.model.model_file import Model
from airpuck.physics.puck_on_table import Moving, PuckOnTable
from airpuck.twin.plant import LONGEST_STEP, Plant
from airpuck.twin.radio import RadioLink
from airpuck.twin.settings import Motors, Starts, TwinSettings

MotorCommand = Float[np.ndarray, " n"]
#: A packet that is late by less than this at the end of a PWM period counts as in time, since time
#: stamps are rounded [s].
_IN_TIME = 1e-9
#: Fraction of a PWM period after which a new packet begins the next one. Earlier ones wait.
_RESTARTS = 0.5


class Driver:
    """Drives actuators of one kind: takes commands, and their changes a dead time later.

    It simulates every change of a drive, between any samples: pulses, PWM periods, dead time. The
    changes come from the kind of actuator; rise and fall belong to the plant.
    """

    def __init__(self, kind: ActuatorKind, n: int) -> None:
        self._kind, self._driven, self._force = kind, Driven(kind, n), np.zeros(n)
        self._later: deque[tuple[float, MotorCommand]] = deque()
        #: The command that was taken, when, and whether a packet brought it; otherwise the previous
        #: PWM period is repeated.
        self._command, self._begun, self._fresh = np.zeros(n), -math.inf, False

    def next_change(self, now: float, command: Callable[[float], MotorCommand]) -> float:
        """Return when a drive next changes under the current command."""
        self.drive(now, command(now))
        times = [time for time, _ in (*self._later, *self._driven.ahead)]
        if (period := self._kind.pwm_period_s) is not None:
            times += [self._begun + period * _RESTARTS, self._begun + period + _IN_TIME]
        return min((time for time in times if time > now), default=math.inf)

    def drive(self, now: float, command: MotorCommand) -> MotorCommand:
        """Return the drives now; times must not decrease."""
        changed = self._driven.until(now)
        if self._takes(now, command):
            self._driven.take(now, command)
            changed += self._driven.until(now)
        self._later.extend((time + self._kind.dead_time_s, drive) for time, drive in changed)
        while self._later and self._later[0][0] <= now:
            _, self._force = self._later.popleft()
        return self._force

    def _takes(self, now: float, command: MotorCommand) -> bool:
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

    def next_change(self, now: float, command: Callable[[float], MotorCommand]) -> float:
        """Return when a drive next changes under the current command."""
        self.drive(now, command(now))
        changes = [wheel.ends for wheel in self._wheels if wheel.ends > now]
        first = self._first_wheel
        event = self._thrusters.next_change(now, lambda time: command(time)[:first])
        return min([event, *changes])

    def drive(self, now: float, command: Float[np.ndarray, " c"]) -> MotorCommand:
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


#: Longest step while the puck is near the craft [s]: within it, the path of a craft at full thrust
#: is straight to a micrometre.
_SHORT_STEP = 1e-3
#: Distance that counts as near, in addition to both bodies' travel in a step [m].
_NEAR = 5e-3
#: Stream of random numbers for starts of motors; others are the radio's and the sensors'.
_STARTS = 40


class MotorUnit:
    """From the received command to the command that the motors follow."""

    def __init__(
        self,
        settings: Motors,
        names: tuple[str, ...],
        starts: Starts | None = None,
        random: np.random.Generator | None = None,
    ) -> None:
        for field, faults in (("stalls", settings.stalls), ("weak", settings.weak)):
            for fault in faults:
                if fault.motor not in names:
                    raise InputError(
                        f"there is no motor called {fault.motor!r} (there are {', '.join(names)})"
                        + nearest(fault.motor, names),
                        field=f"motors.{field}",
                    )
        self._settings = settings
        self._stalls = [(names.index(s.motor), s.start_s, s.stop_s) for s in settings.stalls]
        self._weak = [(names.index(w.motor), w) for w in settings.weak]
        faults = (*settings.stalls, *settings.weak)
        self._edges = sorted(
            {settings.unarmed_s, *(t for f in faults for t in (f.start_s, f.stop_s))}
        )
        #: Time from which each motor follows its command; infinite while it idles.
        self._released = np.full(len(names), np.inf)
        #: From when on each motor has rested.
        self._rested = np.full(len(names), -np.inf)
        self._starts, self._random = starts or Starts(), random or np.random.default_rng(0)
        self._starts_late = settings.starting_delay_s > 0 or any(self._starts.failed)
        #: Time, motor and duration of every start that failed [s].
        self.failed_starts: list[tuple[float, int, float]] = []
        self._full = np.ones(len(names))

    def next_change(self, now: float) -> float:
        """Return when a motor next fails or recovers."""
        released = self._released.tolist() if self._starts_late else ()
        return min((t for t in (*self._edges, *released) if now < t < math.inf), default=math.inf)

    def follow(self, now: float, command: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the commands that the motors follow now."""
        s = self._settings
        if now < s.unarmed_s:
            return np.zeros_like(command)
        if self._starts_late:
            idles = np.abs(command) < s.idle_below
            begins = ~idles & np.isinf(self._released)
            self._rested[idles & np.isfinite(self._released)] = now
            self._released[idles] = np.inf
            self._released[begins] = now + s.starting_delay_s
            for motor in np.flatnonzero(begins):
                self._released[motor] += self._failure(now, int(motor))
            follows = idles | (self._released <= now)
            command = np.where(follows, command, np.clip(command, -s.idle_below, s.idle_below))
        for motor, start, stop in self._stalls:
            if start <= now < stop:
                command = command.copy()
                command[motor] = 0.0
        return command

    def _failure(self, now: float, motor: int) -> float:
        """Draw whether a start fails; return for how long [s]."""
        if self._random.random() >= self._starts.failing(now - float(self._rested[motor])):
            return 0.0
        lasts = self._random.exponential(self._starts.lasting_s)
        self.failed_starts.append((now, motor, lasts))
        return lasts

    def share(self, now: float) -> Float[np.ndarray, " n"]:
        """Return the fraction of its thrust that each motor gives now."""
        share = self._full.copy() if self._weak else self._full
        for motor, weakness in self._weak:
            if weakness.start_s <= now < weakness.stop_s:
                share[motor] *= weakness.share
        return share


class Craft:
    """A craft: radio, motors and plant; one of the discs of a `World`.

    Parameters
    ----------
    model : Model
        The truth.
    settings : TwinSettings
        Radio, motors and their starts, battery.
    plant : Plant
        The craft on its table, with the effects of both.
    seed : int
        Random generator of the radio.
    pose : tuple of float
        Initial pose [m, m, rad].
    logs : bool
        Whether to record contacts.

    Attributes
    ----------
    state : array, shape (6 + n,)
        Pose, rates and motor speeds.
    contacts : list of (float, float)
        When it met a rail [s], and its speed towards the rail [m/s].
    """

    def __init__(
        self,
        model: Model,
        settings: TwinSettings,
        plant: Plant,
        seed: int,
        pose: tuple[float, float, float],
        logs: bool,
    ) -> None:
        vehicle = model.vehicle
        still = np.zeros(3 + vehicle.n_propellers)
        self.state: Float[np.ndarray, " s"] = np.concatenate([pose, still])
        self.plant, self.radius = plant, vehicle.radius_m
        random = np.random.default_rng([seed, 0])
        self.radio = RadioLink(settings.radio, random, len(vehicle.columns))
        starts = settings.starts, np.random.default_rng([seed, _STARTS])
        self.motors = MotorUnit(settings.motors, vehicle.columns, *starts)
        self.driver = driver_of(vehicle.actuation)
        self._column = [channel.column for channel in vehicle.actuation.channels]
        self.contacts: list[tuple[float, float]] = []
        self._logs = logs
        self._sag = settings.effects.battery_sag_1_s
        self._center_of_mass = tuple(map(float, plant.dynamics.center_of_mass))
        # State at the beginning of the current step, and at its end without a puck.
        self._step: tuple[float, float, Any, Any] = (0.0, 0.0, None, None)
        self._after, self._met = self.state, False

    def next_change(self, now: float) -> float:
        """Return when its motion next changes: a packet, a timeout, a fault, a valve [s]."""
        event = min(self.radio.next_change(now), self.motors.next_change(now))
        return min(event, self.driver.next_change(now, self._commanded))

    def _commanded(self, now: float) -> Float[np.ndarray, " n"]:
        """Return the commands that reach the drivers now."""
        return self.motors.follow(now, self.radio.command(now))

    def thrust_left(self, time: float) -> Float[np.ndarray, " n"]:
        """Return the fraction of the thrust that battery and motors still give."""
        return max(1 - self._sag * time, 0.0) * self.motors.share(time)[self._column]

    def pose(self) -> Float[np.ndarray, " 3"]:
        """Return the true pose."""
        return self.state[:3]

    def longest_step(self, puck: PuckOnTable) -> float:
        """Return how long a step may be; shorter if the craft may soon hit the puck [s]."""
        other = puck.state
        x, y, _, vx, vy = self.state[:5].tolist()
        apart = math.hypot(other.x - x, other.y - y) - self.radius - puck.radius
        moves = math.hypot(other.vx - vx, other.vy - vy) * LONGEST_STEP
        return LONGEST_STEP if apart > moves + _NEAR else _SHORT_STEP

    def moving(self, duration: float, now: float = 0.0) -> Moving:
        """Begin a step, as if there were no puck; return its path."""
        drive = self.driver.drive(now, self._commanded(now))
        self._step = now, duration, drive, self.thrust_left(now)
        self._after, self._met = self._flown(duration)
        return self._disc(self._after, duration)

    def arrive(self, way: Moving, lasted: float, hit: bool = False) -> None:
        """End the step after a duration: at the end of the path, or where it `hit` a puck."""
        now, duration, *_ = self._step
        before = self.state
        if hit or lasted < duration:
            self._after, self._met = self._flown(lasted) if lasted > 0 else (before, False)
        if hit:
            gained = [
                way.vx - way.ax * lasted,
                way.vy - way.ay * lasted,
                way.spin - way.spinning_up * lasted,
            ]
            velocity = self._after[3:6] + gained - before[3:6]
            self._after = np.concatenate([self._after[:3], velocity, self._after[6:]])
        elif lasted == duration and (way.x, way.y) != (self._after[0], self._after[1]):
            self._after = np.concatenate([[way.x, way.y], self._after[2:]])
        self.state = self._after
        if self._met and self._logs:
            self.contacts.append((now + lasted, self._towards_rail(before, self.state)))

    def disc(self) -> Moving:
        """Return it as a disc that others can hit now."""
        return self._disc(self.state, 1.0)

    @property
    def place(self) -> tuple[float, float]:
        """The position of its centre [m]."""
        x, y = self.state[:2].tolist()
        return x, y

    def take(self, disc: Moving) -> None:
        """Take the position and motion after a contact with another disc."""
        moved = [disc.x, disc.y, self.state[2], disc.vx, disc.vy, disc.spin]
        self.state = np.concatenate([moved, self.state[6:]])

    def _flown(self, duration: float) -> tuple[Any, bool]:
        """Return the craft's final state without a puck, and whether it touches a rail."""
        _, _, drive, left = self._step
        state, met = self.plant.advance(self.state, drive, np.float64(duration), left)
        return state, bool(met)

    def _disc(self, after: Float[np.ndarray, " s"], duration: float) -> Moving:
        """Return the craft as a moving disc that reaches a given state."""
        x, y, yaw, vx, vy, spin = self.state[:6].tolist()
        to_x, to_y, _, to_vx, to_vy, to_spin = after[:6].tolist()
        dynamics, disc = self.plant.dynamics, self.plant.disc
        rx, ry = self._center_of_mass
        if dynamics.frame == "body":
            cos, sin = math.cos(yaw), math.sin(yaw)
            rx, ry = cos * rx - sin * ry, sin * rx + cos * ry
        return Moving(
            x,
            y,
            vx,
            vy,
            spin,
            disc.radius,
            disc.mass,
            disc.inertia,
            (rx, ry),
            to_x=to_x,
            to_y=to_y,
            ax=(to_vx - vx) / duration,
            ay=(to_vy - vy) / duration,
            spinning_up=(to_spin - spin) / duration,
            kind="craft",
        )

    def _towards_rail(
        self, before: Float[np.ndarray, " s"], after: Float[np.ndarray, " s"]
    ) -> float:
        """Return its speed towards the rail that it met in a step [m/s]."""
        fastest = 0.0
        for axis, reach in enumerate(self.plant.table.reach(self.radius)):
            towards = math.copysign(1.0, after[axis]) * float(before[3 + axis])
            beyond = abs(float(after[axis])) + abs(towards) * LONGEST_STEP >= reach
            fastest = max(fastest, towards if beyond else 0.0)
        return fastest
