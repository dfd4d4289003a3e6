"""An effect with coefficients that a fit learns: drag that differs along and across the craft."""

from dataclasses import dataclass
from typing import ClassVar

from airpuck import Effect


@dataclass(frozen=True, eq=False)
class CrossDrag(Effect):
    """Linear drag along and across the craft."""

    along: float = 0.05
    across: float = 0.05
    unit = "1/s"
    bounds: ClassVar = {"along": (0.0, 10.0), "across": (0.0, 10.0)}

    def acceleration(self, xp, motion):
        """Decelerate the craft."""
        return -self.along * motion.forward, -self.across * motion.left, 0.0

    def acceleration_bound(self, within):
        """State the largest acceleration, so that plans keep their proven lower bound."""
        return max(self.along, self.across) * within.speed, 0.0
