"""Wrong signs of the axes of a logged pose, found by the motion that commands should cause.

A pose is logged as (sx x, sy y, sγ γ). Forces f in the body frame are R(γ) f in the world. In the
log they are S R(γ) f with S = diag(sx, sy). Rotated back by the logged yaw, they are

    R(-sγ γ) S R(γ) f = S f              where sγ = det S
                      = S R(2γ) f        otherwise.

So a wrong sign of one axis, or of the yaw alone, scatters the forces. Both together mirror the
craft, and wrong signs of both axes turn it by 180°. Of four corrections (the sign of y, the sign of
yaw, both, or none) one leaves forces that the commands explain. A wrong sign of x is a wrong sign
of y, turned by 180°.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float

from airpuck.data.trajectory import Trajectory

#: If the forces are turned by 180 degrees to within this angle, two more flips are assumed.
_HALF_TURN = 0.5
#: Least improvement of the sum of correlations, at most 2, by which other signs are accepted.
_MARGIN = 0.15


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


def find_axis_signs(
    trajectory: Trajectory, modelled: Float[np.ndarray, "3 N"], longest_delay: float
) -> AxisSigns:
    """Find the signs with which modelled body accelerations best explain the measured ones.

    Forces may be turned by any angle, since the rigid body may be. Their complex correlation
    therefore counts by magnitude; the correlation of moments counts by value.
    """
    scores = {}
    for y, yaw in product((1, -1), repeat=2):
        signs = AxisSigns(1, y, yaw)
        measured = body_acceleration(signs.undone(trajectory)) * trajectory.usable
        scores[signs] = max(
            _likeness(measured[:, shift:], modelled[:, : modelled.shape[1] - shift])
            for shift in range(trajectory.steps(longest_delay) + 1)
        )
    usual = scores[AxisSigns()]
    best = max(scores, key=lambda signs: scores[signs][0])
    if scores[best][0] < usual[0] + _MARGIN:
        return AxisSigns()
    if np.pi - abs(scores[best][1]) < _HALF_TURN:
        return replace(best, x=-best.x, y=-best.y)
    return best


def body_acceleration(trajectory: Trajectory) -> Float[np.ndarray, "3 N"]:
    """Return measured accelerations in the body frame."""
    ax, ay, spin_rate = trajectory.acceleration.T
    cos, sin = np.cos(trajectory.state[:, 2]), np.sin(trajectory.state[:, 2])
    return np.stack([cos * ax + sin * ay, cos * ay - sin * ax, spin_rate])


def _likeness(
    measured: Float[np.ndarray, "3 M"], modelled: Float[np.ndarray, "3 M"]
) -> tuple[float, float]:
    """Return the sum of the two correlations, and the rotation of the forces [rad]."""
    force, cause = (a[0] + 1j * a[1] for a in (measured, modelled))
    turned = _correlation(cause, force)
    return float(abs(turned) + _correlation(modelled[2], measured[2]).real), float(np.angle(turned))


def _correlation(cause: np.ndarray, effect: np.ndarray) -> complex:
    """Return the normalised inner product; zero if either vector is zero."""
    size = np.linalg.norm(cause) * np.linalg.norm(effect)
    return complex(np.vdot(cause, effect) / size) if size > 0 else 0j
