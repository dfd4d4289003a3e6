"""The craft on its table for MuJoCo: a planar rigid body, site actuators, rails, sensors."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from airpuck.boundary.outputs import rendered
from airpuck.craft.table import Table
from airpuck.craft.vehicle import GRAVITY
from airpuck.export.kinds import (
    Subject,
    printable,
    refuse_actuators,
    refuse_effects,
    refuse_frame,
    refuse_settings,
)
from airpuck.model.model_file import Model
from airpuck.physics.effects import Tilt

#: Time step [s].
_TIMESTEP = 2.5e-4
#: Angular frequency of a contact with a rail [rad/s]: it lasts about 6 ms, or 25 steps, and a craft
#: at 1 m/s penetrates the rail by 2 mm.
_RAIL = 500.0
#: MuJoCo's largest constraint impedance. The smaller its difference from 1, the less a force that
#: pushes the craft into the rail affects the bounce.
_IMPEDANCE = "0.9999 0.9999 0.001 0.5 2"
#: Lowest restitution exported: below it, the damping makes the contact stiff [fraction].
_LEAST_RESTITUTION = 0.05


def xml(model: Model, table: Table) -> str:
    """Return the MJCF of a craft on its table.

    Parameters
    ----------
    model : Model
        The craft. The table's tilt is the only effect that MuJoCo can represent here.
    table : Table
        Size of the table, restitution and friction of its rails.

    Returns
    -------
    str
        The file's content.

    Raises
    ------
    InputError
        If MuJoCo cannot represent the model.
    """
    refuse_effects(model, "mjcf", [Tilt])
    refuse_actuators(model, "mjcf")
    refuse_frame(model, "mjcf", "body")
    vehicle, parameters = model.vehicle, model.parameters
    slopes = [effect.gravity for effect in model.dynamics.effects if effect.gravity is not None]
    damping = _damping_ratio(max(table.restitution, _LEAST_RESTITUTION))
    return rendered(
        "craft.xml.jinja",
        name=printable(model.name),
        vehicle=printable(vehicle.name),
        table=table,
        delay_ms=1e3 * model.transport_delay,
        timestep=_TIMESTEP,
        gravity=[*np.sum([(0.0, 0.0), *slopes], axis=0), -GRAVITY],
        lag=float(parameters.motor_time_constant),
        powers=range(1, np.shape(parameters.thrust)[1] + 1),
        center=parameters.center_of_mass,
        mass=vehicle.mass_kg,
        inertia=float(parameters.inertia),
        radius=vehicle.radius_m,
        motors=list(_motors(model)),
        command_min=vehicle.command_min,
        command_max=vehicle.command_max,
        spring=(-(_RAIL**2), -2 * damping * _RAIL),
        impedance=_IMPEDANCE,
        numbers=_numbers,
        actuator=_actuator,
    )


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write the MJCF, and the Python functions that set its controls."""
    model, table = subject.model, subject.twin.table
    refuse_settings(subject.twin, "mjcf", ("effects", "motors"))
    (folder / "craft.xml").write_text(xml(model, table), encoding="utf-8")
    # Not imported: an export does not need MuJoCo.
    shutil.copyfile(Path(__file__).with_name("mujoco_craft.py"), folder / "airpuck_craft.py")
    return {
        "time step": f"{1e3 * _TIMESTEP:g} ms",
        "thrust": "set_command of airpuck_craft.py sets the controls before each step",
        "transport delay": f"{1e3 * model.transport_delay:.4g} ms, not in the file",
        "not in the file": "goals, puck and mallet, sensors and radio of the twin",
    }


def _numbers(*values: Any) -> str:
    """Write numbers and vectors one after another, in the fewest digits that identify each."""
    return " ".join(
        repr(number).removesuffix(".0") for number in np.hstack(values, dtype=float).tolist()
    )


def _motors(model: Model) -> Iterator[dict[str, Any]]:
    """Yield name, place, direction, gear and thrust curve of each motor; any Π is exact."""
    vehicle, dynamics, center = model.vehicle, model.dynamics, model.parameters.center_of_mass
    mass, inertia = vehicle.mass_kg, float(model.parameters.inertia)
    cos, sin = math.cos(model.parameters.angle_offset), math.sin(model.parameters.angle_offset)
    places = vehicle.positions @ np.array([[cos, sin], [-sin, cos]])
    forces, moments = mass * dynamics.configuration[:2].T, inertia * dynamics.configuration[2]
    for name, place, (fx, fy), moment, curve in zip(
        vehicle.propeller_names, places, forces, moments, model.parameters.thrust, strict=True
    ):
        half, (px, py) = math.atan2(fy, fx) / 2, place - center
        yield {
            "name": printable(name),
            "place": place,
            "turn": (math.cos(half), 0, 0, math.sin(half)),
            # A learned Π may turn the craft differently than the forces at its propellers would.
            "gear": (math.hypot(fx, fy), 0, 0, 0, 0, moment - (px * fy - py * fx)),
            "thrust": curve,
        }


def _actuator(motor: dict[str, Any], power: int) -> str:
    """Return the name of the actuator for a motor and a power of its speed."""
    return motor["name"] if power == 1 else f"{motor['name']}^{power}"


def _damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring and damper that bounces with a restitution.

    A contact ends when spring and damper no longer push. After a contact of duration t the speed is
    exp(-ζ t) times the speed before it, with time in units of the spring's (Schwager, Pöschel,
    Granular Matter 9, 2007).
    """

    def bounce(ratio: float) -> float:
        away = math.sqrt(abs(1 - ratio**2))
        if ratio < 1:
            time = math.atan2(2 * ratio * away, 2 * ratio**2 - 1) / away
        else:
            time = math.atanh(2 * ratio * away / (2 * ratio**2 - 1)) / away
        return math.exp(-ratio * time)

    low, high = 0.0, 0.999999
    if restitution < bounce(high):
        low, high = 1.000001, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if bounce(middle) > restitution else (low, middle)
    return low
