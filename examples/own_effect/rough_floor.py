"""An effect of your own: rough floor slows the craft down. See docs/architecture.md."""

from dataclasses import dataclass

from airpuck import Effect


@dataclass(frozen=True, eq=False)
class RoughFloor(Effect):
    """Dry friction, smooth at rest: a = -f v / sqrt(v² + s²)."""

    friction_m_s2: float = 0.3
    slow_m_s: float = 0.01

    def acceleration(self, xp, motion):
        """Slow the craft down, whatever the array namespace."""
        speed = xp.sqrt(motion.forward**2 + motion.left**2 + self.slow_m_s**2)
        share = -self.friction_m_s2 / speed
        return share * motion.forward, share * motion.left, 0.0

    def acceleration_bound(self, within):
        """State the largest acceleration, so that plans keep their proven lower bound."""
        return self.friction_m_s2, 0.0
