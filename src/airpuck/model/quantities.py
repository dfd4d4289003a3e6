"""All learnable quantities, in one table.

Model files, labels, bounds, rungs, displayed tables and the settings of the twin's optional effects
derive from it. A new effect is a class in `airpuck.physics.effects` and an entry here, or a class
of the user's own (`quantity_of`).
"""

from __future__ import annotations

import inspect
import keyword
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError, unknown
from airpuck.boundary.files import NonNegative, Positive
from airpuck.compute.arrays import coefficients_of
from airpuck.physics.effects import (
    HIDDEN,
    Dish,
    Drag,
    Effect,
    Friction,
    IdleLag,
    Inflow,
    PairInteraction,
    Residual,
    Tilt,
    VoltageSag,
)
from airpuck.physics.hull import Hull

Pair = tuple[float, float]
Triple = tuple[float, float, float]
Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Quantity:
    """One kind of parameter."""

    #: Attribute of `airpuck.model.parameters.Parameters`.
    name: str
    #: Key in a model file; ends with the unit.
    key: str
    #: Unit and symbol; separated by commas if entries have their own.
    unit: str
    symbol: str
    #: Description in a few words.
    meaning: str
    #: Type in a model file.
    toml: Any = float
    #: Bounds that a fit must respect, of all entries or of each.
    bounds: tuple[Any, Any] = (-np.inf, np.inf)
    #: Labels of the entries; if propellers have their own, a function of the propellers' names and
    #: the degree of the thrust polynomials.
    labels: tuple[str, ...] | Callable[[tuple[str, ...], int], tuple[str, ...]] = ("",)
    #: Rungs of the paper's ladder that learn it (table:models).
    rungs: tuple[str, ...] = ()
    #: Whether it only serves to compute Π, and has no use if Π is learned directly.
    in_matrix: bool = False
    #: Whether it is always positive, so that a relative change is meaningful.
    positive: bool = False
    #: Display in tables: unit, factor from the file's unit, format.
    shown: tuple[str, float, str] | None = None
    #: Default value; …: required, None: it is not modelled.
    default: Any = ...
    #: If it is optional: its class if it is an effect beside Π, the term in a rung's name, the
    #: initial value of a fit, and keys in a twin's settings if they differ from `key`.
    effect: type[Effect] | None = None
    term: str = ""
    start: float | tuple[float, ...] = 0.0
    settings: tuple[str, ...] = ()
    #: Whether fits without it look for it: not for physics that few craft have, or many weights.
    searched: bool = True

    def entries(self, propellers: tuple[str, ...], degree: int) -> tuple[str, ...]:
        """Return the labels of the entries, in the order of the flat vector."""
        return self.labels(propellers, degree) if callable(self.labels) else self.labels

    def of_entry(self, number: int) -> tuple[str, str]:
        """Return symbol and unit of one entry, if entries have their own."""
        symbols, units = self.symbol.split(", "), self.unit.split(", ")
        return symbols[number], units[min(number, len(units) - 1)]


def _coefficients(propellers: tuple[str, ...], degree: int) -> tuple[str, ...]:
    return tuple(f"{name} φ^{power}" for name in propellers for power in range(1, degree + 1))


def _matrix_entries(propellers: tuple[str, ...], _degree: int) -> tuple[str, ...]:
    return tuple(f"{row} {name}" for row in ("x", "y", "yaw") for name in propellers)


def _weights(propellers: tuple[str, ...], _degree: int) -> tuple[str, ...]:
    inputs = "forward", "left", "spin", *propellers, "1"
    units = range(1, HIDDEN + 1)
    into = (f"{unit} {name}" for unit in units for name in inputs)
    return (*into, *(f"{row} {unit}" for row in ("x", "y", "yaw") for unit in units))


#: All quantities, in the order of the flat vector.
# fmt: off
QUANTITIES = (
    Quantity("thrust", "thrust_N", "N", "a, b, c, …",
             "coefficients of φ, φ², φ³, … of each propeller's thrust", Matrix,
             labels=_coefficients, rungs=("M0", "M1", "M2", "M3", "M4"), positive=True),
    Quantity("inertia", "inertia_kg_m2", "kg m²", "I",
             "moment of inertia about the centre of mass", Positive, bounds=(1e-7, 1e4),
             rungs=("M1", "M3"), in_matrix=True, positive=True, shown=("10⁻³ kg m²", 1e3, ".4f")),
    Quantity("motor_time_constant", "motor_time_constant_s", "s", "τ",
             "first-order lag of motor speed behind the command; 0: none is modelled", NonNegative,
             bounds=(1e-4, 1.0), rungs=("M2", "M3", "M4"), positive=True, shown=("ms", 1e3, ".2f")),
    Quantity("angle_offset", "angle_offset_rad", "rad", "α",
             "rotation of the propeller layout against the measured yaw", bounds=(-np.pi, np.pi),
             rungs=("M3",), in_matrix=True, shown=("mrad", 1e3, ".1f")),
    Quantity("center_of_mass", "center_of_mass_m", "m", "r",
             "offset of the centre of mass from the geometric centre", Pair, bounds=(-1.0, 1.0),
             labels=("x", "y"), rungs=("M3",), in_matrix=True, shown=("mm", 1e3, ".2f")),
    Quantity("configuration_matrix", "configuration_matrix_SI", "1/kg, 1/kg, 1/(kg m)", "Π",
             "directly learned map from thrusts to body accelerations", Matrix,
             labels=_matrix_entries, rungs=("M4",), default=None),
    Quantity("thrust_direction", "thrust_direction_rad", "rad", "δ",
             "rotation of all thrusts against the vehicle file's directions", bounds=(-0.5, 0.5),
             in_matrix=True, default=None, term="direction", shown=("mrad", 1e3, ".1f")),
    Quantity("drag", "drag_SI", "1/s, 1/m, 1/s, 1/rad", "c₁, c₂, d₁, d₂",
             "linear and quadratic drag of the velocity and of the spin",
             tuple[float, float, float, float], bounds=(0.0, np.inf),
             labels=("linear", "quadratic", "spin linear", "spin quadratic"),
             default=None, effect=Drag, term="drag", start=(0.0, 0.0, 0.0, 0.0),
             settings=("drag_linear_1_s", "drag_quadratic_1_m",
                       "spin_drag_linear_1_s", "spin_drag_quadratic_1_rad")),
    Quantity("inflow", "inflow_s_m", "s/m", "cᵢ",
             "loss of thrust per air speed along the propeller's axis", bounds=(-10.0, 10.0),
             default=None, effect=Inflow, term="inflow"),
    # Opposing twins lose equally, so a small interaction does not change the difference of their
    # thrusts: zero is a stationary point. A fit starts away from it, and stays above a negligible
    # bound where the derivative does not vanish.
    Quantity("pair_interaction", "pair_interaction_1_N", "1/N", "cₚ",
             "loss of thrust per thrust of the twin", bounds=(1e-2, 1e3),
             default=None, effect=PairInteraction, term="pair", start=1.0),
    Quantity("voltage_sag", "voltage_sag_1_N", "1/N", "cᵥ",
             "loss of battery voltage per total thrust", bounds=(0.0, 1e3),
             default=None, effect=VoltageSag, term="sag"),
    Quantity("tilt", "tilt_rad", "rad", "sₓ, s_y", "slope of the table", Pair, bounds=(-0.5, 0.5),
             labels=("x", "y"), default=None, effect=Tilt, term="tilt", start=(0.0, 0.0),
             shown=("mrad", 1e3, ".1f")),
    Quantity("dish", "dish_rad_m", "rad/m", "kₓ, k_y, kₓ_y", "change of the slope across the table",
             Triple, bounds=(-0.5, 0.5), labels=("x", "y", "xy"),
             default=None, effect=Dish, term="dish", start=(0.0, 0.0, 0.0)),
    Quantity("friction", "friction_SI", "m/s², rad/s²", "f, f_ω", "dry friction of the floor", Pair,
             bounds=(0.0, np.inf), labels=("linear", "spin"), default=None, effect=Friction,
             term="friction", start=(0.0, 0.0)),
    Quantity("residual", "residual", "1", "w", "weights of the neural term", tuple[float, ...],
             labels=_weights, default=None, effect=Residual, term="residual", start=(),
             searched=False),
    Quantity("idle_lag", "idle_lag", "1", "cₗ", "relative increase of the lag at standstill",
             bounds=(0.0, 100.0), default=None, effect=IdleLag, term="idle", start=1.0),
    Quantity("hull", "hull_SI", "1, 1/s, 1/s, 1/s, 1/m, 1/m, 1/rad", "μ, a₁, b₁, e₁, a₂, b₂, e₂",
             "added mass across a hull, drag along, across and of the spin",
             tuple[float, float, float, float, float, float, float], bounds=(0.0, 1e3),
             labels=("added mass", "linear along", "linear across", "linear spin",
                     "quadratic along", "quadratic across", "quadratic spin"),
             default=None, effect=Hull, term="hull", start=(0.5, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1),
             settings=("hull_added_mass", "hull_linear_along_1_s", "hull_linear_across_1_s",
                       "hull_linear_spin_1_s", "hull_quadratic_along_1_m",
                       "hull_quadratic_across_1_m", "hull_quadratic_spin_1_rad"),
             searched=False),
    # Not part of the equations of motion.
    Quantity("transport_delay", "transport_delay_s", "s", "d",
             "from a command's stamp to the motors", NonNegative, bounds=(0.0, 0.5),
             positive=True, shown=("ms", 1e3, ".2f"), default=0.0),
)
# fmt: on

#: Parameters that Π is computed from; meaningless if it is learned directly.
IN_MATRIX = frozenset(quantity.name for quantity in QUANTITIES if quantity.in_matrix)
#: Optional quantities, by name.
EFFECTS = {quantity.name: quantity for quantity in QUANTITIES if quantity.term}


def quantity_of(
    effect: type[Effect],
    term: str = "",
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> Quantity:
    """Declare the coefficients of a user's effect; see `Rung.with_effect`."""
    term = term or f"{effect.__module__}:{effect.__qualname__}"

    def refuse(problem: str) -> InputError:
        return InputError(f"the effect {term} {problem}", field="model")

    if not (inspect.isclass(effect) and issubclass(effect, Effect) and is_dataclass(effect)):
        raise refuse("must be a dataclass that inherits from airpuck.Effect")
    if effect.idle_lag is not Effect.idle_lag:
        raise refuse("changes the motors' lag, which only built-in effects can")
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", effect.__name__).lower()
    if keyword.iskeyword(name) or name in {quantity.name for quantity in QUANTITIES}:
        raise refuse("has the name of a built-in quantity, or a keyword; rename the class")
    if not (found := coefficients_of(effect)):
        raise refuse("has no coefficients: annotate a field as float, with a number as default")
    limits = dict.fromkeys(found, (-np.inf, np.inf)) | dict(effect.bounds) | dict(bounds or {})
    values = found | dict(start or {})
    for key in [*values, *limits]:
        if key not in found:
            raise refuse(f"has no such coefficient: {unknown(key, found)}")
        if not limits[key][0] <= values[key] <= limits[key][1]:
            raise refuse(f"starts with {key} = {values[key]:g}, outside its bounds")
    unit, several = effect.unit or "SI", len(found) > 1
    return Quantity(
        name,
        name,
        unit,
        ", ".join(f"{name} {label}" for label in found) if several else name,
        (inspect.getdoc(effect) or name).partition("\n")[0].rstrip("."),
        bounds=(tuple(limits[key][0] for key in found), tuple(limits[key][1] for key in found)),
        labels=tuple(found),
        default=None,
        effect=effect,
        term=term,
        start=tuple(float(values[key]) for key in found),
    )
