"""Smoothing times of slow craft, whose poses are noisier than their motion.

The time follows from the white noise σ of the poses, their rate f, and the acceleration a that a
typical actuator causes at full command (`airpuck.deviation.time_scale`).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck.craft.vehicle import Vehicle
from airpuck.data.sampling import usual_period
from airpuck.data.trajectory import Trajectory, vehicle_of
from airpuck.deviation.time_scale import measured_positions, pose_noise, usual_push
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


def smoothing_time(
    time: Float[np.ndarray, " N"], position: Float[np.ndarray, "N 2"], vehicle: Vehicle
) -> float:
    """Return the time over which poses are smoothed for velocities: at least 46 ms [s].

    It balances the noise of the velocity and its bias where an actuator switches.
    """
    push = usual_push(vehicle)
    if not push > 0 or len(time) < 2:
        return VELOCITY_TIME
    noise = pose_noise(time, position, push)
    ratio = (noise / (_SLOPE_BIAS * push)) ** 2 * usual_period(time)
    best = (1.5 * _SLOPE_NOISE * ratio) ** 0.2
    return min(max(best, VELOCITY_TIME), _LONGEST)


def is_slow(trajectory: Trajectory) -> bool:
    """Return whether the poses of a recording were smoothed for longer than usual."""
    vehicle = vehicle_of([trajectory])
    return smoothing_time(*measured_positions(trajectory), vehicle) > VELOCITY_TIME


def smoothed_as_measured(
    trajectory: Trajectory, modelled: Float[np.ndarray, "N k"]
) -> Float[np.ndarray, "N k"]:
    """Smooth modelled accelerations like the measured ones of a slow craft.

    The usual smoothing is too short to matter.
    """
    time = trajectory.time
    duration = smoothing_time(*measured_positions(trajectory), vehicle_of([trajectory]))
    if duration <= VELOCITY_TIME:
        return modelled
    smoothed = modelled.copy()
    period = trajectory.sample_period
    for part in smooth_stretches(time, trajectory.bridged, duration, trajectory.excluded):
        if len(time[part]) >= shortest_stretch(period):
            lasting = acceleration_time(duration)
            smoothed[part] = smooth(time[part], modelled[part], lasting, period)
    return smoothed
