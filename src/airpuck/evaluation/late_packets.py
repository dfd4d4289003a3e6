"""Innovations with late packets: the radio's jitter is part of the null hypothesis.

A packet that changes the acceleration by Δa and comes late by δ leaves the motors short of Δa δ/τ,
for as long as they lag. So each axis has a fourth state m, the acceleration that late packets
withhold or add, m' = -m/τ, excited by each packet with the variance σ² Δa²/τ². With it, innovations
are white even under jitter and feedback, because a packet's effect is known when it is sent. Along
a motion that is already estimated, the axes are linear, and so is the effect of a model error on
the innovations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from airpuck.data.trajectory import Trajectory
from airpuck.deviation.motor_regression import accelerations_by_motor
from airpuck.deviation.packet_delays import delay_for
from airpuck.evaluation.innovations import Innovations, NoiseSearch, motor_speeds_at, passed
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.physics.thrust import thrust

#: Spread of a packet's effect around its usual time: standard deviation of a typical radio [s].
_SCATTER = 0.007
#: Shortest lag of the motors [s].
_LEAST_LAG = 1e-3
#: Ranges of log₁₀ of the noises in units of the pose's variance: accelerations and disturbances
#: [(per sample period)³ and ⁵], delays in units of `_SCATTER`² over the pose's. The lower end means
#: zero.
_LOWEST, _HIGHEST = np.array([-14.0, -22.0, -8.0]), np.array([3.0, 3.0, 4.0])
#: First and last steps of the search [decades].
_COARSEST, _FINEST = 1.0, 0.1
#: Step of the finite differences in delay and lag [s].
_STEP = 0.002


@dataclass(frozen=True, eq=False)
class LatePackets:
    """Innovations that allow for late packets, and the effects of model errors on them."""

    #: In standard deviations: x, y, γ; zero where they are not used.
    values: Float[np.ndarray, "N 3"]
    #: The same for a filter without a wandering disturbance: the disturbance would follow slow
    #: model errors and hide them.
    steady: Float[np.ndarray, "N 3"]
    #: First-order effects of errors on the latter: a delay longer by one second; a lag longer and a
    #: delay shorter by one second; each motor twice as strong.
    directions: Float[np.ndarray, "N 3 m"]
    #: The same for other missing accelerations of 1 m/s² or rad/s².
    others: Float[np.ndarray, "N 3 s"]
    #: Standard deviation of the delay of single packets, estimated from each axis [s].
    jitter: Float[np.ndarray, " 3"]


def late_packets(
    model: Model, trajectory: Trajectory, found: Innovations, others: Float[np.ndarray, "N 3 s"]
) -> LatePackets:
    """Filter a trajectory again, along the estimated motion; see `LatePackets` for `others`."""
    time, period = trajectory.time, trajectory.sample_period
    kicks = _kicks(model, trajectory)
    steps = np.diff(time, prepend=time[0])
    lag = max(float(model.dynamics.motor_time_constant), _LEAST_LAG)
    pose, directions = trajectory.state[:, :3], _directions(model, trajectory, found)
    per_sample = kicks, steps, found.restart, trajectory.measured, found.used.astype(float)
    one = pose, found.added[:, :, None], *per_sample
    known = 1 + directions.shape[2]
    added = np.concatenate(
        [found.added[:, :, None], directions, _over_steps(others, steps)], axis=2
    )

    def filtered(wanders: bool) -> tuple[Float[np.ndarray, "N 3 s"], Float[np.ndarray, " 3"]]:
        ratios, variance = _most_likely(found, one, lag, period, wanders)
        scaled = passed(ratios[None], lag, period, (pose, added, *per_sample))[2]
        scaled = np.where(found.used[:, None, None], scaled / np.sqrt(variance)[:, None], 0.0)
        return scaled, np.sqrt(ratios[:, 2] * variance)

    (usual, jitter), (scaled, _) = filtered(True), filtered(False)
    return LatePackets(
        values=usual[..., 0],
        steady=scaled[..., 0],
        directions=-scaled[..., 1:known],
        others=-scaled[..., known:],
        jitter=jitter,
    )


def _kicks(model: Model, trajectory: Trajectory) -> Float[np.ndarray, "N 3"]:
    """Return Σ Δa²/τ² of the packets that act before each sample, spread by their jitter."""
    time, dynamics = trajectory.time, model.dynamics
    acts = trajectory.command_time + delay_for(model, trajectory)
    force = thrust(dynamics.thrust, trajectory.command.T)
    changes = np.diff(force, axis=1, prepend=force[:, :1])
    inside = (acts > time[0]) & (acts < time[-1])
    at = np.searchsorted(time, acts[inside])
    lag = max(float(dynamics.motor_time_constant), _LEAST_LAG)
    squares = np.zeros((len(time), 3))
    for sample, change in zip(at, changes[:, inside].T, strict=True):
        matrix, _ = acceleration_map(np, dynamics, trajectory.state[sample, 2], 0.0)
        squares[sample] += (matrix @ change / lag) ** 2
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(squares, _SCATTER / trajectory.sample_period, axis=0, mode="constant")


def _directions(
    model: Model, trajectory: Trajectory, found: Innovations
) -> Float[np.ndarray, "N 3 m 2"]:
    """Return the effects of delay, lag and motors on position and velocity over each step."""
    time, state, command = trajectory.time, trajectory.state, trajectory.command
    acts, dynamics = trajectory.command_time + delay_for(model, trajectory), model.dynamics
    slow = replace(dynamics, motor_time_constant=dynamics.motor_time_constant + _STEP)
    later = motor_speeds_at(time, acts + _STEP, command, dynamics.lag, dynamics.idle_lag)
    slower = motor_speeds_at(time, acts, command, slow.lag, dynamics.idle_lag)
    now, *changed = (
        accelerations_by_motor(dynamics, state, speed)[0]
        for speed in (found.motor_speed, later, slower)
    )
    by_delay, by_lag = ((one - now).sum(axis=2, keepdims=True) / _STEP for one in changed)
    rates = np.concatenate([by_delay, by_lag - by_delay, now], axis=2)
    return _over_steps(rates, np.diff(time, prepend=time[0]))


def _over_steps(
    rates: Float[np.ndarray, "N 3 m"], steps: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "N 3 m 2"]:
    """Integrate accelerations over each step: their effect on position and velocity."""
    before, h = np.concatenate([rates[:1], rates[:-1]]), steps[:, None, None]
    return np.stack([h**2 / 6 * (2 * before + rates), h / 2 * (before + rates)], axis=-1)


def _most_likely(
    found: Innovations, given: tuple[np.ndarray, ...], lag: float, period: float, wanders: bool
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Find the noises with the largest likelihood, and the pose's variance.

    The search resembles `most_likely_noise`, and starts from the noises without jitter. Noises that
    do not improve the likelihood enough are zero, as are disturbances unless they may wander.
    """
    pose = np.square(found.noise.pose)
    units = np.stack([np.full(3, period**-3), np.full(3, period**-5), _SCATTER**2 / pose], axis=1)
    densities = np.square([found.noise.acceleration, found.noise.disturbance]).T / pose[:, None]
    point = np.zeros((3, 3))
    point[:, :2] = np.log10(densities / units[:, :2] + 1e-300)
    point = np.clip(point, _LOWEST + _COARSEST, _HIGHEST)
    # Vary each noise alone, then accelerations against delays, which can replace each other.
    alone = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    around = np.concatenate([alone, [[-1, 0, 1], [1, 0, -1]]]).astype(int)
    search = NoiseSearch(given, lag, period, units * (1.0, wanders, 1.0), _LOWEST, _HIGHEST)
    return search.best(point, np.full((3, 3), _COARSEST), around, _FINEST)
