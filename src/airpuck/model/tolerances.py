"""Errors of parameters that follow from the tolerances of a vehicle file.

A recording shows accelerations, but neither lever arms nor masses. If the file's geometry is wrong,
a fit finds the parameters whose accelerations are closest to the true ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
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
#: Root mean square of the spin in an excitation flight, divided by its rate's [s].
_TURNS = 0.1
#: Relative step of difference quotients.
_STEP = 1e-6


def bar(model: Model, quantity: Callable[[Model], Any]) -> Float[np.ndarray, "*shape"]:
    """Compute a standard error that includes the tolerances; see `Model.standard_error`."""
    now = quantity(model)
    square = sum((np.asarray(quantity(moved)) - now) ** 2 for moved in _moved(model))
    return np.asarray(np.hypot(model.standard_error(quantity), np.sqrt(square)))


@lru_cache(maxsize=4)
def _moved(model: Model) -> list[Model]:
    """Return what the model would be with each error of the vehicle file, for all quantities."""
    vector = model.parameters.to_vector()
    shifts = geometry_shifts(model.parameters, model.vehicle, model.free)
    moved = (model.parameters.with_vector(vector + shift) for shift in shifts)
    return [replace(model, parameters=parameters, uncertainty=None) for parameters in moved]


def geometry_shifts(
    parameters: Parameters, vehicle: Vehicle, free: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, "K P"]:
    """Return the changes of the parameters by K errors of the vehicle file, each one tolerance."""
    vector, size = parameters.to_vector(), np.shape(parameters.thrust)
    if parameters.configuration_matrix is not None:
        # Only the scale of a learned Π depends on the file, by its mass.
        return vehicle.mass_error * (vector * free * parameters.mask(frozenset({"thrust"})))[None]
    now = _seen(parameters, vehicle)
    # The thrust coefficients come first in the vector.
    rows = np.kron(np.eye(size[0]), np.ones(size[1]))
    steps = np.pad(rows, ((0, 0), (0, len(vector) - rows.shape[1]))) * vector * free
    slopes = [now * unit for unit in np.eye(size[0])]
    for entry in np.flatnonzero(free & parameters.mask(IN_MATRIX)):
        unit = np.eye(len(vector))[entry]
        step = _STEP * max(abs(vector[entry]), _STEP)
        slopes.append((_seen(parameters.with_vector(vector + step * unit), vehicle) - now) / step)
        steps = np.vstack([steps, unit])
    errors = [matrix - now for matrix in _wrong(parameters, vehicle)]
    full = np.abs(np.asarray(parameters.thrust).sum(axis=1))
    same = _same_actuator(vehicle)
    # Of a propeller's directions only one is in use, each half of the time.
    on = 1 / same.sum(axis=1)
    moments = np.outer(full * on, full * on) * _MEAN**2 * ~same + np.diag(full**2 * on * _SQUARE)
    weight = np.array([1.0, 1.0, _YAW])[:, None]
    root = np.linalg.cholesky(moments + 1e-9 * full.max() ** 2 * np.eye(size[0]))
    kept = np.abs(steps).any(axis=1)
    table, aim = (
        (weight * np.array(part) @ root).reshape(len(part), -1).T
        for part in (np.array(slopes)[kept], errors)
    )
    # The centripetal acceleration tells r, too: it is normal with the mean square ω² = 3 ω̄⁴.
    offset = steps[kept][:, parameters.mask(frozenset({"center_of_mass"}))].T
    spun = np.sqrt(3.0) * _TURNS**2 * (now[2] @ moments @ now[2]) * offset
    aim = np.pad(aim, ((0, len(spun)), (0, 0)))
    return np.linalg.lstsq(np.vstack([table, spun]), aim, rcond=1e-9)[0].T @ steps[kept]


def _wrong(parameters: Parameters, vehicle: Vehicle) -> Iterator[Any]:
    """Yield the map for an error of each position and direction, and of the mass."""
    for mine in _same_actuator(vehicle)[: len(vehicle.propellers), :, None]:
        for axis in np.eye(2):
            positions = vehicle.positions + vehicle.position_error_m * mine * axis
            yield _seen(parameters, vehicle, positions=positions)
        angle = np.radians(vehicle.direction_error_deg)
        directions = np.where(mine, turned(np, vehicle.directions, angle), vehicle.directions)
        yield _seen(parameters, vehicle, directions=directions)
    yield _seen(parameters, vehicle, mass=vehicle.mass_kg * (1 + vehicle.mass_error))


def _same_actuator(vehicle: Vehicle) -> Bool[np.ndarray, "n n"]:
    """Return which channels are directions of one actuator; propellers come first."""
    owner = np.array([channel.column for channel in vehicle.actuation.channels])
    return owner[:, None] == owner


def _seen(parameters: Parameters, vehicle: Vehicle, **wrong: Any) -> Any:
    """Return the map from thrusts to the accelerations of the geometric centre, which poses show.

    A recording tells the offset r of the centre of mass by these, not by the moments alone.
    """
    forward, left, angular = parameters.matrix(np, vehicle, **wrong)
    x, y = parameters.center_of_mass
    return np.stack([forward + y * angular, left - x * angular, angular])
