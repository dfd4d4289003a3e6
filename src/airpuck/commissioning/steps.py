"""Steps that take a craft from rest to a controlled hover."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import percent
from airpuck.boundary.results import Finding
from airpuck.commissioning.correction import corrected, layout_findings, matched, measured
from airpuck.commissioning.session import Commissioned, Ended
from airpuck.control.law import Pilot, Step
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.craft.vehicle import Vehicle
from airpuck.deviation.time_scale import usual_pushes
from airpuck.flight.pulses import DELAYS, PulsePlan, PulseTest, pulse_responses
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.uncertainty import Cameras
from airpuck.physics.rigid_body import acceleration_map
from airpuck.physics.thrust import thrust

#: Lowest useful rate of poses [1/s].
_RATE = 50.0
#: Largest standard deviation of poses at rest [m, rad].
_NOISE = (2e-3, 5e-2)
_GRAVITY = 9.81
#: Lags that the pulses are compared with [s].
_LAGS = (0.01, 0.015, 0.025, 0.04, 0.06, 0.085, 0.12, 0.16)
#: Twice the factor by which squared residuals exceed those of white noise.
_TEMPERED = 8.0
#: Response time for which the packaged controller is made [s]; slower craft get a slower one.
_RESPONSE, _SLOWEST = 0.08, 3.0
#: Spin that a pulse may cause [rad/s].
_SPIN = 1.0
#: Effect below which a motor counts as dead, relative to the median motor's.
_DEAD = 0.15
#: Error of an effect from which a motor is tried again, relative to the usual effect; and effect
#: that moves the craft, relative to the vehicle file's.
_VAGUE, _MOVED = 0.15, 0.1
#: Smallest effect of a start that did not fail, relative to the largest of the motor's pulses, and
#: largest misfit of a pulse that was not disturbed, relative to the smallest.
_STARTED, _DISTURBED = 0.3, 5.0
#: Factor by which a vehicle file's thrusts may be wrong.
_ROUGH = 2.0
#: Fewest known motors that can bring a craft back, and the time that they get [s].
_STEERED, _RETURN = 3, 6.0
#: Distance to the rails that is kept [m], and time until a slowed law brakes [s].
_CLEARANCE, _REACTION = 0.05, 0.4
#: Time to a rail at which pulses end although nothing can bring the craft back [s].
_AT_RAIL = 0.2
#: A motor that gave nothing in this many flights more counts as dead: starts may fail.
_SILENT = 2
#: Time over which a drifting craft's speed is taken [s].
_LOOK = 0.15
#: A table counts as level up to this slope [mrad].
_LEVEL = 1.0
#: Accelerations per newton: forward, left, turn.
Effects = Float[np.ndarray, "3 n"]


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
        vehicle = session.vehicle
        # Poses may begin late; the session ends the run if none come.
        enough = lambda now: now - session.first_pose > self.duration_s  # noqa: E731
        session.fly("rest", _Resting(vehicle.idle), 10.0, until=enough)
        pose = session.flights[-1].recording["pose"]
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
        slope = float(np.hypot(*session.slope)) / _GRAVITY
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

    On a slope the craft drifts towards a rail meanwhile. It is then brought back with the motors
    that are known by then, and the rest are tried afterwards.

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
        unclear, cause = np.arange(given.n_propellers), None
        for tried in range(self.tries):
            steered = not tried or self._brought_back(session, given, evidence)
            plan = pulse_plan(given, session.cameras, stronger)
            order = uphill(session, plan, unclear.tolist())
            pilot = PulseTest(given, plan, session.table, order)
            lacking = _STEERED - np.isfinite(evidence.effects[1]).sum()
            wait = max(int(lacking), 0) * (plan.rest + plan.length) + plan.rest
            begins = session.link.now + wait if steered else math.inf
            stop = _DriftingOff(session, given, begins)
            session.fly("pulses", pilot, pilot.duration, until=stop, guarded=False)
            evidence = evidence.after(pilot)
            unclear, cause = _unclear(model, *evidence.effects)
            untried = np.isnan(evidence.effects[0]).any()
            if not len(unclear) or (tried >= _SILENT and not untried):
                break
            stronger *= 1.0 if untried else 1.6
        if cause is not None:
            raise Ended(_because_of_slope(session, cause))
        self._conclude(session, given, evidence)

    def _brought_back(self, session: Commissioned, given: Vehicle, evidence: PulseEvidence) -> bool:
        """Bring the craft back to the middle if it can be; return whether it can."""
        effects, _ = evidence.effects
        # If a motor gave nothing, the others cannot steer; it may be tried again while coasting.
        known = np.isfinite(effects).all(axis=0).sum()
        if known < _STEERED or _silent(evidence.model, effects).any():
            return False
        session.vehicle = known_vehicle(given, session.cameras, evidence)
        try:
            pilot = hovering(session)
        except InputError:
            return False  # What is known so far steers no craft.
        session.fly("return", pilot, _RETURN, until=_Settled(session, 0.12, 0.1))
        session.fly("pause", _Resting(given.idle), 2 * evidence.lag + evidence.delay + 0.05)
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


def _unclear(
    model: Model, effects: Effects, errors: Float[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " k"], Finding | None]:
    """Return the motors that have to be tried again, and what is wrong with the first one."""
    names = model.vehicle.propeller_names
    untried = np.isnan(effects).any(axis=0)
    share, silent = _shares(effects), _silent(model, effects)
    if (untried | silent).all():
        remedy = "Check that the motors are armed, powered and on the command's topic."
        cause = Finding("actuator", "No motor moves the craft", "", remedy)
        return np.arange(len(names)), cause
    matches = matched(model, np.where(silent, np.nan, effects))
    odd = np.array([k in matches and matches[k].acts_as is None for k in range(len(names))])
    unclear = np.flatnonzero(untried | silent | odd | (errors > _VAGUE))
    if not (untried | silent | odd).any():
        return unclear, None
    for k in np.flatnonzero(silent).tolist():
        remedy = "Check its cable, power and bearing, and start again."
        evidence = f"{percent(float(share[k]))} of the others' effect"
        return unclear, Finding("actuator", f"{names[k]} gives no thrust", evidence, remedy)
    for k in np.flatnonzero(odd).tolist():
        angle = math.degrees(math.acos(float(np.clip(matches[k].cosine, -1, 1))))
        cause = f"{names[k]} acts {angle:.0f}° off its place in the vehicle file"
        remedy = "Check its position_m and direction_deg, and the axes of the poses."
        return unclear, Finding("layout", cause, "", remedy)
    cause = f"The craft came near a rail before {names[np.flatnonzero(untried)[0]]} was tried"
    return unclear, Finding("table", cause, "", "Level the table, and start in the middle.")


def _shares(effects: Effects) -> Float[np.ndarray, " n"]:
    """Return the motors' effects relative to the median motor's; nan of those not tried."""
    size = np.linalg.norm(effects[:2], axis=0)
    return size / np.nanmedian(size)


def _silent(model: Model, effects: Effects) -> Bool[np.ndarray, " n"]:
    """Return which motors were tried and gave nothing."""
    stated = np.asarray(acceleration_map(np, model.dynamics, 0.0, 0.0)[0])[:2]
    least = _MOVED * np.linalg.norm(stated, axis=0).max()
    return (_shares(effects) < _DEAD) | (np.linalg.norm(effects[:2], axis=0) < least)


def _because_of_slope(session: Commissioned, cause: Finding) -> Finding:
    """Return the slope as the cause if it kept motors from being tried."""
    slope = 1e3 * float(np.hypot(*session.slope)) / _GRAVITY
    said, slopes = f"The table slopes by {slope:.0f} mrad", slope > _LEVEL and cause.kind == "table"
    return replace(cause, cause=said, evidence=cause.cause) if slopes else cause


def known_vehicle(given: Vehicle, cameras: Cameras | None, evidence: PulseEvidence) -> Vehicle:
    """Return the vehicle that pulses show: order, signs, strengths, inertia, lag and delay."""
    effects, _ = evidence.effects
    right = corrected(given, matched(nominal_model(given), effects))
    start = with_lag(replace(nominal_model(right), cameras=cameras), evidence.lag)
    # Effects are per unit of the given file's thrusts.
    ratios = given.nominal_thrust.sum(axis=1) / right.nominal_thrust.sum(axis=1)
    return measured(start, effects * ratios, evidence.delay)


class _DriftingOff:
    """Whether the craft has to be brought back now, lest it comes near a rail.

    Until a time nothing can bring it back: then pulses go on until it is at the rail.
    """

    def __init__(self, session: Commissioned, vehicle: Vehicle, steered: float) -> None:
        self._session, self._steered = session, steered
        self._reach = np.array(session.table.reach(vehicle.radius_m)) - _CLEARANCE
        self._braking = usual_pushes(vehicle)[0] / (2 * _ROUGH)
        self._motion = _Motion()

    def __call__(self, now: float) -> bool:
        moved = self._motion.at(now, self._session.position)
        if moved is None:
            return False
        place, speed = moved
        braked = speed * _REACTION + speed * np.abs(speed) / (2 * self._braking)
        ahead = braked if now >= self._steered else speed * _AT_RAIL
        return bool((np.abs(place + ahead) > self._reach).any())


class _Motion:
    """Position and velocity from poses a tenth of a second apart."""

    def __init__(self) -> None:
        self._poses: list[tuple[float, Float[np.ndarray, " 2"]]] = []

    def at(self, now: float, pose: np.ndarray | None) -> tuple[np.ndarray, np.ndarray] | None:
        """Add the pose of now; return place and velocity [m, m/s], None until they are known."""
        if pose is None:
            return None
        self._poses.append((now, pose[:2]))
        while len(self._poses) > 2 and now - self._poses[1][0] >= 0.1:
            del self._poses[0]
        before, old = self._poses[0]
        return (pose[:2], (pose[:2] - old) / (now - before)) if now - before >= 0.1 else None


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
    """Order motors so that, by the vehicle file, pulses undo the slope's motion and each other's.

    Motion is along x, y and the yaw times the radius of gyration.
    """
    poses = session.flights[-1].recording["pose"] if session.flights else None
    if poses is None or len(poses.time) < 2 or not motors:
        return motors
    model, order, turn = nominal_model(session.vehicle), list[int](), plan.length + plan.rest
    scale = np.array([1.0, 1.0, model.radius_of_gyration])
    first = np.searchsorted(poses.time, poses.time[-1] - _LOOK).clip(0, len(poses.time) - 2)
    moved = (poses.values[-1] - poses.values[first]) / (poses.time[-1] - poses.time[first])
    place, speed = poses.values[-1] * [1, 1, 0], moved * scale
    effects, _ = acceleration_map(np, model.dynamics, float(poses.values[-1, 2]), 0.0)
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
    """What all pulses so far tell of a craft that is as stated, but for its motors and timing."""

    model: Model
    #: How well each lag and delay explains them; every pair is as likely at first.
    costs: Float[np.ndarray, "L D"] = field(
        default_factory=lambda: np.zeros((len(_LAGS), len(DELAYS)))
    )
    #: Pose times, poses, command times and commands of each test.
    logs: tuple[tuple[np.ndarray, ...], ...] = ()

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
        log, costs = (times, poses, sent, commands), np.array(self.costs)
        for row, lag in zip(costs, _LAGS, strict=True):
            for one in pulse_responses(with_lag(self.model, lag), *log):
                row += one.costs
        return replace(self, costs=costs, logs=(*self.logs, log))

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
    def effects(self) -> tuple[Effects, Float[np.ndarray, " n"]]:
        """Effects of the motors, nan of those not tried, and their errors over the usual effect."""
        model, count = with_lag(self.model, self.lag), self.model.vehicle.n_propellers
        effects, errors = np.full((3, count), np.nan), np.full(count, np.nan)
        delays = np.full(len(self.logs) * 10 * count, self.delay)
        seen = [one for log in self.logs for one in pulse_responses(model, *log, delays=delays)]
        scale = np.array([1.0, 1.0, model.radius_of_gyration])
        for motor in {one.motor for one in seen}:
            own = [one for one in seen if one.motor == motor]
            # A start may have failed, or a rail or a hand disturbed a pulse.
            largest = max(float(np.linalg.norm(scale * one.effect)) for one in own)
            least = _DISTURBED * min(one.misfit for one in own)
            good = [one for one in own if one.misfit <= least]
            good = [g for g in good if np.linalg.norm(scale * g.effect) > _STARTED * largest] or own
            covariance = np.linalg.pinv(sum(one.information for one in good))
            effects[:, motor] = covariance @ sum(one.information @ one.effect for one in good)
            errors[motor] = math.sqrt(np.diag(covariance) @ scale**2 / 3)
        usual = np.nanmedian(np.linalg.norm(scale[:, None] * effects, axis=0)) if seen else 1.0
        return effects, errors / max(float(usual), 1e-9)


def careful(model: Model) -> Tuning:
    """Return the packaged tuning, slowed for a craft that answers slowly."""
    response = float(np.max(model.dynamics.lag)) + model.transport_delay
    return tuning_for(model).slowed(float(np.clip(response / _RESPONSE, 1.0, _SLOWEST)))


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


def hovering(session: Commissioned) -> TrackingController:
    """Return a controller that holds the middle of the table."""
    model = session.model
    rate = 240.0 if session.cameras is None else session.cameras.rate_hz
    tuning = careful(model).with_camera(rate)
    # Compiling takes seconds, in which the motors would idle and the craft drift.
    return TrackingController(model, session.here, tuning, table=session.table, compiled=False)


class _Settled:
    """Whether the craft has been near the middle, and slow, for a while."""

    def __init__(self, session: Commissioned, near: float, slow: float) -> None:
        self._session, self._near, self._slow = session, near, slow
        self._since: float | None = None
        self._motion = _Motion()
        #: Whether it has settled.
        self.reached = False

    def __call__(self, now: float) -> bool:
        moved = self._motion.at(now, self._session.position)
        if moved is None:
            return False
        place, speed = moved
        near = math.hypot(*place) < self._near and math.hypot(*speed) < self._slow
        self._since = (self._since if self._since is not None else now) if near else None
        self.reached = self._since is not None and now - self._since >= 0.2
        return self.reached
