"""Experiments on the twin: excitation, tracking of set points, and races along plans."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, about
from airpuck.boundary.results import Result
from airpuck.control.excitation import Excitation
from airpuck.control.law import Law, Pilot
from airpuck.control.reference import Reference, SetPoints
from airpuck.control.settings import ExcitationPlan
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.craft.vehicle import Vehicle
from airpuck.flight.loop import FlightLog, PilotMaker, fly, pilot_named
from airpuck.model.model_file import Model, nominal_model
from airpuck.physics.rigid_body import wrapped
from airpuck.planning.plan import Plan, plan
from airpuck.planning.settings import Limits
from airpuck.planning.tracking import for_plans
from airpuck.recording.stream import Recording
from airpuck.twin.plant import Plant, build_plant
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import Twin


@dataclass(frozen=True, eq=False)
class Excited:
    """An excitation experiment on the twin."""

    #: The recording, as made by a recorder on the network.
    recording: Recording
    #: Total pause of the signals while the craft was near a rail [s].
    paused: float
    #: Times at which it met a rail nevertheless, from the start of the flight [s].
    contacts: tuple[float, ...]


def excite(
    model: Model,
    duration: float = 90.0,
    seed: int = 0,
    *,
    amplitude: float | Sequence[float] = 1.0,
    hold: float = 0.2,
    margin: float = 0.05,
    settings: TwinSettings | None = None,
    tuning: Tuning | None = None,
    plant: Plant | None = None,
) -> Recording:
    """Fly the excitation experiment on the twin (sec:experiment).

    The controller knows only the vehicle's nominal values, as before a first identification.

    Parameters
    ----------
    model : Model
        The truth of the twin.
    duration : float, default 90
        Length [s].
    seed : int, default 0
        Seed of signals, noise and radio.
    amplitude : float or sequence of float, default 1
        Largest signal, one number for all or one each; see `Excitation`.
    hold : float, default 0.2
        Time between changes of the signals [s].
    margin : float, default 0.05
        Distance from the rails at which the craft must be able to stop [m].
    settings : TwinSettings, optional
        Table, sensors, radio, faults; by default the paper's.
    tuning : Tuning, optional
        Tuning of the controller; by default the one for the model.
    plant : Plant, optional
        From `airpuck.twin.twin.build_plant`, to compile only once.

    Returns
    -------
    Recording
        The recording, as made by a recorder on the network.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> recording = airpuck.excite(model, duration=1.0, seed=1)
    >>> sorted(recording.streams)
    ['command', 'imu', 'mouse', 'pose', 'reference']
    """
    each = tuple(amplitude) if isinstance(amplitude, Sequence) else amplitude
    # The fields of a plan end with their units; the arguments here do not.
    with about(None, lambda field: field.removesuffix("_s").removesuffix("_m")):
        plan = ExcitationPlan(each, hold, duration, margin)
    flown = fly_excitation(model, plan, seed, settings=settings, tuning=tuning, plant=plant)
    return flown.recording


def fly_excitation(
    model: Model,
    plan: ExcitationPlan,
    seed: int = 0,
    *,
    settings: TwinSettings | None = None,
    tuning: Tuning | None = None,
    plant: Plant | None = None,
) -> Excited:
    """Fly an excitation experiment, and record its smallest distance to the rails; see `excite`."""
    settings = settings or default_twin_settings()
    tuning = (tuning or tuning_for(model)).with_camera(settings.motion_capture.rate_hz)
    _check_duration(plan.duration_s, tuning)
    twin = Twin(model, settings, seed=seed, plant=plant)
    pilot = Excitation(
        nominal_model(model.vehicle),
        tuning=tuning,
        amplitude=plan.amplitude,
        hold=plan.hold_s,
        seed=seed,
        table=settings.table,
        margin=plan.margin_m,
    )
    period = pilot.controller.tuning.period_s
    fly(pilot, twin, plan.duration_s, period)
    source = f"excitation of {model.name} on the twin, seed {seed}"
    recording = replace(twin.recording(), source=source)
    return Excited(recording, pilot.pauses * period, tuple(twin.contacts))


def track(
    model: Model,
    reference: Reference,
    duration: float,
    *,
    truth: Model | None = None,
    seed: int = 0,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gain: Float[np.ndarray, "3 6"] | None = None,
    compensate_delay: bool = True,
    reject_disturbance: bool = True,
    on_board: bool = False,
    settings: TwinSettings | None = None,
    tuning: Tuning | None = None,
    plant: Plant | None = None,
    make_pilot: PilotMaker | None = None,
    law: str | type[Law] | Law | None = None,
) -> FlightLog:
    """Fly the twin along a reference.

    Parameters
    ----------
    model : Model
        The controller's model of the craft.
    reference : Reference
        Reference to track.
    duration : float
        Length [s].
    truth : Model, optional
        The truth of the twin; by default the controller's model.
    seed : int, default 0
        Seed of noise and radio.
    pose : tuple of float, default (0, 0, 0)
        Initial pose of the craft [m, m, rad].
    gain : array, shape (3, 6), optional
        Gain of the LQR; by default from the tuning's weights.
    compensate_delay, reject_disturbance : bool, default True
        See `TrackingController`.
    on_board : bool, default False
        Whether the controller also uses the IMU and the optical sensor.
    settings : TwinSettings, optional
        Table, sensors, radio, faults; by default the paper's.
    tuning : Tuning, optional
        Tuning of the controller; by default the one for the model.
    plant : Plant, optional
        From `airpuck.twin.twin.build_plant`, to compile only once.
    make_pilot : callable, optional
        Factory of a user's pilot from (model, reference); the controller's options then do not
        apply.
    law : str, or subclass of Law or an object of it, optional
        See `TrackingController`. FILE.py:NAME may also name a pilot, to which the controller's
        options do not apply.

    Returns
    -------
    FlightLog
        The controller's log, with the recording that a recorder on the network made.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> log = airpuck.track(model, airpuck.SetPoint(0.1, 0.0, 0.0), duration=1.0)
    >>> log.recording["pose"].columns
    ('x_m', 'y_m', 'yaw_rad')
    """
    tuning, truth = tuning or tuning_for(model), truth or model
    _check_duration(duration, tuning)
    check_same_craft(model.vehicle, truth.vehicle)
    twin = Twin(truth, settings, seed=seed, pose=pose, plant=plant)
    given: Any = {"law": law, "gain": gain}
    given |= {"compensate_delay": compensate_delay, "reject_disturbance": reject_disturbance}
    make_pilot = make_pilot or (pilot_named(law) if isinstance(law, str) else None)
    pilot = make_pilot(model, reference) if make_pilot else None
    log, words = _fly(model, reference, duration, twin, tuning, pilot, on_board, **given)
    goal = "set points" if isinstance(reference, SetPoints) else "its target"
    source = f"flying to {goal} with {words} ({model.name} on a twin of {truth.name}, seed {seed})"
    return replace(log, recorded=replace(twin.recording(), source=source), vehicle=truth.vehicle)


def _fly(
    model: Model,
    reference: Reference,
    duration: float,
    twin: Twin,
    tuning: Tuning,
    own: Pilot | None = None,
    on_board: bool = False,
    **options: Any,
) -> tuple[FlightLog, str]:
    """Fly a reference on the twin, by default with the controller; also say what flies."""
    chosen = tuning.with_camera(twin.settings.motion_capture.rate_hz)
    chosen = for_plans(chosen) if isinstance(reference, Plan) else chosen
    options["table"] = twin.settings.table
    pilot = own or TrackingController(model, reference, chosen, **options)
    log = fly(pilot, twin, duration, tuning.period_s, on_board=on_board)
    return log, pilot.law.title if isinstance(pilot, TrackingController) else "a pilot"


def _check_duration(duration: float, tuning: Tuning) -> None:
    """Raise InputError for a flight shorter than a control period, or far too long."""
    numbers.FLIGHT_DURATION.check(duration, "duration")
    if duration < tuning.period_s:
        words = f"must be at least the controller's period, {tuning.period_s:g} s"
        raise InputError(words, field="duration")


#: The goal counts as reached within these distances [m, rad, m/s].
TOLERANCE = (0.01, 0.1, 0.05)
#: A point counts as passed within this distance [m].
_PASSED = 0.03
#: Speeds below which a plan counts as starting, or ending, at rest [m/s, rad/s].
_STANDING, _STOPPED = 1e-6, 1e-2
#: Time at rest before the start; waiting time after the planned end, for a plan and a set point
#: [s].
_LEAD, _PATIENCE, _SET_POINT_PATIENCE = 0.5, 0.5, 2.5
#: Limits of the plans of courses: reserve of thrust, distance to the rails [m], smoothness.
_LIMITS = Limits(reserve=0.1, margin=0.02, smoothing=2e-4)

#: Start, goal and way points of each course.
COURSES: dict[str, tuple[Sequence[float], Sequence[float], Sequence[Sequence[float]]]] = {
    "straight": ((-0.5, 0.0, 0.0), (0.5, 0.0, 0.0), ()),
    "slalom": ((-0.8, 0.0, 0.0), (0.8, 0.0, 0.0), ((-0.4, 0.2), (0.0, -0.2), (0.4, 0.2))),
    "eight": (
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
        ((0.5, 0.25), (0.5, -0.25), (0.0, 0.0), (-0.5, 0.25), (-0.5, -0.25)),
    ),
}


@dataclass(frozen=True, eq=False)
class Race(Result):
    """A plan and its flights.

    Attributes
    ----------
    plan : Plan
        The planned flight.
    flown : tuple of float or None
        Time of each flight to the goal [s]; None: not reached.
    set_point : tuple of float or None, or None
        The same for a controller with only the goal. None if that is a different task: a plan past
        points or discs, or to a moving goal.
    contacts : int
        Number of rail contacts in all flights of the plan.
    touches : int
        Number of flights of the plan that touched a forbidden disc.
    paths : tuple of array, shape (N, 2)
        True positions of the craft in each flight of the plan [m].
    recording : Recording
        Log of the first flight of the plan.
    """

    JSON = (
        "planned_s=plan.duration flown_s=flown lower_bound_s=plan.lower_bound contacts "
        "touches set_point_s=set_point reserve=plan.reserve"
    )

    plan: Plan
    flown: tuple[float | None, ...]
    set_point: tuple[float | None, ...] | None
    contacts: int
    touches: int
    paths: tuple[Float[np.ndarray, "N 2"], ...]
    recording: Recording


def course_plan(course: str, model: Model, settings: TwinSettings) -> Plan:
    """Plan a course on the twin's table."""
    start, goal, via = COURSES[course]
    intervals = 20 if via else 40
    return plan(
        model, start, goal, via=via, table=settings.table, limits=_LIMITS, intervals=intervals
    )


def race(
    planned: Plan,
    truth: Model,
    *,
    seeds: int = 1,
    settings: TwinSettings | None = None,
    tuning: Tuning | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Race:
    """Fly a plan on the twin, and the same controller to the goal as a set point.

    Parameters
    ----------
    planned : Plan
        Plan to fly; its model is the controller's.
    truth : Model
        The truth of the twin.
    seeds : int, default 1
        Number of flights, each with its own noise and radio.
    settings : TwinSettings, optional
        Table, sensors, radio, faults; by default the paper's.
    tuning : Tuning, optional
        Tuning of the controller; by default the one for the model.
    progress : callable, optional
        Called with the number of flights done and the total.

    Returns
    -------
    Race
        All flights.

    Raises
    ------
    InputError
        If the plan starts in motion: the twin's craft is initially at rest.

    Examples
    --------
    >>> limits = airpuck.Limits(reserve=0.1, margin=0.02)
    >>> path = airpuck.plan(model, (0, 0, 0), (0.2, 0, 0), table=airpuck.Table(), limits=limits)
    >>> airpuck.race(path, model).contacts
    0
    """
    if np.abs(planned.states[0, 3:6]).max() > _STANDING:
        raise InputError(
            "starts in motion; the twin only flies plans that start at rest (plan without "
            "--velocity)",
            field="plan",
        )
    check_same_craft(planned.model.vehicle, truth.vehicle)
    settings = settings or default_twin_settings()
    tuning = tuning or tuning_for(planned.model)
    plant, (x, y, yaw) = build_plant(truth, settings), planned.states[0, :3].tolist()
    goal = planned.samples[1][-1]
    ends = SetPoints([0.0, _LEAD], [planned.states[0, :3], goal[:3]])
    flights: list[tuple[Reference, float]] = [(planned.starting(_LEAD), _PATIENCE)]
    if not (planned.via or planned.keep_out) and np.abs(goal[3:6]).max() < _STOPPED:
        flights.append((ends, _SET_POINT_PATIENCE))
    twins: list[list[Twin]] = []
    for seed in range(seeds):
        twins.append([])
        for reference, patience in flights:
            twin = Twin(truth, settings, seed=seed, pose=(x, y, yaw), plant=plant)
            _fly(planned.model, reference, _LEAD + planned.duration + patience, twin, tuning)
            twins[-1].append(twin)
        progress(seed + 1, seeds)
    raced, *alone = zip(*twins, strict=True)
    return Race(
        planned,
        tuple(_reached(twin, planned) for twin in raced),
        tuple(_reached(twin, planned) for twin in alone[0]) if alone else None,
        sum(len(twin.contacts) for twin in raced),
        sum(_touches(twin, planned) for twin in raced),
        tuple(twin.truth[1][:, :2] for twin in raced),
        raced[0].recording(),
    )


def check_same_craft(own: Vehicle, true: Vehicle) -> None:
    """Raise InputError if the twin has other motors than the controller's craft."""
    ours, theirs = (len(one.columns) for one in (own, true))
    if ours != theirs:
        words = f"the controller's craft has {ours} motors, the twin {theirs}"
        raise InputError(f"{words}; name a truth of the same craft", field="truth")


def _reached(twin: Twin, planned: Plan) -> float | None:
    """Return when the craft reached the goal after passing all points, or None."""
    time, states = twin.truth
    time, passed = time - _LEAD, 0
    for point in planned.via:
        near = np.flatnonzero(passes(states[passed:], np.array(point)))
        if not len(near):
            return None
        passed += int(near[0])
    there = arrived(states, planned.samples[1][-1])
    there[:passed] = False
    begun = np.flatnonzero(there & (time > 0))
    return float(time[begun[0]]) if len(begun) else None


def passes(
    states: Float[np.ndarray, "*n k"], points: Float[np.ndarray, "*#n 2"]
) -> Bool[np.ndarray, "*n"]:
    """Return whether poses or states count as passing points."""
    return np.hypot(*np.moveaxis(states[..., :2] - points, -1, 0)) < _PASSED


def arrived(
    states: Float[np.ndarray, "*n k"], goals: Float[np.ndarray, "*#n m"]
) -> Bool[np.ndarray, "*n"]:
    """Return whether states count as having reached goals."""
    away = np.hypot(*np.moveaxis(states[..., :2] - goals[..., :2], -1, 0))
    turned = np.abs(wrapped(np, states[..., 2] - goals[..., 2]))
    faster = np.hypot(*np.moveaxis(states[..., 3:5] - goals[..., 3:5], -1, 0))
    return (away < TOLERANCE[0]) & (turned < TOLERANCE[1]) & (faster < TOLERANCE[2])


def _touches(twin: Twin, planned: Plan) -> bool:
    """Return whether the craft touched a forbidden disc."""
    place, radius = twin.truth[1][:, :2], planned.model.vehicle.radius_m
    return any(
        bool((np.hypot(*(place - (x, y)).T) < disc + radius).any())
        for x, y, disc in planned.keep_out
    )
