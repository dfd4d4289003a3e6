"""How long a craft must be watched until its thrust shows above the noise of its poses."""

from __future__ import annotations

import math

import numpy as np

from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory, hold
from airpuck.model.model_file import nominal_model
from airpuck.physics.thrust import thrust

#: Displacement by the usual acceleration that is clear, in standard deviations of the noise: the
#: fits of an air-bearing satellite are best with predictions of about this length.
_CLEAR = 50.0
#: Longest useful time [s]: cables, slopes and draughts then weigh more than the noise of poses.
_LONGEST = 3.0
#: Differences of poses, which leave little of the motion, and their growth of white noise.
_DIFFERENCES = 3
_GROWN = math.comb(2 * _DIFFERENCES, _DIFFERENCES)
#: Standard deviation of the same differences of a motion whose acceleration changes at every
#: sample, in accelerations times squared sample periods: between 1.1 and 1.5.
_OF_MOTION = 1.5


def showing_time(trajectory: Trajectory, vehicle: Vehicle) -> float:
    """Return the time after which commanded motion stands out from the noise of poses [s].

    A craft of acceleration a moves by a t²/2; the noise is the white part of measured positions.
    At most 3; 0 if the recording is too short or nothing is commanded.
    """
    usable = trajectory.usable
    if len(usable) <= _DIFFERENCES:
        return 0.0
    whole = np.lib.stride_tricks.sliding_window_view(usable, _DIFFERENCES + 1).all(axis=1)
    steps = np.diff(trajectory.state[:, :2], n=_DIFFERENCES, axis=0)[whole]
    command = hold(trajectory.command_time, trajectory.command, trajectory.time[usable])
    force = thrust(vehicle.nominal_thrust, command.T)
    push = np.asarray(nominal_model(vehicle).dynamics.configuration)[:2] @ force
    usual = float(np.sqrt(np.mean(push**2))) if push.size else 0.0
    if not (len(steps) and usual > 0):
        return 0.0
    # The median of squares: jumps and blows do not count.
    seen = float(np.median(np.abs(steps)) / 0.6745) ** 2
    motion = (_OF_MOTION * usual * trajectory.sample_period**2) ** 2
    noise = math.sqrt(max(seen - motion, 0.0) / _GROWN)
    return min(math.sqrt(2 * _CLEAR * noise / usual), _LONGEST)
