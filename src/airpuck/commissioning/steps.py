"""Steps that take a craft from rest to a controlled hover."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import percent
from airpuck.boundary.results import Finding
from airpuck.commissioning.pulse_evidence import (
    PulseEffects,
    PulseEvidence,
    corrected,
    layout_findings,
    matched,
    measured,
    pulse_plan,
    uphill,
    with_lag,
)
from airpuck.commissioning.session import Commissioned, Ended
from airpuck.control.authority import LEAST_EFFORT, weakest_effort
from airpuck.control.law import Pilot, Step
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.craft.vehicle import GRAVITY, Vehicle
from airpuck.deviation.time_scale import lateness, usual_pushes
from airpuck.flight.pulses import PulseTest
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.uncertainty import Cameras
from airpuck.physics.rigid_body import acceleration_map

#: Lowest useful rate of poses [1/s].
_RATE = 50.0
#: Largest standard deviation of poses at rest [m, rad].
_NOISE = (2e-3, 5e-2)
#: Effect below which a motor counts as dead, relative to the usual one's. A slow motor still pushes
#: while the next one is tried, so that a dead one may seem to give a quarter.
_DEAD = 0.35
#: Error of an effect from which a motor is tried again, relative to the usual effect; and effect
#: that moves the craft, relative to the vehicle file's.
_VAGUE, _MOVED = 0.15, 0.1
#: Factor by which a vehicle file's thrusts may be wrong.
_ROUGH = 2.0
#: Fewest known motors that can bring a craft back, and the time that they get [s].
_STEERED, _RETURN = 3, 6.0
#: Thrust of a motor that is to idle, as a share: curves must rise.
_FAINT = 0.05
#: Distance to the rails that is kept [m], and time until a slowed law brakes [s].
_CLEARANCE, _REACTION = 0.05, 0.4
#: Time until the last pose after a pulse has come [s].
_LATE_POSES = 0.05
#: Time to a rail at which pulses end although nothing can bring the craft back [s].
_AT_RAIL = 0.2
#: Further flights once all motors were tried, and pulses after which a motor counts as dead, or as
#: out of its place: starts may fail.
_SILENT, _TRIES = 2, 2
#: A table counts as level up to this slope [mrad].
_LEVEL = 1.0


@runtime_checkable
class CommissioningStep(Protocol):
    """A part of the run; raises `Ended` if the run cannot continue."""

    def run(self, session: Commissioned) -> None:
        """Fly, learn, and note what was learned in the session."""
        ...


@dataclass
class _Resting(Pilot):
    """Lets the motors idle."""

    idle: Float[np.ndarray, " c"]

    def step(self, time: float) -> Step:
        """Return idle commands; see `Pilot`."""
        return Step(self.idle.copy(), "open loop", np.zeros(3), None)


@dataclass(frozen=True)
class Rest:
    """Rate and noise of the poses, and the slope of the table, with the motors idle.

    Attributes
    ----------
    duration_s : float
        How long to look.
    """

    duration_s: float = 0.4

    def run(self, session: Commissioned) -> None:
        """Measure the poses; see `CommissioningStep`."""

        def enough(now: float) -> bool:
            # Poses may begin late; the session ends the run if none come.
            return bool(session.poses) and now - session.poses[0][0] > self.duration_s

        pose = session.fly("rest", _Resting(session.vehicle.idle), 10.0, until=enough)["pose"]
        time, values = pose.time - pose.time[0], np.array(pose.values)
        values[:, 2] = np.unwrap(values[:, 2])
        rate = 1 / float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        if rate < _RATE:
            cause = f"Poses come at {rate:.0f} Hz; at least {_RATE:g} Hz are needed"
            raise Ended(Finding("poses", cause, "", "Set the cameras to a higher rate."))
        if not np.ptp(values, axis=0).any():
            remedy = "Check that the cameras track the craft's rigid body."
            raise Ended(Finding("poses", "The pose never changes", "", remedy))
        curve = np.stack([np.ones_like(time), time, time**2 / 2], axis=1)
        found, *_ = np.linalg.lstsq(curve, values, rcond=None)
        noise = np.std(values - curve @ found, axis=0)
        across = float(noise[:2].max())
        if across > _NOISE[0] or noise[2] > _NOISE[1]:
            said = f"{1e3 * across:.2g} mm and {1e3 * noise[2]:.2g} mrad at rest"
            cause, remedy = f"The poses' noise is {said}", "Calibrate the cameras."
            raise Ended(Finding("poses", cause, "", remedy))
        seen = {"position_noise_m": across, "yaw_noise_rad": float(noise[2])}
        session.cameras = Cameras(rate_hz=rate, **seen)
        session.slope = found[2, :2]
        slope = float(np.hypot(*session.slope)) / GRAVITY
        self._check_place(session, values[-1])
        said = f"poses at {rate:.0f} Hz, noise {1e3 * across:.2g} mm and {1e3 * noise[2]:.2g} mrad"
        session.note("rest", f"{said}; the craft drifts as on a slope of {1e3 * slope:.1f} mrad")

    def _check_place(self, session: Commissioned, pose: Float[np.ndarray, " 3"]) -> None:
        """End the run if the craft is not where pulses can be tried."""
        reach = np.array(session.table.reach(session.vehicle.radius_m))
        if (np.abs(pose[:2]) > reach).any():
            where = f"x = {pose[0]:.3g} m, y = {pose[1]:.3g} m"
            remedy = "Check the unit and the origin of the poses, and the size of the table."
            raise Ended(Finding("units", f"The craft is beyond the rails, at {where}", "", remedy))
        if (np.abs(pose[:2]) > 0.6 * reach).any():
            remedy = "Put the craft near the middle of the table, and start again."
            raise Ended(Finding("table", "The craft is near a rail", "", remedy))


@dataclass(frozen=True)
class Pulses:
    """Order, signs, strengths, lag and delay of the motors, by short pulses of each.

    On a slope the craft drifts towards a rail meanwhile, and a start may fail. The craft is then
    brought back with the motors that are known by then, and the rest are tried afterwards.

    Attributes
    ----------
    tries : int
        Largest number of flights; in each, motors that are still unclear are tried.
    """

    tries: int = 8

    def run(self, session: Commissioned) -> None:
        """Try each motor, and correct the vehicle; see `CommissioningStep`."""
        given = session.vehicle
        if given.wheels or given.actuators.pulsed:
            remedy = "Use `airpuck preflight`, `airpuck fly-excitation` and `airpuck identify`."
            cause = "Commissioning needs propellers alone: no wheels, no on/off thrusters"
            raise Ended(Finding("layout", cause, "", remedy))
        model, stronger = session.model, 1.0
        evidence = PulseEvidence(model)
        unclear, cause, complete = np.arange(given.n_propellers), None, 0
        for tried in range(self.tries):
            steered = not tried or self._brought_back(session, given, evidence)
            plan = pulse_plan(given, session.cameras, stronger)
            order = uphill(session, plan, unclear.tolist())
            # The craft has rested when the first one begins: on a slope every moment counts.
            rested = [*session.poses] if not tried else []
            pilot = PulseTest(given, plan, session.table, order, rested)
            lacking = _STEERED - len(_answering(given, np.isfinite(evidence.effects[1])))
            wait = max(lacking, 0) * (plan.rest + plan.length) + (0.0 if rested else plan.rest)
            begins = session.link.now + wait + _LATE_POSES if steered else math.inf
            stop = _DriftingOff(session, given, begins)
            session.fly("pulses", pilot, pilot.duration, until=stop, guarded=False)
            evidence = evidence.after(pilot)
            unclear, cause = _unclear(evidence)
            untried = np.isnan(evidence.effects[0]).any()
            complete += not untried
            if not len(unclear) or complete > _SILENT:
                break
            stronger *= 1.0 if untried else 1.6
        if cause is not None:
            raise Ended(_because_of_slope(session, cause))
        self._conclude(session, given, evidence)

    def _brought_back(self, session: Commissioned, given: Vehicle, evidence: PulseEvidence) -> bool:
        """Bring the craft back to the middle if it can be; return whether it can."""
        found, _ = evidence.effects
        known = _answering(given, np.isfinite(found).all(axis=0) & ~_silent(evidence.model, found))
        if len(known) < _STEERED:
            return False
        session.vehicle = known_vehicle(given, session.cameras, evidence)
        try:
            pilot = _without_unknown(session, known)
            # If others are needed, the estimator finds those that do not push as stated.
            estimator = "kalman" if len(known) == len(given.propellers) else "learning"
            pilot = pilot or hovering(session, estimator)
        except InputError:
            return False  # Too little is known to steer the craft.
        session.fly("return", pilot, _RETURN, until=_Settled(session, 0.12, 0.1))
        # Long enough to know the drift, too.
        pause = max(2 * evidence.lag + evidence.delay + 0.05, 0.15)
        session.fly("pause", _Resting(given.idle), pause)
        return True

    def _conclude(self, session: Commissioned, given: Vehicle, evidence: PulseEvidence) -> None:
        """Continue with the corrected vehicle, and say so."""
        effects, _ = evidence.effects
        wrong = layout_findings(given, matched(nominal_model(given), effects))
        session.findings += wrong
        session.vehicle = known_vehicle(given, session.cameras, evidence)
        session.late = evidence.latest
        if wrong:
            said = "; ".join(one.cause for one in wrong)
            session.tell(f"{said}: continuing with a corrected vehicle file")
        lag, delay = (f"{1e3 * one:.0f} ms" for one in (evidence.lag, evidence.delay))
        count = len(given.propellers)
        session.note("pulses", f"{count} motors answer; lag about {lag}, delay about {delay}")


def _answering(vehicle: Vehicle, channels: Bool[np.ndarray, " n"]) -> set[int]:
    """Return the propellers that some of these channels belong to."""
    return {vehicle.actuation.channels[k].column for k in np.flatnonzero(channels)}


def _unclear(evidence: PulseEvidence) -> tuple[Int[np.ndarray, " k"], Finding | None]:
    """Return the motors that have to be tried again, and what is wrong with the first one."""
    model, (effects, errors) = evidence.model, evidence.effects
    names = model.vehicle.propeller_names
    untried = np.isnan(effects).any(axis=0)
    share, silent = _shares(model, effects), _silent(model, effects)
    if (untried | silent).all():
        remedy = "Check that the motors are armed, powered and on the command's topic."
        cause = Finding("actuator", "No motor moves the craft", "", remedy)
        return np.arange(len(names)), cause
    matches = matched(model, np.where(silent, np.nan, effects))
    odd = np.array([k in matches and matches[k].acts_as is None for k in range(len(names))])
    unclear = np.flatnonzero(untried | silent | odd | (errors > _VAGUE))
    if not (untried | silent | odd).any():
        return unclear, None
    for k in np.flatnonzero(silent & (evidence.tries >= _TRIES)).tolist():
        remedy = "Check its cable, power and bearing, and start again."
        seen = f"at most {percent(float(share[k]))} of the usual effect"
        cause = Finding("actuator", f"{names[k]} gives little or no thrust", seen, remedy)
        return unclear, cause
    for k in np.flatnonzero(odd & (evidence.tries >= _TRIES)).tolist():
        angle = math.degrees(math.acos(float(np.clip(matches[k].cosine, -1, 1))))
        cause = f"{names[k]} acts {angle:.0f}° off its place in the vehicle file"
        remedy = "Check its position_m and direction_deg, and the axes of the poses."
        return unclear, Finding("layout", cause, "", remedy)
    first = names[np.flatnonzero(untried | silent | odd)[0]]
    cause = f"The craft came near a rail before {first} was tried often enough"
    return unclear, Finding("table", cause, "", "Level the table, and start in the middle.")


def _shares(model: Model, effects: PulseEffects) -> Float[np.ndarray, " n"]:
    """Return the motors' effects relative to the usual one's; nan of those not tried.

    The larger of two ratios counts, to the median motor and to the vehicle file, so that a motor
    that is stated to be weak does not pass for dead.
    """
    size = np.linalg.norm(effects[:2], axis=0)
    size, relative = size / np.nanmedian(size), size / _stated(model)
    return np.maximum(size, relative / np.nanmedian(relative))


def _stated(model: Model) -> Float[np.ndarray, " n"]:
    """Return the linear accelerations per newton that a model states."""
    return np.linalg.norm(acceleration_map(np, model.dynamics, 0.0, 0.0)[0][:2], axis=0)


def _silent(model: Model, effects: PulseEffects) -> Bool[np.ndarray, " n"]:
    """Return which motors were tried and gave nothing."""
    least = _MOVED * _stated(model).max()
    return (_shares(model, effects) < _DEAD) | (np.linalg.norm(effects[:2], axis=0) < least)


def _because_of_slope(session: Commissioned, cause: Finding) -> Finding:
    """Return the slope as the cause if it kept motors from being tried."""
    slope = 1e3 * float(np.hypot(*session.slope)) / GRAVITY
    said, slopes = f"The table slopes by {slope:.0f} mrad", slope > _LEVEL and cause.kind == "table"
    return replace(cause, cause=said, evidence=cause.cause) if slopes else cause


def known_vehicle(given: Vehicle, cameras: Cameras | None, evidence: PulseEvidence) -> Vehicle:
    """Return the vehicle that pulses show: order, signs, strengths, inertia, lag and delay."""
    effects, _ = evidence.effects
    # A start may have failed: a motor without thrust counts as not tried.
    effects = np.where(_silent(evidence.model, effects), np.nan, effects)
    right = corrected(given, matched(nominal_model(given), effects))
    start = with_lag(replace(nominal_model(right), cameras=cameras), evidence.lag)
    # Effects are per unit of the given file's thrusts.
    ratios = given.nominal_thrust.sum(axis=1) / right.nominal_thrust.sum(axis=1)
    return measured(start, effects * ratios, evidence.delay)


class _DriftingOff:
    """Whether the craft must be brought back now to keep it away from a rail.

    Early on nothing can bring it back; pulses then continue until it is at the rail.
    """

    def __init__(self, session: Commissioned, vehicle: Vehicle, steered: float) -> None:
        self._session, self._steered = session, steered
        self._reach = np.array(session.table.reach(vehicle.radius_m)) - _CLEARANCE
        self._braking = usual_pushes(vehicle)[0] / (2 * _ROUGH)

    def __call__(self, now: float) -> bool:
        if (motion := self._session.motion) is None:
            return False
        place, speed = (one[:2] for one in motion)
        braked = speed * _REACTION + speed * np.abs(speed) / (2 * self._braking)
        ahead = braked if now >= self._steered else speed * _AT_RAIL
        return bool((np.abs(place + ahead) > self._reach).any())


def careful(model: Model) -> Tuning:
    """Return the packaged tuning, slowed for a craft that answers slowly."""
    tuning = tuning_for(model)
    return tuning.model_copy(update={"law": tuning.slowed(lateness(model)).law})


@dataclass(frozen=True)
class Hover:
    """A first flight with a careful law, which brings the craft to the middle of the table.

    Attributes
    ----------
    longest_s : float
        The run ends if the craft has not settled after this time.
    near : tuple of float
        Distance and speed at which it has settled [m, m/s].
    """

    longest_s: float = 15.0
    near: tuple[float, float] = (0.1, 0.08)

    def run(self, session: Commissioned) -> None:
        """Hold the place; see `CommissioningStep`."""
        begun, settled = session.link.now, _Settled(session, *self.near)
        session.fly("hover", hovering(session), self.longest_s, until=settled)
        took = session.link.now - begun
        if not settled.reached:
            cause = f"The craft did not come to rest in the middle within {took:.0f} s"
            remedy = "Check for cables, draughts and the slope of the table, and start again."
            raise Ended(Finding("control", cause, "", remedy))
        session.note("hover", f"the craft came to rest in the middle after {took:.1f} s")


def hovering(
    session: Commissioned, estimator: str = "kalman", model: Model | None = None
) -> TrackingController:
    """Return a controller that holds the middle of the table."""
    model = model or session.model
    rate = 240.0 if session.cameras is None else session.cameras.rate_hz
    tuning = careful(model).with_camera(rate).with_estimator(estimator)
    # Compiling takes seconds, in which the motors would idle and the craft drift.
    given: dict[str, Any] = {"table": session.table, "compiled": False}
    controller = TrackingController(model, session.here, tuning, **given)
    session.brief(controller)
    return controller


def _without_unknown(session: Commissioned, known: set[int]) -> Pilot | None:
    """Return a controller that holds the middle with the known motors; None if it needs others.

    A motor that has not answered yet may push anywhere. The known ones must push twice as strongly
    as the slope pulls.
    """
    model = session.model
    runs = np.array([one.column in known for one in model.vehicle.actuation.channels])
    needed = max(LEAST_EFFORT, 2 * float(np.hypot(*session.slope)))
    if runs.all() or weakest_effort(model, runs) < needed:
        return None
    curves = np.where(runs[:, None], 1.0, _FAINT) * model.parameters.thrust
    model = replace(model, parameters=replace(model.parameters, thrust=curves))
    return _Sparing(hovering(session, model=model), sorted(known))


class _Sparing(Pilot):
    """Flies with some motors only."""

    def __init__(self, controller: TrackingController, runs: list[int]) -> None:
        self._controller, self._runs = controller, runs
        self.reference = controller.reference
        self.pose, self.measured, self.sent = controller.pose, controller.measured, controller.sent

    def step(self, time: float) -> Step:
        """Return the controller's step without the other motors; see `Pilot`."""
        step, command = self._controller.step(time), self._controller.model.vehicle.idle
        command[self._runs] = step.command[self._runs]
        return replace(step, command=command)


class _Settled:
    """Whether the craft has been near the middle, and slow, for a while."""

    def __init__(self, session: Commissioned, near: float, slow: float) -> None:
        self._session, self._near, self._slow = session, near, slow
        self._since: float | None = None
        #: Whether it has settled.
        self.reached = False

    def __call__(self, now: float) -> bool:
        if (motion := self._session.motion) is None:
            return False
        place, speed = (math.hypot(*one[:2]) for one in motion)
        near = place < self._near and speed < self._slow
        self._since = (self._since if self._since is not None else now) if near else None
        self.reached = self._since is not None and now - self._since >= 0.2
        return self.reached
