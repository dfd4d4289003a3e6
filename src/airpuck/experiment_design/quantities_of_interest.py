"""What the accuracy of a model is judged by: quantities, and the size that each matters against.

Coefficients of a thrust curve are no such quantities: they correlate by more than 0.95, and the
curve is known far better than they are. Force at half and at full speed says what a curve is worth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Uncertainty
from airpuck.physics.thrust import thrust

#: Speeds at which thrust is judged.
_SPEEDS = (0.5, 1.0)
#: Step of a finite difference, in the size of a parameter; of one near zero, in this size.
_STEP, _LEAST = 1e-6, 1e-3
#: A relative error below this is rounding: a constraint holds the quantity.
HELD = 1e-9


@dataclass(frozen=True, eq=False)
class Interest:
    """A quantity that a model is judged by."""

    #: Its name.
    label: str
    #: Of its value.
    unit: str
    #: An error of this size is one of 100 %. Infinite where the quantity has no size to be compared
    #: with: it is then told, but not judged.
    scale: float
    #: ``model -> value``.
    of: Callable[[Model], Any]


def interests(model: Model) -> tuple[Interest, ...]:
    """List what a model is judged by: whatever it has learned, in comparable units."""
    return (*_pushes(model), *_scalars(model))


class RelativeErrors:
    """Standard errors of interests for many uncertainties of one model (delta method)."""

    def __init__(self, model: Model, wanted: tuple[Interest, ...]) -> None:
        self._estimate = vector = model.parameters.to_vector()
        self._scale = scales_of(wanted)
        rows = []
        for entry, step in enumerate(_STEP * np.maximum(np.abs(vector), _LEAST)):
            ends = []
            for sign in (1, -1):
                moved = vector.copy()
                moved[entry] += sign * step
                parameters = model.parameters.with_vector(moved)
                ends.append(values_of(replace(model, parameters=parameters), wanted))
            rows.append((ends[0] - ends[1]) / (2 * step))
        self._gradient = np.array(rows)

    def of(self, uncertainty: Uncertainty | None) -> Float[np.ndarray, " K"]:
        """Compute standard errors."""
        if uncertainty is None or not np.array_equal(uncertainty.estimate, self._estimate):
            return np.full(len(self._scale), np.inf)
        errors = uncertainty.propagate(lambda v: (v - self._estimate) @ self._gradient)
        shares = np.where(np.isfinite(errors), errors / self._scale, np.inf)
        return np.where(np.isfinite(self._scale), shares, np.nan)


def relative_errors(model: Model, wanted: tuple[Interest, ...]) -> Float[np.ndarray, " K"]:
    """Compute the standard errors of interests, from the model's own uncertainty."""
    return RelativeErrors(model, wanted).of(model.uncertainty)


def values_of(model: Model, wanted: tuple[Interest, ...]) -> Float[np.ndarray, " K"]:
    """Return the values of interests."""
    return np.array([float(one.of(model)) for one in wanted])


def scales_of(wanted: tuple[Interest, ...]) -> Float[np.ndarray, " K"]:
    """Return the scales of interests."""
    return np.array([one.scale for one in wanted])


def _pushes(model: Model) -> Iterator[Interest]:
    """List what is judged of each propeller."""
    learned = model.free[model.parameters.mask(frozenset({"thrust", "configuration_matrix"}))]
    if not learned.any():
        return
    for motor, name in enumerate(model.vehicle.propeller_names):
        for speed in _SPEEDS:

            def force(m: Model, motor: int = motor, speed: float = speed) -> float:
                push = np.hypot(*m.propeller_effects[:2, motor])
                curve = np.asarray(m.parameters.thrust)[motor : motor + 1]
                return m.vehicle.mass_kg * push * thrust(curve, np.array([speed]))[0]

            full = abs(force(model, speed=1.0)) or np.inf
            yield Interest(f"F({speed:g}) {name}", "N", full, force)
    if model.parameters.configuration_matrix is None:
        return
    for motor, name in enumerate(model.vehicle.propeller_names):
        straight = np.asarray(model.dynamics.configuration)[:2, motor]

        def direction(m: Model, motor: int = motor, straight: Any = straight) -> float:
            x, y = np.asarray(m.dynamics.configuration)[:2, motor]
            return np.arctan2(straight[0] * y - straight[1] * x, straight @ (x, y))

        def turn(m: Model, motor: int = motor) -> float:
            x, y, z = np.asarray(m.dynamics.configuration)[:, motor]
            return z / np.hypot(x, y)

        yield Interest(f"direction {name}", "rad", 1.0, direction)
        yield Interest(f"turn per push {name}", "rad/m", 1 / model.radius_of_gyration, turn)


def _scalars(model: Model) -> Iterator[Interest]:
    """List everything learned that belongs to no propeller."""
    against = {"angle_offset": 1.0, "center_of_mass": model.radius_of_gyration}
    names, degree = model.vehicle.propeller_names, np.shape(model.parameters.thrust)[1]
    for quantity in model.parameters.quantities:
        if quantity.name in ("thrust", "configuration_matrix"):
            continue
        free = model.free[model.parameters.mask(frozenset({quantity.name}))]
        entries = quantity.entries(names, degree)
        for k, (entry, is_free) in enumerate(zip(entries, free, strict=True)):
            if not is_free:
                continue

            def value(m: Model, name: str = quantity.name, k: int = k) -> float:
                return np.ravel(getattr(m.parameters, name))[k]

            scale = against.get(quantity.name) or abs(float(value(model))) or np.inf
            label, unit = f"{quantity.symbol} {entry}".rstrip(), quantity.unit
            if ", " in quantity.symbol:
                label, unit = quantity.of_entry(k)
            yield Interest(label, unit, scale, value)
