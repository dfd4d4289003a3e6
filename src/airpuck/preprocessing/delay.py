"""Transport delay: how many samples the motion lags what the commands explain (subsec:data)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import Dynamics
from airpuck.physics.rigid_body import acceleration as model_acceleration

#: Longest delay that is looked for [s].
LONGEST = 0.5


@dataclass(frozen=True)
class DelayEstimate:
    """Result of the correlation."""

    #: Delay in samples of the motion capture.
    samples: int
    #: Correlation of modelled and measured accelerations at that delay, mean over x, y and yaw.
    correlation: float
    #: Times that the signals were correlated until no shift was left.
    passes: int


def estimate_delay(
    time: Float[np.ndarray, " N"],
    state: Float[np.ndarray, "N 6"],
    acceleration: Float[np.ndarray, "N 3"],
    command: Float[np.ndarray, "N n"],
    dynamics: Dynamics,
    usable: Bool[np.ndarray, " N"] | None = None,
) -> DelayEstimate:
    """Find the delay at which modelled accelerations fit the measured ones best.

    Modelled and measured accelerations are correlated channel by channel; commands are shifted by
    the mean of the three best lags, and this is repeated, since the modelled acceleration depends
    on the yaw it is paired with, until no shift is left.
    """
    usable = np.ones(len(time), dtype=bool) if usable is None else usable
    speed = motor_speeds(time, command, dynamics.motor_time_constant)
    limit = round(LONGEST / float(np.median(np.diff(time))))
    shift, passes, peak = 0, 0, 0.0
    visited: set[int] = set()
    # Shifts cannot oscillate for ever: a shift that comes back ends the search.
    while shift not in visited:
        visited.add(shift)
        passes += 1
        # Sample k of the motion is paired with the motor speed `shift` samples before.
        motion = slice(max(shift, 0), len(time) + min(shift, 0))
        cause = slice(max(-shift, 0), len(time) - max(shift, 0))
        modelled = np.stack(model_acceleration(np, dynamics, state[motion, 2:].T, speed[cause].T))
        # Only one of the two is masked: what both lack would correlate, at no lag.
        measured = acceleration[motion].T * usable[motion]
        lags, peaks = zip(
            *(_best_lag(a, b, limit) for a, b in zip(measured, modelled, strict=True)), strict=True
        )
        peak = float(np.mean(peaks))
        shift = int(np.clip(shift + np.rint(np.mean(lags)), -limit, limit))
    return DelayEstimate(samples=shift, correlation=peak, passes=passes)


def _best_lag(
    measured: Float[np.ndarray, " N"], modelled: Float[np.ndarray, " N"], limit: int
) -> tuple[int, float]:
    """Return the lag of `measured` behind `modelled`, and the correlation coefficient there."""
    limit = min(limit, len(modelled) - 1)
    # Over a circle that is long enough for no lag of interest to go round it.
    size = 1 << (len(measured) + limit).bit_length()
    spectrum = np.fft.rfft(measured, size) * np.fft.rfft(modelled, size).conj()
    full = np.fft.irfft(spectrum, size)
    window = full[np.arange(-limit, limit + 1)]
    best = int(np.argmax(window))
    norm = float(np.linalg.norm(measured) * np.linalg.norm(modelled))
    return best - limit, float(window[best]) / norm if norm > 0 else 0.0
