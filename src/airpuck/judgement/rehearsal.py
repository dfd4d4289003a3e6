"""Flights on the twin with the controllers that a model's user would design from it.

The simulated craft is the model with its systematic errors, as a recording shows them, corrected.
Cameras are as in the recording, and the controller is tuned to the model as everywhere else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.control.authority import control_authority, weakest_effort
from airpuck.control.laws import law_class
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.effect_errors import EffectErrors
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.flight.loop import fly
from airpuck.identification.cameras import cameras_of
from airpuck.judgement.findings import next_step
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.uncertainty import Cameras
from airpuck.physics.rigid_body import pose_difference
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import Twin

#: Goal of the craft, from rest at the origin, and tolerance [m, m, rad].
GOAL, NEAR = (0.45, 0.2, 1.5), (0.02, 0.02, 0.1)
#: Shortest time allowed to get there, and time to stay within the tolerance [s].
_ARRIVES, _STAYS = 2.0, 1.0
#: A craft with little thrust is given this multiple of the shortest time that its accelerations
#: allow, up to a limit [s].
_LEISURE, _LONGEST = 3.0, 60.0
#: Fraction of its effort in the vehicle file that a craft needs in its weakest motion. With 3 %,
#: one propeller almost dead, all controllers hold the paper's craft; with none it drifts away,
#: though MPC may keep it at the goal for a second.
_HELD = 0.02
#: Largest useful frame rate for a controller; more frames only cost time.
_MOST_FRAMES = 240.0
#: Margin below which more than one flight has to settle, and how many. With the noise of a flight
#: that just settles, margins scatter by 30 % from seed to seed.
_CLOSE, _SEEDS = 1.4, 3
#: Standard deviation of errors that are uniform within a step, in steps.
_UNIFORM = 12**-0.5
#: Noise that the tuning assumes, relative to the recording's, if a law is unsettled by noise.
_CALMER = 3.0


@dataclass(frozen=True)
class Rehearsal(Result):
    """How the controller designed from a model flies the craft that a recording shows.

    Attributes
    ----------
    margin : float
        Tolerance over the largest error at the goal, after the time to get there; the smallest of
        three flights if it is just above 1; 0 if the craft touched a rail, or no controller can be
        designed.
    remedy : str
        Why the craft does not settle, and what to do; empty if it settles.
    """

    JSON = "settles margin remedy"

    margin: float
    remedy: str = ""

    @property
    def settles(self) -> bool:
        """Whether the craft stays at the goal."""
        return self.margin >= 1


def flown_margin(
    model: Model, craft: Model, settings: TwinSettings, tuning: Tuning | None = None
) -> float:
    """Return the margin with which the controller of a model brings a craft to rest at the goal.

    If a flight just settles, the smallest margin of three counts: a craft that stays at the goal in
    two of three does not settle.
    """
    tuning = tuning or tuning_for(model)
    margins = [_margin(model, craft, settings, tuning, 0)]
    if 1 <= margins[0] < _CLOSE:
        margins += [_margin(model, craft, settings, tuning, seed) for seed in range(1, _SEEDS)]
    return min(margins)


def _margin(model: Model, craft: Model, settings: TwinSettings, tuning: Tuning, seed: int) -> float:
    """Fly once; see `Rehearsal.margin`."""
    # Compiling a small program for one flight takes longer than it saves.
    compiled = getattr(law_class(tuning.law.kind), "looks_ahead", True)
    pilot = TrackingController(
        model, SetPoint(*GOAL), tuning, table=settings.table, compiled=compiled
    )
    twin = Twin(craft, settings, plant=build_plant(craft, settings, compiled=False), seed=seed)
    arrives = time_there(model)
    with np.errstate(all="ignore"):  # as compiled programs compute
        fly(pilot, twin, arrives + _STAYS, tuning.period_s)
    time, state = twin.truth
    goal = np.array([*GOAL, 0.0, 0.0, 0.0])
    off = np.array([pose_difference(np, row[:6], goal)[:3] for row in state[time >= arrives]])
    worst = float(np.max(np.abs(off) / NEAR))
    return 0.0 if twin.contacts or not math.isfinite(worst) else 1 / max(worst, 1e-3)


def time_there(model: Model) -> float:
    """Return the deadline for the craft's arrival [s]."""
    pushes = np.maximum(largest_acceleration(model), 1e-9)
    least = max(
        math.sqrt(4 * math.hypot(*GOAL[:2]) / pushes[:4].min()),
        math.sqrt(4 * GOAL[2] / pushes[4:].min()),
    )
    return float(np.clip(_LEISURE * least, _ARRIVES, _LONGEST))


def as_seen(model: Model, effects: EffectErrors) -> Model:
    """Return the craft as recorded: the model with its systematic errors corrected."""
    matrix = np.array(model.dynamics.configuration)
    runs = np.linalg.norm(effects.modelled, axis=0) > 0
    thrusts = np.linalg.norm(effects.modelled, axis=0) / np.linalg.norm(matrix, axis=0)
    matrix[:, runs] = effects.found[:, runs] / thrusts[runs]
    delay = max(model.transport_delay + effects.later, 0.0)
    parameters = replace(model.parameters, configuration_matrix=matrix, transport_delay=delay)
    return replace(model, parameters=parameters, uncertainty=None)


def like(cameras: Cameras, model: Model) -> TwinSettings:
    """Return a twin with the cameras of a recording, on a table with room for the craft."""
    usual = default_twin_settings()
    seen = cameras.model_dump(include={"position_noise_m", "yaw_noise_rad"})
    seen["rate_hz"] = min(cameras.rate_hz, _MOST_FRAMES)
    seen["stamp_step_s"] = cameras.stamp_jitter_s / _UNIFORM
    table, room = usual.table, 2 * model.vehicle.radius_m
    sides = {"length_m": table.length_m + room, "width_m": table.width_m + room}
    updates = {"motion_capture": usual.motion_capture.model_copy(update=seen)}
    updates |= {"table": table.model_copy(update=sides)}
    return usual.model_copy(update=updates).without_on_board()


def rehearse(
    model: Model, trajectory: Trajectory, effects: EffectErrors, law: str | None = None
) -> Rehearsal:
    """Fly the craft of a recording with the controller of a model, by default with its usual law.

    If the craft does not settle, more flights find the cause.
    """
    seen = as_seen(model, effects)
    cameras = cameras_of(seen, [trajectory])
    if cameras is None:
        return Rehearsal(0.0, "The recording is too short to determine its cameras' noise.")
    if model.cameras is None:
        model = replace(model, cameras=cameras)
    if weakest_effort(model) < _HELD * weakest_effort(nominal_model(model.vehicle)):
        why = f"No controller can hold the modelled craft: {_weakness(model)}. Check the motors."
        return Rehearsal(0.0, why)
    tuning, settings = tuning_for(model), like(cameras, model)
    tuning = tuning if law is None else tuning.with_law(law)
    try:
        margin = flown_margin(model, seen, settings, tuning)
        why = "" if margin >= 1 else _unsettled(model, seen, settings, tuning)
        return Rehearsal(margin, why)
    except InputError as error:
        return Rehearsal(0.0, f"No controller can be designed from the model: {error.problem}.")


def _unsettled(model: Model, seen: Model, settings: TwinSettings, tuning: Tuning) -> str:
    """Describe why the controller does not settle, and the remedy."""
    flown = f"In simulation, {law_class(tuning.law.kind).__name__} with the usual tuning"
    noise, good = settings.motion_capture, default_twin_settings().motion_capture
    if flown_margin(model, seen, settings.model_copy(update={"motion_capture": good}), tuning) >= 1:
        told = (
            f"{flown} settles with good cameras, but not with the noise of this recording: "
            f"{1e3 * noise.position_noise_m:.2g} mm and {1e3 * noise.yaw_noise_rad:.2g} mrad at "
            f"{noise.rate_hz:.0f} Hz"
        )
        if noise.stamp_step_s:
            told += f", stamps off by {1e3 * _UNIFORM * noise.stamp_step_s:.2g} ms"
        own = tuning.estimation
        calmer = {key: _CALMER * getattr(own, key) for key in ("position_m", "yaw_rad")}
        calm = tuning.model_copy(update={"estimation": own.model_copy(update=calmer)})
        if flown_margin(model, seen, settings, calm) >= 1:
            line = ", ".join(f"{key} = {value:.2g}" for key, value in calmer.items())
            return f"{told}. It settles with {line} in [estimation] of the tuning (`--tuning`)."
        return f"{told}. Improve the cameras, or tune a slower controller (`airpuck twin`)."
    if flown_margin(model, model, settings, tuning) >= 1:
        return (
            f"{flown} settles on the modelled craft, but not on the craft that the recording "
            f"shows: motors and timing differ too much. {next_step(model)}"
        )
    return (
        f"{flown} does not settle on the modelled craft: {_weakness(model)}. "
        "Check the motors, or tune a controller for this craft and fly it in simulation first "
        "(`airpuck twin`)."
    )


def _weakness(model: Model) -> str:
    """Describe what the craft's motors cannot do."""
    return "; ".join(control_authority(model).sentences or ("its motors are too weak or unequal",))
