"""Data quality: requirements on streams, unusable samples, and lost frames of the cameras.

A prediction needs a start and commands, but not every pose. So a sample stands for each lost frame:
windows of equally many samples last equally long. Its state is interpolated and marked as not
measured. Only a long pause remains a gap.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.data.sampling import longest_bridge, runs, usual_period
from airpuck.data.trajectory import Span, Trajectory
from airpuck.preprocessing.derivative import ACCELERATION_TIME, JUMP, window_length
from airpuck.recording.stream import Stream

#: Cause of the spans that are left out beside a step of a clock.
CLOCK_STEP = "clock step"
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
#: A pause between commands longer than this many periods leaves the motors' input unknown.
COMMAND_GAP_PERIODS = 10
#: Number of regular steps required on both sides of a clock's step, and their relative tolerance.
_BESIDE, _REGULAR = 3, 0.3
#: Largest fraction of samples that may be dropped because their stamps go back.
_DROPPED = 0.2
#: Smallest step of a clock that the motion shows [s]; poses on either side that give velocities;
#: error of the motion if the clock did not step, and if it did [standard errors of a pose].
_STEP, _SLOPES, _STRANGE, _USUAL = 8e-3, 8, 15.0, 5.0
#: Plausible time steps between motion-capture poses [s].
_PERIODS = (1e-4, 0.5)
#: Plausible steps between commands, which may be logged only when they change [s], and the fewest
#: commands to judge by.
_COMMAND_PERIODS = (5e-5, 5.0)
_FEW = 20
#: Longest pause that is no gap [s]: 0.1 s of lost frames. Longer ones hide what the craft does.
_LONGEST = 0.125
#: Fraction of lost frames that is mentioned.
_MENTIONED = 0.001
#: Causes that are described in words, singular and plural.
_NOUNS = {
    "gap": ("gap", "gaps"),
    "frozen pose": ("frozen pose", "frozen poses"),
    "jumping pose": ("jump", "jumps"),
    "no commands": ("pause of the commands", "pauses of the commands"),
    "contact": ("contact", "contacts"),
}


class Samples(NamedTuple):
    """Samples of a stream in strictly increasing time."""

    #: Times [s].
    time: Float[np.ndarray, " N"]
    values: Float[np.ndarray, "N k"]
    #: Descriptions of dropped samples.
    warnings: tuple[str, ...] = ()
    #: Times after which the sender's clock was set back [s].
    breaks: tuple[float, ...] = ()


def check_poses(pose: Stream, time: Float[np.ndarray, " N"]) -> None:
    """Raise InputError if poses cannot be in metres and radians."""
    _check_finite(pose, time, "pose")
    position, yaw = pose.values[:, :2], pose.values[:, 2]
    if np.abs(position).max() > 50:
        raise InputError(
            f"positions reach {np.abs(position).max():.4g}, which is too large for an air-hockey "
            'table in metres; for millimetres, name the mapping\'s unit: pose = {units = ["mm"]}',
            field="pose.position",
        )
    period, mean = _period(time), float(np.mean(np.abs(np.diff(time)))) if len(time) > 1 else 0.0
    if period and not _PERIODS[0] <= period <= _PERIODS[1]:
        bursts = _PERIODS[0] <= mean <= _PERIODS[1]
        remedy = "; they come in bursts" if bursts else _other_unit(period, "pose")
        raise InputError(
            f"poses come every {period:.3g} s, which is implausible for motion capture{remedy}",
            field="time",
        )
    jumps = np.abs(np.diff(yaw))
    # In radians a wrapped yaw stays within ±π and a continuous one has no jumps.
    wraps_at_360 = np.any((jumps > 300) & (jumps < 361))
    spins_too_fast = len(jumps) > 0 and period > 0 and np.quantile(jumps, 0.9) / period > 100
    if np.abs(yaw).max() > 2 * np.pi and (wraps_at_360 or spins_too_fast):
        raise InputError(
            f"yaw reaches {np.abs(yaw).max():.4g} and looks like degrees; "
            'name them among the mapping\'s units: pose = {units = ["deg"]}',
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
    command: Stream, time: Float[np.ndarray, " K"], lowest: float | Float[np.ndarray, " c"] = 0.0
) -> None:
    """Raise InputError for commands below the lowest, above 1, or at an implausible rate."""
    _check_finite(command, time, "command")
    period = _period(time) if len(time) > _FEW else 0.0
    if period and not _COMMAND_PERIODS[0] <= period <= _COMMAND_PERIODS[1]:
        raise InputError(
            f"commands come every {period:.3g} s, which is implausible for a controller"
            f"{_other_unit(period, 'command')}",
            field="time",
        )
    least = np.broadcast_to(lowest, command.values.shape[1:])
    outside = (command.values < least) | (command.values > 1)
    if outside.any():
        row, column = np.argwhere(outside)[0]
        raise InputError(
            f"command {command.values[row, column]:g} at {time[row]:.3f} s is outside "
            f"[{least[column]:.0f}, 1]; set its scale in a mapping file: "
            "command = {scale = 0.01} for percent, {neutral = 1000, span = 1000} for pulses of 1 "
            "to 2 ms; `disarmed` is a value that means stopped",
            field=command.columns[column],
        )


def _period(time: Float[np.ndarray, " N"]) -> float:
    """Return the usual step between stamps, which may repeat; 0 if undefined [s]."""
    steps = np.abs(np.diff(time))
    return float(np.median(steps[steps > 0])) if steps.any() else 0.0


def _check_finite(stream: Stream, time: Float[np.ndarray, " N"], kind: str) -> None:
    """Raise InputError for NaN and infinity."""
    bad = ~np.isfinite(stream.values)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(
            f"{int(bad.any(axis=1).sum())} of {len(stream)} {kind}s are not finite, the first at "
            f"{time[row]:.3f} s (row {row + 1}); remove these rows (missing samples are "
            "then treated as a gap)",
            field=stream.columns[column],
        )


def drop_disorder(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"], kind: str
) -> Samples:
    """Drop samples whose stamp repeats an earlier one or precedes it.

    A clock was set back where stamps go back between regular steps.
    """
    if len(time) == 0:
        return Samples(time, values)
    latest = np.maximum.accumulate(time)
    ahead = np.concatenate([[True], time[1:] > latest[:-1]])
    duplicated = np.concatenate([[False], time[1:] == latest[:-1]])
    backward = ~ahead & ~duplicated
    lost = backward & ~np.isin(time, time[ahead])
    if lost.mean() > _DROPPED:
        first = int(np.argmax(lost))
        raise InputError(
            f"{int(lost.sum())} of {len(time)} {kind}s have stamps before earlier ones, from "
            f"row {first + 1} on, where time goes back by {latest[first] - time[first]:.3f} s: its "
            "clock was set back, or recordings were joined; cut it there",
            field="time",
        )
    warnings = []
    for found, what in ((duplicated, "a duplicated stamp"), (backward, "a stamp that goes back")):
        if found.any():
            warnings.append(
                f"dropped {int(found.sum())} of the {kind} samples, with {what}, "
                f"the first at {time[found][0]:.3f} s"
            )
    steps, usual = np.diff(time), _period(time)
    odd = np.abs(steps - usual) > _REGULAR * usual
    back = np.flatnonzero((steps < 0) & ~ahead[1:]).tolist()
    back = [k for k in back if _lone(odd, k) and ahead[k + 1 :].any()]
    warnings += [
        f"the clock of the {kind}s is set back by {1e3 * (usual - steps[k]):.0f} ms after "
        f"{time[k]:.3f} s"
        for k in back
    ]
    return Samples(time[ahead], values[ahead], tuple(warnings), tuple(time[back].tolist()))


def _lone(odd: Bool[np.ndarray, " N"], k: int) -> bool:
    """Return whether a step is odd, and those before and after it are not."""
    near = odd[max(k - _BESIDE, 0) : k + _BESIDE + 1]
    return bool(len(near) == 2 * _BESIDE + 1 and odd[k] and near.sum() == 1)


def steps_of_motion(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N 3"]
) -> dict[float, float]:
    """Return steps of the cameras' clock [s] by time: pauses in which the craft moves little.

    During lost frames, it moves on with the velocity that it has before and after them.
    """
    period, found = usual_period(time), {}
    if len(time) < 2 * _SLOPES:
        return found
    noise = np.median(np.abs(np.diff(values, 2, axis=0)), axis=0) / (0.6745 * math.sqrt(6)) + 1e-12
    steps = np.diff(time)
    odd = np.abs(steps - period) > _REGULAR * period
    for k in np.flatnonzero((steps > period + _STEP) & (steps <= longest_pause(period))).tolist():
        sides = slice(k + 1 - _SLOPES, k + 1), slice(k + 1, k + 1 + _SLOPES)
        if not _lone(odd, k) or k < _SLOPES or k + _SLOPES >= len(time):
            continue
        lines = [
            np.polyfit(time[side] - time[at], values[side] / noise, 1)
            for side, at in zip(sides, (k, k + 1), strict=True)
        ]
        moved, velocity = lines[1][1] - lines[0][1], (lines[0][0] + lines[1][0]) / 2
        strange, usual = (np.linalg.norm(moved - velocity * t) for t in (steps[k], period))
        if strange > _STRANGE and usual < _USUAL:
            found[float(time[k])] = float(steps[k] - period)
    return found


def other_parts(time: Float[np.ndarray, " N"], breaks: Sequence[float]) -> tuple[Span, ...]:
    """Return all but the longest part between steps of clocks: one delay does not hold in all."""
    parts = list(pairwise([float(time[0]), *sorted(breaks), float(time[-1])]))
    longest = max(parts, key=lambda part: part[1] - part[0])
    return tuple(Span(*part, CLOCK_STEP) for part in parts if part != longest)


def find_gaps(
    time: Float[np.ndarray, " N"], longest: float, cause: str = "gap"
) -> tuple[Span, ...]:
    """Find pauses in a stream that are longer than `longest` [s]."""
    before = np.flatnonzero(np.diff(time) > longest)
    return tuple(Span(float(time[k]), float(time[k + 1]), cause) for k in before)


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
    from scipy.ndimage import median_filter

    rate = np.diff(values, axis=0) / pause[:, None]
    usual = [median_filter(column, neighbours, mode="nearest") for column in rate.T]
    leap = np.abs(rate - np.stack(usual, axis=1))
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
        Span(float(time[first]), float(time[last - 1]), JUMP) for first, last in runs(spoilt)
    )


def longest_pause(period: float) -> float:
    """Return the longest pause between poses that is no gap [s]."""
    return max(_LONGEST, longest_bridge(period))


def with_lost_frames(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"]
) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M k"], Bool[np.ndarray, " M"]]:
    """Add a sample for each lost frame; return times, values, and which are measured."""
    pause, period = np.diff(time), usual_period(time)
    lost = np.where(pause <= longest_pause(period), np.rint(pause / period) - 1, 0)
    lost = np.maximum(lost, 0).astype(int)
    before = np.repeat(np.arange(len(pause)), lost)
    number = 1 + np.arange(len(before)) - np.repeat(np.cumsum(lost) - lost, lost)
    added = time[before] + pause[before] * number / (lost[before] + 1)
    order = np.argsort(np.concatenate([time, added]), kind="stable")
    measured = order < len(time)
    between = np.concatenate([values, np.zeros((len(added), values.shape[1]))])[order]
    times = np.concatenate([time, added])[order]
    if len(added):
        rates = np.zeros_like(between)
        rates[measured] = np.gradient(values, time, axis=0)
        between, _ = interpolated(times, between, rates, measured)
    return times, between, measured


def interpolated(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N k"],
    rates: Float[np.ndarray, "N k"],
    known: Bool[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "N k"], Float[np.ndarray, "N k"]]:
    """Fill in unknown values and rates from cubics between their known neighbours."""
    places, unknown = np.flatnonzero(known), np.flatnonzero(~known)
    # Unknown samples beyond the first or the last known one keep what they have.
    unknown = unknown[(unknown > places[0]) & (unknown < places[-1])]
    after = np.searchsorted(places, unknown)
    begin, end = places[after - 1], places[after]
    length = (time[end] - time[begin])[:, None]
    u = (time[unknown] - time[begin])[:, None] / length
    step = values[end] - values[begin]
    first, last = length * rates[begin] - step, step - length * rates[end]
    values, rates = values.copy(), rates.copy()
    values[unknown] = values[begin] + u * step + u * (1 - u) * (first * (1 - u) + last * u)
    slope = (1 - 2 * u) * (first * (1 - u) + last * u) + u * (1 - u) * (last - first)
    rates[unknown] = (step + slope) / length
    return values, rates


def lost_frames_words(
    time: Float[np.ndarray, " N"], measured: Bool[np.ndarray, " N"]
) -> tuple[str, ...]:
    """Return a warning that states how many frames are lost, if any number worth mentioning."""
    share = 1 - float(measured.mean())
    if share < _MENTIONED:
        return ()
    known = time[measured]
    pause = np.diff(known)
    longest = float(pause[pause <= longest_pause(usual_period(known))].max())
    return (
        f"{100 * share:.1f} % of the frames are lost (up to {longest:.3f} s in a row); they count "
        "as poses that were not measured",
    )


def left_out_words(trajectory: Trajectory) -> str:
    """Describe which fraction of the time must not be used, and why.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory, possibly with faults excluded, too.

    Returns
    -------
    str
        For example ``left out: 3.1 % (2 gaps, 14 jumps; longest 0.21 s at 31.2 s)``.
    """
    first, last = trajectory.time[[0, -1]]
    spans = [s for s in trajectory.excluded if s.stop >= first and s.start <= last]
    if not spans:
        return "left out: nothing"
    causes = Counter(span.cause for span in spans)
    counted = ", ".join(_counted(cause, count) for cause, count in causes.items())
    longest = max(spans, key=lambda span: span.stop - span.start)
    return (
        f"left out: {100 * (1 - trajectory.usable_share):.1f} % ({counted}; longest "
        f"{longest.stop - longest.start:.2f} s at {longest.start:.1f} s)"
    )


def left_out_json(trajectory: Trajectory) -> dict[str, Any]:
    """Return the usable fraction of the time, and all excluded spans."""
    return {
        "usable": trajectory.usable_share,
        "excluded": [vars(span) for span in trajectory.excluded],
    }


def _counted(cause: str, count: int) -> str:
    """Write how often a cause occurred."""
    if cause in _NOUNS:
        return f"{count} {_NOUNS[cause][count > 1]}"
    return cause if count == 1 else f"{count} × {cause}"
