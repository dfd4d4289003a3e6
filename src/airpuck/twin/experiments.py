"""Experiments on the twin: excitation, and tracking of set points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.control.excitation import Excitation
from airpuck.control.pilot import Pilot
from airpuck.control.reference import Reference, SetPoints
from airpuck.control.settings import ExcitationPlan
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.flight.loop import FlightLog, fly
from airpuck.flight.pilot import PilotMaker
from airpuck.model.model_file import Model, nominal_model
from airpuck.recording.stream import Recording
from airpuck.twin.plant import Plant
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import Twin

#: Laws as titles of pages and animations name them.
_LAWS = {"lqr": "a linear regulator", "mpc": "predictive control"}


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
        Table, sensors, radio, faults; by default the packaged ones.
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
    try:
        plan = ExcitationPlan(each, hold, duration, margin)
    except InputError as error:
        # The fields of a plan end with their units; the arguments here do not.
        field = (error.field or "").removesuffix("_s").removesuffix("_m")
        raise InputError(error.problem, field=field) from error
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
) -> tuple[Recording, FlightLog]:
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
        Table, sensors, radio, faults; by default the packaged ones.
    tuning : Tuning, optional
        Tuning of the controller; by default the one for the model.
    plant : Plant, optional
        From `airpuck.twin.twin.build_plant`, to compile only once.
    make_pilot : callable, optional
        Factory of a user's pilot from (model, reference); the controller's options then do not
        apply.

    Returns
    -------
    recording : Recording
        The recording, as made by a recorder on the network.
    log : FlightLog
        The controller's log.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> recording, log = airpuck.track(model, airpuck.SetPoint(0.1, 0.0, 0.0), duration=1.0)
    >>> "reference" in recording.streams
    True
    """
    tuning = tuning or tuning_for(model)
    _check_duration(duration, tuning)
    truth = truth or model
    if len(truth.vehicle.columns) != len(model.vehicle.columns):
        raise InputError(
            f"the controller's model has {len(model.vehicle.columns)} propellers, the twin "
            f"{len(truth.vehicle.columns)}; name a truth of the same craft"
        )
    twin = Twin(truth, settings, seed=seed, pose=pose, plant=plant)
    if make_pilot is not None:
        pilot: Pilot = make_pilot(model, reference)
    else:
        pilot = TrackingController(
            model,
            reference,
            tuning.with_camera(twin.settings.motion_capture.rate_hz),
            table=twin.settings.table,
            gain=gain,
            compensate_delay=compensate_delay,
            reject_disturbance=reject_disturbance,
        )
    log = fly(pilot, twin, duration, tuning.period_s, on_board=on_board)
    law = "a pilot" if make_pilot else _LAWS.get(tuning.regulator.kind, "a law of its own")
    goal = "set points" if isinstance(reference, SetPoints) else "its target"
    source = f"flying to {goal} with {law} ({model.name} on a twin of {truth.name}, seed {seed})"
    return replace(twin.recording(), source=source), log


def _check_duration(duration: float, tuning: Tuning) -> None:
    """Raise InputError for a flight shorter than a control period, or far too long."""
    numbers.FLIGHT_DURATION.check(duration, "duration")
    if duration < tuning.period_s:
        words = f"must be at least the controller's period, {tuning.period_s:g} s"
        raise InputError(words, field="duration")
