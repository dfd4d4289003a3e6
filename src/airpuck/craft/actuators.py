"""Kinds of actuators: how commands drive them, and how their force follows.

The force of every kind is a thrust curve of a state that follows its drive in [0, 1] with a
first-order lag, a transport delay after the command. So the physics is the same for all kinds.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.boundary.files import NonNegative, Section

#: Each packet starts a PWM period if the usual interval is this close to it [relative].
_SAME_PERIOD = 0.1
#: Edges of pulses that are closer than this are one event [s].
_ONE_EVENT = 1e-9
#: Longest plausible times of a valve, and of a PWM period [s].
_VALVE_TIME, _PWM_TIME = 0.5, 2.0


class Propellers(Section):
    """Propellers: motors that follow any command; the thrust curve is a polynomial."""

    kind: Literal["propeller"] = "propeller"

    #: Time from the driver to the force [s], and shortest pulse [s].
    dead_time_s: ClassVar[float] = 0.0
    least_on_s: ClassVar[float] = 0.0
    #: Whether the force is either full or zero, so that only its mean can be commanded.
    pulsed: ClassVar[bool] = False

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

    kind: Literal["on_off"]
    #: From switching to the beginning of the change of the force.
    dead_time_s: Annotated[float, pydantic.Field(ge=0, le=_VALVE_TIME)] = 0.0
    #: First-order lag of the force when the valve opens, and when it closes.
    rise_s: Annotated[float, pydantic.Field(ge=0, le=_VALVE_TIME)] = 0.0
    fall_s: Annotated[float, pydantic.Field(ge=0, le=_VALVE_TIME)] = 0.0
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

    def nominal(self) -> dict[str, float]:
        """Return mean lag and dead time."""
        lag = (self.rise_s + self.fall_s) / 2
        return {"motor_time_constant_s": lag, "transport_delay_s": self.dead_time_s}

    def check_thrust(self, degree: int) -> None:
        """Raise ValueError unless the curve is linear: F(u) = F u, also for means over pulses."""
        if degree != 1:
            raise ValueError(
                f"the force of on/off thrusters is proportional to their on-time; a thrust curve "
                f"of degree {degree} cannot be identified, give degree 1"
            )

    def possible(self, command: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Return open or shut for switches, otherwise duty cycles without too short pulses."""
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
        """Return a lag for each valve, which opens and closes at different rates."""
        mean = (self.rise_s + self.fall_s) / 2
        if mean == 0:
            return time_constant
        return time_constant / mean * xp.where(drive > 0.5, self.rise_s, self.fall_s)


Actuators = Annotated[Propellers | OnOff, pydantic.Field(discriminator="kind")]
