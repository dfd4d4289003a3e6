"""The scale of thrusts if Π is learned directly; Newton's law fixes it.

s times a propeller's thrust and 1/s times its column of Π give the same motion: data determine only
their product. By Newton's law the linear part of a column has the length 1/m; at that scale the
thrust is in newtons.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from airpuck.craft.vehicle import Vehicle
from airpuck.model.parameters import Parameters, thrust_scale


def gauge_directions(
    parameters: Parameters, free: Bool[np.ndarray, " P"]
) -> dict[int, Float[np.ndarray, " P"]]:
    """Return, for each motor, the direction in θ along which predictions do not change."""
    matrix = parameters.configuration_matrix
    if matrix is None:
        return {}
    thrust, matrix = np.asarray(parameters.thrust), np.asarray(matrix)
    of_thrust = parameters.mask(frozenset({"thrust"}))
    of_matrix = parameters.mask(frozenset({"configuration_matrix"}))
    found = {}
    for motor, unit in enumerate(np.eye(len(thrust))):
        direction = np.zeros(len(free))
        direction[of_thrust] = np.ravel(unit[:, None] * thrust)
        direction[of_matrix] = np.ravel(-matrix * unit)
        # A thrust or a column that is not free fixes the scale.
        if not (direction[~free] != 0).any() and unit @ np.hypot(matrix[0], matrix[1]) > 0:
            found[motor] = direction
    return found


def fix_gauge(parameters: Parameters, vehicle: Vehicle, free: Bool[np.ndarray, " P"]) -> Parameters:
    """Scale thrusts whose scale is free to newtons; predictions do not change."""
    motors = list(gauge_directions(parameters, free))
    if not motors:
        return parameters
    scale = np.ones(vehicle.n_propellers)
    scale[motors] = thrust_scale(np, parameters, vehicle)[motors]
    return replace(
        parameters,
        thrust=np.asarray(parameters.thrust) * scale[:, None],
        configuration_matrix=np.asarray(parameters.configuration_matrix) / scale,
    )


def gauge_constraints(
    parameters: Parameters, free: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, "K P"]:
    """Return the rows of a linear constraint that keeps each ‖Π_xy,i‖, to first order."""
    motors = list(gauge_directions(parameters, free))
    rows = np.zeros((len(motors), len(free)))
    entries = np.flatnonzero(parameters.mask(frozenset({"configuration_matrix"})))
    for row, motor in zip(rows, motors, strict=True):
        column = entries.reshape(3, -1)[:2, motor]
        row[column] = np.asarray(parameters.configuration_matrix)[:2, motor]
    return rows
