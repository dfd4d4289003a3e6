"""The known properties of a craft before any flight: geometry, mass, limits, nominal values.

The body frame has its origin at the geometric centre, x forward, y to the left; angles are
counter-clockwise. Any number of propellers in any planar layout is allowed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
import pydantic
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError, check_known, nearest
from airpuck.boundary.extensions import with_code
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
from airpuck.craft.actuators import Actuators, ActuatorSet, Channel, Propellers
from airpuck.craft.wheel import Wheel

#: Plausible radii of craft on a table [m].
_RADII, _USUAL_RADIUS = (0.005, 2.0), 0.1
#: Plausible ratios: farthest propeller to radius; mass to squared radius [kg/m²]; inertia to mass
#: times squared radius (a disc has ½).
_FARTHEST, _MASS, _INERTIA = 5.0, (0.03, 2000.0), (0.01, 20.0)
#: Largest plausible ratio of a propeller's thrust to the craft's weight; longest lag and delay [s].
_THRUST, _TIME = 10.0, 1.0
#: Largest plausible thrust of a propeller backwards, relative to forwards. Blades are made for one
#: way, so it is usually below 1.
_REVERSE = 2.0
#: Shortest lever arm that determines the inertia [radii of gyration]. The centre of mass is
#: uncertain by a tenth of that.
_LEVER = 0.2
#: Largest number of reaction wheels; one is usual.
_MOST_WHEELS = 4
#: Suffix of the name of the direction that a negative command drives.
_BACKWARDS = "_reverse"
#: Acceleration of free fall [m/s²].
GRAVITY = 9.81
_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
_MASSES = {"grams": 1e-3}
_INERTIAS = {"g m²": 1e-3, "kg cm²": 1e-4, "kg mm²": 1e-6, "g cm²": 1e-7, "g mm²": 1e-9}
_FORCES = {"gram-force": 1e-3 * GRAVITY}
_TIMES = {"milliseconds": 1e-3, "microseconds": 1e-6}


class Propeller(Section):
    """One propeller: its position, and the direction in which its thrust pushes the craft."""

    #: The column of a command that drives it, e.g. ``motor_a_1``.
    name: str = pydantic.Field(min_length=1)
    #: (x, y) in the body frame.
    position_m: tuple[float, float]
    #: Direction of the force on the craft, counter-clockwise from the body's x axis.
    direction_deg: float
    #: Of a reversible propeller: its nominal thrust backwards, relative to that forwards.
    reverse: Annotated[float, pydantic.Field(gt=0, le=_REVERSE)] | None = None


#: Usual tolerances of a vehicle file: callipers, the frame's symmetry, kitchen scales.
TOLERANCES = {"position_error_m": 5e-4, "direction_error_deg": 1.0, "mass_error": 0.005}
#: Identified thrusts of propellers of one make differ by up to 5 % (studies/weak_motors.md).
THRUST_SPREAD = 0.05


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
    #: Largest difference between sound motors' full thrusts, relative: more makes one weak.
    thrust_spread: Fraction = THRUST_SPREAD


class Vehicle(Section):
    """A craft: mass, propellers, pairs, command limits, nominal values (seq:model).

    In all arrays, a reversible propeller, or a wheel, counts as two propellers: one for each
    direction. The second has the name of the first with the suffix ``_reverse``. Commands have one
    column for each actuator (`columns`), in [-1, 1] if it pushes both ways.

    Attributes
    ----------
    name : str
        Free text.
    mass_kg : float
        Total mass as flown.
    position_error_m, direction_error_deg, mass_error : float
        Tolerances of the propellers' positions and directions, and of the mass (relative): standard
        errors, which the bars of identified parameters include.
    radius_m : float
        Outer radius, for rails and pictures.
    command_min, command_max : float
        Range of a motor command; at the minimum the motor still turns.
    propellers : tuple of Propeller
        Propellers, in the order of a command's columns.
    wheels : tuple of Wheel
        Reaction wheels; their columns follow the propellers' columns.
    pairs : tuple of pairs of str
        Names of propellers that are excited as a pair, one blowing at a time. They must oppose each
        other: push in opposite directions, and turn the craft in opposite directions about its
        centre.
    actuators : ActuatorKind
        Kind of the actuators; by default propellers.
    nominal : Nominal
        Starting values for identification.

    Examples
    --------
    >>> vehicle = airpuck.default_vehicle()
    >>> isinstance(vehicle, airpuck.Vehicle), len(vehicle.propellers)
    (True, 6)
    """

    SHOWN: ClassVar[str] = "name mass_kg radius_m command_min command_max motors=propeller_names"
    name: str
    mass_kg: Positive
    position_error_m: NonNegative = TOLERANCES["position_error_m"]
    direction_error_deg: NonNegative = TOLERANCES["direction_error_deg"]
    mass_error: Fraction = TOLERANCES["mass_error"]
    radius_m: Positive = 0.07
    command_min: Fraction = 0.0
    command_max: Fraction = 1.0
    pairs: tuple[tuple[str, str], ...] = ()
    propellers: tuple[Propeller, ...] = pydantic.Field(min_length=1, max_length=PROPELLERS)
    wheels: tuple[Wheel, ...] = pydantic.Field(default=(), max_length=_MOST_WHEELS)
    actuators: Actuators = Propellers()
    nominal: Nominal

    @pydantic.model_serializer(mode="wrap")
    def _without_default(self, dump: Any) -> dict[str, Any]:
        content = dump(self)
        # TOML has no null.
        content["propellers"], content["wheels"] = (
            [_without_null(one) for one in content[key]] for key in ("propellers", "wheels")
        )
        content["actuators"] = _without_null(content["actuators"])
        if not self.wheels:
            del content["wheels"]
        for name, usual in TOLERANCES.items():
            if content[name] == usual:
                del content[name]
        if self.nominal.thrust_spread == THRUST_SPREAD:
            del content["nominal"]["thrust_spread"]
        if self.actuators == Propellers():
            del content["actuators"]
        return content

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Vehicle:
        derived = self.actuators.nominal()
        for name in self.nominal.model_fields_set & derived.keys():
            del derived[name]
        # The class is frozen: assignment would fail, even here.
        nominal = self.nominal.model_copy(update=derived)
        object.__setattr__(self, "nominal", nominal)
        names = self.propeller_names
        two_way = {self.columns[k] for k in np.flatnonzero(self.actuation.two_way)}
        if twice := _repeated(names):
            raise ValueError(f"two propellers have the same name, {twice!r}")
        if self.actuators.pulsed and any(one.reverse is not None for one in self.propellers):
            raise ValueError("propellers: on/off thrusters have no reverse")
        for pair in self.pairs:
            for name in pair:
                if name not in names:
                    raise ValueError(f"pairs: unknown propeller {name!r}{nearest(name, names)}")
                if name in two_way:
                    raise ValueError(f"pairs: {name!r} pushes both ways and needs no partner")
        paired = [name for pair in self.pairs for name in pair]
        if twice := _repeated(paired):
            raise ValueError(f"pairs: {twice!r} can be in one pair only")
        if self.command_min >= self.command_max:
            raise ValueError("command_min must be below command_max")
        curves = _nominal_thrust(nominal.thrust_N, len(self.propellers))
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

    @cached_property
    def actuation(self) -> ActuatorSet:
        """How commands drive the actuators, with a channel for each direction of each actuator."""
        forwards = [
            Channel(one.name, k, 1, one.position_m, one.direction_deg)
            for k, one in enumerate(self.propellers)
        ]
        backwards = [
            replace(
                channel,
                name=f"{channel.name}{_BACKWARDS}",
                sign=-1,
                direction_deg=(channel.direction_deg + 180) % 360,
                strength=one.reverse,
            )
            for channel, one in zip(forwards, self.propellers, strict=True)
            if one.reverse is not None
        ]
        wheels = [
            Channel(one.name, k, 1, (0.0, 0.0), 0.0, one.couple, one.torque_Nm, one.time_constant_s)
            for k, one in enumerate(self.wheels, start=len(forwards))
        ]
        against = [
            replace(one, name=f"{one.name}{_BACKWARDS}", sign=-1, couple=-one.couple)
            for one in wheels
        ]
        return ActuatorSet(self.actuators, self.wheels, (*forwards, *wheels, *backwards, *against))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of a command's columns: of the propellers, then of the wheels."""
        return tuple(one.name for one in (*self.propellers, *self.wheels))

    @cached_property
    def command_range(self) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
        """Lowest and highest command of each column."""
        two_way, most = self.actuation.two_way, self.command_max
        return np.where(two_way, -most, self.command_min), np.full(len(two_way), most)

    @property
    def idle(self) -> Float[np.ndarray, " c"]:
        """The command at which every actuator pushes as little as possible."""
        return np.maximum(self.command_range[0], 0.0)

    @cached_property
    def propeller_names(self) -> tuple[str, ...]:
        """Names of the propellers; those that push both ways have two."""
        return tuple(channel.name for channel in self.actuation.channels)

    @property
    def n_propellers(self) -> int:
        """Number of propellers; those that push both ways count twice."""
        return len(self.actuation.channels)

    @cached_property
    def positions(self) -> Float[np.ndarray, "n 2"]:
        """Propeller positions in the body frame [m]."""
        return np.array([channel.position_m for channel in self.actuation.channels])

    @cached_property
    def directions(self) -> Float[np.ndarray, "n 2"]:
        """Unit vectors of thrust in the body frame; zero for wheels."""
        angles = np.deg2rad([channel.direction_deg for channel in self.actuation.channels])
        vectors = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.where(self.is_wheel[:, None], 0.0, vectors)

    @cached_property
    def couples(self) -> Float[np.ndarray, " n"]:
        """Moment of each propeller per thrust, beside the moment of its force; ±1 for wheels."""
        return np.array([channel.couple for channel in self.actuation.channels])

    @cached_property
    def is_wheel(self) -> Bool[np.ndarray, " n"]:
        """Marks the propellers that stand for a direction of a wheel."""
        return self.couples != 0

    @cached_property
    def pair_indices(self) -> tuple[tuple[int, int], ...]:
        """`pairs` as column numbers."""
        names = self.propeller_names
        return tuple((names.index(first), names.index(second)) for first, second in self.pairs)

    @cached_property
    def opposed(self) -> tuple[tuple[int, int], ...]:
        """`pair_indices`, and the two directions of each actuator that has two."""
        channels, first = self.actuation.channels, len(self.columns)
        ways = ((channel.column, k) for k, channel in enumerate(channels) if k >= first)
        return (*self.pair_indices, *ways)

    @cached_property
    def propellers_turn(self) -> bool:
        """Whether propellers have lever arms long enough for identifying the inertia."""
        (px, py), (dx, dy) = self.positions.T, self.directions.T
        arms = np.abs(px * dy - py * dx)
        return float(arms.max()) > _LEVER * math.sqrt(self.nominal.inertia_kg_m2 / self.mass_kg)

    @cached_property
    def nominal_thrust(self) -> Float[np.ndarray, "n degree"]:
        """Nominal thrust coefficients, one row for each propeller [N]; of wheels [N m]."""
        curves = _nominal_thrust(self.nominal.thrust_N, len(self.propellers))
        if self.n_propellers == len(curves):
            return curves
        channels = self.actuation.channels
        line = np.eye(1, curves.shape[1])[0]
        rows = [line if channel.is_wheel else curves[channel.column] for channel in channels]
        return np.array([c.strength for c in channels])[:, None] * rows

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the vehicle as TOML.

        Parameters
        ----------
        path : path-like
            The file to write.
        """
        write_toml(path, self.model_dump(mode="json"), header="An airpuck vehicle.")


def _without_null(content: dict[str, Any]) -> dict[str, Any]:
    """Return a table without fields that are None."""
    return {name: value for name, value in content.items() if value is not None}


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
        A TOML file; see ``docs/your_own_craft.md``. With actuators of a kind of your own:
        ``vehicle.toml+FILE.py:NAME``.

    Returns
    -------
    Vehicle
        The craft.

    Raises
    ------
    InputError
        If the file cannot be read or a field is wrong.

    Examples
    --------
    >>> airpuck.default_vehicle().save("vehicle.toml")
    >>> airpuck.read_vehicle("vehicle.toml") == airpuck.default_vehicle()
    True
    """
    return read_toml(with_code(path, "vehicle")[0], Vehicle)


def default_vehicle() -> Vehicle:
    """Return the hovercraft of the paper.

    Returns
    -------
    Vehicle
        Six propellers in three opposing pairs, 137.7 g.

    Examples
    --------
    >>> airpuck.default_vehicle().propeller_names[0]
    'motor_a_1'
    """
    return read_packaged("holohover.toml", Vehicle)


def _repeated(names: Sequence[str]) -> str:
    """Return the first name that occurs again; empty if none does."""
    return next((name for name in names if names.count(name) > 1), "")


def unnamed_columns(n: int) -> tuple[str, ...]:
    """Name the columns of a command that was logged without names, in the vehicle's order."""
    return tuple(f"value_{number}" for number in range(1, n + 1))


def match_columns(vehicle: Vehicle, columns: tuple[str, ...], *, source: str) -> list[int]:
    """Return which column of a recorded command drives each propeller, or raise InputError."""
    names = vehicle.columns
    if len(columns) != len(names):
        wheels = f" and {len(vehicle.wheels)} wheels" if vehicle.wheels else ""
        raise InputError(
            f"has {len(columns)} motors ({', '.join(columns)}), but the vehicle {vehicle.name!r} "
            f"has {len(vehicle.propellers)} propellers{wheels}; pass the craft's vehicle file "
            "(--vehicle), or a model of it",
            file=source,
        )
    if columns == unnamed_columns(len(columns)) and set(columns) != set(names):
        return list(range(len(columns)))
    problem = (
        f"drives no propeller of the vehicle {vehicle.name!r} (it has {', '.join(names)}); rename "
        "the propellers in the vehicle file, or name them in the mapping: command.propellers"
    )
    for column in columns:
        check_known(column, names, problem, file=source, field=column)
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
    if thrust > _THRUST * mass * GRAVITY:
        raise ValueError(
            f"nominal.thrust_N adds up to {thrust:g} at full speed, "
            f"{thrust / (mass * GRAVITY):.0f} times the craft's weight"
            f"{_guess(thrust, _FORCES, 0.3 * mass * GRAVITY)}"
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
