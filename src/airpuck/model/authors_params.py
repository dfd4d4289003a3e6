"""The authors' files: ``params.json`` of their identification, the YAML of their controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pydantic
from jaxtyping import Bool

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Fraction, NonNegative, Positive, checked, load_json, load_yaml
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.model.parameters import Parameters
from airpuck.model.quantities import Matrix
from airpuck.model.rungs import RUNGS
from airpuck.model.sections import with_nominal_delay

#: Motors as named in the controller's keys, and their numbers in the keys of thrust curves.
MOTORS = {name: k for k, name in enumerate(("a_1", "a_2", "b_1", "b_2", "c_1", "c_2"), start=1)}
#: Rounding error of unit vectors in published files, which are in single precision.
_SINGLE = 1e-6

_Vector = tuple[float, float, float]


class _AuthorsValues(pydantic.BaseModel):
    """The authors' ``model_params``."""

    thrust_N: Matrix = pydantic.Field(alias="signal2thrust")
    mass_kg: Positive = pydantic.Field(alias="mass")
    inertia_kg_m2: float = pydantic.Field(alias="inertia")
    motor_time_constant_s: float = pydantic.Field(alias="tau")
    angle_offset_rad: float = pydantic.Field(alias="motor_angle_offset")
    center_of_mass_m: _Vector = pydantic.Field(alias="center_of_mass")
    configuration_matrix_SI: Matrix = pydantic.Field(alias="configuration_matrix")


class AuthorsSwitches(pydantic.BaseModel):
    """The authors' ``model``: the learned parameters."""

    thrust: bool = pydantic.Field(alias="learn_signal2thrust")
    inertia: bool = pydantic.Field(alias="learn_inertia")
    motor_time_constant: bool = pydantic.Field(alias="learn_tau")
    angle_offset: bool = pydantic.Field(alias="learn_motor_angle_offset")
    center_of_mass: bool = pydantic.Field(alias="learn_center_of_mass")
    configuration_matrix: bool = pydantic.Field(alias="learn_configuration_matrix")


class _AuthorsModel(pydantic.BaseModel):
    """The part of the authors' params.json that describes a model."""

    model: AuthorsSwitches
    model_params: _AuthorsValues


def of_authors(
    name: str, vehicle: Vehicle, parameters: Parameters, free: Bool[np.ndarray, " P"], source: str
) -> dict[str, Any]:
    """Return the fields of a `Model` in the authors' conventions.

    The offset of the centre of mass is fixed to the world, and the encoder takes commands at the
    end of each interval.
    """
    return {
        "name": name,
        "vehicle": vehicle,
        "parameters": parameters,
        "free": free,
        "frame": "world",
        "indexing": "end",
        "source": source,
    }


def read_params_json(path: Path) -> dict[str, Any]:
    """Return the fields of the `Model` in a params.json: the default vehicle, with their mass."""
    content = checked(load_json(path), _AuthorsModel, file=path)
    section, switches = content.model_params.model_dump(), content.model
    vehicle = default_vehicle().model_copy(update={"mass_kg": section.pop("mass_kg")})
    section["center_of_mass_m"] = section["center_of_mass_m"][:2]
    if not switches.configuration_matrix:
        del section["configuration_matrix_SI"]
    parameters = with_nominal_delay(section, vehicle, file=path)
    mask = parameters.mask(frozenset(name for name, learned in switches if learned))
    rung = (n for n, p in RUNGS.items() if np.array_equal(p.mask(parameters), mask))
    return of_authors(next(rung, path.parent.name), vehicle, parameters, mask, str(path))


_of_motors: dict[str, Any] = {
    **{f"motor_pos_{name}": (_Vector, ...) for name in MOTORS},
    **{f"learned_motor_vec_{name}": (_Vector, ...) for name in MOTORS},
    **{f"signal_to_thrust_coeffs_motor_{k}": (tuple[float, ...], ...) for k in MOTORS.values()},
}


class _ControllersValues(pydantic.create_model("_OfMotors", **_of_motors)):
    """The properties of a craft that the authors' ROS 2 controller reads."""

    mass: Positive
    CoM: _Vector
    inertia: Positive
    idle_signal: Fraction
    motor_tau: NonNegative
    use_configuration_matrix: bool
    configuration_matrix: tuple[float, ...] = pydantic.Field(min_length=18, max_length=18)

    def of_motors(self, key: str) -> np.ndarray:
        """Return the vectors of all motors, without their height."""
        return np.array([getattr(self, f"{key}_{name}") for name in MOTORS])[:, :2]


def read_params_yaml(path: Path) -> dict[str, Any]:
    """Return the fields of the `Model` in the YAML of the authors' ROS 2 controller.

    Its positions and directions include the angle offset, so the model has none.
    """
    found = load_yaml(path)
    known = {key: found[key] for key in _ControllersValues.model_fields if key in found}
    content = checked(known, _ControllersValues, file=path)
    directions = content.of_motors("learned_motor_vec")
    if (np.abs(np.hypot(*directions.T) - 1) > _SINGLE).any():
        raise InputError("must be unit vectors", file=path, field="learned_motor_vec")
    thrust = [getattr(content, f"signal_to_thrust_coeffs_motor_{k}") for k in MOTORS.values()]
    section = {
        "thrust_N": thrust,
        "inertia_kg_m2": content.inertia,
        "motor_time_constant_s": content.motor_tau,
        "angle_offset_rad": 0.0,
        "center_of_mass_m": content.CoM[:2],
    }
    if content.use_configuration_matrix:
        section["configuration_matrix_SI"] = np.reshape(
            content.configuration_matrix, (3, 6)
        ).tolist()
    usual = default_vehicle()
    angles = np.rad2deg(np.arctan2(*directions.T[::-1])).tolist()
    propellers = [
        {"name": propeller.name, "position_m": place, "direction_deg": angle}
        for propeller, place, angle in zip(
            usual.propellers, content.of_motors("motor_pos").tolist(), angles, strict=True
        )
    ]
    changed = {
        "name": path.stem,
        "mass_kg": content.mass,
        "command_min": content.idle_signal,
        "propellers": propellers,
    }
    vehicle = checked(usual.model_dump() | changed, Vehicle, file=path)
    parameters = with_nominal_delay(section, vehicle, file=path)
    free = parameters.mask(frozenset())
    return of_authors(path.stem, vehicle, parameters, free, str(path))
