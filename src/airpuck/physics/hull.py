"""Water around a hull: an optional term of the equations of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from airpuck.physics.effects import BodyMotion, Effect, Layout, magnitude


@dataclass(frozen=True, eq=False)
class Hull(Effect):
    """Water around a hull: added mass, and drag that differs along and across the craft.

    Fossen's model in three degrees of freedom ("Handbook of Marine Craft Hydrodynamics and Motion
    Control", 2011, chapter 6), for a hull symmetric about its length. Motion alone does not tell
    added mass along the hull from stronger thrusts, nor added inertia from inertia, nor the
    coupling of sway and yaw from the centre of mass. So the vehicle's mass includes the mass added
    along the hull, and the other two are part of the quantities that a fit learns anyway.
    """

    #: Mass added across the hull, beyond that along it, relative to the vehicle's mass.
    added: Any
    #: Linear drag along, across [1/s] and of the spin [1/s].
    linear: tuple[Any, Any, Any]
    #: Quadratic drag along, across [1/m] and of the spin [1/rad].
    quadratic: tuple[Any, Any, Any]
    #: Moment of inertia over mass [m²].
    squared_gyration: Any

    @classmethod
    def of(cls, layout: Layout, value: Any) -> Effect:
        """Take the radius of gyration from the craft; see `Effect.of`."""
        added, *drag = value
        return cls(added, tuple(drag[:3]), tuple(drag[3:]), layout.squared_gyration)

    @property
    def added_mass(self) -> tuple[Any, Any, Any]:
        """Add mass across the hull; see `Effect.added_mass`."""
        return 0.0, self.added, self.squared_gyration

    def acceleration(self, xp: Any, motion: BodyMotion) -> tuple[Any, Any, Any]:
        """Decelerate the craft; see `Effect.acceleration`."""
        rates = motion.forward, motion.left, motion.spin
        forward, left, angular = (
            -(a + b * magnitude(xp, rate)) * rate
            for a, b, rate in zip(self.linear, self.quadratic, rates, strict=True)
        )
        return forward, left, angular
