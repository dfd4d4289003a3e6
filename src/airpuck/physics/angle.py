"""Differences of angles and poses, modulo whole turns."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float


def wrapped(xp: Any, angle: Any) -> Any:
    """Shift angles by whole turns to between -π and π."""
    return angle - 2 * np.pi * xp.round(angle * (0.5 / np.pi))


def pose_difference(xp: Any, pose: Any, other: Any) -> Any:
    """Subtract a pose x, y, γ, or a state that begins with one, from another; wrap its yaw."""
    difference = pose - other
    turn = wrapped(xp, difference[2:3])
    return xp.concatenate([difference[:2], turn, difference[3:]])


def to_body(
    values: Float[np.ndarray, "N 3"], yaw: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "N 3"]:
    """Turn rates of x, y, γ into the body frame."""
    x, y, spin = values.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([cos * x + sin * y, cos * y - sin * x, spin], axis=1)
