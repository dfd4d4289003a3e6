"""The cameras' clock behind time stamps that were made on arrival.

A client stamps poses when it gets them: in bursts, and later by whatever the network took. Cameras
expose at a constant rate, so the exposures are a line through the earliest arrivals, and a pose is
on the frame that its number says. A lost frame is one number more: later poses are late by a period
for good. Where arrivals allow several frames, the motion decides: a craft does not jerk to and fro.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from airpuck.preprocessing.missing import longest_pause
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.stream import Stream, rows_of

#: A step below this fraction of the mean step, and the fraction of such steps, from which stamps
#: are times of arrival.
_FAR_BELOW, _MANY = 0.3, 0.01
#: Change of the logarithm of a step from which steps are uneven.
_UNEVEN = 0.3
#: Squared error of a pose, in those usual, from which the motion bends; and fraction of the bends
#: that is left if stamps are times of arrival, and poses are placed where they were exposed.
_BENDS, _STRAIGHTER = 20.0, 0.55
#: Poses by which this is judged.
_JUDGED = 2000
#: Fewest poses from which a clock is estimated.
_FEWEST = 200
#: Poses at the end that are too few to show a lost frame.
_LAST = 5
#: Time in which some pose arrives early [s], and the time of a point of the line [s].
_SOON, _BLOCK = 0.25, 0.5
#: Poses in a row that count towards the period, and the quantile of their mean steps: few are lost.
_COUNTED, _QUANTILE = 100, 0.1
#: Rates that cameras have [1/s], tried if many frames are lost, and the smallest fraction kept.
_RATES = (30, 50, 60, 90, 100, 120, 150, 180, 200, 240, 250, 300, 330, 360, 400, 500, 1000)
_KEPT = 0.7
#: Step of the earliest arrivals that is a lost frame, and speed at which the reference follows the
#: clocks' drift, per pose.
_LOST, _FOLLOWS = 0.6, 0.02
#: Spread of the earliest arrivals about the line, in periods, above which frames were miscounted,
#: and above which the motion does not help, either; relative error of a nominal rate.
_SPREAD, _HOPELESS, _NOMINAL = 0.45, 1.0, 0.1
#: How often frames are counted, and then chosen by the motion; how far a choice moves a pose, and
#: by how much its latency may then be below 0 or above the usual ones [periods].
_ROUNDS, _MOVES, _BELOW, _ABOVE = 3, np.arange(-2, 3), 0.3, 0.1
#: Cost of a move by a frame, which counts if the motion does not tell, and the most that a jump
#: costs, in squared standard errors.
_MOVE_COST, _JUMP_COST = 4.0, 60.0
#: Poses whose costs are computed at once, which bounds memory.
_AT_ONCE = 1 << 12
#: Repeats of a pose, as a fraction of all poses, that a logger must have made: in runs of at most
#: this length [periods, s].
_REPEATS, _RUN_PERIODS, _RUN_S = 0.005, 3, 5 / 240


def at_exposure(stream: Stream) -> tuple[Stream, tuple[str, ...]]:
    """Return poses with the times of their exposures, and what was wrong with their stamps.

    Repeated poses are dropped. Good stamps are returned as they are.
    """
    stream, warnings = _without_repeats(stream)
    time = (stream.stamp_ns - stream.stamp_ns[0]) / SECOND_NS
    steps = np.diff(time)
    if stream.exact or len(time) < _FEWEST or (steps < 0).any() or not time[-1] > 0:
        return stream, warnings
    share = float(np.mean(steps < _FAR_BELOW * np.mean(steps)))
    uneven = np.mean(np.abs(np.diff(np.log(np.maximum(steps, 1e-9)))) > _UNEVEN) > _MANY
    if not (share > _MANY or stream.rate_hz or warnings):
        # Steps of a client that polls about as often as the cameras expose look like lost frames.
        if not uneven or (stream.stamp_ns != stream.received_ns).any():
            return stream, warnings
        begin, values = time[:_JUDGED], stream.values[:_JUDGED]
        found = _exposures(begin, values, None)
        if not found or not _straighter(values, found[0], begin):
            return stream, warnings
        said = "poses are stamped on arrival (otherwise the craft would jerk)"
    else:
        said = "poses are spaced evenly"
    found = _exposures(time, stream.values, stream.rate_hz)
    if share > _MANY:
        said = f"poses are stamped on arrival ({100 * share:.0f} % of the steps are far too short)"
    if found is None:
        if stream.rate_hz:
            usual = 1 / float(np.median(steps[steps > 0]))
            said = f"rate_hz = {stream.rate_hz:g} does not fit the stamps ({usual:.1f} per second)"
            warnings += (f"{said}; they are used as they are",)
        elif share > _MANY:
            remedy = "state it in the mapping: pose = {rate_hz = 120}, or pose = {stamps = "
            warnings += (f'{said}, and the cameras\' rate is unclear; {remedy}"exact"}}',)
        return stream, warnings
    exposed, period = found
    remedy = "" if stream.rate_hz else '; if the stamps are right: pose = {stamps = "exact"}'
    warnings += (f"{said}; they are placed at the cameras' {1 / period:.2f} Hz{remedy}",)
    moved = np.rint((exposed - time) * SECOND_NS).astype(np.int64)
    return replace(stream, stamp_ns=stream.stamp_ns + moved), warnings


def _without_repeats(stream: Stream) -> tuple[Stream, tuple[str, ...]]:
    """Keep the first of equal poses, if a logger faster than the cameras repeated them."""
    same = np.concatenate([[False], np.all(stream.values[1:] == stream.values[:-1], axis=1)])
    if stream.exact or same.mean() < _REPEATS or len(stream) < _FEWEST:
        return stream, ()
    time = (stream.stamp_ns - stream.stamp_ns[0]) / SECOND_NS
    first = np.flatnonzero(~same)
    if len(first) < 2:
        return stream, ()
    changes = np.diff(time[first])
    period = float(np.mean(changes[changes <= 2.5 * np.median(changes)]))
    ends = np.append(first[1:], len(time))
    run = np.repeat(np.arange(len(first)), ends - first)
    since = time - time[first][run]
    lasted = np.append(time[first[1:]], time[-1]) - time[first]
    if (same & (lasted <= max(_RUN_PERIODS * period, _RUN_S))[run]).sum() < _REPEATS * len(time):
        return stream, ()
    # A frozen pose, or a craft at rest, keeps the cameras' rate; frames are lost for shorter.
    frozen = lasted > longest_pause(period)
    frame, last = (np.floor(one / max(period, 1e-9) + 0.5) for one in (since, lasted))
    new = frozen[run] & np.concatenate([[True], frame[1:] > frame[:-1]])
    new &= frame < last[run]  # the pose that ends it has the last frame
    kept = ~same | new
    dropped = int((~kept).sum())
    return rows_of(stream, kept), (
        f"{100 * dropped / len(time):.0f} % of the poses repeat the one before, because they were "
        f"logged faster than they change ({1 / period:.0f} Hz); the first of equal poses is used",
    )


def _exposures(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N 3"], rate: float | None
) -> tuple[Float[np.ndarray, " N"], float] | None:
    """Return the times of the exposures and the cameras' period; None if they are unclear."""
    mean = float(time[-1] / (len(time) - 1))
    if rate is not None:
        periods = [1 / rate]
    else:
        count = min(_COUNTED, len(time) - 1)
        counted = np.quantile((time[count:] - time[:-count]) / count, _QUANTILE)
        nominal = [1 / one for one in _RATES if _KEPT * mean < 1 / one < 1.005 * mean]
        periods = sorted([float(counted), *nominal], reverse=True)
    # The longest period that fits: shorter ones explain any arrivals, with more losses.
    for period in periods:
        line, spread, frame = np.array([period, 0.0]), np.inf, np.arange(len(time))
        for attempt in range(2 * _ROUNDS):
            if attempt < _ROUNDS:
                frame = _frames(time, line[0])
            elif spread < _HOPELESS * line[0]:
                frame = _smoothest(frame, time - np.polyval(line, frame), values, line[0])
            line, spread = _earliest(time, frame, line[0])
            if abs(line[0] - period) > _NOMINAL * period:
                break
        else:
            if spread < _SPREAD * line[0]:
                return np.polyval(line, frame), float(line[0])
    return None


def _motion(
    values: Float[np.ndarray, "N 3"], steps: Float[np.ndarray, " M"] | Int[np.ndarray, " M"]
) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "L 3"]]:
    """Return the motion in each step, and the errors of poses on the line of the two before.

    The errors are for these durations of the steps, and scaled to equal variances.
    """
    moved = np.diff(np.column_stack([values[:, :2], np.unwrap(values[:, 2])]), axis=0)
    ratio = (steps[1:] / steps[:-1])[:, None]
    return moved, (moved[1:] - ratio * moved[:-1]) / np.sqrt(1 + ratio + ratio**2)


def _straighter(
    values: Float[np.ndarray, "N 3"], time: Float[np.ndarray, " N"], other: Float[np.ndarray, " N"]
) -> bool:
    """Return whether the motion bends at far fewer poses with these times than with the others."""
    errors = [np.abs(_motion(values, np.maximum(np.diff(t), 1e-9))[1]) for t in (time, other)]
    usual = np.min([np.median(error, axis=0) for error in errors], axis=0) + 1e-12
    bent, before = (((error / usual) ** 2).sum(axis=1) > _BENDS for error in errors)
    return bool(bent.mean() < _STRAIGHTER * before.mean())


def _smoothest(
    frame: Int[np.ndarray, " N"],
    late: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N 3"],
    period: float,
) -> Int[np.ndarray, " N"]:
    """Return the poses' frames, near the given ones, with which the motion is the smoothest.

    A pose is where the two before it lead, with errors of all three. The best sequence follows from
    dynamic programming over the frames of two poses in a row (Viterbi).
    """
    if frame[-1] - frame[0] == len(frame) - 1 or not np.isfinite(values).all():
        return frame
    steps, error = _motion(values, np.diff(frame))
    steps /= np.median(np.abs(error), axis=0) + 1e-12
    squares, products = (steps**2).sum(axis=1), (steps[1:] * steps[:-1]).sum(axis=1)
    frames, latency = frame[:, None] + _MOVES, late[:, None] - period * _MOVES
    most = np.quantile(late, 0.995) + _ABOVE * period
    possible = (latency >= -_BELOW * period) & (latency <= most) | (_MOVES == 0)
    own = np.where(possible, _MOVE_COST * np.abs(_MOVES), np.inf)
    gap = frames[1] - frames[0][:, None]
    cost = np.where(gap > 0, own[0][:, None] + own[1], np.inf)
    best = np.zeros((len(frame), *cost.shape), dtype=np.int8)
    for first in range(2, len(frame), _AT_ONCE):
        part = np.arange(first, min(first + _AT_ONCE, len(frame)))
        before, after = (frames[k][:, None] - frames[k - 1][:, :, None] for k in (part - 1, part))
        allowed = np.where(after > 0, own[part][:, None], np.inf)
        ratio = after[:, None] / np.maximum(before, 1)[..., None]
        terms = (squares[part - 1], -2 * products[part - 2], squares[part - 2])
        least, linear, square = (one[:, None, None, None] for one in terms)
        error = (least + linear * ratio + square * ratio**2) / (1 + ratio + ratio**2)
        # For each frame of a pose and of the one before, the best frame of the one before that.
        for k, jump, last in zip(part, np.minimum(error, _JUMP_COST), allowed, strict=True):
            total = cost[..., None] + jump
            best[k] = total.argmin(axis=0)
            cost = total.min(axis=0) + last
    chosen = list(np.unravel_index(cost.argmin(), cost.shape))[::-1]
    for k in range(len(frame) - 1, 1, -1):
        chosen.append(best[k][chosen[-1], chosen[-2]])
    return frame + _MOVES[chosen[::-1]]


def _frames(time: Float[np.ndarray, " N"], period: float) -> Int[np.ndarray, " N"]:
    """Return the number of each pose's frame: a lost one delays all later poses by a period."""
    late = time - period * np.arange(len(time))
    soon = max(round(_SOON / period), 20)
    padded = np.append(late, np.full(soon - 1, np.inf))
    earliest = np.lib.stride_tricks.sliding_window_view(padded, soon).min(axis=1)
    # The last few poses are too few to tell a lost frame from a late arrival.
    earliest[-_LAST:] = earliest[-_LAST - 1]
    lost = np.zeros(len(time), dtype=int)
    reference, number = float(earliest[0]), 0
    for k, value in enumerate(earliest.tolist()):
        off = value - reference - number * period
        if off > _LOST * period:
            more = max(round(off / period), 1)
            number, off = number + more, off - more * period
        reference += _FOLLOWS * off
        lost[k] = number
    return np.arange(len(time)) + lost


def _earliest(
    time: Float[np.ndarray, " N"], frame: Int[np.ndarray, " N"], period: float
) -> tuple[Float[np.ndarray, " 2"], float]:
    """Fit a line to the earliest arrivals; return period and start, and the spread about it."""
    late = time - period * frame
    size = max(round(_BLOCK / period), 20)
    blocks = np.array_split(np.arange(len(time)), max(len(time) // size, 2))
    least = np.array([block[np.argmin(late[block])] for block in blocks])
    slope, start = np.polyfit(frame[least], late[least], 1)
    rest = late[least] - slope * frame[least] - start
    low, high = np.quantile(rest, [0.1, 0.9])
    return np.array([period + slope, start]), float(high - low)
