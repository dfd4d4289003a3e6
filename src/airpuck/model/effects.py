"""Optional terms of the equations of motion, each a small piece that is added or left out.

An effect changes the thrusts, or adds a force or moment; `airpuck.model.rigid_body.acceleration`
applies those of `Dynamics.effects` in order. All are array operations with the batch as last axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.model.linear_map import linear_map
from airpuck.vehicle import Vehicle

#: Acceleration of free fall [m/s²].
GRAVITY = 9.81


@dataclass(frozen=True)
class BodyMotion:
    """Velocities as the craft feels them.

    Attributes
    ----------
    forward, left : array or float
        Velocity of the geometric centre along the body's axes [m/s].
    spin : array or float
        ω [rad/s].
    cos, sin : array or float
        Of the yaw.
    """

    forward: Any
    left: Any
    spin: Any
    cos: Any
    sin: Any


class Effect:
    """Base of all effects: changes nothing."""

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Change the thrusts.

        Parameters
        ----------
        xp : module
            Array namespace.
        thrust : array, shape (n, ...)
            Thrusts so far [N].
        motion : BodyMotion
            Velocities.

        Returns
        -------
        array, shape (n, ...)
            Thrusts with the effect [N].
        """
        return thrust

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Add accelerations of the centre of mass.

        Parameters
        ----------
        xp : module
            Array namespace.
        motion : BodyMotion
            Velocities.

        Returns
        -------
        forward, left, angular : array or float
            In the body frame [m/s², m/s², rad/s²].
        """
        return 0.0, 0.0, 0.0


@dataclass(frozen=True, eq=False)
class Drag(Effect):
    """Drag of air cushion and air: a = -(c₁ + c₂|v|) v, ω' = -(d₁ + d₂|ω|) ω.

    Attributes
    ----------
    linear, quadratic : float
        c₁ [1/s], c₂ [1/m].
    spin_linear, spin_quadratic : float
        d₁ [1/s], d₂ [1/rad].
    """

    linear: Any = 0.0
    quadratic: Any = 0.0
    spin_linear: Any = 0.0
    spin_quadratic: Any = 0.0

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Slow the craft down; see `Effect.acceleration`."""
        # Smooth at rest, where the derivative of |v| has no value.
        speed = xp.sqrt(motion.forward**2 + motion.left**2 + 1e-12)
        rate = self.linear + self.quadratic * speed
        spin_rate = self.spin_linear + self.spin_quadratic * xp.abs(motion.spin)
        return -rate * motion.forward, -rate * motion.left, -spin_rate * motion.spin


@dataclass(frozen=True, eq=False)
class Inflow(Effect):
    """Thrust falls as the propeller moves into its own inflow: F (1 - c v), v along the thrust.

    The linear term of the thrust of a propeller in axial flow, C_T(J) ≈ C_T(0) - k J (e.g.
    McCormick, "Aerodynamics, Aeronautics and Flight Mechanics", 1995, chapter 6).

    Attributes
    ----------
    coefficient : float
        c [s/m].
    axes : array, shape (n, 3)
        How the velocities forward, left and ω add up to the speed of each propeller along its
        thrust: (dₓ, d_y, r × d).
    """

    coefficient: Any
    axes: Any

    @classmethod
    def of(cls, vehicle: Vehicle, coefficient: Any, angle_offset: float = 0.0) -> Inflow:
        """Take the axes from a vehicle.

        Parameters
        ----------
        vehicle : Vehicle
            Positions and directions of the propellers.
        coefficient : float
            c [s/m].
        angle_offset : float, default 0
            Rotation α of the layout against the measured yaw [rad].

        Returns
        -------
        Inflow
            The effect.
        """
        (px, py), (dx, dy) = vehicle.positions.T, vehicle.directions.T
        cos, sin = np.cos(angle_offset), np.sin(angle_offset)
        turned = [cos * dx - sin * dy, sin * dx + cos * dy, px * dy - py * dx]
        return cls(coefficient, np.stack(turned, axis=1))

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Reduce thrusts; see `Effect.thrust`."""
        axial = linear_map(self.axes, xp.stack([motion.forward, motion.left, motion.spin]))
        return thrust * (1 - self.coefficient * axial)


@dataclass(frozen=True, eq=False)
class PairInteraction(Effect):
    """A propeller loses thrust when its twin blows into it: F / (1 + c F_twin).

    Attributes
    ----------
    coefficient : float
        c [1/N].
    twins : array, shape (n, n)
        One at the twin of each propeller, zeros elsewhere.
    """

    coefficient: Any
    twins: Any

    @classmethod
    def of(cls, vehicle: Vehicle, coefficient: Any) -> PairInteraction:
        """Take the twins from a vehicle.

        Parameters
        ----------
        vehicle : Vehicle
            Its pairs.
        coefficient : float
            c [1/N].

        Returns
        -------
        PairInteraction
            The effect.
        """
        twins = np.zeros((vehicle.n_propellers, vehicle.n_propellers))
        for first, second in vehicle.pair_indices:
            twins[first, second] = twins[second, first] = 1.0
        return cls(coefficient, twins)

    def thrust(self, xp: Any, thrust: Any, motion: BodyMotion) -> Any:
        """Reduce thrusts; see `Effect.thrust`."""
        return thrust / (1 + self.coefficient * linear_map(self.twins, thrust))


@dataclass(frozen=True, eq=False)
class Tilt(Effect):
    """The table is not level: a constant acceleration in the world frame.

    Attributes
    ----------
    x, y : float
        Slope along the table's axes, positive where the table falls [rad].
    """

    x: Any = 0.0
    y: Any = 0.0

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Let the craft slide; see `Effect.acceleration`."""
        ax, ay = GRAVITY * self.x, GRAVITY * self.y
        return motion.cos * ax + motion.sin * ay, motion.cos * ay - motion.sin * ax, 0.0
