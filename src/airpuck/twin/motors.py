"""Motors that do not follow their command: not armed, slow to start, stalled, weak."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.twin.settings import Motors


class MotorUnit:
    """From the received command to what the motors follow."""

    def __init__(self, settings: Motors, names: tuple[str, ...]) -> None:
        for field, faults in (("stalls", settings.stalls), ("weak", settings.weak)):
            for fault in faults:
                if fault.motor not in names:
                    raise InputError(
                        f"there is no motor called {fault.motor!r} (there are {', '.join(names)})",
                        field=f"motors.{field}",
                    )
        self._settings = settings
        self._stalls = [(names.index(s.motor), s.start_s, s.stop_s) for s in settings.stalls]
        self._weak = [(names.index(w.motor), w) for w in settings.weak]
        faults = (*settings.stalls, *settings.weak)
        self._edges = sorted(
            {settings.unarmed_s, *(t for f in faults for t in (f.start_s, f.stop_s))}
        )
        #: When each motor may follow its command; never while it idles.
        self._released = np.full(len(names), np.inf)

    def next_change(self, now: float) -> float:
        """Return when a motor next fails or recovers."""
        times = [t for t in (*self._edges, *self._released.tolist()) if now < t < math.inf]
        return min(times, default=math.inf)

    def follow(self, now: float, command: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return what the motors follow now."""
        s = self._settings
        if now < s.unarmed_s:
            return np.zeros_like(command)
        if s.starting_delay_s > 0:
            idles = command < s.idle_below
            begins = ~idles & np.isinf(self._released)
            self._released[idles] = np.inf
            self._released[begins] = now + s.starting_delay_s
            follows = idles | (self._released <= now)
            command = np.where(follows, command, np.minimum(command, s.idle_below))
        for motor, start, stop in self._stalls:
            if start <= now < stop:
                command = command.copy()
                command[motor] = 0.0
        return command

    def share(self, now: float) -> Float[np.ndarray, " n"]:
        """Return the share of its thrust that each motor gives now."""
        share = np.ones(len(self._released))
        for motor, weakness in self._weak:
            if weakness.start_s <= now < weakness.stop_s:
                share[motor] *= weakness.share
        return share
