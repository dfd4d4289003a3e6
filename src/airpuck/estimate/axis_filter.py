"""A Kalman filter of independent axes: pure functions over an array namespace.

Each axis x, y, γ has a state (p, v, d): p' = v, v' = a(t) + d + w₁, d' = w₂.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Result
from airpuck.compute.arrays import small_product
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics, acceleration, pose_difference


@dataclass(frozen=True)
class Noise(Result):
    """Noise of the three axes x, y, γ."""

    JSON = "pose acceleration_density=acceleration disturbance_density=disturbance"

    #: Standard deviation of the measured pose [m, m, rad].
    pose: tuple[float, float, float]
    #: Density of the white acceleration w₁ [m/s²/√Hz, m/s²/√Hz, rad/s²/√Hz].
    acceleration: tuple[float, float, float]
    #: Density of w₂, which drives the disturbance [m/s³/√Hz, m/s³/√Hz, rad/s³/√Hz].
    disturbance: tuple[float, float, float]

    @property
    def initial_variance(self) -> Float[np.ndarray, "3 3"]:
        """Variances of pose, velocity and disturbance at the first pose, a row for each axis."""
        drives = np.array(self.disturbance) > 0
        initial = np.array([self.pose, INITIAL_VELOCITY, INITIAL_DISTURBANCE * drives])
        return (initial**2).T


#: Standard deviation of velocity and disturbance at the first pose, in each axis.
INITIAL_VELOCITY = np.array([0.5, 0.5, 5.0])
INITIAL_DISTURBANCE = np.array([0.1, 0.1, 3.0])


@dataclass(frozen=True, eq=False)
class IndependentAxes:
    """Equations of a craft's belief if the motors follow the model.

    Given the yaw, which the cameras measure well, the axes are independent. A belief is a mean (3,
    3) and covariances (3, 3, 3), the axis first.
    """

    dynamics: Dynamics
    noise: Noise

    def begin(self, pose: Any, before: Any, elapsed: float) -> tuple[Any, ...]:
        """Return the belief at a pose, at rest; the previous belief does not matter."""
        mean, covariance = np.zeros((3, 3)), np.zeros((3, 3, 3))
        mean[:, 0] = pose
        covariance[:, range(3), range(3)] = self.noise.initial_variance
        return mean, covariance

    def advance(self, xp: Any, mean: Any, covariance: Any, speed: Any, *pieces: Any) -> Any:
        """Advance belief and motor speeds through durations (S,) and commands (S, n)."""
        white, drift = xp.array(self.noise.acceleration), xp.array(self.noise.disturbance)
        mean, speed = propagate(xp, self.dynamics, mean, speed, *pieces)
        return mean, spread(xp, covariance, xp.sum(pieces[0]), white**2, drift**2), speed

    def use_pose(self, xp: Any, mean: Any, covariance: Any, speed: Any, *given: Any) -> Any:
        """Advance, then use a pose, the last argument; the last result is the innovation."""
        *pieces, pose = given
        mean, covariance, speed = self.advance(xp, mean, covariance, speed, *pieces)
        innovation = pose_difference(xp, pose, mean[:, 0])
        variance = xp.array(self.noise.pose) ** 2
        mean, covariance = correct(mean, covariance, 0, innovation, variance)
        return mean, covariance, speed, innovation

    def use_imu(self, belief: Any, motors: Any, force: Any, gyro: float, noise: Any) -> Any:
        """Use an inertial measurement at given motor speeds and commands."""
        mean, covariance = belief
        (_, vx, dx), (_, vy, dy), (yaw, spin, _) = mean
        modelled = acceleration(np, self.dynamics, (yaw, vx, vy, spin), motors[0])
        ax, ay = to_world(force, yaw)
        innovation = np.array([ax - modelled[0] - dx, ay - modelled[1] - dy, 0.0])
        variance = np.array([noise[0] ** 2, noise[0] ** 2, np.inf])
        mean, covariance = correct(mean, covariance, 2, innovation, variance)
        innovation = np.array([0.0, 0.0, gyro - mean[2, 1]])
        variance = np.array([np.inf, np.inf, noise[1] ** 2])
        return correct(mean, covariance, 1, innovation, variance)

    def use_mouse(self, belief: Any, velocity: Any, noise: float) -> Any:
        """Use a measured velocity along the body's axes."""
        mean, covariance = belief
        innovation = np.array([*to_world(velocity, mean[2, 0]), mean[2, 1]]) - mean[:, 1]
        return correct(mean, covariance, 1, innovation, np.array([noise**2, noise**2, np.inf]))

    def predict(self, xp: Any, mean: Any, covariance: Any, *given: Any) -> tuple[Any, ...]:
        """Return state, motor speeds, disturbance and effectiveness after time intervals."""
        mean, speed = propagate(xp, self.dynamics, mean, *given)
        return xp.ravel(mean[:, :2].T), speed, mean[:, 2], xp.ones(speed.shape)


def propagate(
    xp: Any, dynamics: Dynamics, mean: Any, motor_speed: Any, durations: Any, commands: Any
) -> tuple[Any, Any]:
    """Advance mean and motor speeds through intervals with one command each.

    Each interval uses the acceleration at its middle, so that the error is of second order.
    """
    tau, idle = dynamics.lag, dynamics.idle_lag
    for k in range(len(durations)):
        h, command = durations[k], commands[k]
        middle = motor_step(xp, motor_speed, command, h / 2, tau, idle)
        motion = mean[2, 0] + h / 2 * mean[2, 1], mean[0, 1], mean[1, 1], mean[2, 1]
        rate = xp.array(acceleration(xp, dynamics, motion, middle)) + mean[:, 2]
        p, v, d = mean[:, 0], mean[:, 1], mean[:, 2]
        mean = xp.stack([p + h * v + h * h / 2 * rate, v + h * rate, d], axis=1)
        motor_speed = motor_step(xp, motor_speed, command, h, tau, idle)
    return mean, motor_speed


def to_world(vector: Float[np.ndarray, " 2"], yaw: float) -> tuple[float, float]:
    """Rotate a body vector into the world frame."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]


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
    """Integrate both noises, given as squared densities, over a time."""
    h = duration
    by_acceleration = xp.array([[h**3 / 3, h**2 / 2, 0.0], [h**2 / 2, h, 0.0], [0.0, 0.0, 0.0]])
    by_disturbance = xp.array(
        [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]
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
    return (mean + gain * innovation[:, None], covariance - gain[:, :, None] * column[:, None, :])
