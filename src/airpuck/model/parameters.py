"""Everything that can be learned, as one set for all rungs of the model ladder.

A rung (`airpuck.model.rungs`) only says which entries are free. `Quantity` states each
parameter's unit, shape and bounds once, for files, summaries and optimisers alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.craft.vehicle import Vehicle
from airpuck.physics.effects import make_effects
from airpuck.physics.rigid_body import CenterOfMassFrame, Dynamics, configuration_matrix


@dataclass(frozen=True)
class Quantity:
    """One kind of parameter."""

    #: Attribute of `Parameters`.
    name: str
    #: Key in a model file; ends with the unit.
    key: str
    #: Unit for people.
    unit: str
    #: Symbol in the documentation.
    symbol: str
    #: Bounds that a fit must respect.
    lower: float
    upper: float
    #: A few words.
    meaning: str
    #: ``(propeller names, degree) -> labels`` of the entries, in the order of the flat vector.
    entries: Callable[[tuple[str, ...], int], tuple[str, ...]]

    def of_entry(self, number: int) -> tuple[str, str]:
        """Return what one entry is called, where each has a name of its own."""
        symbols, units = self.symbol.split(", "), self.unit.split(", ")
        return symbols[number], units[min(number, len(units) - 1)]


def _scalar(_names: tuple[str, ...], _degree: int) -> tuple[str, ...]:
    return ("",)


QUANTITIES: tuple[Quantity, ...] = (
    Quantity(
        "thrust",
        "thrust_N",
        "N",
        "a, b, c, …",
        -np.inf,
        np.inf,
        "coefficients of φ, φ², φ³, … of each propeller's thrust",
        lambda names, degree: tuple(f"{n} φ^{k}" for n in names for k in range(1, degree + 1)),
    ),
    Quantity(
        "inertia",
        "inertia_kg_m2",
        "kg m²",
        "I",
        1e-7,
        np.inf,
        "moment of inertia about the centre of mass",
        _scalar,
    ),
    Quantity(
        "motor_time_constant",
        "motor_time_constant_s",
        "s",
        "τ",
        1e-4,
        1.0,
        "first-order lag of motor speed behind the command",
        _scalar,
    ),
    Quantity(
        "angle_offset",
        "angle_offset_rad",
        "rad",
        "α",
        -np.pi,
        np.pi,
        "rotation of the propeller layout against the measured yaw",
        _scalar,
    ),
    Quantity(
        "center_of_mass",
        "center_of_mass_m",
        "m",
        "r",
        -1.0,
        1.0,
        "offset of the centre of mass from the geometric centre",
        lambda _names, _degree: ("x", "y"),
    ),
    Quantity(
        "configuration_matrix",
        "configuration_matrix_SI",
        "1/kg, 1/kg, 1/(kg m)",
        "Π",
        -np.inf,
        np.inf,
        "directly learned map from thrusts to body accelerations",
        lambda names, _degree: tuple(f"{row} {n}" for row in ("x", "y", "yaw") for n in names),
    ),
    Quantity(
        "drag",
        "drag_SI",
        "1/s, 1/m, 1/s, 1/rad",
        "c₁, c₂, d₁, d₂",
        0.0,
        np.inf,
        "linear and quadratic drag of the velocity and of the spin",
        lambda _names, _degree: ("linear", "quadratic", "spin linear", "spin quadratic"),
    ),
    Quantity(
        "inflow",
        "inflow_s_m",
        "s/m",
        "cᵢ",
        -10.0,
        10.0,
        "loss of thrust per air speed along the propeller's axis",
        _scalar,
    ),
    Quantity(
        "pair_interaction",
        "pair_interaction_1_N",
        "1/N",
        "cₚ",
        # Nothing to speak of, yet with a derivative: zero is a stationary point (see EFFECTS).
        1e-2,
        1e3,
        "loss of thrust per thrust of the twin",
        _scalar,
    ),
    Quantity(
        "voltage_sag",
        "voltage_sag_1_N",
        "1/N",
        "cᵥ",
        0.0,
        1e3,
        "loss of battery voltage per total thrust",
        _scalar,
    ),
    Quantity(
        "tilt",
        "tilt_rad",
        "rad",
        "sₓ, s_y",
        -0.5,
        0.5,
        "slope of the table",
        lambda _names, _degree: ("x", "y"),
    ),
    Quantity(
        "transport_delay",
        "transport_delay_s",
        "s",
        "d",
        0.0,
        0.5,
        "from a command's stamp to the motors",
        _scalar,
    ),
)

#: Quantities of the optional effects (`airpuck.physics.effects`), with where a fit starts. Twins
#: that oppose each other lose alike: a small interaction does not change their difference, so zero
#: is a stationary point.
EFFECTS: dict[str, float | tuple[float, ...]] = {
    "drag": (0.0, 0.0, 0.0, 0.0),
    "inflow": 0.0,
    "pair_interaction": 1.0,
    "voltage_sag": 0.0,
    "tilt": (0.0, 0.0),
}


@dataclass(frozen=True, eq=False)
class Parameters:
    """A point in parameter space.

    Attributes
    ----------
    thrust : array, shape (n, degree)
        Coefficients of φ, φ², φ³, … of each propeller's thrust [N].
    inertia : float
        Moment of inertia I about the centre of mass [kg m²].
    motor_time_constant : float
        Lag τ of motor speed behind the command; 0: none is modelled [s].
    angle_offset : float
        Rotation α of the propeller layout against the measured yaw [rad].
    center_of_mass : array, shape (2,)
        Offset r of the centre of mass from the geometric centre, body frame [m].
    configuration_matrix : array, shape (3, n), or None
        Π, where it is learned directly; None where it follows from the vehicle and the parameters
        above [1/kg, 1/kg, 1/(kg m)].
    drag : array, shape (4,), or None
        c₁ [1/s], c₂ [1/m], d₁ [1/s], d₂ [1/rad] of `airpuck.physics.effects.Drag`; None, as for the
        optional effects below: not modelled.
    inflow : float or None
        Loss of thrust per air speed along the propeller's axis [s/m].
    pair_interaction : float or None
        Loss of thrust per thrust of the twin [1/N].
    voltage_sag : float or None
        Loss of battery voltage per total thrust [1/N].
    tilt : array, shape (2,), or None
        Slope of the table along its axes [rad].
    transport_delay : float
        From a command's stamp to the motors, d; no part of the equations of motion [s].
    """

    thrust: Any
    inertia: Any
    motor_time_constant: Any
    angle_offset: Any
    center_of_mass: Any
    configuration_matrix: Any = None
    drag: Any = None
    inflow: Any = None
    pair_interaction: Any = None
    voltage_sag: Any = None
    tilt: Any = None
    transport_delay: Any = 0.0

    @property
    def quantities(self) -> Iterator[Quantity]:
        """The kinds of parameter that this set has."""
        return (q for q in QUANTITIES if getattr(self, q.name) is not None)

    @property
    def effects(self) -> frozenset[str]:
        """Names of the optional effects that this set models."""
        return frozenset(name for name in EFFECTS if getattr(self, name) is not None)

    def to_vector(self) -> Float[np.ndarray, " P"]:
        """Return all entries as one vector, in the order of `QUANTITIES`.

        Returns
        -------
        array, shape (P,)
            The entries.
        """
        return np.concatenate([np.ravel(getattr(self, q.name)) for q in self.quantities])

    def with_vector(self, vector: Any) -> Parameters:
        """Return the parameters whose `to_vector` is the given one.

        Parameters
        ----------
        vector : array, shape (P,)
            All entries; real, complex, or traced by JAX.

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
        sizes = [np.size(getattr(self, q.name)) for q in self.quantities]
        lower = np.repeat([q.lower for q in self.quantities], sizes)
        upper = np.repeat([q.upper for q in self.quantities], sizes)
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
        return np.concatenate(
            [np.full(np.size(getattr(self, q.name)), q.name in free) for q in self.quantities]
        )

    def dynamics(self, xp: Any, vehicle: Vehicle, frame: CenterOfMassFrame = "body") -> Dynamics:
        """Compute the coefficients of the equations of motion.

        Parameters
        ----------
        xp : module
            Array namespace.
        vehicle : Vehicle
            Geometry and mass.
        frame : {"body", "world"}
            Where the offset of the centre of mass is constant.

        Returns
        -------
        Dynamics
            What the physics computes with.
        """
        configuration = self.configuration_matrix
        if configuration is None:
            configuration = configuration_matrix(
                xp,
                vehicle.positions,
                vehicle.directions,
                vehicle.mass_kg,
                self.inertia,
                self.angle_offset,
                self.center_of_mass,
            )
        return Dynamics(
            thrust=self.thrust,
            configuration=configuration,
            center_of_mass=self.center_of_mass,
            motor_time_constant=self.motor_time_constant,
            frame=frame,
            effects=make_effects(
                vehicle,
                **{name: getattr(self, name) for name in EFFECTS},
                angle_offset=self.angle_offset,
                scale=1.0 if self.configuration_matrix is None else thrust_scale(xp, self, vehicle),
                xp=xp,
            ),
        )


def thrust_scale(xp: Any, parameters: Parameters, vehicle: Vehicle) -> Any:
    """Return the factor that brings each thrust to newtons.

    By Newton's law a propeller's column of Π has a linear part of length 1/m. Where Π is learned
    directly, s times the thrust and 1/s times the column give the same motion, and the length can
    be any.
    """
    matrix = parameters.configuration_matrix
    if matrix is None:
        return np.ones(vehicle.n_propellers)
    # Not hypot, which complex steps cannot go through.
    return vehicle.mass_kg * xp.sqrt(matrix[0] ** 2 + matrix[1] ** 2)


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
    # 1/(i+j+1). Small degrees only, so its conditioning does no harm.
    power = np.arange(1, old + 1)
    gram = 1.0 / (power[:, None] + power[None, :] + 1)
    return np.linalg.solve(gram[:degree, :degree], gram[:degree] @ coefficients.T).T
