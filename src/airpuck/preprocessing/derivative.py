"""Velocity and acceleration from smoothed poses (subsec:data_preprocessing)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

#: Order of the smoothing polynomials, and samples they span for velocity and for acceleration.
POLYNOMIAL_ORDER = 3
VELOCITY_WINDOW = 11
ACCELERATION_WINDOW = 15


def unwrap_yaw(yaw: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Make a yaw that is wrapped to one turn continuous."""
    turns = np.cumsum(np.rint(np.diff(yaw) / (2 * np.pi)))
    # Whole turns are added to the measured number, so that no digit of it is lost.
    return yaw - 2 * np.pi * np.concatenate([[0.0], turns])


def smooth(values: Float[np.ndarray, "N k"], window: int) -> Float[np.ndarray, "N k"]:
    """Smooth by local cubic polynomials (Savitzky-Golay)."""
    # Projects the samples of a window onto polynomials: row k is their value at sample k. SciPy's
    # filter gives the same, but importing scipy.signal takes longer than all of preprocessing.
    half = window // 2
    basis, _ = np.linalg.qr(np.vander(np.arange(-half, half + 1) / half, POLYNOMIAL_ORDER + 1))
    fitted = basis @ basis.T
    inner = np.lib.stride_tricks.sliding_window_view(values, window, axis=0) @ fitted[half]
    ends = fitted[:half] @ values[:window], fitted[half + 1 :] @ values[-window:]
    return np.concatenate([ends[0], inner, ends[1]])


def velocity(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"]
) -> Float[np.ndarray, "N k"]:
    """Differentiate once: smooth over 11 samples, then second-order differences."""
    return np.gradient(smooth(values, VELOCITY_WINDOW), time, axis=0, edge_order=2)


def acceleration(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"]
) -> Float[np.ndarray, "N k"]:
    """Differentiate twice: smooth over 15 samples, then the second divided difference."""
    smoothed = smooth(values, ACCELERATION_WINDOW)
    before, after = np.diff(time)[:-1, None], np.diff(time)[1:, None]
    inner = (
        2
        * (smoothed[:-2] * after - smoothed[1:-1] * (before + after) + smoothed[2:] * before)
        / (before * after * (before + after))
    )
    ends = [
        2 * np.polynomial.polynomial.polyfit(time[part] - time[end], smoothed[part], 3)[2:3]
        for part, end in ((slice(0, 4), 0), (slice(-4, None), -1))
    ]
    return np.concatenate([ends[0], inner, ends[1]])
