"""Pulses of single motors: how strong and in which order, and the vehicle file that they show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from airpuck.boundary.files import checked, laid_over
from airpuck.boundary.results import Finding
from airpuck.commissioning.session import Commissioned
from airpuck.craft.vehicle import Vehicle
from airpuck.deviation.time_scale import usual_pushes
from airpuck.faults.propeller_check import EffectMatch, force_to_moment, match_effects
from airpuck.flight.pulses import DELAYS, PulsePlan, PulseTest, pulse_responses, sound_pulses
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.uncertainty import Cameras
from airpuck.physics.rigid_body import acceleration_map
from airpuck.physics.thrust import thrust

#: Lags that the pulses are compared with [s].
_LAGS = (0.01, 0.015, 0.025, 0.04, 0.06, 0.085, 0.12, 0.16)
#: Twice the factor by which squared residuals exceed those of white noise.
_TEMPERED = 8.0
#: Spin that a pulse may cause [rad/s].
_SPIN = 1.0
#: Smallest effect of a start that did not fail, relative to the largest of the motor's pulses.
_STARTED = 0.3
#: Bounds for the ratio of measured and stated inertia: beyond, the pulses were disturbed.
_INERTIA = (0.4, 2.5)
#: Least thrust of a motor whose pulses tell none, relative to the median motor's.
_LEAST = 0.1
#: Accelerations per newton: forward, left, turn.
PulseEffects = Float[np.ndarray, "3 n"]


def pulse_plan(vehicle: Vehicle, cameras: Cameras | None, stronger: float) -> PulsePlan:
    """Return pulses whose motion stands out from the noise, twenty times if thrusts are right."""
    noise, rate = (1e-4, 100.0) if cameras is None else (cameras.position_noise_m, cameras.rate_hz)
    push, turn = usual_pushes(vehicle)
    level = min(0.5 * stronger, 1.0) * vehicle.command_max
    # The speed of a line of poses over a quarter of a second, before and after. In shorter pulses
    # slow motors reach a part of their thrust only: lag and thrust cannot be told apart.
    speed = 20 * noise * math.sqrt(24 / (0.25 * rate)) / 0.25
    length = float(np.clip(speed / max(level * push, 1e-6), 0.2, 0.35))
    # At half of its speed a propeller gives about a quarter of its thrust.
    length = stronger * min(length, max(_SPIN / max(level**2 * turn, 1e-6), 0.08))
    rest = max(0.3, 22 / rate)
    return PulsePlan(level, min(round(length, 2), 0.6), rest, rounds=2)


def uphill(session: Commissioned, plan: PulsePlan, motors: list[int]) -> list[int]:
    """Order motors so that their pulses best stop the drift, if the vehicle file is right.

    Each next motor minimises the distance from the middle plus the speed, after a second; yaw
    counts times the radius of gyration.
    """
    if (motion := session.motion) is None:
        return motors
    model, order, turn = nominal_model(session.vehicle), list[int](), plan.length + plan.rest
    scale = np.array([1.0, 1.0, model.radius_of_gyration])
    place, speed = motion[0] * [1, 1, 0], motion[1] * scale
    effects, _ = acceleration_map(np, model.dynamics, float(motion[0][2]), 0.0)
    force = thrust(model.dynamics.thrust, np.full(model.vehicle.n_propellers, plan.level))
    pushes = scale[:, None] * np.asarray(effects) * force * plan.length
    for _ in range(len(motors)):
        left = [k for k in motors if k not in order]
        speed = speed + np.append(session.slope, 0.0) * turn
        place = place + speed * turn
        order.append(min(left, key=lambda k: np.linalg.norm(place + speed + pushes[:, k])))
        speed = speed + pushes[:, order[-1]]
    return order


def with_lag(model: Model, lag: float) -> Model:
    """Return a model with another lag of all motors [s]."""
    return replace(model, parameters=replace(model.parameters, motor_time_constant=lag))


@dataclass(frozen=True, eq=False)
class PulseEvidence:
    """What all pulses show about a craft whose motors and timing may not be as stated."""

    model: Model
    #: How well each lag and delay explains them; every pair is as likely at first.
    costs: Float[np.ndarray, "L D"] = field(
        default_factory=lambda: np.zeros((len(_LAGS), len(DELAYS)))
    )
    #: Pose times, poses, command times and commands of each test.
    logs: tuple[tuple[np.ndarray, ...], ...] = ()
    #: Number of pulses of each motor that were seen from before to after.
    tries: Int[np.ndarray, " n"] | int = 0

    def after(self, test: PulseTest) -> PulseEvidence:
        """Return the evidence after another test."""
        if not test.poses or not test.sent_commands:
            return self
        (times, poses), (sent, commands) = (
            map(np.array, zip(*log, strict=True)) for log in (test.poses, test.sent_commands)
        )
        poses[:, 2] = np.unwrap(poses[:, 2])
        vehicle = self.model.vehicle
        if vehicle.actuation.two_way.any():
            commands = np.maximum(vehicle.actuation.split(commands), vehicle.command_min)
        log = times, poses, sent, commands
        seen = [pulse_responses(with_lag(self.model, lag), *log) for lag in _LAGS]
        costs = [
            sum((one.costs for one in each), row)
            for each, row in zip(seen, self.costs, strict=True)
        ]
        motors = np.array([one.motor for one in seen[0]], dtype=int)
        tries = self.tries + np.bincount(motors, minlength=self.model.vehicle.n_propellers)
        return replace(self, costs=np.array(costs), logs=(*self.logs, log), tries=tries)

    @cached_property
    def _weights(self) -> Float[np.ndarray, "L D"]:
        """Probability of each pair."""
        # The model of a pulse is not exact, so costs count less than those of white noise.
        found = np.exp(-(self.costs - self.costs.min()) / _TEMPERED)
        return found / found.sum()

    @property
    def lag(self) -> float:
        """Mean lag [s]."""
        return float(self._weights.sum(axis=1) @ _LAGS)

    @property
    def delay(self) -> float:
        """Mean delay [s]."""
        return float(self._weights.sum(axis=0) @ DELAYS)

    @property
    def latest(self) -> float:
        """Largest sum of lag and delay that is likely [s]."""
        off = np.add.outer(_LAGS, DELAYS) - self.lag - self.delay
        return self.lag + self.delay + 2 * math.sqrt(np.sum(self._weights * off**2))

    @cached_property
    def effects(self) -> tuple[PulseEffects, Float[np.ndarray, " n"]]:
        """Effects of the motors, nan of those not tried, and their errors over the usual effect."""
        model, count = with_lag(self.model, self.lag), self.model.vehicle.n_propellers
        effects, errors = np.full((3, count), np.nan), np.full(count, np.nan)
        delays = np.full(len(self.logs) * 10 * count, self.delay)
        seen = [one for log in self.logs for one in pulse_responses(model, *log, delays=delays)]
        scale = np.array([1.0, 1.0, model.radius_of_gyration])
        # A start may have failed, or a rail or a hand disturbed a pulse.
        for motor, good in sound_pulses(seen, model.radius_of_gyration, _STARTED).items():
            covariance = np.linalg.pinv(sum(one.information for one in good))
            effects[:, motor] = covariance @ sum(one.information @ one.effect for one in good)
            errors[motor] = math.sqrt(np.diag(covariance) @ scale**2 / 3)
        usual = np.nanmedian(np.linalg.norm(scale[:, None] * effects, axis=0)) if seen else 1.0
        return effects, errors / max(float(usual), 1e-9)


def matched(model: Model, effects: Float[np.ndarray, "3 n"]) -> dict[int, EffectMatch]:
    """Match the measured effects of motors (nan: not measured) with the model's.

    A wrong inertia scales all moments alike. So moments are first scaled to the forces, if most
    motors are measured: then the scale does not depend on their order.
    """
    scale = np.array([1.0, 1.0, model.radius_of_gyration])[:, None]
    expected = scale * acceleration_map(np, model.dynamics, 0.0, 0.0)[0]
    motors = np.flatnonzero(np.isfinite(effects).all(axis=0))
    seen = scale * effects[:, motors]
    if 2 * len(motors) > expected.shape[1]:
        factor = force_to_moment(seen, np.zeros_like(seen), expected[:, motors])
        expected[2] /= np.clip(factor, *_INERTIA)
    return match_effects(seen, expected, motors)


def layout_findings(vehicle: Vehicle, matches: Mapping[int, EffectMatch]) -> list[Finding]:
    """Name the motors that act like another one, or the other way."""
    names, found = vehicle.propeller_names, []
    for k, match in sorted(_of_propellers(vehicle, matches).items()):
        if match.acts_as is None:
            continue
        other = names[match.acts_as]
        if match.acts_as != k:
            how = "" if match.sign > 0 else " the other way round"
            remedy = f"Exchange their cables, or give {names[k]} the place of {other}."
            found.append(Finding("order", f"{names[k]} acts like {other}{how}", "", remedy))
        elif match.sign < 0:
            remedy = f"Add 180 to direction_deg of {names[k]}, or turn it round."
            found.append(Finding("layout", f"{names[k]} pushes the other way", "", remedy))
    return found


def corrected(vehicle: Vehicle, matches: Mapping[int, EffectMatch]) -> Vehicle:
    """Return a copy whose motors stand and push as their effects say; names stay in order."""
    matches = _of_propellers(vehicle, matches)
    if all(match.acts_as == k and match.sign > 0 for k, match in matches.items()):
        return vehicle
    given, propellers, place = vehicle.propellers, list(vehicle.propellers), dict[int, int]()
    taken = {match.acts_as: k for k, match in matches.items()}
    for k in set(range(len(given))) - set(matches):
        # An untried motor whose place is taken most likely has the place of the one that took it.
        there = k
        while there in taken:
            there = taken[there]
        matches[k] = EffectMatch(there, 1, 1.0)
    curves = vehicle.nominal_thrust[: len(given)].copy()
    for k, match in matches.items():
        if match.acts_as is None:
            continue
        source = given[match.acts_as]
        turned = (source.direction_deg + 90 * (1 - match.sign)) % 360
        reverse = given[k].reverse and (source.reverse or given[k].reverse)
        update = {"position_m": source.position_m, "direction_deg": turned, "reverse": reverse}
        propellers[k] = given[k].model_copy(update=update)
        curves[k] = vehicle.nominal_thrust[match.acts_as]
        if match.sign > 0:
            place[match.acts_as] = k
    # A pair holds the motors that now stand where its motors stood, if both push as those did.
    pairs = [
        (given[place[one]].name, given[place[other]].name)
        for one, other in vehicle.pair_indices
        if one in place and other in place
    ]
    placed = [one.model_dump(mode="json", exclude_none=True) for one in propellers]
    nominal = {"thrust_N": curves.tolist()}
    return _changed(vehicle, {"propellers": placed, "pairs": pairs, "nominal": nominal})


def _of_propellers(vehicle: Vehicle, matches: Mapping[int, EffectMatch]) -> dict[int, EffectMatch]:
    """Return the matches of propellers, by their forward channels where these are known.

    A propeller is turned round if its forward channel acts like a backward one, or the reverse.
    """
    channels, found = vehicle.actuation.channels, dict[int, EffectMatch]()
    for k, match in sorted(matches.items(), reverse=True):
        own = channels[k]
        if match.acts_as is not None:
            other = channels[match.acts_as]
            match = replace(match, acts_as=other.column, sign=match.sign * own.sign * other.sign)
        found[own.column] = match
    return found


def measured(model: Model, effects: Float[np.ndarray, "3 n"], delay: float) -> Vehicle:
    """Return a vehicle with the thrusts, inertia, lag and delay that the pulses showed."""
    vehicle = model.vehicle
    stated = np.asarray(acceleration_map(np, model.dynamics, 0.0, 0.0)[0])
    tried = np.isfinite(effects).all(axis=0)
    push = np.sum(effects[:2] * stated[:2], axis=0) / np.sum(stated[:2] ** 2, axis=0)
    turns = tried & (np.abs(stated[2]) > 0.2 * np.abs(stated[2]).max())
    ratio = effects[2, turns] / stated[2, turns] / push[turns]
    inertia = 1 / float(np.clip(np.median(ratio), *_INERTIA)) if turns.any() else 1.0
    usual = float(np.median(push[tried]))
    nominal, curves = vehicle.nominal, vehicle.nominal_thrust[: len(vehicle.propellers)]
    strength = np.full(len(curves), usual)
    # Of a propeller that pushes both ways, the file states the thrust forwards.
    for k in np.flatnonzero(tried)[::-1]:
        strength[vehicle.actuation.channels[k].column] = push[k]
    # What is not clear yet keeps a little thrust: a curve must rise.
    strength = np.maximum(strength, _LEAST * abs(usual))
    found = {
        "thrust_N": (strength[:, None] * curves).tolist(),
        "inertia_kg_m2": inertia * nominal.inertia_kg_m2,
        "motor_time_constant_s": float(np.max(model.dynamics.lag)),
        "transport_delay_s": max(delay, 0.0),
    }
    return _changed(vehicle, {"nominal": found})


def _changed(vehicle: Vehicle, values: dict[str, Any]) -> Vehicle:
    """Return a checked copy with other values, table by table."""
    return checked(laid_over(vehicle.model_dump(mode="json"), values), Vehicle)
