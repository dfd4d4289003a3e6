"""Velocity and acceleration from smoothed poses (subsec:data_preprocessing)."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.data.sampling import usual_period

#: Order of the smoothing polynomials, and their time spans for velocity and for acceleration: 11
#: and 15 samples at 240 Hz [s]. Both grow in proportion for a slow craft
#: (`airpuck.deviation.time_scale`).
POLYNOMIAL_ORDER = 3
VELOCITY_TIME, ACCELERATION_TIME = 11 / 240, 15 / 240
#: Minimum number of samples for a second derivative.
_FEWEST = 5
#: Number of samples in windows that are processed at once, which bounds memory.
_AT_ONCE = 1 << 20
#: Deviation of a step from the period, relative to it, above which smoothing uses actual times.
_UNEVEN = 0.1
#: Weight of an interpolated pose, which only keeps local polynomials determined.
_INTERPOLATED = 1e-6


def window_length(duration: float, period: float) -> int:
    """Return the odd number of samples closest to a duration."""
    return 2 * max(round((duration / period - 1) / 2), 1) + 1


def shortest_stretch(period: float) -> int:
    """Return how many consecutive samples velocity and acceleration need."""
    return max(window_length(ACCELERATION_TIME, period), _FEWEST)


def unwrap_yaw(yaw: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Make a yaw that is wrapped to one turn continuous."""
    turns = np.cumsum(np.rint(np.diff(yaw) / (2 * np.pi)))
    # Whole turns are added to the measured number, so no digit of it is lost.
    return yaw - 2 * np.pi * np.concatenate([[0.0], turns])


def smooth(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N k"],
    period: float | None = None,
    duration: float = VELOCITY_TIME,
    measured: Bool[np.ndarray, " N"] | None = None,
) -> Float[np.ndarray, "N k"]:
    """Smooth with local cubic polynomials (Savitzky-Golay).

    If a window has no more poses than a cubic has coefficients, poses are not smoothed: their
    differences contain little noise. If `time` is a stretch between gaps, `period` is the usual
    sample period of the whole recording, which a few samples may not show. Values that are not
    `measured` do not count.
    """
    own = usual_period(time)
    window = window_length(duration, own if period is None else period)
    window = min(window, len(time) - 1 + len(time) % 2)
    if window <= POLYNOMIAL_ORDER + 1:
        return values
    values, steps = _filled(time, values, window, measured), np.diff(time)
    if own != np.median(steps) or np.abs(steps / own - 1).max() > _UNEVEN:
        return _smooth_unevenly(time, values, window, np.ones_like(time), np.arange(len(time)))
    # Projects the samples of a window onto polynomials: row k is their value at sample k. SciPy's
    # filter gives the same result, but importing scipy.signal takes longer than all of
    # preprocessing.
    half = window // 2
    basis, _ = np.linalg.qr(np.vander(np.arange(-half, half + 1) / half, POLYNOMIAL_ORDER + 1))
    fitted = basis @ basis.T
    inner = np.lib.stride_tricks.sliding_window_view(values, window, axis=0) @ fitted[half]
    ends = fitted[:half] @ values[:window], fitted[half + 1 :] @ values[-window:]
    return np.concatenate([ends[0], inner, ends[1]])


def _filled(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N k"],
    window: int,
    measured: Bool[np.ndarray, " N"] | None,
) -> Float[np.ndarray, "N k"]:
    """Replace lost poses by local cubics through the measured ones around them.

    Smoothing is then the same at all samples, so that its errors remain alike at neighbours.
    """
    if measured is None or measured.all():
        return values
    values, lost = values.copy(), np.flatnonzero(~measured)
    weight = np.where(measured, 1.0, _INTERPOLATED)
    values[lost] = _smooth_unevenly(time, values, window, weight, lost)
    return values


def _smooth_unevenly(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N k"],
    window: int,
    weight: Float[np.ndarray, " N"],
    places: Int[np.ndarray, " M"],
) -> Float[np.ndarray, "M k"]:
    """Smooth at some samples with local cubic polynomials in the actual times."""
    found, root = np.empty((len(places), values.shape[1])), np.sqrt(weight)
    size = max(_AT_ONCE // window, 1)
    for part in np.split(np.arange(len(places)), range(size, len(places), size)):
        each = places[part]
        first = np.clip(each - window // 2, 0, len(time) - window)
        index = first[:, None] + np.arange(window)
        offset = (time[index] - time[each, None]) / (time[index[:, -1:]] - time[index[:, :1]])
        powers = offset[..., None] ** np.arange(POLYNOMIAL_ORDER + 1)
        basis, _ = np.linalg.qr(root[index][..., None] * powers)
        own = basis[np.arange(len(each)), each - first] / root[each, None]
        found[part] = np.einsum("np,nwp,nw,nwk->nk", own, basis, root[index], values[index])
    return found


def acceleration_time(duration: float) -> float:
    """Return the time span of smoothing for accelerations, given the span for velocities [s]."""
    return ACCELERATION_TIME * (duration / VELOCITY_TIME)


def velocity(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N k"],
    period: float | None = None,
    duration: float = VELOCITY_TIME,
    measured: Bool[np.ndarray, " N"] | None = None,
) -> Float[np.ndarray, "N k"]:
    """Differentiate once: smooth over 46 ms, then take second-order differences.

    For longer smoothing, return the slopes of local polynomials, which contain less noise.
    """
    if duration > VELOCITY_TIME:
        return _local_derivative(time, values, duration, period, 1, measured)
    return np.gradient(smooth(time, values, period, duration, measured), time, axis=0, edge_order=2)


def acceleration(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N k"],
    period: float | None = None,
    duration: float = VELOCITY_TIME,
    measured: Bool[np.ndarray, " N"] | None = None,
) -> Float[np.ndarray, "N k"]:
    """Differentiate twice: smooth over 62 ms, then take the second divided difference.

    If velocities are smoothed for longer, return the curvatures of local polynomials.
    """
    if duration > VELOCITY_TIME:
        return _local_derivative(time, values, acceleration_time(duration), period, 2, measured)
    smoothed = smooth(time, values, period, ACCELERATION_TIME, measured)
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


def _local_derivative(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N k"],
    duration: float,
    period: float | None,
    order: int,
    measured: Bool[np.ndarray, " N"] | None,
) -> Float[np.ndarray, "N k"]:
    """Return a derivative of cubic polynomials through the neighbours of each sample."""
    window = window_length(duration, usual_period(time) if period is None else period)
    # In a stretch shorter than the window, the window shrinks.
    window = min(max(window, _FEWEST), len(time) - 1 + len(time) % 2)
    found, values = np.empty_like(values), _filled(time, values, window, measured)
    size = max(_AT_ONCE // window, 1)
    for each in np.split(np.arange(len(time)), range(size, len(time), size)):
        first = np.clip(each - window // 2, 0, len(time) - window)
        index = first[:, None] + np.arange(window)
        half = (time[first + window - 1] - time[first])[:, None] / 2
        powers = ((time[index] - time[each, None]) / half)[..., None] ** np.arange(
            POLYNOMIAL_ORDER + 1
        )
        moments = np.swapaxes(powers, 1, 2)
        coefficients = np.linalg.solve(moments @ powers, moments @ values[index])
        found[each] = math.factorial(order) * coefficients[:, order] / half**order
    return found
