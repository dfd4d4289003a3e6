"""Delay compensation (subsec:data_preprocessing): how far the motion lags the commands."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.window_regression import LEVEL, WindowRegression, regress_windows
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import Dynamics
from airpuck.physics.rigid_body import acceleration as model_acceleration
from airpuck.physics.thrust import thrust
from airpuck.preprocessing.derivative import smoothed_as_measured

#: Longest delay that the search covers.
LONGEST_S = numbers.DELAY.high
#: Correlation of modelled and measured accelerations above which commands cause the motion.
_CAUSED = 0.5
#: Least lead of the motion, in lengths of the windows whose mean accelerations show it.
_EARLY = 0.25


def visible_delay(trajectory: Trajectory, dynamics: Dynamics) -> float | None:
    """Return how long after their stamps commands seem to act [s], negative for before.

    None if the original shift of the commands is unknown, or if they explain too little.
    """
    shift, correlation = estimate_delay(trajectory, dynamics)
    if correlation < _CAUSED or not trajectory.delay_known:
        return None
    seen = trajectory.delay + shift * trajectory.sample_period
    if seen < 0 and not motion_precedes(trajectory, dynamics):
        return None
    return seen


def commands_explain(trajectory: Trajectory, dynamics: Dynamics) -> bool:
    """Return whether commands explain the motion beyond chance, however small the fraction."""
    return _explained(trajectory, dynamics) is not None


def motion_precedes(trajectory: Trajectory, dynamics: Dynamics) -> bool:
    """Return whether motion seems to begin before the commands that cause it.

    Unlike in `estimate_delay`, drag may explain part of the motion. Where feedback makes commands
    follow the motion, drag would otherwise look like an early effect of the next command.
    """
    found = _explained(trajectory, dynamics, before=True)
    return found is not None and found.delay < -_EARLY * found.length


def _explained(
    trajectory: Trajectory, dynamics: Dynamics, *, before: bool = False
) -> WindowRegression | None:
    """Return the regression on thrusts; None if they explain no more than chance."""
    speed = motor_speeds(trajectory.time, trajectory.input, dynamics.lag)
    forces, effects = thrust(dynamics.thrust, speed.T), np.asarray(dynamics.configuration)
    found = regress_windows(trajectory, forces, effects, LONGEST_S, before=before)
    return found if found is not None and found.p_value < LEVEL else None


def estimate_delay(trajectory: Trajectory, dynamics: Dynamics) -> tuple[int, float]:
    """Find the delay [samples] at which modelled accelerations fit the measured ones best.

    Modelled and measured accelerations are correlated channel by channel, and commands are shifted
    by the mean of the three best lags. This is repeated until no shift is left, because the
    modelled acceleration depends on the yaw at that time. The second number is the correlation
    coefficient at the result, averaged over x, y and yaw.
    """
    time = trajectory.time
    lag, idle = dynamics.lag, dynamics.idle_lag
    speed = motor_speeds(time, trajectory.input, lag, None if idle is None else float(idle))
    limit = round(LONGEST_S / trajectory.sample_period)
    shift, correlation = 0, 0.0
    visited, known = set[int](), trajectory.usable & trajectory.determined
    # Shifts cannot oscillate forever: the search ends when a shift recurs.
    while shift not in visited:
        visited.add(shift)
        # Sample k of the motion is paired with the motor speed `shift` samples before.
        motion = slice(max(shift, 0), len(time) + min(shift, 0))
        cause = slice(max(-shift, 0), len(time) - max(shift, 0))
        state = trajectory.state[motion, 2:]
        caused = np.zeros_like(trajectory.acceleration)
        caused[motion] = np.stack(model_acceleration(np, dynamics, state.T, speed[cause].T), axis=1)
        modelled = smoothed_as_measured(trajectory, caused)[motion].T
        # Mask only one of the two: gaps common to both would correlate at zero lag.
        measured = trajectory.acceleration[motion].T * known[motion]
        best = [_best_lag(a, b, limit) for a, b in zip(measured, modelled, strict=True)]
        lag, correlation = np.mean(best, axis=0)
        shift = int(np.clip(shift + np.rint(lag), -limit, limit))
    return shift, float(correlation)


def _best_lag(
    measured: Float[np.ndarray, " N"], modelled: Float[np.ndarray, " N"], limit: int
) -> tuple[int, float]:
    """Return the lag of `measured` behind `modelled`, and the correlation coefficient there."""
    limit = min(limit, len(modelled) - 1)
    # A circular correlation, padded so that no lag of interest wraps around.
    size = 1 << (len(measured) + limit).bit_length()
    spectrum = np.fft.rfft(measured, size) * np.fft.rfft(modelled, size).conj()
    window = np.fft.irfft(spectrum, size)[np.arange(-limit, limit + 1)]
    best = int(np.argmax(window))
    norm = float(np.linalg.norm(measured) * np.linalg.norm(modelled))
    return best - limit, float(window[best]) / norm if norm > 0 else 0.0
