"""A Kalman filter of independent axes: pure functions over an array namespace.

Each axis x, y, γ has a state (p, v, d): p' = v, v' = a(t) + d + w₁, d' = w₂.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.compute.arrays import small_product


@dataclass(frozen=True)
class Noise:
    """Noise of the three axes x, y, γ."""

    #: Standard deviation of the measured pose [m, m, rad].
    pose: tuple[float, float, float]
    #: Density of the white acceleration w₁ [m/s²/√Hz, m/s²/√Hz, rad/s²/√Hz].
    acceleration: tuple[float, float, float]
    #: Density of w₂, which drives the disturbance [m/s³/√Hz, m/s³/√Hz, rad/s³/√Hz].
    disturbance: tuple[float, float, float]


#: Standard deviation of velocity and disturbance at the first pose, in each axis.
INITIAL_VELOCITY = np.array([0.5, 0.5, 5.0])
INITIAL_DISTURBANCE = np.array([0.1, 0.1, 3.0])


def spread(
    xp: Any, covariance: Any, duration: Any, acceleration_density: Any, disturbance_density: Any
) -> Any:
    """Let the covariances (3, 3, 3) of all axes grow over a time without measurements."""
    h = duration
    step = xp.array([[1.0, h, h * h / 2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    grown = process_noise(xp, h, acceleration_density, disturbance_density)
    return small_product(xp, small_product(xp, step, covariance), step.T) + grown


def process_noise(
    xp: Any, duration: Any, acceleration_density: Any, disturbance_density: Any
) -> Any:
    """Integrate both noises, given by the squares of their densities, over a time."""
    h = duration
    by_acceleration = xp.array([[h**3 / 3, h**2 / 2, 0.0], [h**2 / 2, h, 0.0], [0.0, 0.0, 0.0]])
    by_disturbance = xp.array(
        [
            [h**5 / 20, h**4 / 8, h**3 / 6],
            [h**4 / 8, h**3 / 3, h**2 / 2],
            [h**3 / 6, h**2 / 2, h],
        ]
    )
    return (
        acceleration_density[:, None, None] * by_acceleration
        + disturbance_density[:, None, None] * by_disturbance
    )


def correct(
    mean: Any, covariance: Any, component: int, innovation: Any, variance: Any
) -> tuple[Any, Any]:
    """Use a measurement of one component of each axis; an infinite variance leaves it out."""
    column = covariance[:, :, component]
    gain = column / (column[:, component] + variance)[:, None]
    return (
        mean + gain * innovation[:, None],
        covariance - gain[:, :, None] * column[:, None, :],
    )
