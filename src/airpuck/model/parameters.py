"""A point in parameter space, and the dynamics that follow from it.

If Π is learned directly, s times a propeller's thrust and 1/s times its column of Π give the same
motion: data determine only their product. By Newton's law the linear part of a column has the
length 1/m; at that scale the thrust is in newtons.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, make_dataclass, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import brief
from airpuck.craft.vehicle import Vehicle
from airpuck.model.quantities import EFFECTS, QUANTITIES, Quantity
from airpuck.physics.effects import Effect, Layout
from airpuck.physics.rigid_body import CenterOfMassFrame, Dynamics, configuration_matrix, turned

#: Times, and the longest that a craft could be flown with [s]; numerical derivatives at 0 step
#: below it by less than this [s].
_TIMES, _LONGEST, _BELOW = ("motor_time_constant", "transport_delay"), 10.0, 1e-3
#: The motor lag, for `Parameters.mask`.
LAG = frozenset({"motor_time_constant"})

#: A field for each quantity.
_Values: Any = make_dataclass(
    "_Values",
    [(q.name, Any) if q.default is ... else (q.name, Any, q.default) for q in QUANTITIES],
    frozen=True,
    eq=False,
)


@dataclass(frozen=True, eq=False, repr=False)
class Parameters(_Values):
    """A point θ in parameter space, with an attribute for each of its quantities.

    Effects of the user's own add quantities (`Rung.with_effect`).

    Values are numbers or arrays: real, complex or traced by JAX, in the units of the quantities'
    keys.

    Examples
    --------
    >>> isinstance(model.parameters, airpuck.Parameters)
    True
    >>> heavier = model.parameters.with_vector(1.01 * model.parameters.to_vector())
    >>> round(float(heavier.inertia / model.parameters.inertia), 2)
    1.01
    """

    #: Quantities of the user's own effects, after `QUANTITIES`.
    own: ClassVar[tuple[Quantity, ...]] = ()

    def __repr__(self) -> str:
        return brief(self, {q.key: getattr(self, q.name) for q in self.quantities})

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the values with the quantities, which a class made at run time has."""
        return _restored, (self.own, vars(self))

    @property
    def quantities(self) -> Iterator[Quantity]:
        """The kinds of parameters in this set."""
        return (q for q in (*QUANTITIES, *self.own) if getattr(self, q.name) is not None)

    @property
    def effects(self) -> frozenset[str]:
        """Names of the optional effects that this set models."""
        return frozenset(q.name for q in self.quantities if q.term)

    def to_vector(self) -> Float[np.ndarray, " P"]:
        """Return all entries as one vector, in the order of `QUANTITIES`.

        Returns
        -------
        array, shape (P,)
            The entries.
        """
        return np.concatenate([np.ravel(getattr(self, q.name)) for q in self.quantities])

    def check(self, n: int) -> None:
        """Check numbers for a craft with `n` propellers; values that JAX traces are skipped.

        Parameters
        ----------
        n : int
            Number of propellers.

        Raises
        ------
        InputError
            If a number is not finite or has an impossible sign, or an array has another shape.
        """
        rows = {
            "thrust": ((n,), f"a curve for each of {n} propellers"),
            "configuration_matrix": ((3, n), f"3 rows of {n} numbers, one for each propeller"),
        }
        for quantity in self.quantities:
            value, field = getattr(self, quantity.name), f"parameters.{quantity.name}"
            shape, needed = rows.get(quantity.name, ((), ""))
            if np.shape(value)[: len(shape)] != shape or (shape and np.ndim(value) != 2):
                raise InputError(f"must have {needed}", field=field)
            if not isinstance(value, float | int | np.ndarray) or np.result_type(value).kind != "f":
                continue
            if not np.isfinite(value).all():
                raise InputError("must be finite numbers", field=field)
            if quantity.name == "inertia" and value <= 0:
                raise InputError(f"must be above 0, not {value:g}", field=field)
            if quantity.name in _TIMES and not -_BELOW < value <= _LONGEST:
                problem = f"must be from 0 to {_LONGEST:g} s, not {value:g}"
                raise InputError(problem, field=field)

    def with_vector(self, vector: Any) -> Parameters:
        """Return the parameters whose `to_vector` is the given one.

        Parameters
        ----------
        vector : array, shape (P,)
            All entries; real, complex, boolean, or traced by JAX.

        Returns
        -------
        moved : Parameters
            A set of the same shapes.
        """
        entries, first = {}, 0
        for quantity in self.quantities:
            shape = np.shape(getattr(self, quantity.name))
            last = first + int(np.prod(shape, dtype=int))
            entries[quantity.name] = vector[first:last].reshape(shape)
            first = last
        return replace(self, **entries)

    def laid_out(self, values: Mapping[str, Any], otherwise: Any) -> np.ndarray:
        """Arrange values like `to_vector`.

        Parameters
        ----------
        values : mapping
            By name of the quantity: one value, or one for each entry.
        otherwise : Any
            The value of all other quantities.

        Returns
        -------
        array, shape (P,)
            One value for each entry.

        Raises
        ------
        ValueError
            If a quantity has another number of entries.
        """
        parts = []
        for quantity in self.quantities:
            size = np.size(getattr(self, quantity.name))
            parts.append(np.broadcast_to(np.ravel(values.get(quantity.name, otherwise)), size))
        return np.concatenate(parts)

    def labels(self, propellers: tuple[str, ...]) -> list[str]:
        """Name every entry of `to_vector`.

        Parameters
        ----------
        propellers : tuple of str
            Names of the propellers.

        Returns
        -------
        list of str
            For example ``thrust motor_a_1 φ^2``.
        """
        degree = np.shape(self.thrust)[1]
        return [
            f"{quantity.name} {entry}".rstrip()
            for quantity in self.quantities
            for entry in quantity.entries(propellers, degree)
        ]

    def bounds(self) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, " P"]]:
        """Return the bounds of every entry of `to_vector`.

        Returns
        -------
        lower, upper : array, shape (P,)
            Bounds that a fit must respect.
        """
        ends = ({q.name: np.array(q.bounds[end]) for q in self.quantities} for end in (0, 1))
        lower, upper = (self.laid_out(values, np.nan) for values in ends)
        return lower, upper

    def mask(self, free: frozenset[str]) -> Bool[np.ndarray, " P"]:
        """Mark the entries of `to_vector` that belong to the named quantities.

        Parameters
        ----------
        free : frozenset of str
            Names of quantities.

        Returns
        -------
        array of bool, shape (P,)
            True where the entry belongs to one of them.
        """
        return self.laid_out(dict.fromkeys(free, True), False)

    def dynamics(self, xp: Any, vehicle: Vehicle, frame: CenterOfMassFrame = "body") -> Dynamics:
        """Compute the coefficients of the equations of motion.

        Parameters
        ----------
        xp : module
            Array namespace.
        vehicle : Vehicle
            Geometry and mass.
        frame : {"body", "world"}
            The frame in which the offset of the centre of mass is constant.

        Returns
        -------
        Dynamics
            Coefficients for the physics.
        """
        configuration = self.configuration_matrix
        if configuration is None:
            configuration = self.matrix(xp, vehicle)
        coefficients = {q.name: getattr(self, q.name) for q in self.quantities if q.term}
        return Dynamics(
            thrust=self.thrust,
            configuration=configuration,
            center_of_mass=self.center_of_mass,
            motor_time_constant=self.motor_time_constant,
            frame=frame,
            effects=make_effects(coefficients, self.layout(xp, vehicle), self.own),
            own_lag=vehicle.actuation.own_lag,
        )

    def matrix(
        self,
        xp: Any,
        vehicle: Vehicle,
        *,
        positions: Float[np.ndarray, "n 2"] | None = None,
        directions: Float[np.ndarray, "n 2"] | None = None,
        mass: float | None = None,
    ) -> Any:
        """Compute Π from first principles.

        Parameters
        ----------
        xp : module
            Array namespace.
        vehicle : Vehicle
            Geometry and mass.
        positions, directions : array, shape (n, 2), optional
            Instead of the vehicle's [m, 1].
        mass : float, optional
            Instead of the vehicle's [kg].

        Returns
        -------
        array, shape (3, n)
            Π [1/kg, 1/kg, 1/(kg m)].
        """
        directions = vehicle.directions if directions is None else directions
        if self.thrust_direction is not None:
            directions = turned(xp, directions, self.thrust_direction)
        return configuration_matrix(
            xp,
            vehicle.positions if positions is None else positions,
            directions,
            vehicle.mass_kg if mass is None else mass,
            self.inertia,
            self.angle_offset,
            self.center_of_mass,
            vehicle.couples,
        )

    def layout(self, xp: Any, vehicle: Vehicle) -> Layout:
        """Return the inputs that optional effects are made from.

        Parameters
        ----------
        xp : module
            Array namespace.
        vehicle : Vehicle
            Geometry and mass.

        Returns
        -------
        Layout
            The vehicle's propellers, turned by the angle offset.
        """
        squared = self.inertia / vehicle.mass_kg
        return Layout(vehicle, self.angle_offset, thrust_scale(xp, self, vehicle), squared, xp)


Parameters.__doc__ = f"{Parameters.__doc__}\n    Attributes\n    ----------\n" + "".join(
    f"    {q.name}\n        {q.meaning.capitalize()} [{q.unit}].\n" for q in QUANTITIES
)


@cache
def _kind(own: tuple[Quantity, ...]) -> type[Parameters]:
    """Return the class of parameters that have quantities of the user's own, too."""
    added = [(q.name, Any, None) for q in own]
    space = {"own": own, "__module__": __name__, "__repr__": Parameters.__repr__}
    bases = (Parameters,)
    return make_dataclass("Parameters", added, bases=bases, namespace=space, frozen=True, eq=False)


def _restored(own: tuple[Quantity, ...], values: Mapping[str, Any]) -> Parameters:
    """Make parameters with quantities of the user's own."""
    return (_kind(own) if own else Parameters)(**values)


def with_own(parameters: Parameters, own: Mapping[Quantity, Any]) -> Parameters:
    """Add quantities of the user's own, with their values."""
    added = {quantity.name: np.array(value, dtype=float) for quantity, value in own.items()}
    return _restored((*parameters.own, *own), vars(parameters) | added)


def make_effects(
    coefficients: Mapping[str, Any], layout: Layout, own: Iterable[Quantity] = ()
) -> tuple[Effect, ...]:
    """Make optional effects from their coefficients by name; None: left out."""
    return tuple(
        quantity.effect.of(layout, coefficients[quantity.name])
        for quantity in (*EFFECTS.values(), *own)
        if quantity.effect is not None and coefficients.get(quantity.name) is not None
    )


def thrust_scale(xp: Any, parameters: Parameters, vehicle: Vehicle) -> Any:
    """Return the factor that converts each thrust to newtons; a wheel's columns are never learned.

    By Newton's law the linear part of a propeller's column of Π has the length 1/m. If Π is learned
    directly, s times the thrust and 1/s times the column give the same motion.
    """
    matrix = parameters.configuration_matrix
    if matrix is None:
        return np.ones(vehicle.n_propellers)
    # Not hypot, which does not support complex steps.
    squared = matrix[0] ** 2 + matrix[1] ** 2
    if vehicle.wheels:
        squared = xp.where(vehicle.is_wheel, vehicle.mass_kg**-2, squared)
    return vehicle.mass_kg * xp.sqrt(squared)


def nominal_parameters(vehicle: Vehicle, degree: int | None = None) -> Parameters:
    """Return the vehicle's nominal values as parameters."""
    return Parameters(
        thrust=change_degree(vehicle.nominal_thrust, degree),
        inertia=vehicle.nominal.inertia_kg_m2,
        motor_time_constant=vehicle.nominal.motor_time_constant_s,
        angle_offset=0.0,
        center_of_mass=np.zeros(2),
        transport_delay=vehicle.nominal.transport_delay_s,
    )


def change_degree(
    coefficients: Float[np.ndarray, "n degree"], degree: int | None
) -> Float[np.ndarray, "n new_degree"]:
    """Express thrust curves by polynomials of another degree."""
    old = coefficients.shape[1]
    if degree is None or degree == old:
        return coefficients
    if degree > old:
        return np.pad(coefficients, ((0, 0), (0, degree - old)))
    # The Gram matrix of the monomials φ, φ², … on [0, 1] is a Hilbert matrix: <φ^i, φ^j> =
    # 1/(i+j+1). Degrees are small, so its conditioning does no harm.
    power = np.arange(1, old + 1)
    gram = 1.0 / (power[:, None] + power[None, :] + 1)
    return np.linalg.solve(gram[:degree, :degree], gram[:degree] @ coefficients.T).T


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
