"""The frame of a side: a player sees its own goal at negative x, on whichever half it plays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck import PuckState
from airpuck.extend import Preview, Reference, Target, asked, preview

#: Signs of x, y, yaw and their rates under a rotation by π.
_SIGNS = np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Frame:
    """Conversion between the world's frame and a side's; the same in both directions.

    The left side uses the world's frame. The right side's frame is rotated by π about the centre
    of the table.
    """

    #: Sign of the x of the side's half, -1 or 1.
    side: int

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Convert one point."""
        return -self.side * x, -self.side * y

    def points(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Convert points."""
        return points * float(-self.side)

    def states(self, values: Float[np.ndarray, "*n k"]) -> Float[np.ndarray, "*n k"]:
        """Convert poses, or poses with their rates."""
        if self.side < 0:
            return values.copy()
        found = values * _SIGNS[: values.shape[-1]]
        found[..., 2] += math.pi
        return found

    def puck(self, puck: PuckState | None) -> PuckState | None:
        """Convert the state of a puck."""
        return puck and PuckState(*self.states(np.array(puck)).tolist())

    def box(self, corners: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "2 2"]:
        """Convert the lowest and the highest corner of a box."""
        return corners if self.side < 0 else -corners[::-1]

    def reference(self, reference: Reference) -> Reference:
        """Convert a reference."""
        return reference if self.side < 0 else TurnedReference(reference, self)


class TurnedReference:
    """A reference in the frame of a side, converted to the world's; a `Reference`."""

    def __init__(self, reference: Reference, frame: Frame) -> None:
        self._own, self._frame = reference, frame

    def at(self, now: float, ahead: float) -> Target:
        """Return the target; see `Reference.at`."""
        target = self._own.at(now, ahead)
        return Target(self._frame.states(target.state), target.acceleration * _SIGNS[:3])

    def asked(self, now: float) -> Float[np.ndarray, " 6"]:
        """Return the state requested for now; see `airpuck.control.reference.asked`."""
        return self._frame.states(asked(self._own, now))

    def over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        """Return the targets at several times; see `airpuck.control.reference.preview`."""
        own = preview(self._own, now, ahead)
        return Preview(self._frame.states(own.states), own.accelerations * _SIGNS[:3], own.arrival)
