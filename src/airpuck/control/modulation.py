"""Modulation: converts the duty cycles of a law to pulses that valves can follow.

A modulator carries over the difference between the requested on-time and the on-time that it gave,
so the mean over several periods is right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.control.tuning import Tuning
from airpuck.craft.actuators import ActuatorKind, ActuatorSet
from airpuck.model.model_file import Model

#: Relative difference up to which a controller's period counts as the craft's PWM period.
_SAME = 1e-3


class Modulator:
    """Sends the law's command unchanged: the modulator of propellers."""

    def reset(self) -> None:
        """Forget the past."""

    def command(self, now: float, duty: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the command to send now, for the duty cycles requested from now on."""
        return duty


class PulseWidth(Modulator):
    """One pulse per period: a switch sequence, or a duty cycle for a craft that has its own PWM."""

    def __init__(self, kind: ActuatorKind, tuning: Tuning) -> None:
        self._tick, self._least = tuning.period_s, kind.least_on_s
        self._switches = kind.pwm_period_s is None
        if kind.pwm_period_s is not None:
            self._period = kind.pwm_period_s
            if abs(self._tick - self._period) > _SAME * self._period:
                raise InputError(
                    f"must be the craft's PWM period, {self._period:g} s, not {self._tick:g} s; "
                    "use a tuning file with this period",
                    field="period_s",
                )
        else:
            self._period = max(round(tuning.modulation.period_s / self._tick), 1) * self._tick
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._begun, self._on, self._rest = -math.inf, np.zeros(()), np.zeros(())

    def command(self, now: float, duty: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the command to send now."""
        half = self._tick / 2
        if not self._begun <= now < self._begun + self._period - half:
            wanted = duty * self._period + self._rest
            on = np.round(wanted / self._tick) * self._tick if self._switches else wanted
            # A rounded time may fall short of the least on-time by a rounding error.
            on = np.minimum(np.where(on < self._least * (1 - 1e-9), 0.0, on), self._period)
            self._begun, self._on, self._rest = now, on, wanted - on
        if self._switches:
            return np.where(now - self._begun + half < self._on, 1.0, 0.0)
        return self._on / self._period


class SigmaDelta(Modulator):
    """Starts a pulse as soon as the accumulated on-time reaches the least on-time."""

    def __init__(self, kind: ActuatorKind, tuning: Tuning) -> None:
        if kind.pwm_period_s is not None:
            raise InputError(
                "sigma_delta needs switches, but this craft takes duty cycles; use pulse_width",
                field="modulation.kind",
            )
        self._tick = tuning.period_s
        self._least = max(math.ceil(kind.least_on_s / self._tick - 1e-9), 1) * self._tick
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._owed, self._lasted = np.zeros(()), np.zeros(())

    def command(self, now: float, duty: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the command to send now."""
        owed, half = self._owed + duty * self._tick, self._tick / 2
        must = (self._lasted > 0) & (self._lasted < self._least - half)
        opens = must | (owed >= np.where(self._lasted > 0, half, self._least / 2))
        self._lasted = np.where(opens, self._lasted + self._tick, 0.0)
        self._owed = owed - opens * self._tick
        return opens.astype(float)


class TwoWayModulator(Modulator):
    """Joins the two directions of each actuator, and commands wheels."""

    def __init__(self, actuation: ActuatorSet, thrusters: Modulator, tick: float) -> None:
        self._actuation, self._thrusters = actuation, thrusters
        self._first_wheel = actuation.n_columns - len(actuation.wheels)
        #: Change of the commanded speed per period at full torque; 0 if torques are commanded.
        gains = [tick / w.spin_up_s if w.commanded == "speed" else 0.0 for w in actuation.wheels]
        self._gain, self._speed = np.array(gains), np.zeros(len(gains))

    def reset(self) -> None:
        """Forget the past; a wheel at rest has no speed."""
        self._thrusters.reset()
        self._speed = np.zeros_like(self._speed)

    def command(self, now: float, duty: Float[np.ndarray, " n"]) -> Float[np.ndarray, " c"]:
        """Return the command to send now."""
        joined, first = self._actuation.joined(duty), self._first_wheel
        self._speed = np.clip(self._speed + self._gain * joined[first:], -1.0, 1.0)
        wheels = np.where(self._gain > 0, self._speed, joined[first:])
        return np.concatenate([self._thrusters.command(now, joined[:first]), wheels])


#: Modulators by name.
MODULATORS: dict[str, Callable[..., Modulator]] = {
    "pulse_width": PulseWidth,
    "sigma_delta": SigmaDelta,
}


def modulator_for(model: Model, tuning: Tuning) -> Modulator:
    """Return the modulator that a craft needs."""
    kind, actuation = model.vehicle.actuators, model.vehicle.actuation
    pulses = MODULATORS[tuning.modulation.kind]
    thrusters = pulses(kind, tuning) if kind.pulsed else Modulator()
    if not actuation.two_way.any():
        return thrusters
    return TwoWayModulator(actuation, thrusters, tuning.period_s)


def of_means(model: Model) -> Model:
    """Return the model of the mean motion over pulses: the force follows duty cycles at once."""
    if not model.vehicle.actuators.pulsed:
        return model
    return replace(model, parameters=replace(model.parameters, motor_time_constant=0.0))


def stage_of_means(model: Model, stage: Callable[..., Any] | None) -> Callable[..., Any] | None:
    """Hide from a law's stage which valves are open now: it plans with the mean."""
    if stage is None or not model.vehicle.actuators.pulsed:
        return stage

    def of_mean(xp: Any, state: Any, speed: Any, *others: Any) -> tuple[Any, ...]:
        return stage(xp, state, 0.0 * speed, *others)

    return of_mean
