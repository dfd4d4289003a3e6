"""Optional terms of the equations of motion, beyond the paper's.

An effect changes the thrusts, or adds accelerations; `airpuck.physics.rigid_body.acceleration`
applies those of `Dynamics.effects` in order. All are array operations with the batch as last axis.
A new effect is a class here, and an entry in `airpuck.model.quantities`. The class also bounds what
it does; without these bounds a plan has no lower bound on its time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.compute.arrays import linear_map
from airpuck.craft.vehicle import Vehicle

#: Acceleration of free fall [m/s²].
GRAVITY = 9.81


@dataclass(frozen=True)
class BodyMotion:
    """Velocities as the craft feels them."""

    #: Velocity of the geometric centre along the body's axes [m/s].
    forward: Any
    left: Any
    #: ω [rad/s].
    spin: Any
    #: Of the yaw.
    cos: Any
    sin: Any


@dataclass(frozen=True)
class Layout:
    """A craft as effects see it: where its propellers are, and how strong."""

    vehicle: Vehicle
    #: α, by which the propellers are turned against the measured yaw [rad].
    angle_offset: Any = 0.0
    #: Of each propeller, the factor that brings its thrust to newtons.
    scale: Any = 1.0
    #: Array namespace.
    xp: Any = np


@dataclass(frozen=True)
class Envelope:
    """The largest velocities at which bounds of an effect must hold."""

    #: Of the geometric centre, in any direction [m/s].
    speed: float
    #: |ω| [rad/s].
    spin: float


class Effect:
    """Base of all effects: changes nothing.

    A subclass that changes thrusts states `thrust_bounds`, one that adds accelerations states
    `acceleration_bound`. None there means that no bound is known.
    """

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Make the effect from its coefficients, in the order of the class's fields."""
        return cls(*value)

    @property
    def idle_lag(self) -> Any:
        """By how much the motors' lag is longer at standstill; None: the same at any speed."""
        return None

    @property
    def gravity(self) -> tuple[Any, Any] | None:
        """A constant acceleration in the world frame, which accelerometers do not feel [m/s²]."""
        return None

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Change the thrusts."""
        return thrust

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Add accelerations of the centre of mass."""
        if self.gravity is None:
            return 0.0, 0.0, 0.0
        ax, ay = self.gravity
        return motion.cos * ax + motion.sin * ay, motion.cos * ay - motion.sin * ax, 0.0

    def thrust_bounds(self, low: Any, high: Any, within: Envelope) -> tuple[Any, Any] | None:
        """Bound the changed thrusts, for any thrusts (n, K) from `low` to `high`."""
        return (low, high) if type(self).thrust is Effect.thrust else None

    def acceleration_bound(self, within: Envelope) -> tuple[float, float] | None:
        """Bound the added acceleration and angular acceleration, beyond `gravity`."""
        return (0.0, 0.0) if type(self).acceleration is Effect.acceleration else None


def _scaled(low: Any, high: Any, least: Any, most: Any) -> tuple[Any, Any]:
    """Bound thrusts times factors, of which each lies anywhere within its range."""
    corners = np.stack(np.broadcast_arrays(low * least, low * most, high * least, high * most))
    return corners.min(axis=0), corners.max(axis=0)


def _weighted(weights: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """Bound weighted sums of thrusts."""
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
        """Slow the craft down; see `Effect.acceleration`."""
        # Smooth at rest, where the derivative of |v| has no value.
        speed = xp.sqrt(motion.forward**2 + motion.left**2 + 1e-12)
        rate = self.linear + self.quadratic * speed
        spin_rate = self.spin_linear + self.spin_quadratic * xp.abs(motion.spin)
        return -rate * motion.forward, -rate * motion.left, -spin_rate * motion.spin

    def acceleration_bound(self, within: Envelope) -> tuple[float, float]:
        """Take drag at the largest velocities; see `Effect.acceleration_bound`."""
        speed = within.speed + 1e-6  # as `acceleration` smooths it
        linear = (abs(self.linear) + abs(self.quadratic) * speed) * speed
        spin_rate = abs(self.spin_linear) + abs(self.spin_quadratic) * within.spin
        return float(linear), float(spin_rate * within.spin)


@dataclass(frozen=True, eq=False)
class Inflow(Effect):
    """Thrust falls as the propeller moves into its own inflow: F (1 - c v), v along the thrust.

    The linear term of the thrust of a propeller in axial flow, C_T(J) ≈ C_T(0) - k J (e.g.
    McCormick, "Aerodynamics, Aeronautics and Flight Mechanics", 1995, chapter 6).
    """

    #: c [s/m].
    coefficient: Any
    #: How the velocities forward, left and ω add up to the speed of each propeller along its
    #: thrust: (dₓ, d_y, r × d).
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
        """Take the largest speeds along each thrust; see `Effect.thrust_bounds`."""
        forward, left, turn = np.asarray(self.axes, dtype=float).T
        axial = np.hypot(forward, left) * within.speed + np.abs(turn) * within.spin
        change = (abs(self.coefficient) * axial)[:, None]
        return _scaled(low, high, 1 - change, 1 + change)


@dataclass(frozen=True, eq=False)
class PairInteraction(Effect):
    """A propeller loses thrust when its twin blows into it: F / (1 + c F_twin)."""

    #: c [1/N].
    coefficient: Any
    #: One at the twin of each propeller, zeros elsewhere; where thrusts are not in newtons, what
    #: brings the twin's there.
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
        """Take the twins' least and most; see `Effect.thrust_bounds`."""
        ends = _weighted(self.coefficient * np.asarray(self.twins, dtype=float), low, high)
        least, most = 1 + ends[0], 1 + ends[1]
        return _scaled(low, high, 1 / most, 1 / least) if (least > 0).all() else None


@dataclass(frozen=True, eq=False)
class VoltageSag(Effect):
    """The battery's voltage falls under load, and with it every thrust.

    A battery of open-circuit voltage E and internal resistance R gives V = E - R I (the Rint model,
    e.g. He, Xiong and Fan, Energies 4, 2011). At a given command the speed of a motor goes with V
    and its thrust with the square of it; the current goes with the torque and so with the thrust.
    With I = k Σ F, c = R k / E and the thrusts F₀ at full voltage

        F = q² F₀,  q = V/E = 1 - c q² S,  S = Σ F₀,  so that  q = 2 / (1 + √(1 + 4 c S)).
    """

    #: c, the share of the voltage that is lost per thrust [1/N].
    coefficient: Any
    #: How thrusts add up to S: ones, or what brings them to newtons.
    weights: Any

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Count all propellers of the vehicle; see `Effect.of`."""
        return cls(value, np.ones(layout.vehicle.n_propellers) * layout.scale)

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Reduce thrusts; see `Effect.thrust`."""
        total = linear_map(self.weights[None], thrust)[0]
        return thrust * (2 / (1 + xp.sqrt(1 + 4 * self.coefficient * total))) ** 2

    def thrust_bounds(self, low: Any, high: Any, within: Envelope) -> tuple[Any, Any] | None:
        """Take the least and the most of all thrusts; see `Effect.thrust_bounds`."""
        ends = _weighted(self.coefficient * np.asarray(self.weights, dtype=float), low, high)
        if (1 + 4 * ends[0] < 0).any():
            return None
        most, least = ((2 / (1 + np.sqrt(1 + 4 * end))) ** 2 for end in ends)
        return _scaled(low, high, least, most)


@dataclass(frozen=True, eq=False)
class IdleLag(Effect):
    """Motors that hardly turn are slow to change their speed: τ (1 + c exp(-φ/0.1)).

    Empirical. A controller without sensors times a brushless motor by the voltage that this
    induces, which grows with the speed: near standstill it has little to go by. The motors' step
    (`airpuck.physics.motor`) takes it into account; forces are what they were.
    """

    #: c, by how much the lag is longer at standstill.
    coefficient: Any

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Take the one coefficient; see `Effect.of`."""
        return cls(value)

    @property
    def idle_lag(self) -> Any:
        """The coefficient; see `Effect.idle_lag`."""
        return self.coefficient


@dataclass(frozen=True, eq=False)
class Tilt(Effect):
    """The table is not level: a constant acceleration in the world frame."""

    #: Slope along the table's axes, positive where the table falls [rad].
    x: Any = 0.0
    y: Any = 0.0

    @property
    def gravity(self) -> tuple[Any, Any]:
        """Pull the craft down the slope; see `Effect.gravity`."""
        return GRAVITY * self.x, GRAVITY * self.y
