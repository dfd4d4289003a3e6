"""Times after which thrust stands out from the noise of poses.

They follow from the white noise σ of the poses, their rate f, and the acceleration a that a
typical actuator causes at full command. They matter only for craft slower than the paper's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.craft.vehicle import Vehicle
from airpuck.data.sampling import usual_period
from airpuck.data.trajectory import Trajectory
from airpuck.model.model_file import Model, nominal_model

#: Displacement that stands out, in standard deviations of the noise: fits of an air-bearing
#: satellite are best when predictions last until about then.
_CLEAR = 50.0
#: Longest useful time [s]: beyond it, cables, slopes and draughts matter more than pose noise.
_LONGEST = 3.0
#: Order of the differences of poses, which suppress motion, and their gain for white noise.
_DIFFERENCES = 3
_GROWN = math.comb(2 * _DIFFERENCES, _DIFFERENCES)
#: Standard deviation of the same differences of a motion whose acceleration changes at every
#: sample, in accelerations times squared sample periods: between 1.1 and 1.5.
_OF_MOTION = 1.5
#: A distance [m], and the time above which a craft that takes it counts as slow [s]: the paper's
#: craft takes 65 ms.
_CENTIMETRE, _USUAL_MOVE = 0.01, 0.075
#: Response time above which a craft counts as late [s], where the paper's has 49 ms; and largest
#: factor by which a controller is slowed for it.
_LATE, _LATEST = 0.08, 3.0
#: Time constants of the slowest motors after which a guess of their initial speed is forgotten to
#: 0.4 %.
FORGOTTEN = 5.5
#: Longest pause between poses that are compared, in sample periods.
_NO_GAP = 1.5


def showing_time(trajectories: Sequence[Trajectory], vehicle: Vehicle) -> float:
    """Return the time after which thrust stands out from the noise of all recordings' poses [s].

    A craft of acceleration a moves by a t²/2. At most 3; 0 if recordings are too short.
    """
    push, _ = usual_pushes(vehicle)
    seen = (measured_poses(one) for one in trajectories)
    return clear_time(max(pose_noise(time, pose[:, :2], push) for time, pose in seen), vehicle)


def clear_time(noise: float, vehicle: Vehicle) -> float:
    """Return the time after which thrust stands out from poses with a noise [m], at most 3 [s]."""
    push, _ = usual_pushes(vehicle)
    return min(math.sqrt(2 * _CLEAR * noise / push), _LONGEST) if push > 0 else 0.0


def forgetting_time(vehicle: Vehicle) -> float:
    """Return the time after which the slowest motors have forgotten an initial speed [s]."""
    return FORGOTTEN * float(np.max(nominal_model(vehicle).dynamics.lag))


def patience(vehicle: Vehicle) -> float:
    """Return how much larger timing errors a craft tolerates than the paper's: at least 1.

    A slow craft is less sensitive to timing errors, because its controllers act over longer times.
    The factor is proportional to the time in which an actuator at full command moves it by 1 cm.
    """
    push, _ = usual_pushes(vehicle)
    return max(1.0, math.sqrt(2 * _CENTIMETRE / push) / _USUAL_MOVE) if push > 0 else 1.0


def response_time(model: Model) -> Any:
    """Return the response time of the motors to a command: lag and delay together [s]."""
    return model.parameters.motor_time_constant + model.transport_delay


def lateness(model: Model) -> float:
    """Return the factor, 1 to 3, by which a controller is slowed if the motors answer late."""
    return float(np.clip(np.max(response_time(model)) / _LATE, 1.0, _LATEST))


def usual_pushes(vehicle: Vehicle) -> tuple[float, float]:
    """Return a typical actuator's accelerations at full command, linear and angular [m/s², rad/s²].

    0 if no actuator pushes, or none turns the craft.
    """
    model = nominal_model(vehicle)
    full = np.abs(np.asarray(model.dynamics.thrust).sum(axis=1))
    x, y, turn = np.abs(np.asarray(model.dynamics.configuration)) * full
    each = np.hypot(x, y), turn
    linear, angular = (float(np.median(one[one > 0])) if one.any() else 0.0 for one in each)
    return linear, angular


def measured_poses(
    trajectory: Trajectory,
) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M 3"]]:
    """Return times and values of the measured poses."""
    return trajectory.time[trajectory.measured], trajectory.state[trajectory.measured, :3]


def pose_noise(time: Float[np.ndarray, " N"], pose: Float[np.ndarray, "N k"], push: float) -> float:
    """Return the standard deviation of the white noise of poses; 0 if there are too few.

    Differences of poses contain the motion of a craft with the acceleration `push`, too.
    """
    if len(time) <= _DIFFERENCES:
        return 0.0
    period = usual_period(time)
    near = np.diff(time) < _NO_GAP * period
    whole = np.lib.stride_tricks.sliding_window_view(near, _DIFFERENCES).all(axis=1)
    steps = np.diff(pose, n=_DIFFERENCES, axis=0)[whole]
    if not len(steps):
        return 0.0
    # The median ignores jumps and impacts.
    seen = float(np.median(np.abs(steps))) / 0.6745
    motion = _OF_MOTION * push * period**2
    return math.sqrt(max(seen**2 - motion**2, 0.0) / _GROWN)
