"""The guard: when motors must idle, whatever the controller requests. Needs no network."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from airpuck.control.law import Pilot, Step
from airpuck.control.pose_gate import SHORTEST_PAUSE
from airpuck.craft.table import Table
from airpuck.data.measurement import Measurement
from airpuck.flight.loop import checked_step

#: Receives the level and the text of an event.
_Log = Callable[[Literal["info", "error"], str], object]


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of a flight; motors idle beyond them.

    Examples
    --------
    >>> airpuck.SafetyLimits(geofence=(0.9, 0.4), pose_timeout=0.1).settle
    0.3
    """

    #: Largest distance of the craft's centre from the centre of the table along x and y [m].
    geofence: tuple[float, float]
    #: Half of the table that the craft's centre must not leave, by the sign of its x; 0: none.
    half: int = 0
    #: Smallest allowed distance to the centre line [m].
    line: float = 0.0
    #: Motors idle after this long without a pose [s].
    pose_timeout: float = SHORTEST_PAUSE
    #: This many equal poses in a row are not measurements: real ones have noise.
    frozen: int = 12
    #: Two consecutive poses this far apart, beyond what `fastest` explains, count as a jump [m,
    #: rad].
    jump: tuple[float, float] = (0.05, 0.5)
    #: Speed and yaw rate that the craft never reaches [m/s, rad/s].
    fastest: tuple[float, float] = (3.0, 40.0)
    #: After a fault, poses must be good for this long before motors may run again [s].
    settle: float = 0.3


#: Largest overlap of a craft with a rail, and with the centre line [m].
_OVER_RAIL, _OVER_LINE = 0.01, 0.02


def within_rails(table: Table, radius: float) -> tuple[float, float]:
    """Return the geofence ±x, ±y [m] of a craft that may lean on the rails, noise included."""
    x, y = table.reach(radius)
    return x + _OVER_RAIL, y + _OVER_RAIL


def half_of(table: Table, radius: float, side: int) -> SafetyLimits:
    """Return the limits of a craft that plays on one half of a table, by the sign of its x."""
    return SafetyLimits(geofence=within_rails(table, radius), half=side, line=radius - _OVER_LINE)


class Guard:
    """Watches the poses and decides whether the motors may run."""

    def __init__(self, limits: SafetyLimits) -> None:
        self.limits = limits
        self._heard = -math.inf
        self._last: tuple[float, Float[np.ndarray, " 3"]] | None = None
        self._equal = 1
        #: Time since which everything has been good; None while something is wrong.
        self._good_since: float | None = None
        self._reason = "no pose yet"
        self._stopped: dict[str, str] = {}

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Judge a pose, measured at a time [s]."""
        fault = self._fault_of(time, pose)
        # A pose that is not finite cannot be compared with the next one.
        self._last = (time, pose) if np.isfinite(pose).all() else None
        if fault is not None:
            self.fault(fault)
        else:
            self._heard = time
            if self._good_since is None:
                self._good_since = time

    def fault(self, reason: str) -> None:
        """Record a fault; poses must be good for a while before motors run again."""
        self._good_since = None
        self._reason = reason

    @property
    def position(self) -> Float[np.ndarray, " 3"] | None:
        """The last pose; None unless poses are good."""
        return None if self._last is None or self._good_since is None else self._last[1]

    def stop(self, who: str, reason: str) -> None:
        """Idle the motors until `release` by the same name."""
        self._stopped[who] = reason

    def release(self, who: str) -> None:
        """Withdraw a stop."""
        if self._stopped.pop(who, None) is not None:
            self.fault("after a stop")

    def refusal(self, time: float) -> str | None:
        """Return why motors must idle at a time [s]; None if they may run."""
        if self._stopped:
            return next(iter(self._stopped.values()))
        if self._good_since is not None and time - self._heard > self.limits.pose_timeout:
            self.fault(f"no pose for {1e3 * self.limits.pose_timeout:.0f} ms")
        if self._good_since is None or time - self._good_since < self.limits.settle:
            return self._reason
        return None

    def _fault_of(self, time: float, pose: Float[np.ndarray, " 3"]) -> str | None:
        """Return the problem with a pose that follows the last one; None if there is none."""
        if not np.isfinite(pose).all():
            self._equal = 1
            return "pose is not finite"
        x, y, yaw = pose.tolist()
        if self._last is not None:
            passed = max(time - self._last[0], 0.0)
            last_x, last_y, last_yaw = self._last[1].tolist()
            moved = math.hypot(x - last_x, y - last_y)
            turned = abs(math.remainder(yaw - last_yaw, 2 * math.pi))
            self._equal = self._equal + 1 if moved == 0 and turned == 0 else 1
            (far, wide), (speed, spin) = self.limits.jump, self.limits.fastest
            if moved > far + speed * passed or turned > wide + spin * passed:
                return f"pose jumped by {moved:.2f} m and {turned:.2f} rad"
            if self._equal >= self.limits.frozen:
                return f"the pose is frozen: {self.limits.frozen} equal ones in a row"
        if abs(x) > self.limits.geofence[0] or abs(y) > self.limits.geofence[1]:
            return "the craft is outside the geofence"
        if self.limits.half and x * self.limits.half < self.limits.line:
            return "the craft is in the opponent's half"
        return None


class GuardedPilot(Pilot):
    """A pilot whose commands pass a guard.

    Commands are at least `lowest`. Idling motors get it, or zero if it is negative.
    """

    def __init__(
        self, pilot: Pilot, guard: Guard, lowest: Float[np.ndarray, " c"], log: _Log
    ) -> None:
        self.pilot, self.guard, self.watches = pilot, guard, pilot.watches
        #: The pilot's reference at its latest step.
        self.reference = pilot.reference
        self._lowest, self._idle, self._log = lowest, np.maximum(lowest, 0.0), log
        #: Why the motors idle, as last logged; None while they run.
        self._logged: str | None = ""

    def measured(self, measurement: Measurement) -> None:
        """Judge a pose, and pass every measurement on; see `Pilot.measured`."""
        if measurement.kind == "pose":
            self.guard.pose(measurement.stamp, np.asarray(measurement.values, dtype=float))
        self._tell(self.pilot.measured, measurement)

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Forward the command that was sent; see `Pilot.sent`."""
        self._tell(self.pilot.sent, time, command)

    def _tell(self, method: Callable[..., None], *news: Any) -> None:
        """Call a method of the pilot; if it fails, the motors idle."""
        try:
            method(*news)
        # As in `step`.
        except Exception as error:
            self.guard.fault(_failure(error))

    def step(self, time: float) -> Step:
        """Compute a command that is safe to send."""
        reason = self.guard.refusal(time)
        if reason is None:
            try:
                step = checked_step(self.pilot, self.pilot.step(time))
                self.reference = self.pilot.reference
            # After any failure of a controller, the motors must idle and the loop must continue.
            except Exception as error:
                reason = _failure(error)
            else:
                command = np.asarray(step.command, dtype=float)
                if command.shape == self._idle.shape and np.isfinite(command).all():
                    self._log_change(None if step.flies else step.status)
                    return replace(step, command=np.clip(command, self._lowest, 1.0))
                reason = f"the controller's command is not {len(self._idle)} finite numbers"
            self.guard.fault(reason)
        self._log_change(reason)
        return Step(self._idle.copy(), "unsafe", np.zeros(3), None)

    def _log_change(self, reason: str | None) -> None:
        """Log the reason for idling motors, or that they run, when it changes."""
        if reason is None and self._logged is not None:
            self._log("info", "flying")
        elif reason is not None and reason != self._logged:
            self._log("error", f"motors idle: {reason}")
        self._logged = reason


def _failure(error: Exception) -> str:
    """Describe how the controller failed."""
    return f"the controller failed: {type(error).__name__}: {error}"
