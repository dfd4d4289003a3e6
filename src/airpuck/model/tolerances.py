"""Errors of parameters that follow from the tolerances of a vehicle file.

A recording shows accelerations, but neither lever arms nor masses. If the file's geometry is wrong,
a fit finds the parameters whose Π is closest to the true one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.craft.vehicle import Vehicle
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters
from airpuck.model.quantities import IN_MATRIX
from airpuck.physics.rigid_body import turned

#: Weight of a yaw error [1/rad] beside one of a position [1/m], as in the published loss.
_YAW = 0.1
#: Mean and mean square of φ² at random speeds φ: thrusts relative to the full ones.
_MEAN, _SQUARE = 1 / 3, 1 / 5
#: Relative step of difference quotients.
_STEP = 1e-6


def bar(model: Model, quantity: Callable[[Model], Any]) -> Float[np.ndarray, "*shape"]:
    """Compute a standard error that includes the tolerances; see `Model.standard_error`."""
    vector, now, square = model.parameters.to_vector(), quantity(model), 0.0
    for shift in geometry_shifts(model.parameters, model.vehicle, model.free):
        parameters = model.parameters.with_vector(vector + shift)
        moved = quantity(replace(model, parameters=parameters, uncertainty=None))
        square = square + (np.asarray(moved) - now) ** 2
    return np.asarray(np.hypot(model.standard_error(quantity), np.sqrt(square)))


def geometry_shifts(
    parameters: Parameters, vehicle: Vehicle, free: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, "K P"]:
    """Return the changes of the parameters by K errors of the vehicle file, each one tolerance."""
    vector, size = parameters.to_vector(), np.shape(parameters.thrust)
    if parameters.configuration_matrix is not None:
        # Only the scale of a learned Π depends on the file, by its mass.
        return vehicle.mass_error * (vector * free * parameters.mask(frozenset({"thrust"})))[None]
    now = parameters.matrix(np, vehicle)
    # The thrust coefficients come first in the vector.
    rows = np.kron(np.eye(size[0]), np.ones(size[1]))
    steps = np.pad(rows, ((0, 0), (0, len(vector) - rows.shape[1]))) * vector * free
    slopes = [now * unit for unit in np.eye(size[0])]
    for entry in np.flatnonzero(free & parameters.mask(IN_MATRIX)):
        unit = np.eye(len(vector))[entry]
        step = _STEP * max(abs(vector[entry]), _STEP)
        moved = parameters.with_vector(vector + step * unit)
        slopes.append((moved.matrix(np, vehicle) - now) / step)
        steps = np.vstack([steps, unit])
    errors = [matrix - now for matrix in _wrong(parameters, vehicle)]
    full = np.abs(np.asarray(parameters.thrust).sum(axis=1))
    moments = np.outer(full, full) * (_MEAN**2 + (_SQUARE - _MEAN**2) * np.eye(size[0]))
    weight = np.array([1.0, 1.0, _YAW])[:, None]
    root = np.linalg.cholesky(moments + 1e-9 * full.max() ** 2 * np.eye(size[0]))
    kept = np.abs(steps).any(axis=1)
    table, aim = (
        (weight * np.array(part) @ root).reshape(len(part), -1).T
        for part in (np.array(slopes)[kept], errors)
    )
    return np.linalg.lstsq(table, aim, rcond=1e-9)[0].T @ steps[kept]


def _wrong(parameters: Parameters, vehicle: Vehicle) -> Iterator[Any]:
    """Yield Π for an error of each position and direction, and of the mass."""
    owner = np.array([channel.column for channel in vehicle.actuation.channels])
    for column in range(len(vehicle.propellers)):
        mine = (owner == column)[:, None]
        for axis in np.eye(2):
            positions = vehicle.positions + vehicle.position_error_m * mine * axis
            yield parameters.matrix(np, vehicle, positions=positions)
        angle = np.radians(vehicle.direction_error_deg)
        directions = np.where(mine, turned(np, vehicle.directions, angle), vehicle.directions)
        yield parameters.matrix(np, vehicle, directions=directions)
    yield parameters.matrix(np, vehicle, mass=vehicle.mass_kg * (1 + vehicle.mass_error))
