"""The equations of the filter: pure functions over an array namespace.

Three axes x, y, γ, each with a state (p, v, d): p' = v, v' = a(t) + d + w₁, d' = w₂.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics, acceleration


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


def propagate(
    xp: Any, dynamics: Dynamics, mean: Any, motor_speed: Any, durations: Any, commands: Any
) -> tuple[Any, Any]:
    """Move mean and motor speeds through pieces of time with one command each.

    In each piece the acceleration is that of its middle, so that the error is of second order.
    """
    tau = dynamics.motor_time_constant
    for k in range(len(durations)):
        h, command = durations[k], commands[k]
        middle = motor_step(xp, motor_speed, command, h / 2, tau)
        motion = mean[2, 0] + h / 2 * mean[2, 1], mean[0, 1], mean[1, 1], mean[2, 1]
        rate = xp.stack(acceleration(xp, dynamics, motion, middle)) + mean[:, 2]
        p, v, d = mean[:, 0], mean[:, 1], mean[:, 2]
        mean = xp.stack([p + h * v + h * h / 2 * rate, v + h * rate, d], axis=1)
        motor_speed = motor_step(xp, motor_speed, command, h, tau)
    return mean, motor_speed


def spread(
    xp: Any, covariance: Any, duration: Any, acceleration_density: Any, disturbance_density: Any
) -> Any:
    """Let the covariance grow over a time without measurements."""
    h = duration
    step = xp.array([[1.0, h, h * h / 2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    grown = process_noise(xp, h, acceleration_density, disturbance_density)
    return _product(xp, _product(xp, step, covariance), step.T) + grown


def process_noise(
    xp: Any, duration: Any, acceleration_density: Any, disturbance_density: Any
) -> Any:
    """Integrate both noises over a time."""
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


def _product(xp: Any, left: Any, right: Any) -> Any:
    """Multiply stacks of small matrices, without the call to a library that `@` would be."""
    return xp.sum(left[..., :, :, None] * right[..., None, :, :], axis=-2)


def correct(
    mean: Any, covariance: Any, component: int, innovation: Any, variance: Any
) -> tuple[Any, Any]:
    """Use a measurement of one component of every axis."""
    column = covariance[:, :, component]
    gain = column / (column[:, component] + variance)[:, None]
    return (
        mean + gain * innovation[:, None],
        covariance - gain[:, :, None] * column[:, None, :],
    )
