"""Wrong signs of the axes of a logged pose, found by the motion that commands should cause.

A pose is logged as (sx x, sy y, sγ γ). Forces f in the body frame are R(γ) f in the world. In the
log they are S R(γ) f with S = diag(sx, sy). Rotated back by the logged yaw, they are

    R(-sγ γ) S R(γ) f = S f              where sγ = det S
                      = S R(2γ) f        otherwise.

So a wrong sign of one axis, or of the yaw alone, scatters the forces. Both together mirror the
craft, and wrong signs of both axes turn it by 180°. Of four corrections (the sign of y, the sign of
yaw, both, or none) one leaves forces that the commands explain (`airpuck.faults.layout_check`). A
wrong sign of x is a wrong sign of y, turned by 180°.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from airpuck.data.trajectory import Trajectory


@dataclass(frozen=True)
class AxisSigns:
    """Signs by which logged x, y and yaw are multiplied to get the true ones."""

    x: int = 1
    y: int = 1
    yaw: int = 1

    @property
    def flipped(self) -> tuple[str, ...]:
        """Names of the axes with the wrong sign."""
        return tuple(name for name in ("x", "y", "yaw") if getattr(self, name) < 0)

    @property
    def names(self) -> tuple[str, ...]:
        """The wrong signs in words."""
        return tuple("the yaw" if name == "yaw" else f"the {name} axis" for name in self.flipped)

    def line(self, axes: Sequence[str]) -> str:
        """Return the corrected line of a mapping file; `axes` are its current ones."""
        signs = (self.x, self.y, self.yaw)
        mended = [_turned(a) if sign < 0 else a for a, sign in zip(axes, signs, strict=True)]
        return f"axes = {mended}".replace("'", '"')

    @property
    def half_turned(self) -> AxisSigns:
        """The signs if x and y are turned by 180 degrees, too."""
        return replace(self, x=-self.x, y=-self.y)

    def undone(self, trajectory: Trajectory) -> Trajectory:
        """Return the trajectory with true signs."""
        signs = np.array([self.x, self.y, self.yaw], dtype=float)
        return replace(
            trajectory,
            state=trajectory.state * np.tile(signs, 2),
            acceleration=trajectory.acceleration * signs,
        )


def _turned(axis: str) -> str:
    """Return an axis of a mapping with the opposite sign."""
    return axis.removeprefix("-") if axis.startswith("-") else f"-{axis}"
