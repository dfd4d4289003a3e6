"""A model for presentation: what people ask for first, then its structure and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Result, html_table
from airpuck.model.model_file import Model
from airpuck.model.parameters import thrust_scale as parameters_scale
from airpuck.model.quantities import IN_MATRIX, QUANTITIES, Quantity
from airpuck.model.rungs import RUNGS
from airpuck.model.tolerances import bar
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


def propeller_accelerations(
    model: Model,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return each propeller's effect at full speed, linear [m/s²] and angular [rad/s²]."""
    full = np.asarray(model.parameters.thrust).sum(axis=1)
    forward, left, angular = np.asarray(model.dynamics.configuration) * full
    return np.hypot(forward, left), angular


@dataclass(frozen=True)
class MainQuantity:
    """A number that follows from a model's parameters."""

    #: Name for a table.
    label: str
    #: Name for a sentence.
    words: str
    #: Unit of its values, errors and differences.
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


def main_quantities(
    model: Model, speeds: tuple[float, ...] = (1.0,), *, in_si: bool = False
) -> list[MainQuantity]:
    """List the quantities that people ask for first, in units for people or in the file's."""
    listed = []
    for quantity in model.parameters.quantities:
        if quantity.name not in _BY_EFFECT:
            listed += _entries(model, replace(quantity, shown=None) if in_si else quantity)
    # A linear curve is one number.
    linear = np.shape(model.parameters.thrust)[1] == 1
    for motor, channel in enumerate(model.vehicle.actuation.channels):
        name, wheel = channel.name, channel.is_wheel
        what, unit = ("torque", "N m") if wheel else ("thrust", "N")
        for speed in speeds[-1:] if linear or wheel else speeds:
            at = "full speed" if speed == 1 else f"φ = {speed:g}"
            listed.append(
                MainQuantity(
                    f"F({speed:g}) {name}", f"{what} of {name} at {at}", unit, "thrust", None,
                    ".4g" if wheel else ".4f", partial(_force, motor, speed), motor=motor,
                )
            )  # fmt: skip
    return listed


def _force(motor: int, speed: float, model: Model) -> Any:
    return thrust(physical_thrust(model)[motor : motor + 1], np.array([speed]))[0]


def _entry(name: str, k: int, factor: float, model: Model) -> Any:
    return factor * np.ravel(getattr(model.parameters, name))[k]


def _entries(model: Model, quantity: Quantity) -> list[MainQuantity]:
    """Return the entries of one quantity."""
    symbol = quantity.symbol
    unit, factor, form = quantity.shown or (quantity.unit, 1.0, ".4g")
    degree = np.shape(model.parameters.thrust)[1]
    listed = []
    for k, entry in enumerate(quantity.entries(model.vehicle.propeller_names, degree)):
        words = f"{quantity.name.replace('_', ' ')} {entry}".strip()
        label = f"{symbol} {entry}".strip()
        if "," in symbol:  # each entry has its own name
            label, of_file = quantity.of_entry(k)
            unit = unit if quantity.shown else of_file
        name, value = quantity.name, partial(_entry, quantity.name, k, factor)
        listed.append(MainQuantity(label, words, unit, name, k, form, value, factor))
    return listed


#: Placeholder for a value that the data do not determine.
NOT_IDENTIFIED = "not identified by these flights"
#: Directions of acceleration: row of Π, sign.
WAYS = (
    ("forward", 0, 1, "m/s²"),
    ("backward", 0, -1, "m/s²"),
    ("left", 1, 1, "m/s²"),
    ("right", 1, -1, "m/s²"),
    ("counter-clockwise", 2, 1, "rad/s²"),
    ("clockwise", 2, -1, "rad/s²"),
)


@dataclass(frozen=True)
class Value(Result):
    """A number with its error."""

    JSON = "label unit value learned identified standard_error=error interval_95=interval"

    #: Name of the quantity.
    label: str
    unit: str
    #: Value in `unit`; the error is nan if there is none.
    value: float
    standard_error: float
    #: Half the 95 % interval, in standard errors.
    quantile: float
    #: Whether it was learned, or follows from learned parameters.
    learned: bool

    @property
    def known(self) -> bool:
        """Whether there is a standard error."""
        return bool(np.isfinite(self.standard_error) and self.standard_error > 0)

    @property
    def identified(self) -> bool:
        """Whether the data determine it; held by a constraint, it has the standard error 0."""
        return self.learned and bool(np.isfinite(self.standard_error))

    @property
    def error(self) -> float | None:
        """The standard error; None if there is none."""
        return self.standard_error if self.known else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Ends of the 95 % interval; None without a standard error."""
        if not self.known:
            return None
        reach = self.quantile * self.standard_error
        return self.value - reach, self.value + reach


@dataclass(frozen=True)
class Presentation(Result):
    """A model in words and numbers.

    Attributes
    ----------
    name : str
        The rung.
    structure : tuple of str
        Its equations, and which terms are free.
    parameters, derived : tuple of Value
        Main quantities, and quantities derived from them.
    conditions : tuple of (str, str)
        Method and data of the fit.
    notes : tuple of str
        Undetermined parameters, and other warnings.

    Examples
    --------
    >>> shown = airpuck.present(model)
    >>> isinstance(shown, airpuck.Presentation), shown.parameters[0].label
    (True, 'I')
    """

    JSON = "model=name structure parameters derived notes"

    name: str
    structure: tuple[str, ...]
    parameters: tuple[Value, ...]
    derived: tuple[Value, ...]
    conditions: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Presentation({self.name}, {len(self.parameters)} quantities)"

    def _repr_html_(self) -> str:
        values = [*self.parameters, *self.derived]
        rows = ((v.label, v.value, v.standard_error, v.unit) for v in values)
        return html_table("; ".join(self.structure[:1]), ("", "value", "± error", "unit"), rows)

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``conditions`` of the identification, by name.

        Returns
        -------
        dict
            ``model, structure, parameters, derived, notes, conditions``.
        """
        return super().to_json() | {"conditions": dict(self.conditions)}


def present(model: Model) -> Presentation:
    """Present a model.

    Parameters
    ----------
    model : Model
        Any model.

    Returns
    -------
    Presentation
        Structure, parameters ± standard errors with 95 % intervals, derived quantities, conditions
        of the fit, notes.

    Examples
    --------
    >>> airpuck.present(model).parameters[0].label
    'I'
    """
    quantities = [q for q in main_quantities(model, speeds=(0.5, 1.0)) if q.used(model)]
    return Presentation(
        name=model.name,
        structure=tuple(_structure(model)),
        parameters=tuple(value_of(model, quantity) for quantity in quantities),
        derived=tuple(_derived(model)),
        conditions=tuple(_conditions(model)),
        notes=tuple(_notes(model)),
    )


def value_of(model: Model, quantity: MainQuantity) -> Value:
    """Evaluate a quantity and its error."""
    label, unit, value = quantity.label, quantity.unit, quantity.value
    return _value(model, label, unit, value, learned=quantity.learned(model))


def _value(
    model: Model, label: str, unit: str, quantity: Callable[[Model], Any], *, learned: bool
) -> Value:
    """Evaluate anything computed from the parameters."""
    error = float(bar(model, quantity)) if learned else np.nan
    quantile = model.known.quantile if model.known else np.nan
    return Value(label, unit, float(quantity(model)), error, quantile, learned)


def at_bounds(model: Model) -> list[str]:
    """Return the labels of learned parameters that are at a bound."""
    vector, (lower, upper) = model.parameters.to_vector(), model.parameters.bounds()
    held = model.free & ((vector <= lower) | (vector >= upper))
    return list(compress(model.parameters.labels(model.vehicle.propeller_names), held))


def delay_words(model: Model) -> str:
    """Write the transport delay and its jitter, with their errors."""
    error = float(model.standard_error(lambda m: m.transport_delay))
    known = f" ± {1e3 * error:.2f}" if np.isfinite(error) else ""
    delay = f"{1e3 * model.transport_delay:.2f}{known} ms"
    jitter = model.delay_jitter
    if jitter is None:
        return delay
    return (
        f"{delay}, jitter {1e3 * jitter.standard_deviation_s:.1f} ± "
        f"{1e3 * jitter.standard_error_s:.1f} ms over {jitter.packets} packets"
    )


def largest_acceleration(model: Model) -> Float[np.ndarray, " 6"]:
    """Compute the largest acceleration of a craft at rest in each direction, with all motors."""
    vehicle, matrix = model.vehicle, np.asarray(model.dynamics.configuration)
    coefficients = np.asarray(model.parameters.thrust)
    ends = np.array([[vehicle.command_min], [vehicle.command_max]]) * np.ones(len(coefficients))
    forces = np.array([thrust(coefficients, command) for command in ends])
    return np.array([(sign * matrix[row] * forces).max(axis=0).sum() for _, row, sign, _ in WAYS])


def _derived(model: Model) -> list[Value]:
    """Return quantities derived from the parameters."""
    values = []
    for k, (way, _, _, unit) in enumerate(WAYS):

        def push(m: Model, k: int = k) -> float:
            return largest_acceleration(m)[k]

        label = f"largest acceleration {way}"
        values.append(_value(model, label, unit, push, learned=bool(model.free.any())))
    if float(model.parameters.motor_time_constant) > 0:

        def bandwidth(m: Model) -> float:
            return 1 / (2 * np.pi * m.parameters.motor_time_constant)

        learned = "motor_time_constant" in model.learned
        label = "bandwidth of the motors 1/(2πτ)"
        values.append(_value(model, label, "Hz", bandwidth, learned=learned))
    return values


def _structure(model: Model) -> list[str]:
    """Describe the equations."""
    rung, parameters = RUNGS.get(model.name), model.parameters
    lines = [] if rung is None else [f"{model.name}: {rung.summary}"]
    degree = np.shape(parameters.thrust)[1]
    lines.append(f"thrust F(φ) = Σ cₖ φᵏ, k = 1 … {degree}, of each propeller")
    lag = float(parameters.motor_time_constant) > 0
    lines.append("motors τ φ' = u − φ" if lag else "motors follow at once, φ = u")
    direct = parameters.configuration_matrix is not None
    lines.append(
        "forces to accelerations by a matrix Π that was learned directly"
        if direct
        else "forces to accelerations by Newton's law from mass, I, α and r"
    )
    lines.append(f"offset of the centre of mass constant in the frame of the {model.frame}")
    for quantity in parameters.quantities:
        free = model.free[parameters.mask(frozenset({quantity.name}))]
        state = "free" if free.all() else "partly free" if free.any() else "fixed"
        lines.append(f"{state}: {quantity.meaning} ({quantity.symbol})")
    return lines


def _conditions(model: Model) -> list[tuple[str, str]]:
    """List method and data of a fit."""
    rows = [("source", model.source)] if model.source else []
    rows.append(("transport delay", delay_words(model)))
    rows += [(key.replace("_", " "), _text(value)) for key, value in model.fit.items()]
    rows += [(f"data {name}", digest) for name, digest in model.data.items()]
    if model.known is not None:
        rows.append(("blocks of time behind the errors", str(model.known.clusters)))
    return rows


def _text(value: Any) -> str:
    """Write a value of the fit's table."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):  # faults that were left out
        spans, share = value.get("spans", ()), value.get("share_of_windows", 0.0)
        return f"{100 * share:.1f} % of the windows, for {len(spans)} spans with faults"
    return ", ".join(map(_text, value)) if isinstance(value, (list, tuple)) else str(value)


def _notes(model: Model) -> list[str]:
    """List caveats of a model."""
    if model.uncertainty is None:
        return ["no standard errors: the model was not identified here, or by an older version"]
    if model.known is None:
        return ["no standard errors: the parameters were changed after the fit"]
    unfinished = model.fit.get("converged") is False
    return [*model.known.notes, *(["the fit had not converged"] if unfinished else [])]
