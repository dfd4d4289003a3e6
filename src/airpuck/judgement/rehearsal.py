"""Flights on the twin with the controller that a model's user would design from it.

The simulated craft is the model with its systematic errors, as a recording shows them, corrected.
Cameras are as in the recording.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.control.authority import control_authority, weakest_effort
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import tuning_for
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.effect_errors import EffectErrors
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.flight.loop import fly
from airpuck.model.model_file import Model, nominal_model
from airpuck.physics.angle import pose_difference
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


def settles(model: Model, craft: Model, settings: TwinSettings) -> bool:
    """Return whether the controller designed from a model brings a craft to rest at the goal."""
    tuning = tuning_for(model)
    # NumPy, since compiling a program for one flight takes longer than it saves.
    pilot = TrackingController(model, SetPoint(*GOAL), tuning, table=settings.table, compiled=False)
    plant = build_plant(craft, settings, compiled=False)
    twin = Twin(craft, settings, plant=plant)
    arrives = _time_there(model)
    with np.errstate(all="ignore"):  # as compiled programs compute
        fly(pilot, twin, arrives + _STAYS, tuning.period_s)
    time, state = twin.truth
    goal = np.array([*GOAL, 0.0, 0.0, 0.0])
    off = [pose_difference(np, row[:6], goal)[:3] for row in state[time >= arrives]]
    return not twin.contacts and bool((np.abs(off) < NEAR).all())


def _time_there(model: Model) -> float:
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


def like(trajectory: Trajectory, effects: EffectErrors, model: Model) -> TwinSettings:
    """Return a twin with the cameras of a recording, on a table with room for the craft."""
    usual = default_twin_settings()
    cameras = usual.motion_capture.model_copy(
        update={
            "rate_hz": min(1 / trajectory.sample_period, _MOST_FRAMES),
            "position_noise_m": float(effects.noise[:2].mean()),
            "yaw_noise_rad": float(effects.noise[2]),
        }
    )
    room = 2 * model.vehicle.radius_m
    table = usual.table.model_copy(
        update={"length_m": usual.table.length_m + room, "width_m": usual.table.width_m + room}
    )
    updates = {"motion_capture": cameras, "table": table}
    return usual.model_copy(update=updates).without_on_board()


def failures(model: Model, trajectory: Trajectory, effects: EffectErrors) -> list[str]:
    """Describe why the controller does not settle, and the remedy; empty if it settles."""
    settings, seen = like(trajectory, effects, model), as_seen(model, effects)
    if weakest_effort(model) < _HELD * weakest_effort(nominal_model(model.vehicle)):
        why = _weakness(model)
        return [f"No controller can hold the modelled craft: {why}. Check the motors."]
    flown = "In simulation, the packaged controller"
    try:
        if settles(model, seen, settings):
            return []
        noise, cameras = settings.motion_capture, default_twin_settings().motion_capture
        if settles(model, seen, settings.model_copy(update={"motion_capture": cameras})):
            return [
                f"{flown} settles with good cameras, but not with the noise of this recording: "
                f"{1e3 * noise.position_noise_m:.2g} mm and {1e3 * noise.yaw_noise_rad:.2g} mrad "
                f"at {noise.rate_hz:.0f} Hz. State this noise in the tuning ([estimation] "
                "position_m, yaw_rad) and fly it in simulation first (`airpuck twin`), or improve "
                "the cameras."
            ]
        if settles(model, model, settings):
            return [
                f"{flown} settles on the modelled craft, but not on the craft that the recording "
                "shows: motors and timing differ too much. Try a richer model "
                "(`--model auto`)."
            ]
    except InputError as error:
        return [f"No controller can be designed from the model: {error.problem}."]
    return [
        f"{flown} does not settle on the modelled craft: {_weakness(model)}. "
        "Check the motors, or tune a controller for this craft and fly it in simulation first "
        "(`airpuck twin`)."
    ]


def _weakness(model: Model) -> str:
    """Describe what the craft's motors cannot do."""
    return "; ".join(control_authority(model).sentences or ("its motors are too weak or unequal",))
