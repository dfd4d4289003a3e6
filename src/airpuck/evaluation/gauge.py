"""Thrust on a common scale: what can be compared between models that learn Π and ones that do not.

Where the configuration matrix is learned directly, multiplying a propeller's thrust curve by s and
dividing its column of Π by s changes nothing that can be observed. Only products count: the linear
and angular acceleration that a propeller causes. `physical_thrust` picks the scale at which a
column's force part has the length 1/m, as it has by Newton's law. Our own fits are at that scale
already (`airpuck.model.gauge`); published parameters are as published.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck.model.model_file import Model
from airpuck.model.parameters import thrust_scale as parameters_scale
from airpuck.physics.thrust import thrust


def thrust_scale(model: Model) -> Float[np.ndarray, " n"]:
    """Return the factor that brings each thrust curve to newtons."""
    return parameters_scale(np, model.parameters, model.vehicle)


def physical_thrust(model: Model) -> Float[np.ndarray, "n degree"]:
    """Return the thrust coefficients at the physical scale.

    Parameters
    ----------
    model : Model
        The model.

    Returns
    -------
    array, shape (n, degree)
        Coefficients of φ, φ², … [N].
    """
    return thrust_scale(model)[:, None] * np.asarray(model.parameters.thrust)


def largest_accelerations(
    model: Model, speed: float = 1.0
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return what each propeller alone does to the craft, linear [m/s²] and angular [rad/s²]."""
    coefficients = np.asarray(model.parameters.thrust)
    force = thrust(coefficients, np.full(len(coefficients), speed))
    matrix = np.asarray(model.dynamics.configuration)
    return np.hypot(matrix[0], matrix[1]) * force, matrix[2] * force
