"""The files of the paper's authors, for their identification and their ROS 2 controller."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from airpuck.craft.vehicle import default_vehicle
from airpuck.export.kinds import (
    Subject,
    cannot,
    printable,
    refuse_actuators,
    refuse_effects,
    refuse_frame,
)
from airpuck.model.authors_params import MOTORS, AuthorsSwitches
from airpuck.model.model_file import Model

#: Angle from the middle of the first pair to each of its propellers, and their distance from the
#: centre [rad, m] (holohover-sysid, params.json).
_HALF_ANGLE, _DISTANCE = 0.32822, 0.046532
#: Largest rounding error of the paper's positions and directions [m, 1].
_SAME = 1e-9
_PROPERTIES = """\
# {name} of {vehicle}, written by airpuck for holohover_utils/config/common.

mass: {mass!r}  # kg
CoM: {center}  # m, fixed to the world
inertia: {inertia!r}  # kg m^2
idle_signal: {idle!r}  # lowest command
motor_tau: {tau!r}  # s

# Thrusts [N] to accelerations of the body [m/s^2, m/s^2, rad/s^2], row by row.
use_configuration_matrix: {direct}
configuration_matrix: {matrix}

# Positions from the geometric centre [m], directions of the force on the craft, and coefficients of
# the command, its square and its cube [N].
"""


def params_json(model: Model) -> dict[str, Any]:
    """Return the content of holohover-sysid's ``params.json`` that describes a model.

    Parameters
    ----------
    model : Model
        A model of the paper's craft, apart from its mass.

    Returns
    -------
    dict
        Tables ``model``, ``default_model_params`` and ``model_params``.

    Raises
    ------
    InputError
        If the format cannot represent the model.
    """
    _refuse(model)
    known, vehicle, values = default_vehicle(), model.vehicle, model.parameters
    for name in ("positions", "directions"):
        if not np.allclose(getattr(vehicle, name), getattr(known, name), rtol=0, atol=_SAME):
            cannot(f"propeller {name} other than the paper craft's", "params.json")
    order = np.shape(values.thrust)[1]
    if order > 3:
        cannot(f"thrust curves of degree {order}", "params.json; the highest is 3")
    fields = AuthorsSwitches.model_fields
    switches = {str(field.alias): name in model.learned for name, field in fields.items()}
    switches["learn_configuration_matrix"] = values.configuration_matrix is not None
    shared = {
        "center_of_mass": [*np.asarray(values.center_of_mass).tolist(), 0.0],
        "mass": vehicle.mass_kg,
        "inertia": float(values.inertia),
        "signal2thrust": np.asarray(values.thrust).tolist(),
        "motor_angle_offset": float(values.angle_offset),
        "tau": float(values.motor_time_constant),
    }
    places, directions = _turned(model)
    return {
        "model": {
            "load_model": False,
            "thrust_poly_order": order,
            **switches,
            "learn_mass": False,
            "learn_motors_vec": False,
            "learn_motors_pos": False,
        },
        "default_model_params": {
            "motor_distance": _DISTANCE,
            "motor_angel_delta": _HALF_ANGLE,
            **shared,
        },
        "model_params": {
            **shared,
            "configuration_matrix": np.asarray(model.dynamics.configuration).tolist(),
            "motors_vec": directions.tolist(),
            "motors_pos": places.tolist(),
        },
    }


def params_yaml(model: Model) -> str:
    """Return the properties of a craft that the authors' ROS 2 controller reads.

    Parameters
    ----------
    model : Model
        A model of a craft with six propellers in any layout.

    Returns
    -------
    str
        The content of a YAML file like ``holohover_params.yaml``.

    Raises
    ------
    InputError
        If the format cannot represent the model.
    """
    _refuse(model)
    values = model.parameters
    places, directions = _turned(model)
    head = _PROPERTIES.format(
        name=printable(model.name),
        vehicle=printable(model.vehicle.name),
        mass=model.vehicle.mass_kg,
        center=[*np.asarray(values.center_of_mass).tolist(), 0.0],
        inertia=float(values.inertia),
        idle=model.vehicle.command_min,
        tau=float(values.motor_time_constant),
        direct=str(values.configuration_matrix is not None).lower(),
        matrix=np.ravel(model.dynamics.configuration).tolist(),
    )
    each = (array.tolist() for array in (places, directions, np.asarray(values.thrust)))
    motors = [
        f"motor_pos_{name}: {place}\n"
        f"learned_motor_vec_{name}: {direction}\n"
        f"signal_to_thrust_coeffs_motor_{k}: {curve}\n"
        for (name, k), place, direction, curve in zip(MOTORS.items(), *each, strict=True)
    ]
    return head + "".join(motors)


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write both files."""
    text = json.dumps(params_json(subject.model), indent=4)
    (folder / "params.json").write_text(text + "\n", encoding="utf-8")
    (folder / "holohover_params.yaml").write_text(params_yaml(subject.model), encoding="utf-8")
    return {
        "params.json": "without data and learning_params, which describe a training",
        "radius, pairs and names": "not in the files; read_model assumes the paper's craft",
        "transport delay": f"{1e3 * subject.model.transport_delay:.4g} ms, not in the files",
    }


def _refuse(model: Model) -> None:
    """Raise InputError if neither format can represent the model."""
    refuse_effects(model, "holohover")
    refuse_actuators(model, "holohover")
    refuse_frame(model, "holohover", "world")
    vehicle = model.vehicle
    if vehicle.n_propellers != len(MOTORS):
        cannot(f"{vehicle.n_propellers} propellers instead of {len(MOTORS)}", "holohover")
    if vehicle.command_max != 1:
        cannot(f"a highest command of {vehicle.command_max:g} instead of 1", "holohover")


def _turned(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and directions of the propellers, turned by the angle offset."""
    cos, sin = np.cos(model.parameters.angle_offset), np.sin(model.parameters.angle_offset)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0]])
    return model.vehicle.positions @ turn, model.vehicle.directions @ turn
