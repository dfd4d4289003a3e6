"""A kind of actuator of your own: valves whose pulses lie in the middle of the PWM period."""

from typing import Literal

import numpy as np

from airpuck import ActuatorKind


class CentredPulses(ActuatorKind):
    """Valves that a timer drives, counting up and down."""

    kind: Literal["centred"] = "centred"
    pwm_period_s: float = 0.1
    pulsed = True

    def changes(self, time, command, since):
        """Open each valve in the middle of the period."""
        middle, half = time + self.pwm_period_s / 2, command * self.pwm_period_s / 2
        edges = np.unique([time, *(middle - half), *(middle + half)])
        return [(t, ((t >= middle - half) & (t < middle + half)) * 1.0) for t in edges]
