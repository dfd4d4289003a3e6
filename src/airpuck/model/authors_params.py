"""The authors' ``params.json``, as published with the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pydantic

from airpuck.boundary.files import Positive, checked
from airpuck.boundary.parsing import load_json
from airpuck.craft.vehicle import default_vehicle
from airpuck.model.quantities import Rows
from airpuck.model.rungs import RUNGS
from airpuck.model.sections import with_nominal_delay


class _AuthorsValues(pydantic.BaseModel):
    """The authors' ``model_params``."""

    thrust_N: Rows = pydantic.Field(alias="signal2thrust")
    mass_kg: Positive = pydantic.Field(alias="mass")
    inertia_kg_m2: float = pydantic.Field(alias="inertia")
    motor_time_constant_s: float = pydantic.Field(alias="tau")
    angle_offset_rad: float = pydantic.Field(alias="motor_angle_offset")
    center_of_mass_m: tuple[float, float, float] = pydantic.Field(alias="center_of_mass")
    configuration_matrix_SI: Rows = pydantic.Field(alias="configuration_matrix")


class _AuthorsSwitches(pydantic.BaseModel):
    """The authors' ``model``: the learned parameters."""

    thrust: bool = pydantic.Field(alias="learn_signal2thrust")
    inertia: bool = pydantic.Field(alias="learn_inertia")
    motor_time_constant: bool = pydantic.Field(alias="learn_tau")
    angle_offset: bool = pydantic.Field(alias="learn_motor_angle_offset")
    center_of_mass: bool = pydantic.Field(alias="learn_center_of_mass")
    configuration_matrix: bool = pydantic.Field(alias="learn_configuration_matrix")


class _AuthorsModel(pydantic.BaseModel):
    """The part of the authors' params.json that describes a model."""

    model: _AuthorsSwitches
    model_params: _AuthorsValues


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
    return {
        "name": next(rung, path.parent.name),
        "vehicle": vehicle,
        "parameters": parameters,
        "free": mask,
        "frame": "world",
        "indexing": "end",
        "source": str(path),
    }
