"""What the motors really do, estimated in closed loop from one measurement to the next.

What `airpuck.estimate.actuation` asks of a window, with the same priors, evidence and equations of
motion, here as a recursion over the whole flight: the effectiveness of each motor beside state and
disturbance. The equations are in `airpuck.estimate.multiple_models`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.compute.compiled import program
from airpuck.estimate.actuation import ActuationEncoder
from airpuck.estimate.axis_filter import (
    INITIAL_DISTURBANCE,
    INITIAL_VELOCITY,
    Noise,
    propagate,
)
from airpuck.estimate.estimator import ActuationEstimate, Estimate
from airpuck.estimate.kalman import turned
from airpuck.estimate.multiple_models import (
    ACTUATION,
    DISTURBANCE,
    POSITION,
    VELOCITY,
    States,
    advance,
    measure,
    mixed,
    renewed,
    sensitivity,
)
from airpuck.estimate.recursive_filter import (
    PIECES_TO_MEASURE,
    PIECES_TO_PREDICT,
    Belief,
    Pieces,
    RecursiveFilter,
)
from airpuck.model.model_file import Model
from airpuck.physics.angle import pose_difference


class ActuationFilter(RecursiveFilter):
    """Estimates state, motor speeds, disturbance, and what each motor does with its command."""

    def __init__(
        self,
        model: Model,
        noise: Noise,
        *,
        encoder: ActuationEncoder | None = None,
        lasting: float = 3.0,
        delay_deviation: float = 3e-3,
        compiled: bool = True,
    ) -> None:
        super().__init__(model, compiled)
        encoder = encoder or ActuationEncoder()
        n = model.vehicle.n_propellers
        covariance = np.zeros((len(encoder.priors), n + 1, n + 1))
        covariance[:, :n, :n] = [prior.covariance(n) for prior in encoder.priors]
        # Motors without lag give no hint of the delay: their speed jumps.
        lags = float(model.dynamics.motor_time_constant) > 0
        covariance[:, n, n] = delay_deviation**2 * lags
        weight = np.array([prior.weight for prior in encoder.priors])
        self._names = tuple(prior.name for prior in encoder.priors)
        self._states = States(
            weight / weight.sum(), covariance, lasting, encoder.tail, encoder.tempering
        )
        self._noise = noise
        self._advance_by, self._measure_pose = self._programs()
        self._predict = self.composed(lambda *_: ())

    def _programs(self) -> tuple[Callable[..., Any], ...]:
        """Return what runs at every piece of time and pose."""
        dynamics, states, noise = self.model.dynamics, self._states, self._noise
        size, n = 10 + len(self._idle), len(self._idle)
        variances, rows = np.square(noise.pose), np.eye(size)[POSITION]

        def move(xp: Any, means: Any, covariances: Any, weights: Any, *given: Any) -> Any:
            belief = means, covariances, weights
            belief, speed = advance(xp, dynamics, states, noise, belief, *given)
            return *belief, speed

        def use(xp: Any, means: Any, covariances: Any, weights: Any, *given: Any) -> Any:
            *moving, pose = given
            *belief, speed = move(xp, means, covariances, weights, *moving)
            expected = xp.sum(belief[2][:, None] * belief[0], axis=0)[POSITION]
            innovation = pose_difference(xp, pose, expected)
            belief = measure(xp, states, tuple(belief), rows, innovation, variances)
            return *belief, speed, innovation

        h = len(states.weight)
        belief = np.zeros((h, size)), np.zeros((h, size, size)), np.zeros(h)
        to_advance = np.zeros(PIECES_TO_PREDICT), np.zeros((PIECES_TO_PREDICT, n))
        to_measure = np.zeros(PIECES_TO_MEASURE), np.zeros((PIECES_TO_MEASURE, n))
        return (
            program(move, *belief, self._idle, *to_advance, compiled=self._compiled),
            program(use, *belief, self._idle, *to_measure, np.zeros(3), compiled=self._compiled),
        )

    def _prediction(self) -> Callable[..., tuple[Any, ...]]:
        dynamics = self.model.dynamics

        def predict(xp: Any, means: Any, covariances: Any, weights: Any, *given: Any) -> Any:
            mean = xp.sum(weights[:, None] * means, axis=0)
            e = mean[ACTUATION]
            # The delay is told, but not used: commands on their way have one of their own.
            effective = replace(dynamics, thrust=dynamics.thrust * (1 + e[:-1])[:, None])
            axes = xp.reshape(mean[:9], (3, 3)).T
            axes, speed = propagate(xp, effective, axes, *given)
            variances = xp.diagonal(covariances, axis1=1, axis2=2) + (means - mean) ** 2
            spread = xp.sqrt(xp.sum(weights[:, None] * variances, axis=0)[ACTUATION])
            delay = xp.stack([e[-1], spread[-1]])
            motion = xp.ravel(axes[:, :2].T), speed, axes[:, 2]
            return *motion, 1 + e[:-1], spread[:-1], weights, delay

        return predict

    def _estimate(self, time: float, results: Sequence[Any]) -> tuple[Estimate, Sequence[Any]]:
        state, speed, disturbance, effectiveness, deviation, weights, delay, *following = results
        probability = dict(zip(self._names, weights.tolist(), strict=True))
        actuation = ActuationEstimate(effectiveness, deviation, probability, *delay.tolist())
        return Estimate(time, state, speed, disturbance, actuation), following

    def _begun(
        self, pose: Float[np.ndarray, " 3"], before: Belief | None, elapsed: float
    ) -> Belief:
        states = self._states
        if before is None:
            h, size = len(states.weight), 10 + len(self._idle)
            means, covariances = np.zeros((h, size)), np.zeros((h, size, size))
            covariances[:, ACTUATION, ACTUATION] = states.covariance
            weights = states.weight
        else:
            # What is known of the motors is kept, as far as it is not too old.
            means, covariances, weights = renewed(np, states, before, elapsed)
        means[:, :9], covariances[:, :9, :], covariances[:, :, :9] = 0.0, 0.0, 0.0
        means[:, POSITION] = pose
        drives = np.array(self._noise.disturbance) > 0
        initial = [self._noise.pose, INITIAL_VELOCITY, INITIAL_DISTURBANCE * drives]
        covariances[:, range(9), range(9)] = np.square(np.concatenate(initial))
        return means, covariances, weights

    def _advanced(
        self, belief: Belief, speed: Float[np.ndarray, " n"], pieces: Pieces
    ) -> tuple[Belief, Float[np.ndarray, " n"]]:
        *after, speed = self._advance_by(*belief, speed, *pieces)
        return tuple(after), speed

    def _with_pose(
        self,
        belief: Belief,
        speed: Float[np.ndarray, " n"],
        pieces: Pieces,
        pose: Float[np.ndarray, " 3"],
    ) -> tuple[Belief, Float[np.ndarray, " n"], Float[np.ndarray, " 3"]]:
        *after, speed, innovation = self._measure_pose(*belief, speed, *pieces, pose)
        return tuple(after), speed, innovation

    def _with_imu(
        self,
        belief: Belief,
        speed: Float[np.ndarray, " n"],
        acceleration_body: Float[np.ndarray, " 2"],
        gyro: float,
        noise: tuple[float, float],
    ) -> Belief:
        mean, _ = mixed(np, belief)
        motion = mean[2], *mean[VELOCITY]
        modelled, by_e = sensitivity(np, self.model.dynamics, motion, speed, self._acting)
        rows = np.zeros((3, len(mean)))
        rows[:, DISTURBANCE] = np.diag([1.0, 1.0, 0.0])
        rows[:2, ACTUATION] = by_e[:2]
        rows[2, 5] = 1.0
        measured = np.array([*turned(acceleration_body, mean[2]), gyro])
        innovation = measured - np.array([*modelled[:2], 0.0]) - rows @ mean
        variance = np.square([noise[0], noise[0], noise[1]])
        return measure(np, self._states, belief, rows, innovation, variance)

    def _with_mouse(
        self, belief: Belief, velocity: Float[np.ndarray, " 2"], noise: float
    ) -> Belief:
        mean, _ = mixed(np, belief)
        rows = np.eye(len(mean))[3:5]
        innovation = np.array(turned(velocity, mean[2])) - mean[3:5]
        return measure(np, self._states, belief, rows, innovation, np.full(2, noise**2))
