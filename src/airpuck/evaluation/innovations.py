"""One-step innovations: what a model's prediction of the next pose has left to be told.

The predictor is the extended Kalman filter of `airpuck.estimate.axis_filter`, with the physics of
`airpuck.physics.rollout`: x, y and γ have states (p, v, d) with p' = v, v' = a + d + w₁, d' = w₂.
Maximum likelihood of the innovations finds how large the noises are, a prediction error method
(Ljung 1999, ch. 7). With the true model the innovations are white.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.errors import InputError
from airpuck.compute.arrays import scan
from airpuck.compute.compiled import for_batches
from airpuck.data.trajectory import Trajectory, check_propellers
from airpuck.estimate.axis_filter import Noise, correct, spread
from airpuck.evaluation.command_pieces import cut_at_commands, speed_before
from airpuck.evaluation.noise_likelihood import initial_covariance, most_likely_noise
from airpuck.evaluation.prediction import delay_for
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics
from airpuck.physics.rollout import rollout

#: Fewest innovations that a likelihood is made from.
_FEWEST = 50
#: What the search for the noise begins with.
_FIRST_GUESS = Noise((5e-5, 5e-5, 6e-4), (0.1, 0.1, 2.0), (0.2, 0.2, 6.0))


@dataclass(frozen=True, eq=False)
class Innovations:
    """Innovations of one model on one trajectory, and the filter behind them."""

    #: Sample times [s].
    time: Float[np.ndarray, " N"]
    #: Measured minus predicted x, y [m], γ [rad].
    values: Float[np.ndarray, "N 3"]
    #: Standard deviations that the filter gives them.
    deviation: Float[np.ndarray, "N 3"]
    #: False in excluded spans, and at the first two samples of every stretch, which only determine
    #: where the craft is and how fast it moves.
    used: Bool[np.ndarray, " N"]
    #: Estimates after each pose: axes x, y, γ; components p, v, d.
    mean: Float[np.ndarray, "N 3 3"]
    #: Of the estimates, for each axis.
    covariance: Float[np.ndarray, "N 3 3 3"]
    #: φ at each sample.
    motor_speed: Float[np.ndarray, "N n"]
    #: Standard deviations of the pose and densities of w₁ and w₂.
    noise: Noise
    #: How many numbers of the noise were found in these data, of each axis; those that came out as
    #: zero do not count.
    noise_parameters: tuple[int, int, int]

    @property
    def standardised(self) -> Float[np.ndarray, "N 3"]:
        """Innovations by their standard deviations; zero where they are not used."""
        return np.where(self.used[:, None], self.values / self.deviation, 0.0)

    @property
    def log_likelihood(self) -> float:
        """Gaussian log-likelihood of the used innovations, all three channels."""
        scaled = self.standardised[self.used]
        logs = np.log(2 * np.pi * self.deviation[self.used] ** 2)
        return float(-0.5 * np.sum(logs + scaled**2))


def innovations(model: Model, trajectory: Trajectory, noise: Noise | None = None) -> Innovations:
    """Predict every pose from those before it and the commands.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Measured poses, and commands that act after the trajectory's delay.
    noise : Noise, optional
        By default that of the largest likelihood.

    Returns
    -------
    Innovations
        Of every sample.

    Raises
    ------
    InputError
        If the trajectory is of another craft, or has too few usable samples in a row.
    """
    usable = trajectory.usable
    restart = ~(usable & np.concatenate([[False], usable[:-1]]))
    used = ~restart & ~np.concatenate([[True], restart[:-1]])
    if used.sum() < _FEWEST:
        raise InputError(
            f"has only {used.sum()} poses whose predecessors are usable; at least {_FEWEST} are "
            "needed to judge one-step predictions",
            file=trajectory.source,
        )
    predictor = _Predictor(model, trajectory)
    pose = trajectory.state[:, :3]
    begin = np.stack([pose, np.zeros_like(pose), np.zeros_like(pose)], axis=2)
    counts = (0, 0, 0)
    if noise is None:
        noise, period = _FIRST_GUESS, trajectory.sample_period
        for near in (False, True):
            # Accelerations depend on the noise only through the estimated yaw: twice will do.
            known = predictor.run(noise, restart, begin)[2]
            given = pose, known, predictor.period, restart, used, period
            noise, counts = most_likely_noise(*given, noise if near else None)
    values, variance, _, mean, covariance, speeds = predictor.run(noise, restart, begin)
    return Innovations(
        time=trajectory.time,
        values=values,
        deviation=np.sqrt(variance),
        used=used,
        mean=mean,
        covariance=covariance,
        motor_speed=speeds,
        noise=noise,
        noise_parameters=counts,
    )


def free_run(
    model: Model, trajectory: Trajectory, known: Innovations, starts: Int[np.ndarray, " M"]
) -> Float[np.ndarray, "N 3"]:
    """Simulate: predict without looking at any pose but those before the starts."""
    restart = np.zeros(len(trajectory), dtype=bool)
    restart[starts] = True
    begin = known.mean.copy()
    begin[:, :, 2] = 0.0
    # A filter that is sure of its state and of its model does not listen to poses.
    sure = Noise((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    predictor = _Predictor(model, trajectory)
    simulated = predictor.run(sure, restart, begin, listening=False)[3][:, :, 0]
    simulated[: starts[0]] = np.nan
    return simulated


class _Predictor:
    """The filter over one trajectory, compiled once for each model."""

    def __init__(self, model: Model, trajectory: Trajectory) -> None:
        check_propellers(model.vehicle, trajectory)
        time, acts = trajectory.time, trajectory.command_time + delay_for(model, trajectory)
        tau = float(model.dynamics.motor_time_constant)
        self.period = np.diff(time, prepend=time[0])
        self._pose = trajectory.state[:, :3]
        self._typical = trajectory.sample_period
        self._pieces = cut_at_commands(time, acts, trajectory.command)
        self._speed = speed_before(float(time[0]), acts, trajectory.command, tau)
        self._program = _compiled(_Identity(model.dynamics))

    def run(
        self,
        noise: Noise,
        restart: Bool[np.ndarray, " N"],
        begin: Float[np.ndarray, "N 3 3"],
        *,
        listening: bool = True,
    ) -> tuple[np.ndarray, ...]:
        """Return innovations, variances, what the model adds, estimates and motor speeds."""
        squares = [np.square(part) for part in (noise.pose, noise.acceleration, noise.disturbance)]
        start = initial_covariance(np, squares[0], squares[2], self._typical)
        if not listening:
            start = np.zeros_like(start)
        inputs = (self._pose, restart, begin, self.period, *self._pieces)
        found = self._program(*squares, start, self._speed, inputs)
        return tuple(np.array(part) for part in found)


class _Identity:
    """Dynamics as a key: the same object is compiled once."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics = dynamics

    def __hash__(self) -> int:
        return id(self.dynamics)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and other.dynamics is self.dynamics


@lru_cache(maxsize=8)
def _compiled(identity: _Identity) -> Any:
    """Compile the filter for one model."""
    import jax.numpy as jnp

    dynamics = identity.dynamics

    def program(
        pose_variance: Any,
        acceleration: Any,
        disturbance: Any,
        start: Any,
        speed: Any,
        inputs: Any,
    ) -> Any:
        def advance(carry: Any, given: Any) -> Any:
            mean, covariance, speed = carry
            pose, restart, begin, h, durations, commands = given
            p, v, d = mean[:, 0], mean[:, 1], mean[:, 2]
            state = jnp.concatenate([p, v, speed])
            end = rollout(jnp, dynamics, state, commands, durations)[-1]
            known = jnp.stack([end[:3] - p - h * v, end[3:6] - v], axis=1)
            mean = jnp.stack([end[:3] + h * h / 2 * d, end[3:6] + h * d, d], axis=1)
            covariance = spread(jnp, covariance, h, acceleration, disturbance)
            innovation = pose - mean[:, 0]
            variance = covariance[:, 0, 0] + pose_variance
            mean, covariance = correct(mean, covariance, 0, innovation, pose_variance)
            mean = jnp.where(restart, begin, mean)
            covariance = jnp.where(restart, start, covariance)
            carry = mean, covariance, end[6:]
            return carry, (innovation, variance, known, *carry)

        first = jnp.zeros((3, 3)), start, speed
        return scan(jnp, advance, first, inputs)[1]

    return for_batches(program)
