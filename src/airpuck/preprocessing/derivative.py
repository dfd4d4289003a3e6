"""Velocity and acceleration from smoothed poses (subsec:data_preprocessing).

Poses of a slow craft are noisier than their motion and are smoothed for longer. The time follows
from the white noise σ of the poses, their rate f, and the acceleration a that a typical actuator
causes at full command (`airpuck.deviation.time_scale`), for positions and for yaw.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.polynomial.polynomial import polyvander

from airpuck.craft.vehicle import Vehicle
from airpuck.data.sampling import longest_bridge, runs, usual_period
from airpuck.data.trajectory import Span, Trajectory, vehicle_of
from airpuck.deviation.time_scale import measured_poses, pose_noise, usual_pushes

#: Order of the smoothing polynomials, and their time spans for velocity and for acceleration: 11
#: and 15 samples at 240 Hz [s]. Both grow in proportion for a slow craft
#: (`airpuck.deviation.time_scale`).
POLYNOMIAL_ORDER = 3
VELOCITY_TIME, ACCELERATION_TIME = 11 / 240, 15 / 240
#: Minimum number of samples for a second derivative.
_FEWEST = 5
#: Number of samples in windows that are processed at once, which bounds memory.
_AT_ONCE = 1 << 20
#: Deviation of a step from the period, relative to it, above which smoothing around that step uses
#: actual times. By sample numbers alone, a jitter of 3 % quadruples errors of acceleration.
_UNEVEN = 0.02
#: Weight of an interpolated pose, which only keeps local polynomials determined.
_INTERPOLATED = 1e-6
#: Cause of a span around a jump.
JUMP = "jumping pose"
#: Longest useful time [s]: beyond it, cables, slopes and draughts matter more than pose noise.
_LONGEST = 0.5
#: The slope of a cubic over L has the variance 75 σ²/(f L³). Where the acceleration jumps by a, its
#: bias is 0.039 a L at the jump and less beside it; this is the usual bias in units of a L.
_SLOPE_NOISE, _SLOPE_BIAS = 75.0, 0.035


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
    # Projects the samples of a window onto polynomials: row k is their value at sample k. SciPy's
    # filter gives the same result, but importing scipy.signal takes longer than all of
    # preprocessing.
    half = window // 2
    basis, _ = np.linalg.qr(np.vander(np.arange(-half, half + 1) / half, POLYNOMIAL_ORDER + 1))
    fitted = basis @ basis.T
    inner = np.lib.stride_tricks.sliding_window_view(values, window, axis=0) @ fitted[half]
    ends = fitted[:half] @ values[:window], fitted[half + 1 :] @ values[-window:]
    smoothed = np.concatenate([ends[0], inner, ends[1]])
    uneven = (np.abs(steps / own - 1) > _UNEVEN) | (own != np.median(steps))
    passed = np.concatenate([[0], np.cumsum(uneven)])
    first = np.clip(np.arange(len(time)) - half, 0, len(time) - window)
    places = np.flatnonzero(passed[first + window - 1] > passed[first])
    smoothed[places] = _smooth_unevenly(time, values, window, np.ones_like(time), places)
    return smoothed


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
        basis, _ = np.linalg.qr(root[index][..., None] * polyvander(offset, POLYNOMIAL_ORDER))
        own = basis[np.arange(len(each)), each - first] / root[each, None]
        shares = np.einsum("np,nwp->nw", own, basis) * root[index]
        found[part] = np.einsum("nw,nwk->nk", shares, values[index])
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
        powers = polyvander((time[index] - time[each, None]) / half, POLYNOMIAL_ORDER)
        moments = np.swapaxes(powers, 1, 2)
        coefficients = np.linalg.solve(moments @ powers, moments @ values[index])
        found[each] = math.factorial(order) * coefficients[:, order] / half**order
    return found


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
    return min(max((1.5 * _SLOPE_NOISE * ratio) ** 0.2, VELOCITY_TIME), _LONGEST)


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


def smooth_stretches(
    time: Float[np.ndarray, " N"],
    bridged: Bool[np.ndarray, " N"],
    duration: float,
    spans: Sequence[Span],
) -> list[slice]:
    """Cut a stream where smoothing must not reach across.

    These are pauses that leave velocities unknown and, for longer smoothing than usual, jumps among
    excluded spans: the usual smoothing affects no poses beyond the span of a jump.
    """
    cuts = set((np.flatnonzero(np.diff(time) > longest_bridge(usual_period(time))) + 1).tolist())
    if duration > VELOCITY_TIME:
        jumps = [edge for span in spans if span.cause == JUMP for edge in (span.start, span.stop)]
        cuts.update(np.searchsorted(time, jumps).tolist())
    found = []
    for first, last in runs(bridged):
        inside = sorted(cut for cut in cuts if first < cut < last)
        found += [slice(a, b) for a, b in pairwise([first, *inside, last])]
    return found


def is_slow(trajectory: Trajectory) -> bool:
    """Return whether the poses of a recording were smoothed for longer than usual."""
    durations = smoothing_times(*measured_poses(trajectory), vehicle_of([trajectory]))
    return max(durations) > VELOCITY_TIME


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
