"""Smoothing times of slow craft, whose poses are noisier than their motion.

The time follows from the white noise σ of the poses, their rate f, and the acceleration a that a
typical actuator causes at full command (`airpuck.deviation.time_scale`), for positions and for yaw.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from airpuck.craft.vehicle import Vehicle
from airpuck.data.sampling import usual_period
from airpuck.data.trajectory import Trajectory, vehicle_of
from airpuck.deviation.time_scale import measured_poses, pose_noise, usual_pushes
from airpuck.preprocessing.derivative import (
    VELOCITY_TIME,
    acceleration_time,
    shortest_stretch,
    smooth,
)
from airpuck.preprocessing.quality import smooth_stretches

#: Longest useful time [s]: beyond it, cables, slopes and draughts matter more than pose noise.
_LONGEST = 0.5
#: The slope of a cubic over L has the variance 75 σ²/(f L³). Where the acceleration jumps by a, its
#: bias is 0.039 a L at the jump and less beside it; this is the usual bias in units of a L.
_SLOPE_NOISE, _SLOPE_BIAS = 75.0, 0.035


def smoothing_times(
    time: Float[np.ndarray, " N"], pose: Float[np.ndarray, "N 3"], vehicle: Vehicle
) -> tuple[float, float]:
    """Return the times over which positions and yaw are smoothed for velocities [s].

    At least 46 ms; they balance the noise of the velocity and its bias where an actuator switches.
    """
    linear, angular = usual_pushes(vehicle)
    return _time(time, pose[:, :2], linear), _time(time, pose[:, 2:], angular)


def _time(time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"], push: float) -> float:
    """Return a smoothing time; see `smoothing_times`."""
    if not push > 0 or len(time) < 2:
        return VELOCITY_TIME
    ratio = (pose_noise(time, values, push) / (_SLOPE_BIAS * push)) ** 2 * usual_period(time)
    best = (1.5 * _SLOPE_NOISE * ratio) ** 0.2
    return min(max(best, VELOCITY_TIME), _LONGEST)


def in_parts(
    derive: Callable[..., Float[np.ndarray, "N k"]],
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N 3"],
    period: float,
    durations: Sequence[float],
    measured: Bool[np.ndarray, " N"] | None = None,
) -> Float[np.ndarray, "N 3"]:
    """Differentiate positions and yaw, each with its own smoothing time."""
    parts = zip(np.split(values, [2], axis=1), durations, strict=True)
    found = [derive(time, part, period, duration, measured) for part, duration in parts]
    return np.concatenate(found, axis=1)


def is_slow(trajectory: Trajectory) -> bool:
    """Return whether the poses of a recording were smoothed for longer than usual."""
    return (
        max(smoothing_times(*measured_poses(trajectory), vehicle_of([trajectory]))) > VELOCITY_TIME
    )


def smoothed_as_measured(
    trajectory: Trajectory, modelled: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N 3"]:
    """Smooth modelled accelerations like the measured ones of a slow craft.

    The usual smoothing is too short to matter.
    """
    time, period = trajectory.time, trajectory.sample_period
    durations = smoothing_times(*measured_poses(trajectory), vehicle_of([trajectory]))
    if max(durations) <= VELOCITY_TIME:
        return modelled
    # Positions or yaw that were smoothed as usual are left alone, by smoothing over one sample.
    lasting = tuple(acceleration_time(d) if d > VELOCITY_TIME else 0.0 for d in durations)
    smoothed = modelled.copy()
    for part in smooth_stretches(time, trajectory.bridged, max(durations), trajectory.excluded):
        if len(time[part]) >= shortest_stretch(period):
            smoothed[part] = in_parts(smooth, time[part], modelled[part], period, lasting)
    return smoothed
