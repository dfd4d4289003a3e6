"""The cameras' clock behind time stamps that were made on arrival.

A client stamps poses when it gets them: in bursts, and later by whatever the network took. Cameras
expose at a constant rate, so the exposures are a line through the earliest arrivals, and a pose is
on the frame that its number says. A lost frame is one number more: later poses are late by a period
for good. Where arrivals allow several frames, the motion decides: a craft does not jerk to and fro.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from airpuck.preprocessing.quality import longest_pause
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.stream import Stream, rows_of

#: A step below this fraction of the mean step, and the fraction of such steps, from which stamps
#: are times of arrival.
_FAR_BELOW, _MANY = 0.3, 0.01
#: Change of the logarithm of a step from which steps are uneven.
_UNEVEN = 0.3
#: Squared error of a pose, in those usual, from which the motion bends; and fraction of the bends
#: that is left if stamps are times of arrival and poses are placed where they were exposed, or if
#: they are placed at the right rate instead of others.
_BENDS, _STRAIGHTER, _RIGHT_RATE = 20.0, 0.55, 0.8
#: Difference of the fractions of bends that is due to chance.
_CHANCE = 0.01
#: Poses by which this is judged.
_JUDGED = 2000
#: Fewest poses from which a clock is estimated, and the smallest fraction of them in order.
_FEWEST, _ORDERED = 200, 0.95
#: Time of a point of the line [s].
_BLOCK = 0.5
#: Poses in a row that count towards the period, and the quantile of their mean steps: few are lost.
_COUNTED, _QUANTILE = 100, 0.1
#: Rates that cameras have [1/s], tried if frames are lost, and the smallest fraction kept. A rate
#: this close to one of them is rather a beat with the client's: relative difference.
_RATES = (30, 50, 60, 90, 100, 120, 150, 180, 200, 240, 250, 300, 330, 360, 400, 500, 1000)
_KEPT, _BEAT = 0.7, 0.01
#: Frames for each pose from which a stated rate does not fit.
_THINNED = 100
#: Largest relative difference between a client's clock and the cameras', and between equal periods.
_CLOCKS, _ALIKE = 3e-4, 2e-3
#: Poses by which a period is refined at first, and the growth of their number.
_REFINED, _GROWTH = 256, 4
#: Share of the earliest arrivals at one phase from which a period is right, and the spread of the
#: earliest arrivals about a line if no frame is lost [periods].
_AT_PHASE, _NONE_LOST = 0.4, 1.0
#: Parts of a period among which the phase is chosen, and those before it without arrivals.
_PHASES, _EMPTY = 32, 10
#: How often frames are chosen by the motion; how far a choice moves a pose, and
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

    Repeated poses are dropped. Good stamps are returned unchanged.
    """
    stream, warnings = _without_repeats(stream)
    time = (stream.stamp_ns - stream.stamp_ns[0]) / SECOND_NS
    ordered = time >= np.maximum.accumulate(time)
    if stream.exact or len(time) < _FEWEST or np.mean(ordered) < _ORDERED or not time.max() > 0:
        return stream, warnings
    arrivals = _arrivals(stream, time[ordered], stream.values[ordered])
    if not (arrivals or warnings or stream.rate_hz):
        return stream, warnings
    said = arrivals or "poses are spaced evenly"
    # A pose whose stamp goes back came before the next one at the latest.
    known = np.where(ordered, time, time.max())[::-1]
    found = _exposures(np.minimum.accumulate(known)[::-1], stream.values, stream.rate_hz)
    if found is None:
        if stream.rate_hz:
            usual = (len(time) - 1) / known[0]
            said = f"rate_hz = {stream.rate_hz:g} does not fit the stamps ({usual:.1f} per second)"
            warnings += (f"{said}; they are used as they are",)
        elif arrivals:
            remedy = 'pose = {rate_hz = 120}, or pose = {stamps = "exact"}'
            rate = f"and the cameras' rate is unclear; state it in the mapping: {remedy}"
            warnings += (f"{said}, {rate}",)
        return stream, warnings
    exposed, period = found
    remedy = "" if stream.rate_hz else '; if the stamps are right: pose = {stamps = "exact"}'
    warnings += (f"{said}; they are placed at the cameras' {1 / period:.2f} Hz{remedy}",)
    moved = np.rint((exposed - time) * SECOND_NS).astype(np.int64)
    return replace(stream, stamp_ns=stream.stamp_ns + moved), warnings


def _arrivals(
    stream: Stream, time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N 3"]
) -> str:
    """Return by what stamps are known to be times of arrival; empty if they are not."""
    steps = np.diff(time)
    share = float(np.mean(steps < _FAR_BELOW * np.mean(steps)))
    if share > _MANY:
        return f"poses are stamped on arrival ({100 * share:.0f} % of the steps are far too short)"
    uneven = np.mean(np.abs(np.diff(np.log(np.maximum(steps, 1e-9)))) > _UNEVEN)
    if uneven <= _MANY or (stream.stamp_ns != stream.received_ns).any():
        return ""
    # Steps of a client that polls about as often as the cameras expose look like lost frames.
    begin, seen = time[:_JUDGED], values[:_JUDGED]
    found = _exposures(begin, seen, None)
    if found is None:
        return ""
    bent, before = _bent(seen, (found[0], begin))
    straighter = bent < _STRAIGHTER * before
    return "poses are stamped on arrival (otherwise the craft would jerk)" if straighter else ""


def _without_repeats(stream: Stream) -> tuple[Stream, tuple[str, ...]]:
    """Keep the first of equal poses, if a logger faster than the cameras repeated them."""
    same = np.concatenate([[False], np.all(stream.values[1:] == stream.values[:-1], axis=1)])
    if stream.exact or same.mean() < _REPEATS or len(stream) < _FEWEST:
        return stream, ()
    time = (stream.stamp_ns - stream.stamp_ns[0]) / SECOND_NS
    first = np.flatnonzero(~same)
    changes = np.diff(time[first])
    if not len(changes) or np.median(changes) <= 0:
        return stream, ()
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
        f"{100 * dropped / len(time):.0f} % of the poses repeat the one before, as if logged "
        f"faster than they change ({1 / period:.0f} Hz), or instead of lost frames; the first of "
        "equal poses is used",
    )


def _exposures(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N 3"], rate: float | None
) -> tuple[Float[np.ndarray, " N"], float] | None:
    """Return the times of the exposures and the cameras' period; None if they are unclear."""
    mean = float(time[-1] / (len(time) - 1))
    if rate is None:
        period = _chosen_period(time, values, mean)
    elif not 1 - _CLOCKS - 2 / len(time) < mean * rate < _THINNED:
        return None  # there are more poses than frames, or very few
    else:
        period = _refined(time, 1 / rate, _CLOCKS)[0]
    if period is None:
        return None
    exposed, found = _placed(time, values, period)
    return (exposed, found) if abs(found / period - 1) < _ALIKE else None


def _chosen_period(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N 3"], mean: float
) -> float | None:
    """Return the cameras' period: the longest that fits, since shorter ones need more losses."""
    line, spread = _earliest(time, np.arange(len(time)), mean)
    periods, fits = [float(line[0])], [spread < _NONE_LOST * mean]
    counted = float(np.quantile((time[_COUNTED:] - time[:-_COUNTED]) / _COUNTED, _QUANTILE))
    nominal = sorted(1 / one for one in _RATES if _KEPT * mean < 1 / one < 1.005 * mean)
    begin, seen = time[:_JUDGED], values[:_JUDGED]
    for period in (*reversed(nominal), *([counted] if counted > _KEPT * mean else [])):
        within = _CLOCKS if period in nominal else 1 / _COUNTED
        period, at_phase = _refined(begin, period, within)
        nearest = min((abs(period / one - 1) for one in nominal), default=1.0)
        if period < mean and not _CLOCKS * 1.001 < nearest < _BEAT:
            periods.append(period)
            fits.append(at_phase > _AT_PHASE)
    bent = _bent(seen, [_placed(begin, seen, period)[0] for period in periods])
    least = bent.min()
    for period, fit, bends in zip(periods, fits, bent, strict=True):
        others = bent[np.abs(np.array(periods) / period - 1) > _ALIKE]
        others = _RIGHT_RATE * others.min(initial=1.0) - _CHANCE
        if bends < others or (fit and _RIGHT_RATE * bends - _CHANCE <= least):
            return period if period == periods[0] else _refined(time, period, _CLOCKS)[0]
    return None


def _early(time: Float[np.ndarray, " N"], period: float) -> Float[np.ndarray, " N"]:
    """Return how far a pose is behind its number at most, as later ones show [periods]."""
    ahead = time / period - np.arange(len(time))
    return np.minimum.accumulate(ahead[::-1])[::-1]


def _refined(time: Float[np.ndarray, " N"], period: float, within: float) -> tuple[float, float]:
    """Return the period with which most earliest arrivals have one phase, and their share."""
    bounds, size = (period * (1 - within), period * (1 + within)), min(_REFINED, len(time))
    while True:
        part = time[:size] - time[0]
        step = period / max(part[-1], period) / 4  # moves the last pose by a quarter of a period
        most = math.ceil(within / step)
        periods = (period * (1 + within * np.linspace(-1, 1, 2 * most + 1))).clip(*bounds)
        phases = (np.exp(2j * np.pi * _early(part, one)).mean() for one in periods)
        shares = np.abs(np.fromiter(phases, complex))
        best = int(np.argmax(shares))
        period, within = float(periods[best]), min(within, 2 * step)
        if size == len(time):
            return period, float(shares[best])
        size = min(_GROWTH * size, len(time))


def _placed(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N 3"], period: float
) -> tuple[Float[np.ndarray, " N"], float]:
    """Return the times of the exposures for a period, and the period with which these fit best.

    Poses are on the latest frames that arrivals allow, and then where the motion is the smoothest.
    """
    early = _early(time, period)
    count = np.bincount((_PHASES * (early % 1)).astype(int) % _PHASES, minlength=_PHASES)
    before = [np.take(count, np.arange(k - _EMPTY, k), mode="wrap").sum() for k in range(_PHASES)]
    frame = np.floor(early - np.argmin(before) / _PHASES).astype(int) + np.arange(len(time))
    for _ in range(_ROUNDS):
        line, _ = _earliest(time, frame, period)
        frame = _smoothest(frame, time - np.polyval(line, frame), values, line[0])
    line, _ = _earliest(time, frame, period)
    return np.polyval(line, frame), float(line[0])


def _motion(
    values: Float[np.ndarray, "N 3"], steps: Float[np.ndarray, " M"] | Int[np.ndarray, " M"]
) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "L 3"]]:
    """Return the motion in each step, and the errors of poses on the line of the two before.

    The errors are for these durations of the steps, and scaled to equal variances.
    """
    moved = np.diff(np.column_stack([values[:, :2], np.unwrap(values[:, 2])]), axis=0)
    ratio = (steps[1:] / steps[:-1])[:, None]
    return moved, (moved[1:] - ratio * moved[:-1]) / np.sqrt(1 + ratio + ratio**2)


def _bent(
    values: Float[np.ndarray, "N 3"], times: Sequence[Float[np.ndarray, " N"]]
) -> Float[np.ndarray, " T"]:
    """Return the fractions of poses at which the motion bends, if they were exposed then."""
    errors = [np.abs(_motion(values, np.maximum(np.diff(t), 1e-9))[1]) for t in times]
    usual = np.min([np.median(error, axis=0) for error in errors], axis=0) + 1e-12
    return np.array([np.mean(((error / usual) ** 2).sum(axis=1) > _BENDS) for error in errors])


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
