"""Data quality: requirements on streams, and detection of unusable samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.data.sampling import longest_bridge, runs, usual_period
from airpuck.data.trajectory import Span
from airpuck.preprocessing.derivative import ACCELERATION_TIME, VELOCITY_TIME, window_length
from airpuck.recording.stream import Stream

#: A pose that repeats exactly for this long [s] and this many times is frozen: real measurements
#: have noise.
_FROZEN_TIME, _FROZEN_LEAST = 5 / 240, 3
#: A pose jumps if its step differs from neighbouring steps by this multiple of the usual
#: difference, and by at least this speed [m/s, m/s, rad/s]: at 240 Hz, 1 mm and 0.02 rad. A blow is
#: not a jump: it changes all later steps alike.
_JUMP_RATIO = 10.0
_JUMP_SPEED = (0.24, 0.24, 4.8)
#: Time span of a step's neighbours, centred on the step [s].
_NEIGHBOURS = 11 / 240
#: Cause of a span around a jump.
_JUMP = "jumping pose"
#: Number of windows sorted at once, which bounds memory.
_SORTED_AT_ONCE = 1 << 14
#: A pause between commands longer than this many periods leaves the motors' input unknown.
COMMAND_GAP_PERIODS = 10
#: Plausible time steps between motion-capture poses [s].
_PERIODS = (1e-4, 0.5)
#: Plausible steps between commands, which may be logged only when they change [s], and the fewest
#: commands to judge by.
_COMMAND_PERIODS = (5e-5, 5.0)
_FEW = 20


class Samples(NamedTuple):
    """Samples of a stream in strictly increasing time."""

    #: Times [s].
    time: Float[np.ndarray, " N"]
    values: Float[np.ndarray, "N k"]
    #: Descriptions of dropped samples.
    warnings: tuple[str, ...] = ()


def check_poses(pose: Stream, time: Float[np.ndarray, " N"], source: str) -> None:
    """Raise InputError if poses cannot be in metres and radians."""
    _check_finite(pose, time, "pose", source)
    position, yaw = pose.values[:, :2], pose.values[:, 2]
    if np.abs(position).max() > 50:
        raise InputError(
            f"positions reach {np.abs(position).max():.0f}, which is too large for an air-hockey "
            "table in "
            'metres; for millimetres, use a mapping: pose = {units = ["mm"]}',
            file=source,
            field="pose.position",
        )
    period, mean = _period(time), float(np.mean(np.abs(np.diff(time)))) if len(time) > 1 else 0.0
    if period and not _PERIODS[0] <= period <= _PERIODS[1]:
        bursts = _PERIODS[0] <= mean <= _PERIODS[1]
        remedy = "; they come in bursts" if bursts else _other_unit(period, "pose")
        raise InputError(
            f"poses come every {period:.3g} s, which is implausible for motion capture{remedy}",
            file=source,
            field="time",
        )
    jumps = np.abs(np.diff(yaw))
    # In radians a wrapped yaw stays within ±π and a continuous one has no jumps.
    wraps_at_360 = np.any((jumps > 300) & (jumps < 361))
    spins_too_fast = len(jumps) > 0 and period > 0 and np.quantile(jumps, 0.9) / period > 100
    if np.abs(yaw).max() > 2 * np.pi and (wraps_at_360 or spins_too_fast):
        raise InputError(
            f"yaw reaches {np.abs(yaw).max():.0f} and looks like degrees; "
            'use a mapping: pose = {units = ["deg"]}',
            file=source,
            field="pose.orientation.yaw",
        )


def _other_unit(period: float, stream: str) -> str:
    """Return a hint at the unit of time that would give a plausible rate."""
    # Compare with the middle of the plausible range, on a logarithmic scale.
    usual = math.sqrt(math.prod(_PERIODS))
    power = 3 * round(math.log10(usual / period) / 3)
    if power in (-3, -6, -9):
        unit = {-3: "ms", -6: "us", -9: "ns"}[power]
        return (
            f"; a unit of time 1e{power} times as long gives {period * 10.0**power:.3g} s: "
            f'in the mapping, {stream} = {{units = ["{unit}"]}} instead of seconds'
        )
    if power > 0:
        return f"; the mapping's unit of time is too small by a factor of about 1e{power}"
    return "; check the column or field of the time"


def check_commands(
    command: Stream,
    time: Float[np.ndarray, " K"],
    source: str,
    lowest: float | Float[np.ndarray, " c"] = 0.0,
) -> None:
    """Raise InputError for commands below the lowest, above 1, or at an implausible rate."""
    _check_finite(command, time, "command", source)
    period = _period(time) if len(time) > _FEW else 0.0
    if period and not _COMMAND_PERIODS[0] <= period <= _COMMAND_PERIODS[1]:
        raise InputError(
            f"commands come every {period:.3g} s, which is implausible for a controller"
            f"{_other_unit(period, 'command')}",
            file=source,
            field="time",
        )
    least = np.broadcast_to(lowest, command.values.shape[1:])
    outside = (command.values < least) | (command.values > 1)
    if outside.any():
        row, column = np.argwhere(outside)[0]
        raise InputError(
            f"command {command.values[row, column]:g} at {time[row]:.3f} s is outside "
            f"[{least[column]:.0f}, 1]; set its scale in a mapping file, "
            "for percent command = {scale = 0.01}; `disarmed` is a value that means stopped",
            file=source,
            field=command.columns[column],
        )


def _period(time: Float[np.ndarray, " N"]) -> float:
    """Return the usual step between stamps, which may repeat; 0 if undefined [s]."""
    steps = np.abs(np.diff(time))
    return float(np.median(steps[steps > 0])) if steps.any() else 0.0


def _check_finite(stream: Stream, time: Float[np.ndarray, " N"], kind: str, source: str) -> None:
    """Raise InputError for NaN and infinity."""
    bad = ~np.isfinite(stream.values)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(
            f"{int(bad.any(axis=1).sum())} of {len(stream)} {kind}s are not finite, the first at "
            f"{time[row]:.3f} s (row {row + 1}); remove these rows, what is missing is then "
            "treated as a gap",
            file=source,
            field=stream.columns[column],
        )


def drop_disorder(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"], kind: str
) -> Samples:
    """Drop samples whose stamp repeats an earlier one or precedes it."""
    if len(time) == 0:
        return Samples(time, values)
    latest = np.maximum.accumulate(time)
    ahead = np.concatenate([[True], time[1:] > latest[:-1]])
    duplicated = np.concatenate([[False], time[1:] == latest[:-1]])
    backward = ~ahead & ~duplicated
    warnings = []
    for found, what in ((duplicated, "a duplicated stamp"), (backward, "a stamp that goes back")):
        if found.any():
            warnings.append(
                f"dropped {int(found.sum())} of the {kind} samples, with {what}, "
                f"the first at {time[found][0]:.3f} s"
            )
    return Samples(time[ahead], values[ahead], tuple(warnings))


def find_gaps(
    time: Float[np.ndarray, " N"], longest: float, cause: str = "gap"
) -> tuple[Span, ...]:
    """Find pauses in a stream that are longer than `longest` [s]."""
    before = np.flatnonzero(np.diff(time) > longest)
    return tuple(Span(float(time[k]), float(time[k + 1]), cause) for k in before)


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
        jumps = [edge for span in spans if span.cause == _JUMP for edge in (span.start, span.stop)]
        cuts.update(np.searchsorted(time, jumps).tolist())
    found = []
    for first, last in runs(bridged):
        inside = sorted(cut for cut in cuts if first < cut < last)
        found += [slice(a, b) for a, b in pairwise([first, *inside, last])]
    return found


def find_frozen(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"]
) -> tuple[Span, ...]:
    """Find stretches over which a measurement repeats exactly."""
    if len(time) < 2:
        return ()
    least = max(round(_FROZEN_TIME / usual_period(time)), _FROZEN_LEAST)
    same = np.all(values[1:] == values[:-1], axis=1)
    return tuple(
        Span(float(time[first]), float(time[last]), "frozen pose")
        for first, last in runs(same)
        if last - first + 1 >= least
    )


def find_jumps(time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N 3"]) -> tuple[Span, ...]:
    """Find poses that jump, either for good or briefly."""
    if len(time) < 2:
        return ()
    pause, period = np.diff(time), usual_period(time)
    neighbours = window_length(_NEIGHBOURS, period)
    if len(time) < neighbours:
        return ()
    rate = np.diff(values, axis=0) / pause[:, None]
    leap = np.abs(rate - _running_median(rate, neighbours))
    limit = np.maximum(_JUMP_RATIO * np.median(leap, axis=0) / 0.6745, _JUMP_SPEED)
    # Beside a lost frame, a jump changes the rate half as much. Motion during a longer pause does
    # not count as a jump.
    leap *= np.clip(pause / period, 1, 2)[:, None]
    jumps = (leap > limit).any(axis=1) & (pause <= longest_bridge(period))
    spoilt = np.zeros(len(time), dtype=bool)
    # Smoothing also spoils its neighbours.
    reach = window_length(ACCELERATION_TIME, period) // 2
    for after in (np.flatnonzero(jumps) + 1).tolist():
        spoilt[max(after - reach, 0) : after + reach] = True
    return tuple(
        Span(float(time[first]), float(time[last - 1]), _JUMP) for first, last in runs(spoilt)
    )


def _running_median(values: Float[np.ndarray, "N k"], window: int) -> Float[np.ndarray, "N k"]:
    """Return medians over an odd number of neighbours, with both ends repeated."""
    half = window // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, window, axis=0)
    found = np.empty_like(values)
    # In chunks, since `partition` copies its input: an hour would take hundreds of megabytes.
    for first in range(0, len(values), _SORTED_AT_ONCE):
        part = slice(first, first + _SORTED_AT_ONCE)
        found[part] = np.partition(windows[part], half, axis=-1)[..., half]
    return found
