"""State estimation from past poses and commands: a Kalman filter with a disturbance.

The accelerations of x, y and γ are those of the model under the commands that act at the time,
plus a disturbance d that wanders slowly. Given the yaw, which the motion capture measures well,
the three axes are independent: each has a state (p, v, d) with p' = v, v' = a(t) + d + w₁, d' = w₂.

The mathematics is in three pure functions (`airpuck.estimate.axis_filter`), here run compiled; the
books are `RecursiveFilter`'s.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.estimate.axis_filter import (
    INITIAL_DISTURBANCE,
    INITIAL_VELOCITY,
    Noise,
    correct,
    propagate,
    spread,
    wrapped,
)
from airpuck.estimate.estimator import Estimate
from airpuck.estimate.recursive_filter import (
    PIECES_TO_MEASURE,
    PIECES_TO_PREDICT,
    Belief,
    Pieces,
    RecursiveFilter,
)
from airpuck.model.compiled import for_real_time
from airpuck.model.rigid_body import acceleration
from airpuck.model_file import Model


class KalmanFilter(RecursiveFilter):
    """Estimates state, motor speeds and disturbance; takes motors to do what they are told.

    Parameters
    ----------
    model : Model
        The craft, with its transport delay.
    noise : Noise
        What to expect of measurements and model.
    compiled : bool, default True
        Whether to compile the mathematics (a second, once) or to run it in NumPy.
    """

    def __init__(self, model: Model, noise: Noise, *, compiled: bool = True) -> None:
        super().__init__(model)
        self._pose_variance = np.square(noise.pose)
        self._noise = np.square(noise.acceleration), np.square(noise.disturbance)
        self._predict, self._advance_by, self._measure_pose = self._programs(compiled)

    def _programs(self, compiled: bool) -> tuple[Callable[..., Any], ...]:
        """Return what runs at every prediction, piece of time and pose."""
        dynamics, noise, pose_variance = self.model.dynamics, self._noise, self._pose_variance

        def programs(xp: Any) -> tuple[Callable[..., Any], ...]:
            def predict(mean: Any, speed: Any, durations: Any, commands: Any) -> Any:
                return propagate(xp, dynamics, mean, speed, durations, commands)

            def advance(mean: Any, covariance: Any, speed: Any, durations: Any, *given: Any) -> Any:
                mean, speed = propagate(xp, dynamics, mean, speed, durations, *given)
                return mean, spread(xp, covariance, xp.sum(durations), *noise), speed

            def measure(mean: Any, covariance: Any, speed: Any, *given: Any) -> Any:
                *pieces, pose = given
                mean, covariance, speed = advance(mean, covariance, speed, *pieces)
                innovation = wrapped(xp, pose - mean[:, 0])
                mean, covariance = correct(mean, covariance, 0, innovation, pose_variance)
                return mean, covariance, speed, innovation

            return predict, advance, measure

        if not compiled:
            return programs(np)
        import jax.numpy as jnp

        predict, advance, measure = programs(jnp)
        n, belief = len(self._idle), (np.zeros((3, 3)), np.zeros((3, 3, 3)))
        to_predict = np.zeros(PIECES_TO_PREDICT), np.zeros((PIECES_TO_PREDICT, n))
        to_measure = np.zeros(PIECES_TO_MEASURE), np.zeros((PIECES_TO_MEASURE, n))
        return (
            for_real_time(predict, belief[0], self._idle, *to_predict),
            for_real_time(advance, *belief, self._idle, *to_predict),
            for_real_time(measure, *belief, self._idle, *to_measure, np.zeros(3)),
        )

    def _begun(
        self, pose: Float[np.ndarray, " 3"], before: Belief | None, elapsed: float
    ) -> Belief:
        mean, covariance = np.zeros((3, 3)), np.zeros((3, 3, 3))
        mean[:, 0] = pose
        covariance[:, 0, 0] = self._pose_variance
        covariance[:, 1, 1] = INITIAL_VELOCITY**2
        covariance[:, 2, 2] = INITIAL_DISTURBANCE**2 * (self._noise[1] > 0)
        return mean, covariance

    def _advanced(
        self, belief: Belief, speed: Float[np.ndarray, " n"], pieces: Pieces
    ) -> tuple[Belief, Float[np.ndarray, " n"]]:
        mean, covariance, speed = self._advance_by(*belief, speed, *pieces)
        return (mean, covariance), speed

    def _with_pose(
        self,
        belief: Belief,
        speed: Float[np.ndarray, " n"],
        pieces: Pieces,
        pose: Float[np.ndarray, " 3"],
    ) -> tuple[Belief, Float[np.ndarray, " n"], Float[np.ndarray, " 3"]]:
        mean, covariance, speed, innovation = self._measure_pose(*belief, speed, *pieces, pose)
        return (mean, covariance), speed, innovation

    def _with_imu(
        self,
        belief: Belief,
        speed: Float[np.ndarray, " n"],
        acceleration_body: Float[np.ndarray, " 2"],
        gyro: float,
        noise: tuple[float, float],
    ) -> Belief:
        mean, covariance = belief
        (_, vx, dx), (_, vy, dy), (yaw, spin, _) = mean
        modelled = acceleration(np, self.model.dynamics, (yaw, vx, vy, spin), speed)
        ax, ay = turned(acceleration_body, yaw)
        innovation = np.array([ax - modelled[0] - dx, ay - modelled[1] - dy, 0.0])
        variance = np.array([noise[0] ** 2, noise[0] ** 2, np.inf])
        mean, covariance = correct(mean, covariance, 2, innovation, variance)
        innovation = np.array([0.0, 0.0, gyro - mean[2, 1]])
        variance = np.array([np.inf, np.inf, noise[1] ** 2])
        return correct(mean, covariance, 1, innovation, variance)

    def _with_mouse(
        self, belief: Belief, velocity: Float[np.ndarray, " 2"], noise: float
    ) -> Belief:
        mean, covariance = belief
        vx, vy = turned(velocity, mean[2, 0])
        innovation = np.array([vx - mean[0, 1], vy - mean[1, 1], 0.0])
        return correct(mean, covariance, 1, innovation, np.array([noise**2, noise**2, np.inf]))

    def _estimate(
        self, time: float, belief: Belief, speed: Float[np.ndarray, " n"], pieces: Pieces
    ) -> Estimate:
        mean, speed = self._predict(belief[0], speed, *pieces)
        return Estimate(time, mean[:, :2].T.ravel(), speed, mean[:, 2])


def turned(vector: Float[np.ndarray, " 2"], yaw: float) -> tuple[float, float]:
    """Turn a body vector into the world frame.

    Parameters
    ----------
    vector : array, shape (2,)
        Along the body's axes.
    yaw : float
        γ [rad].

    Returns
    -------
    tuple of float
        Along the world's axes.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    return cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]
