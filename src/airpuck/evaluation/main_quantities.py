"""The quantities that people ask for first, named once for tables, terminal and comparisons.

If the configuration matrix Π is learned directly, s times a propeller's thrust curve and 1/s times
its column of Π give the same motion. Only their products are comparable: the linear and angular
acceleration that a propeller causes. `physical_thrust` chooses the scale at which the force part of
a column has length 1/m, as Newton's law demands. Our own fits are at that scale already
(`airpuck.model.parameters`); published parameters are left unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.model.model_file import Model
from airpuck.model.parameters import thrust_scale as parameters_scale
from airpuck.model.quantities import IN_MATRIX, QUANTITIES, Quantity
from airpuck.physics.thrust import thrust

#: Quantities shown by their effects: thrusts at a speed, not coefficients; products, not the
#: matrix.
_BY_EFFECT = frozenset({"thrust", "configuration_matrix"})
#: Quantities that are always positive, so that a relative change is meaningful.
_POSITIVE = frozenset(q.name for q in QUANTITIES if q.positive)


def thrust_scale(model: Model) -> Float[np.ndarray, " n"]:
    """Return the factor that converts each thrust curve to newtons."""
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
    """Return each propeller's effect on the craft, linear [m/s²] and angular [rad/s²]."""
    coefficients = np.asarray(model.parameters.thrust)
    force = thrust(coefficients, np.full(len(coefficients), speed))
    matrix = np.asarray(model.dynamics.configuration)
    return np.hypot(matrix[0], matrix[1]) * force, matrix[2] * force


@dataclass(frozen=True)
class MainQuantity:
    """A number that follows from a model's parameters."""

    #: Name for a table, and for a sentence.
    label: str
    words: str
    #: For people.
    unit: str
    #: The quantity of `Parameters` that it belongs to.
    parameter: str
    #: Its index in that quantity; None if it is computed from several.
    entry: int | None
    #: Format that suits it.
    form: str
    #: ``model -> number`` in `unit`.
    value: Callable[[Model], Any]
    #: Factor from SI to `unit`.
    factor: float = 1.0
    #: Index of the propeller whose thrust it is.
    motor: int | None = None

    @property
    def positive(self) -> bool:
        """Whether it is always positive."""
        return self.parameter in _POSITIVE

    def used(self, model: Model) -> bool:
        """Whether a model has it."""
        if getattr(model.parameters, self.parameter, None) is None:
            return False
        direct = model.parameters.configuration_matrix is not None
        return not (direct and self.parameter in IN_MATRIX)

    def learned(self, model: Model) -> bool:
        """Whether a model learned it."""
        free = model.free[model.parameters.mask(frozenset({self.parameter}))]
        return bool(free.any() if self.entry is None else free[self.entry])


def main_quantities(model: Model, speeds: tuple[float, ...] = (1.0,)) -> list[MainQuantity]:
    """List the quantities that people ask for first."""
    listed = []
    for quantity in model.parameters.quantities:
        if quantity.name not in _BY_EFFECT:
            listed += _entries(model, quantity)
    # A linear curve is one number.
    linear = np.shape(model.parameters.thrust)[1] == 1
    for motor, channel in enumerate(model.vehicle.actuation.channels):
        name, wheel = channel.name, channel.is_wheel
        what, unit = ("torque", "N m") if wheel else ("thrust", "N")
        for speed in speeds[-1:] if linear or wheel else speeds:

            def force(m: Model, motor: int = motor, speed: float = speed) -> Any:
                return thrust(physical_thrust(m)[motor : motor + 1], np.array([speed]))[0]

            at = "full speed" if speed == 1 else f"φ = {speed:g}"
            listed.append(
                MainQuantity(
                    f"F({speed:g}) {name}", f"{what} of {name} at {at}", unit, "thrust", None,
                    ".4g" if wheel else ".4f", force, motor=motor,
                )
            )  # fmt: skip
    return listed


def _entries(model: Model, quantity: Quantity) -> list[MainQuantity]:
    """Return the entries of one quantity."""
    symbol = quantity.symbol
    unit, factor, form = quantity.shown or (quantity.unit, 1.0, ".4g")
    degree = np.shape(model.parameters.thrust)[1]
    listed = []
    for k, entry in enumerate(quantity.entries(model.vehicle.propeller_names, degree)):

        def value(m: Model, k: int = k) -> Any:
            return factor * np.ravel(getattr(m.parameters, quantity.name))[k]

        words = f"{quantity.name.replace('_', ' ')} {entry}".strip()
        label = f"{symbol} {entry}".strip()
        if "," in symbol:  # each entry has its own name
            label, unit = quantity.of_entry(k)
        listed.append(MainQuantity(label, words, unit, quantity.name, k, form, value, factor))
    return listed
