"""Landing a craft that a law cannot steer any more, because too few of its motors run."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from airpuck.control.authority import LEAST_EFFORT, weakest_effort
from airpuck.control.law import Step
from airpuck.control.reference import Reference, SetPoint, Unturned
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.physics.thrust import thrust

#: A motor is dead if its effectiveness is below this, with a margin of so many standard deviations.
_DEAD, _CERTAIN = 0.3, 2.0
#: Speed at which the craft has landed [m/s], and the longest time that braking may take [s].
_STOPPED, _LONGEST = 0.05, 3.0
#: Time after which the motors are tried again [s], and landings after which they stay idle: a motor
#: that failed to start may run the next time.
_REST, _LANDINGS = 2.0, 3


class Landing:
    """Brakes and idles a craft when too few of its motors run, and then tries them again, twice.

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
        self._landings = 0

    def reference(self, given: Reference) -> Reference:
        """Return the reference of the next step: while landing, to stop at once."""
        if self._brakes is None:
            return given
        x, y = self._state[:2].tolist()
        return Unturned(SetPoint(x, y, 0.0), self._state)

    def land(self, now: float, step: Step, idle: Float[np.ndarray, " n"]) -> Step:
        """Return the step to send, which idles the motors once the craft has stopped."""
        estimate = step.estimate
        if estimate is None or (self._brakes is None and self._steers(estimate)):
            return step
        if self._brakes is None:
            self._brakes, self._landings = now, self._landings + 1
        self._state = estimate.state
        slow = math.hypot(*self._coasting(estimate)) < _STOPPED
        if self._rests is None and (slow or now > self._brakes + _LONGEST):
            self._rests = now
        if self._rests is None:
            return step
        return Step(idle.copy(), "cannot steer", estimate=estimate)

    def retries(self, now: float) -> bool:
        """Return whether the motors are to be tried again, with nothing known about them."""
        if self._rests is None or now < self._rests + _REST or self._landings == _LANDINGS:
            return False
        self._brakes = self._rests = None
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
        assert found is not None
        dead = found.effectiveness + _CERTAIN * found.deviation < _DEAD
        return not dead.any() or can_steer(self._model, ~dead)


def can_steer(model: Model, running: Bool[np.ndarray, " n"]) -> bool:
    """Return whether some of the motors can push and turn a craft in every direction."""
    curves = model.parameters.thrust * running[:, None]
    left = replace(model, parameters=replace(model.parameters, thrust=curves))
    return weakest_effort(left) >= LEAST_EFFORT
