"""The known properties of a craft before any flight: geometry, mass, limits, nominal values.

The body frame has its origin at the geometric centre, x forward, y to the left; angles are
counter-clockwise. Any number of propellers in any planar layout is allowed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import (
    Fraction,
    NonNegative,
    Positive,
    Section,
    read_packaged,
    read_toml,
    write_toml,
)
from airpuck.boundary.limits import PROPELLERS
from airpuck.craft.actuators import Actuators, Propellers

#: Plausible radii of craft on a table [m].
_RADII, _USUAL_RADIUS = (0.005, 2.0), 0.1
#: Plausible ratios: farthest propeller to radius; mass to squared radius [kg/m²]; inertia to mass
#: times squared radius (a disc has ½).
_FARTHEST, _MASS, _INERTIA = 5.0, (0.03, 2000.0), (0.01, 20.0)
#: Largest plausible ratio of a propeller's thrust to the craft's weight; longest lag and delay [s].
_THRUST, _TIME = 10.0, 1.0
_GRAVITY = 9.81
_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
_MASSES = {"grams": 1e-3}
_INERTIAS = {"g m²": 1e-3, "kg cm²": 1e-4, "kg mm²": 1e-6, "g cm²": 1e-7, "g mm²": 1e-9}
_FORCES = {"gram-force": 1e-3 * _GRAVITY}
_TIMES = {"milliseconds": 1e-3, "microseconds": 1e-6}


class Propeller(Section):
    """One propeller: its position, and the direction in which its thrust pushes the craft."""

    #: The column of a command that drives it, e.g. ``motor_a_1``.
    name: str = pydantic.Field(min_length=1)
    #: (x, y) in the body frame.
    position_m: tuple[float, float]
    #: Direction of the force on the craft, counter-clockwise from the body's x axis.
    direction_deg: float


class Nominal(Section):
    """Starting values for an identification; rough ones are enough."""

    #: Coefficients of φ, φ², φ³, … (φ in [0, 1]): one curve for all propellers, or one list for
    #: each.
    thrust_N: tuple[float, ...] | tuple[tuple[float, ...], ...]
    #: Moment of inertia about the vertical axis through the centre of mass.
    inertia_kg_m2: Positive
    #: First-order lag of motor speed behind the command.
    motor_time_constant_s: NonNegative = 0.03
    #: Delay from a command's time stamp to the motors.
    transport_delay_s: NonNegative = 0.0


class Vehicle(Section):
    """A craft: mass, propellers, pairs, command limits, nominal values (seq:model).

    Attributes
    ----------
    name : str
        Free text.
    mass_kg : float
        Total mass as flown.
    radius_m : float
        Outer radius, for rails and pictures.
    command_min, command_max : float
        Range of a motor command; at the minimum the motor still turns.
    propellers : tuple of Propeller
        Propellers, in the order of a command's columns.
    pairs : tuple of pairs of str
        Names of propellers that are excited as a pair, one blowing at a time. They must oppose each
        other: push in opposite directions, and turn the craft in opposite directions about its
        centre.
    actuators : Propellers or OnOff
        Kind of the actuators; by default propellers.
    nominal : Nominal
        Starting values for identification.
    """

    name: str
    mass_kg: Positive
    radius_m: Positive = 0.07
    command_min: Fraction = 0.0
    command_max: Fraction = 1.0
    pairs: tuple[tuple[str, str], ...] = ()
    propellers: tuple[Propeller, ...] = pydantic.Field(min_length=1, max_length=PROPELLERS)
    actuators: Actuators = Propellers()
    nominal: Nominal

    @pydantic.model_serializer(mode="wrap")
    def _without_default(self, dump: Any) -> dict[str, Any]:
        content = dump(self)
        if self.actuators == Propellers():
            del content["actuators"]
        else:  # TOML has no null
            kept = {k: v for k, v in content["actuators"].items() if v is not None}
            content["actuators"] = kept
        return content

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Vehicle:
        names = self.propeller_names
        if len(set(names)) != len(names):
            raise ValueError("two propellers have the same name")
        for pair in self.pairs:
            for name in pair:
                if name not in names:
                    raise ValueError(f"pairs: unknown propeller {name!r}")
        paired = [name for pair in self.pairs for name in pair]
        if len(set(paired)) != len(paired):
            raise ValueError("pairs: a propeller can be in one pair only")
        if self.command_min >= self.command_max:
            raise ValueError("command_min must be below command_max")
        derived = self.actuators.nominal()
        for name in self.nominal.model_fields_set & derived.keys():
            del derived[name]
        # The class is frozen: assignment would fail, even here.
        nominal = self.nominal.model_copy(update=derived)
        object.__setattr__(self, "nominal", nominal)
        curves = _nominal_thrust(nominal.thrust_N, len(names))
        self.actuators.check_thrust(curves.shape[1])
        full = float(curves.sum(axis=1).max())
        check_sizes(self.mass_kg, self.radius_m, self.positions, nominal.inertia_kg_m2)
        lag, delay = nominal.motor_time_constant_s, nominal.transport_delay_s
        check_nominal(self.mass_kg, full, lag, delay)
        return self

    def __eq__(self, other: object) -> bool:
        """Compare the fields only: pydantic would also compare cached arrays."""
        if not isinstance(other, Vehicle):
            return NotImplemented
        return all(getattr(self, n) == getattr(other, n) for n in type(self).model_fields)

    @property
    def propeller_names(self) -> tuple[str, ...]:
        """Names of the propellers, in the order of a command's columns."""
        return tuple(propeller.name for propeller in self.propellers)

    @property
    def n_propellers(self) -> int:
        """Number of propellers."""
        return len(self.propellers)

    @cached_property
    def positions(self) -> Float[np.ndarray, "n 2"]:
        """Propeller positions in the body frame [m]."""
        return np.array([propeller.position_m for propeller in self.propellers])

    @cached_property
    def directions(self) -> Float[np.ndarray, "n 2"]:
        """Unit vectors of thrust in the body frame."""
        angles = np.deg2rad([propeller.direction_deg for propeller in self.propellers])
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)

    @cached_property
    def pair_indices(self) -> tuple[tuple[int, int], ...]:
        """`pairs` as column numbers."""
        names = self.propeller_names
        return tuple((names.index(first), names.index(second)) for first, second in self.pairs)

    @cached_property
    def nominal_thrust(self) -> Float[np.ndarray, "n degree"]:
        """Nominal thrust coefficients, one row for each propeller [N]."""
        return _nominal_thrust(self.nominal.thrust_N, self.n_propellers)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the vehicle as TOML.

        Parameters
        ----------
        path : path-like
            The file to write.
        """
        write_toml(path, self.model_dump(mode="json"), header="An airpuck vehicle.")


def _nominal_thrust(
    thrust: tuple[float, ...] | tuple[tuple[float, ...], ...], n_propellers: int
) -> Float[np.ndarray, "n degree"]:
    """Return one row of coefficients for each propeller, or raise ValueError."""
    if not thrust:
        raise ValueError("nominal.thrust_N needs at least one coefficient")
    try:
        coefficients = np.array(thrust, dtype=float)
    except ValueError:
        raise ValueError(
            "nominal.thrust_N: propellers need equal numbers of coefficients"
        ) from None
    if coefficients.size == 0:
        raise ValueError("nominal.thrust_N: every propeller needs at least one coefficient")
    if coefficients.ndim == 1:
        coefficients = np.tile(coefficients, (n_propellers, 1))
    if len(coefficients) != n_propellers:
        raise ValueError(
            f"nominal.thrust_N has {len(coefficients)} curves for {n_propellers} propellers"
        )
    return coefficients


def read_vehicle(path: str | os.PathLike[str]) -> Vehicle:
    """Read a vehicle file.

    Parameters
    ----------
    path : path-like
        A TOML file; see ``docs/your_own_craft.md``.

    Returns
    -------
    Vehicle
        The craft.

    Raises
    ------
    InputError
        If the file cannot be read or a field is wrong.
    """
    return read_toml(path, Vehicle)


def default_vehicle() -> Vehicle:
    """Return the hovercraft of the paper.

    Returns
    -------
    Vehicle
        Six propellers in three opposing pairs, 137.7 g.
    """
    return read_packaged("holohover.toml", Vehicle)


def unnamed_columns(n: int) -> tuple[str, ...]:
    """Name the columns of a command that was logged without names, in the vehicle's order."""
    return tuple(f"value_{number}" for number in range(1, n + 1))


def match_columns(vehicle: Vehicle, columns: tuple[str, ...], *, source: str) -> list[int]:
    """Return which column of a recorded command drives each propeller, or raise InputError."""
    names = vehicle.propeller_names
    if len(columns) != len(names):
        raise InputError(
            f"has {len(columns)} motors ({', '.join(columns)}), but the vehicle "
            f"{vehicle.name!r} has {len(names)} propellers; give the right file or model",
            file=source,
        )
    if columns == unnamed_columns(len(columns)) and set(columns) != set(names):
        return list(range(len(columns)))
    unknown = [column for column in columns if column not in names]
    if unknown:
        raise InputError(
            f"drives no propeller of the vehicle {vehicle.name!r} "
            f"(it has {', '.join(names)}); rename the propellers in the vehicle file, or "
            "name them in the mapping: command.propellers",
            file=source,
            field=unknown[0],
        )
    return [columns.index(name) for name in names]


def check_sizes(
    mass: float, radius: float, positions: Float[np.ndarray, "n 2"], inertia: float
) -> None:
    """Raise ValueError if dimensions are inconsistent, with a guess at the wrong unit."""
    distance = np.hypot(*positions.T)
    k = int(np.argmax(distance))
    farthest = float(distance[k])
    if not _RADII[0] <= radius <= _RADII[1]:
        # Positions may be in the same wrong unit.
        usual = farthest if 0.02 <= farthest <= 0.5 else _USUAL_RADIUS
        guess = _guess(radius, _LENGTHS, usual)
        raise ValueError(f"radius_m = {radius:g} is implausible for a craft's radius{guess}")
    if farthest > _FARTHEST * radius:
        x, y = positions[k]
        guess = _guess(farthest, _LENGTHS, 0.7 * radius)
        raise ValueError(
            f"propellers.{k}.position_m = [{x:g}, {y:g}] is {farthest / radius:.3g} times as far "
            f"out as radius_m = {radius:g}{guess}"
        )
    size = max(radius, farthest)
    if not _MASS[0] <= mass / size**2 <= _MASS[1]:
        raise ValueError(
            f"mass_kg = {mass:g} is implausible for a craft with a radius of {size:g} m"
            f"{_guess(mass, _MASSES, 20 * size**2)}"
        )
    if not _INERTIA[0] <= inertia / (mass * size**2) <= _INERTIA[1]:
        disc = 0.5 * mass * radius**2
        raise ValueError(
            f"nominal.inertia_kg_m2 = {inertia:g} is far from the inertia of a disc of this mass "
            f"and radius, {disc:.2g}{_guess(inertia, _INERTIAS, disc)}"
        )


def check_nominal(mass: float, thrust: float, lag: float, delay: float) -> None:
    """Raise ValueError if full thrust, lag or delay are implausible."""
    if thrust > _THRUST * mass * _GRAVITY:
        raise ValueError(
            f"nominal.thrust_N adds up to {thrust:g} at full speed, "
            f"{thrust / (mass * _GRAVITY):.0f} times the craft's weight"
            f"{_guess(thrust, _FORCES, 0.3 * mass * _GRAVITY)}"
        )
    for name, time, usual in (
        ("motor_time_constant_s", lag, 0.03),
        ("transport_delay_s", delay, 0.02),
    ):
        if time > _TIME:
            guess = _guess(time, _TIMES, usual)
            raise ValueError(f"nominal.{name} = {time:g} is too long to fly with{guess}")


def _guess(value: float, units: Mapping[str, float], usual: float) -> str:
    """Suggest the unit in which a value would be closest to typical values, if one comes close."""
    apart = {name: abs(math.log(value * size / usual)) for name, size in units.items()}
    nearest = min(apart, key=lambda name: apart[name])
    return f": {nearest}?" if apart[nearest] < math.log(10) else ": in another unit?"
