"""Optional terms of the equations of motion, beyond the paper's.

An effect changes the thrusts, or adds accelerations or mass;
`airpuck.physics.rigid_body.acceleration` applies the effects of `Dynamics.effects` in order. All
are array operations with the batch as last axis. A new effect is a class here, and an entry in
`airpuck.model.quantities`; an effect of a user needs no entry (`Rung.with_effect`). The class also
bounds its contribution; without these bounds a plan has no lower bound on its time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from airpuck.compute.arrays import coefficients_of, linear_map
from airpuck.craft.vehicle import GRAVITY, Vehicle


@dataclass(frozen=True)
class BodyMotion:
    """Velocities in the body frame, on which effects depend."""

    #: Velocity of the geometric centre along the body's axes [m/s].
    forward: Any
    left: Any
    #: ω [rad/s].
    spin: Any
    #: Cosine and sine of the yaw.
    cos: Any
    sin: Any
    #: Position on the table [m]; None: unknown.
    x: Any = None
    y: Any = None
    #: Thrusts that act [N]; None: unknown. Only for effects `of_thrust`.
    thrust: Any = None


@dataclass(frozen=True)
class Layout:
    """The craft's properties that effects need: positions and strengths of its propellers."""

    vehicle: Vehicle
    #: α, the angle between the propellers and the measured yaw [rad].
    angle_offset: Any = 0.0
    #: For each propeller, the factor that converts its thrust to newtons.
    scale: Any = 1.0
    #: Moment of inertia over mass [m²].
    squared_gyration: Any = 1.0
    #: Array namespace.
    xp: Any = np


@dataclass(frozen=True)
class Envelope:
    """The largest velocities at which bounds of an effect must hold."""

    #: Speed of the geometric centre, in any direction [m/s].
    speed: float
    #: |ω| [rad/s].
    spin: float


def _unknown(*_: Any) -> None:
    """Return None: no bound is known."""


class Effect:
    """Base of all effects: changes nothing.

    Fields of a subclass that are `float` and have a default are its coefficients; a fit starts
    there. Other fields with a default are settings, which a fit leaves as they are. All
    arithmetic uses the array namespace `xp`, since fits differentiate it. A subclass that overrides
    `thrust` also implements `thrust_bounds`; a subclass that overrides `acceleration` implements
    `acceleration_bound`. If it does not, or if either returns None, no bound is known.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, eq=False)
    ... class SpinDrag(airpuck.Effect):
    ...     '''Linear drag of the spin.'''
    ...     rate: float = 0.1
    ...     unit = "1/s"
    ...     bounds = {"rate": (0.0, 10.0)}
    ...     def acceleration(self, xp, motion):
    ...         return 0.0, 0.0, -self.rate * motion.spin
    ...
    >>> airpuck.named_rung("M3").with_effect(SpinDrag).initial(model.vehicle).spin_drag
    array([0.1])
    """

    #: Units of the coefficients, separated by commas if they differ.
    unit: ClassVar[str] = ""
    #: Bounds of coefficients that a fit must respect, by name.
    bounds: ClassVar[Mapping[str, tuple[float, float]]] = {}

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Make the effect from its coefficients.

        Parameters
        ----------
        layout : Layout
            Of the craft's propellers, for an effect that depends on it.
        value : array, shape (K,)
            The coefficients, in the order of the class's fields.

        Returns
        -------
        Effect
            With these coefficients.
        """
        return cls(**dict(zip(coefficients_of(cls), value, strict=True)))

    @property
    def idle_lag(self) -> Any:
        """Relative increase of the motors' lag at standstill; None: the same lag at any speed."""
        return None

    #: Whether it depends on the position on the table; whether accelerations depend on the thrusts.
    of_place: ClassVar[bool] = False
    of_thrust: ClassVar[bool] = False

    @property
    def gravity(self) -> tuple[Any, Any] | None:
        """A constant acceleration in the world frame, which accelerometers do not sense [m/s²]."""
        return None

    @property
    def added_mass(self) -> tuple[Any, Any, Any] | None:
        """Fluid that moves with the craft, with its Coriolis and centripetal terms.

        Relative to the craft's mass: along and across the craft; and the craft's inertia over its
        mass [m²]. None: no fluid does.
        """
        return None

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Change the thrusts.

        Parameters
        ----------
        xp : module
            Array namespace, such as NumPy.
        thrust : array, shape (n, ...)
            Thrusts of the curves [N].
        motion : BodyMotion
            Motion of the craft in its own frame.

        Returns
        -------
        array, shape (n, ...)
            Thrusts that act [N].
        """
        return thrust

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Add accelerations of the centre of mass.

        Parameters
        ----------
        xp : module
            Array namespace, such as NumPy.
        motion : BodyMotion
            Motion of the craft in its own frame.

        Returns
        -------
        forward, left, angular : array
            Accelerations in the frame of the craft [m/s², m/s², rad/s²].
        """
        if self.gravity is None:
            return 0.0, 0.0, 0.0
        ax, ay = self.gravity
        return motion.cos * ax + motion.sin * ay, motion.cos * ay - motion.sin * ax, 0.0

    def thrust_bounds(self, low: Any, high: Any, within: Envelope) -> tuple[Any, Any] | None:
        """Bound the thrusts that act.

        Parameters
        ----------
        low, high : array, shape (n, K)
            Bounds of the thrusts of the curves [N].
        within : Envelope
            Bounds of the motion.

        Returns
        -------
        low, high : array, shape (n, K)
            Bounds of the changed thrusts [N]; None if none is known.
        """
        return low, high

    def acceleration_bound(self, within: Envelope) -> tuple[float, float] | None:
        """Bound the added accelerations, apart from `gravity`.

        Parameters
        ----------
        within : Envelope
            Bounds of the motion.

        Returns
        -------
        linear, angular : float
            Largest added accelerations [m/s², rad/s²]; None if none is known.
        """
        return 0.0, 0.0

    def __init_subclass__(cls, **options: Any) -> None:
        """Drop inherited bounds of what a subclass computes otherwise."""
        super().__init_subclass__(**options)
        bounds = {"thrust": "thrust_bounds", "acceleration": "acceleration_bound"}
        for changed, bound in (bounds | {"added_mass": "acceleration_bound"}).items():
            if changed in vars(cls) and bound not in vars(cls):
                setattr(cls, bound, _unknown)


def magnitude(xp: Any, value: Any) -> Any:
    """Return |x|, also for complex steps, whose derivative abs() would lose."""
    return xp.where(value.real < 0, -value, value) if np.iscomplexobj(value) else xp.abs(value)


def _scaled(low: Any, high: Any, least: Any, most: Any) -> tuple[Any, Any]:
    """Bound thrusts times factors, where each factor lies anywhere within its range."""
    corners = np.stack(np.broadcast_arrays(low * least, low * most, high * least, high * most))
    return corners.min(axis=0), corners.max(axis=0)


def weighted_range(weights: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """Return the lowest and highest weighted sums of thrusts within a range."""
    up, down = np.maximum(weights, 0.0), np.minimum(weights, 0.0)
    return up @ low + down @ high, up @ high + down @ low


@dataclass(frozen=True, eq=False)
class Drag(Effect):
    """Drag of air cushion and air: a = -(c₁ + c₂|v|) v, ω' = -(d₁ + d₂|ω|) ω."""

    #: c₁ [1/s], c₂ [1/m].
    linear: Any = 0.0
    quadratic: Any = 0.0
    #: d₁ [1/s], d₂ [1/rad].
    spin_linear: Any = 0.0
    spin_quadratic: Any = 0.0

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Decelerate the craft; see `Effect.acceleration`."""
        # Smooth at rest, where |v| is not differentiable.
        speed = xp.sqrt(motion.forward**2 + motion.left**2 + 1e-12)
        rate = self.linear + self.quadratic * speed
        spin_rate = self.spin_linear + self.spin_quadratic * magnitude(xp, motion.spin)
        return -rate * motion.forward, -rate * motion.left, -spin_rate * motion.spin

    def acceleration_bound(self, within: Envelope) -> tuple[float, float]:
        """Evaluate drag at the largest velocities; see `Effect.acceleration_bound`."""
        speed = within.speed + 1e-6  # with the same smoothing as in `acceleration`
        linear = (abs(self.linear) + abs(self.quadratic) * speed) * speed
        spin_rate = abs(self.spin_linear) + abs(self.spin_quadratic) * within.spin
        return float(linear), float(spin_rate * within.spin)


#: Speeds below which dry friction counts as smooth [m/s, rad/s].
CREEP, SPIN_CREEP = 0.005, 0.05


@dataclass(frozen=True, eq=False)
class Friction(Effect):
    """Dry friction of the floor: a = -f v/√(v² + s²), likewise for ω; s makes it smooth at rest."""

    #: f [m/s²] and its counterpart for the spin [rad/s²].
    linear: Any = 0.0
    spin: Any = 0.0

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Decelerate the craft; see `Effect.acceleration`."""
        rate = self.linear / xp.sqrt(motion.forward**2 + motion.left**2 + CREEP**2)
        spin_rate = self.spin / xp.sqrt(motion.spin**2 + SPIN_CREEP**2)
        return -rate * motion.forward, -rate * motion.left, -spin_rate * motion.spin

    def acceleration_bound(self, within: Envelope) -> tuple[float, float]:
        """Return the full friction; see `Effect.acceleration_bound`."""
        return float(self.linear), float(self.spin)


@dataclass(frozen=True, eq=False)
class Inflow(Effect):
    """Thrust falls as the propeller moves into its own inflow: F (1 - c v), v along the thrust.

    The linear term of the thrust of a propeller in axial flow, C_T(J) ≈ C_T(0) - k J (e.g.
    McCormick, "Aerodynamics, Aeronautics and Flight Mechanics", 1995, chapter 6).
    """

    #: c [s/m].
    coefficient: Any
    #: Coefficients that combine the velocities forward, left and ω into the speed of each propeller
    #: along its thrust: (dₓ, d_y, r × d).
    axes: Any

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Take the axes from the vehicle; see `Effect.of`."""
        xp, angle = layout.xp, layout.angle_offset
        (px, py), (dx, dy) = layout.vehicle.positions.T, layout.vehicle.directions.T
        cos, sin = xp.cos(angle), xp.sin(angle)
        turned = [cos * dx - sin * dy, sin * dx + cos * dy, px * dy - py * dx]
        return cls(value, xp.stack(turned, axis=1))

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Reduce thrusts; see `Effect.thrust`."""
        axial = linear_map(self.axes, xp.stack([motion.forward, motion.left, motion.spin]))
        return thrust * (1 - self.coefficient * axial)

    def thrust_bounds(self, low: Any, high: Any, within: Envelope) -> tuple[Any, Any]:
        """Use the largest speeds along each thrust; see `Effect.thrust_bounds`."""
        forward, left, turn = np.asarray(self.axes, dtype=float).T
        axial = np.hypot(forward, left) * within.speed + np.abs(turn) * within.spin
        change = (abs(self.coefficient) * axial)[:, None]
        return _scaled(low, high, 1 - change, 1 + change)


@dataclass(frozen=True, eq=False)
class PairInteraction(Effect):
    """A propeller loses thrust when its twin blows into it: F / (1 + c F_twin)."""

    #: c [1/N].
    coefficient: Any
    #: 1 at the twin of each propeller, 0 elsewhere; if thrusts are not in newtons, the factor that
    #: converts the twin's.
    twins: Any

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Take the twins from the vehicle; see `Effect.of`."""
        twins = np.zeros((layout.vehicle.n_propellers, layout.vehicle.n_propellers))
        for first, second in layout.vehicle.pair_indices:
            twins[first, second] = twins[second, first] = 1.0
        return cls(value, twins * layout.scale)

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Reduce thrusts; see `Effect.thrust`."""
        return thrust / (1 + self.coefficient * linear_map(self.twins, thrust))

    def thrust_bounds(self, low: Any, high: Any, within: Envelope) -> tuple[Any, Any] | None:
        """Use the twins' lowest and highest thrusts; see `Effect.thrust_bounds`."""
        ends = weighted_range(self.coefficient * np.asarray(self.twins, dtype=float), low, high)
        least, most = 1 + ends[0], 1 + ends[1]
        return _scaled(low, high, 1 / most, 1 / least) if (least > 0).all() else None


@dataclass(frozen=True, eq=False)
class VoltageSag(Effect):
    """The battery's voltage drops under load, and with it every thrust.

    A battery of open-circuit voltage E and internal resistance R gives V = E - R I (the Rint model,
    e.g. He, Xiong and Fan, Energies 4, 2011). At a given command the speed of a motor is
    proportional to V and its thrust to V²; the current is proportional to the torque and therefore
    to the thrust. With I = k Σ F, c = R k / E and the thrusts F₀ at full voltage

        F = q² F₀,  q = V/E = 1 - c q² S,  S = Σ F₀,  so that  q = 2 / (1 + √(1 + 4 c S)).
    """

    #: c, the fraction of the voltage lost per unit of thrust [1/N].
    coefficient: Any
    #: Weights of the thrusts in S: ones, or the factors that convert them to newtons.
    weights: Any

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Count all propellers of the vehicle, but no wheels; see `Effect.of`."""
        return cls(value, ~layout.vehicle.is_wheel * layout.scale)

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Reduce thrusts; see `Effect.thrust`."""
        total = linear_map(self.weights[None], thrust)[0]
        return thrust * (2 / (1 + xp.sqrt(1 + 4 * self.coefficient * total))) ** 2

    def thrust_bounds(self, low: Any, high: Any, within: Envelope) -> tuple[Any, Any] | None:
        """Use the lowest and the highest total thrust; see `Effect.thrust_bounds`."""
        ends = weighted_range(self.coefficient * np.asarray(self.weights, dtype=float), low, high)
        if (1 + 4 * ends[0] < 0).any():
            return None
        most, least = ((2 / (1 + np.sqrt(1 + 4 * end))) ** 2 for end in ends)
        return _scaled(low, high, least, most)


@dataclass(frozen=True, eq=False)
class IdleLag(Effect):
    """Motors near standstill change their speed slowly: τ (1 + c exp(-φ/0.1)).

    Empirical. A sensorless controller times a brushless motor by the voltage that it induces, which
    grows with the speed: near standstill this signal is weak. The motors' step
    (`airpuck.physics.thrust`) includes this effect; forces do not change.
    """

    #: c, the relative increase of the lag at standstill.
    coefficient: Any

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Take the single coefficient; see `Effect.of`."""
        return cls(value)

    @property
    def idle_lag(self) -> Any:
        """The coefficient; see `Effect.idle_lag`."""
        return self.coefficient


#: Hidden units of `Residual`; velocities and thrusts of size one at its inputs [m/s, rad/s, N]; and
#: accelerations of a weight of one at its outputs [m/s², rad/s²].
HIDDEN, _INPUTS, _OUTPUTS = 6, (0.5, 3.0, 0.3), (1.0, 1.0, 10.0)


@dataclass(frozen=True, eq=False)
class Residual(Effect):
    """What a small neural network adds to the accelerations: A tanh(B (v, ω, F, 1))."""

    #: B, shape (HIDDEN, 4 + n), and A, shape (3, HIDDEN).
    hidden: Any
    output: Any

    of_thrust = True

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Take all weights, row after row; see `Effect.of`."""
        size = HIDDEN * (4 + layout.vehicle.n_propellers)
        return cls(value[:size].reshape(HIDDEN, -1), value[size:].reshape(3, HIDDEN))

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Evaluate the network; see `Effect.acceleration`."""
        speed, spin, force = _INPUTS
        felt = motion.forward / speed, motion.left / speed, motion.spin / spin
        one = 0 * motion.spin + 1
        inputs = xp.stack(xp.broadcast_arrays(*felt, *(motion.thrust / force), one))
        outputs = linear_map(self.output, xp.tanh(linear_map(self.hidden, inputs)))
        forward, left, angular = (scale * row for scale, row in zip(_OUTPUTS, outputs, strict=True))
        return forward, left, angular

    def acceleration_bound(self, within: Envelope) -> tuple[float, float]:
        """Return the sums of the output weights, since |tanh| < 1; see `Effect`."""
        x, y, angular = np.array(_OUTPUTS) * np.abs(self.output).sum(axis=1)
        return float(np.hypot(x, y)), float(angular)


@dataclass(frozen=True, eq=False)
class Tilt(Effect):
    """The table is not level: a constant acceleration in the world frame."""

    #: Slope along the table's axes, positive where the table falls [rad].
    x: Any = 0.0
    y: Any = 0.0

    @property
    def gravity(self) -> tuple[Any, Any]:
        """Accelerate the craft down the slope; see `Effect.gravity`."""
        return GRAVITY * self.x, GRAVITY * self.y


@dataclass(frozen=True, eq=False)
class Dish(Effect):
    """The table is not flat: its slope is linear in the position.

    Filters and laws do not pass the position, so this effect is a disturbance to them.
    """

    #: Change of the slope along x with x, along y with y, and of each with the other [rad/m].
    xx: Any = 0.0
    yy: Any = 0.0
    xy: Any = 0.0

    of_place: ClassVar[bool] = True

    @property
    def gravity(self) -> tuple[Any, Any]:
        """None at the centre; see `Effect.gravity`."""
        return 0.0, 0.0

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Accelerate the craft down the slope; see `Effect.acceleration`."""
        if motion.x is None:
            return 0.0, 0.0, 0.0
        ax = GRAVITY * (self.xx * motion.x + self.xy * motion.y)
        ay = GRAVITY * (self.xy * motion.x + self.yy * motion.y)
        return motion.cos * ax + motion.sin * ay, motion.cos * ay - motion.sin * ax, 0.0
