"""Landing a craft that a law cannot steer any more, because too few of its motors run."""

from __future__ import annotations

import math

import numpy as np

from airpuck.control.authority import LEAST_EFFORT, weakest_effort
from airpuck.control.law import Step
from airpuck.control.reference import Reference, Target
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.physics.thrust import thrust

#: A motor is dead if its effectiveness plus two standard deviations is below this, and runs if its
#: effectiveness minus one is above it.
_DEAD, _SURE = 0.3, 2.0
#: Speed at which the craft has landed [m/s], and the longest time that braking may take [s].
_STOPPED, _LONGEST = 0.05, 3.0
#: Time after which the motors are tried again [s], and landings after which they stay idle: a motor
#: that failed to start may run the next time. A flight of the last duration forgives all landings.
_REST, _LANDINGS, _FORGIVEN = 2.0, 3, 30.0


class Landing:
    """Brakes and idles a craft when too few of its motors run.

    It retries the motors after each of the first landings. Where no motor runs at all, there is
    nothing to land with: the craft is held, the air is off, or the motors are not armed.

    Parameters
    ----------
    model : Model
        The craft.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        #: State of the craft while it brakes.
        self._state = np.zeros(6)
        #: When braking began, and when the motors became idle [s]; None: not yet.
        self._brakes: float | None = None
        self._rests: float | None = None
        #: Landings, and when the last one ended [s].
        self._landings, self._flies = 0, -math.inf

    def reference(self, given: Reference) -> Reference:
        """Return the reference of the next step."""
        return given if self._brakes is None else self

    def at(self, now: float, ahead: float) -> Target:
        """Return the target while landing: to stop at once, whatever the spin; a `Reference`."""
        return Target(self._state * [1, 1, 1, 0, 0, 1], np.zeros(3))

    def land(self, now: float, step: Step) -> Step:
        """Return the step to send, which idles the motors once the craft has stopped."""
        estimate = step.estimate
        if self._brakes is not None and now < (self._rests or self._brakes):
            self._brakes = self._rests = None  # the clock was set back
        if estimate is None or (self._brakes is None and self._steers(estimate)):
            return step
        if self._brakes is None:
            before = self._landings if now < self._flies + _FORGIVEN else 0
            self._brakes, self._landings = now, before + 1
        self._state = estimate.state
        slow = math.hypot(*self._coasting(estimate)) < _STOPPED
        if self._rests is None and (slow or now > self._brakes + _LONGEST):
            self._rests = now
        if self._rests is None:
            return step
        return Step(self._model.vehicle.idle.copy(), "cannot steer", estimate=estimate)

    def retries(self, now: float) -> bool:
        """Return whether to try the motors again, with nothing known about them."""
        if self._rests is None or now < self._rests + _REST or self._landings == _LANDINGS:
            return False
        self._brakes, self._rests, self._flies = None, None, now
        return True

    def _coasting(self, estimate: Estimate) -> list[float]:
        """Return the velocity once motors that idle from now on have stopped [m/s]."""
        dynamics = self._model.dynamics
        # Speeds decay exponentially, so that the k-th power of one lasts a k-th of the lag.
        powers = 1 + np.arange(dynamics.thrust.shape[1])
        lasting = dynamics.lag * thrust(dynamics.thrust / powers, estimate.motor_speed)
        matrix, _ = acceleration_map(np, dynamics, *estimate.state[[2, 5]])
        gained = matrix[:2] @ (lasting * estimate.effectiveness)
        return (estimate.state[3:5] + gained).tolist()

    def _steers(self, estimate: Estimate) -> bool:
        """Return whether the motors that may run can push and turn in all directions."""
        found = estimate.actuation
        if found is None or not (found.effectiveness - found.deviation > _DEAD).any():
            return True
        dead = found.effectiveness + _SURE * found.deviation < _DEAD
        return not dead.any() or weakest_effort(self._model, ~dead) >= LEAST_EFFORT
