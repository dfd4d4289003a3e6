"""The part of a model file that holds the values of its parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section
from airpuck.craft.vehicle import Vehicle
from airpuck.model.parameters import EFFECTS, QUANTITIES, Parameters


class ParametersSection(Section):
    """The table ``[parameters]``."""

    thrust_N: tuple[tuple[float, ...], ...]
    inertia_kg_m2: float = pydantic.Field(gt=0)
    motor_time_constant_s: float = pydantic.Field(ge=0)
    angle_offset_rad: float
    center_of_mass_m: tuple[float, float]
    configuration_matrix_SI: tuple[tuple[float, ...], ...] | None = None
    drag_SI: tuple[float, float, float, float] | None = None
    inflow_s_m: float | None = None
    pair_interaction_1_N: float | None = None
    voltage_sag_1_N: float | None = None
    tilt_rad: tuple[float, float] | None = None

    def parameters(self, vehicle: Vehicle) -> Parameters:
        """Return what the table says; the transport delay, which stands elsewhere, is nominal."""
        n = vehicle.n_propellers
        thrust = _matrix(self.thrust_N, "thrust_N")
        if len(thrust) != n:
            raise InputError(
                f"has {len(thrust)} curves, but the vehicle has {n} propellers",
                field="parameters.thrust_N",
            )
        matrix = self.configuration_matrix_SI
        if matrix is not None:
            matrix = _matrix(matrix, "configuration_matrix_SI")
            if matrix.shape != (3, n):
                raise InputError(
                    f"must have 3 rows of {n} numbers, one for each propeller",
                    field="parameters.configuration_matrix_SI",
                )
        return Parameters(
            thrust=thrust,
            inertia=self.inertia_kg_m2,
            motor_time_constant=self.motor_time_constant_s,
            angle_offset=self.angle_offset_rad,
            center_of_mass=np.array(self.center_of_mass_m),
            configuration_matrix=matrix,
            **{q.name: self._effect(q.key) for q in QUANTITIES if q.name in EFFECTS},
            transport_delay=vehicle.nominal.transport_delay_s,
        )

    def _effect(self, key: str) -> Any:
        """Return an effect's numbers, None where it is not modelled."""
        value = getattr(self, key)
        return np.array(value) if isinstance(value, tuple) else value


def _matrix(rows: tuple[tuple[float, ...], ...], key: str) -> Float[np.ndarray, "rows columns"]:
    """Return rows as an array, or say that they differ in length."""
    if not rows or not rows[0] or len({len(row) for row in rows}) != 1:
        raise InputError("its rows must all have the same length", field=f"parameters.{key}")
    return np.array(rows, dtype=float)
