"""State estimation from past poses and commands: a Kalman filter with a disturbance.

The accelerations of x, y and γ are those of the model under the commands that act at the time,
plus a disturbance d that wanders slowly. Given the yaw, which the motion capture measures well,
the three axes are independent: each has a state (p, v, d) with p' = v, v' = a(t) + d + w₁, d' = w₂.

The mathematics is in three pure functions (`airpuck.estimate.axis_filter`), here run compiled; the
books are `RecursiveFilter`'s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.compute.compiled import program
from airpuck.estimate.axis_filter import (
    INITIAL_DISTURBANCE,
    INITIAL_VELOCITY,
    Noise,
    correct,
    propagate,
    spread,
)
from airpuck.estimate.estimator import Estimate
from airpuck.estimate.recursive_filter import (
    PIECES_TO_MEASURE,
    PIECES_TO_PREDICT,
    Belief,
    Pieces,
    RecursiveFilter,
)
from airpuck.model.model_file import Model
from airpuck.physics.angle import pose_difference
from airpuck.physics.rigid_body import acceleration


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
        super().__init__(model, compiled)
        self._pose_variance = np.square(noise.pose)
        self._noise = np.square(noise.acceleration), np.square(noise.disturbance)
        self._advance_by, self._measure_pose = self._programs()
        self._predict = self.composed(lambda *_: ())

    def _programs(self) -> tuple[Callable[..., Any], ...]:
        """Return what runs at every piece of time and pose."""
        dynamics, noise, pose_variance = self.model.dynamics, self._noise, self._pose_variance

        def advance(xp: Any, mean: Any, covariance: Any, speed: Any, *pieces: Any) -> Any:
            mean, speed = propagate(xp, dynamics, mean, speed, *pieces)
            return mean, spread(xp, covariance, xp.sum(pieces[0]), *noise), speed

        def measure(xp: Any, mean: Any, covariance: Any, speed: Any, *given: Any) -> Any:
            *pieces, pose = given
            mean, covariance, speed = advance(xp, mean, covariance, speed, *pieces)
            innovation = pose_difference(xp, pose, mean[:, 0])
            mean, covariance = correct(mean, covariance, 0, innovation, pose_variance)
            return mean, covariance, speed, innovation

        n, belief = len(self._idle), (np.zeros((3, 3)), np.zeros((3, 3, 3)))
        to_advance = np.zeros(PIECES_TO_PREDICT), np.zeros((PIECES_TO_PREDICT, n))
        to_measure = np.zeros(PIECES_TO_MEASURE), np.zeros((PIECES_TO_MEASURE, n))
        return (
            program(advance, *belief, self._idle, *to_advance, compiled=self._compiled),
            program(
                measure, *belief, self._idle, *to_measure, np.zeros(3), compiled=self._compiled
            ),
        )

    def _prediction(self) -> Callable[..., tuple[Any, ...]]:
        dynamics = self.model.dynamics

        def predict(xp: Any, mean: Any, covariance: Any, *given: Any) -> tuple[Any, ...]:
            mean, speed = propagate(xp, dynamics, mean, *given)
            return xp.ravel(mean[:, :2].T), speed, mean[:, 2], xp.ones(speed.shape)

        return predict

    def _estimate(self, time: float, results: Sequence[Any]) -> tuple[Estimate, Sequence[Any]]:
        state, speed, disturbance, _, *following = results
        return Estimate(time, state, speed, disturbance), following

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


def turned(vector: Float[np.ndarray, " 2"], yaw: float) -> tuple[float, float]:
    """Turn a body vector into the world frame."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]
