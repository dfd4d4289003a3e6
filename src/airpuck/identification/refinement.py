"""Data prepared anew with what a first fit knows: when packets arrived, and how fast the craft was.

Two things are wrong in the same way in all data that are prepared without a model. Commands are
taken to arrive after the mean delay, so that every packet that is late or early leaves an error
that lasts to the end of its windows. And velocities are smoothed across the kinks that switching
motors leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from airpuck.data.trajectory import Trajectory
from airpuck.identification.delay_jitter import spread_of
from airpuck.identification.packet_delays import PacketDelays, packet_delays
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import acceleration
from airpuck.preprocessing.derivative import ACCELERATION_WINDOW, velocity
from airpuck.preprocessing.quality import stretches


def refined(
    trajectories: Sequence[Trajectory], model: Model
) -> tuple[tuple[Trajectory, ...], tuple[PacketDelays, ...]]:
    """Prepare recordings anew: commands at the times of arrival, velocities along the model."""
    delays = tuple(packet_delays(trajectory, model) for trajectory in trajectories)
    if not float(model.dynamics.motor_time_constant) > 0:
        return tuple(trajectories), delays
    spread = spread_of(delays)
    again = (
        smoothed_along(retimed(trajectory, own, spread), model)
        for trajectory, own in zip(trajectories, delays, strict=True)
    )
    return tuple(again), delays


def retimed(trajectory: Trajectory, delays: PacketDelays, jitter: float) -> Trajectory:
    """Move packets to when they arrived, as far as is known.

    The mean of δ given its estimate δ̂ of variance v is σ²/(σ² + v) δ̂ for packets whose delays have
    the standard deviation σ. All other packets keep the mean delay, but overtake none.
    """
    if not len(delays) or jitter == 0:
        return trajectory
    weight = 1 / (jitter**2 + delays.standard_error**2)
    late = jitter**2 * weight * (delays.deviation - np.average(delays.deviation, weights=weight))
    time = trajectory.command_time.copy()
    time[delays.packet] += late
    earliest, latest = np.full_like(time, -np.inf), np.full_like(time, np.inf)
    earliest[delays.packet] = latest[delays.packet] = time[delays.packet]
    earliest = np.maximum.accumulate(earliest)
    latest = np.minimum.accumulate(latest[::-1])[::-1]
    return replace(trajectory, command_time=np.maximum.accumulate(np.clip(time, earliest, latest)))


def smoothed_along(trajectory: Trajectory, model: Model) -> Trajectory:
    """Smooth what the model leaves, rather than the poses.

    v = ∫ a + D(y - ∬ a), a the modelled accelerations along the measured yaw and D the derivative
    of preprocessing: linear, and exact for cubics. Where a is the true acceleration the kinks that
    switching motors leave are all in ∫ a, and are not smoothed away.
    """
    time, state = trajectory.time, trajectory.state.copy()
    modelled = modelled_acceleration(trajectory, model)
    for part in stretches(time):
        if len(time[part]) < ACCELERATION_WINDOW:
            continue  # left out by preprocessing, which has no velocities there either
        gained, moved = _integrated(time[part], modelled[part])
        state[part, 3:] = gained + velocity(time[part], state[part, :3] - moved)
    return replace(trajectory, state=state)


def modelled_acceleration(trajectory: Trajectory, model: Model) -> Float[np.ndarray, "N 3"]:
    """Compute what a model says of the accelerations along the measured motion."""
    assumed = model.vehicle.nominal.transport_delay_s
    held, _ = trajectory.delayed_input(model.transport_delay, assumed)
    speed = motor_speeds(trajectory.time, held, float(model.dynamics.motor_time_constant))
    return np.stack(acceleration(np, model.dynamics, trajectory.state[:, 2:].T, speed.T), axis=1)


def _integrated(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"]
) -> tuple[Float[np.ndarray, "N k"], Float[np.ndarray, "N k"]]:
    """Integrate once and twice from the first sample, linear between samples."""
    h = np.diff(time)[:, None]
    once = np.zeros_like(values)
    once[1:] = np.cumsum(h / 2 * (values[:-1] + values[1:]), axis=0)
    twice = np.zeros_like(values)
    twice[1:] = np.cumsum(h * once[:-1] + h**2 / 6 * (2 * values[:-1] + values[1:]), axis=0)
    return once, twice
