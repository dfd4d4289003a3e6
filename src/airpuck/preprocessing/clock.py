"""Clock alignment: poses and commands on one time axis (subsec:data_preprocessing)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int64

from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.stream import Stream

#: Difference between two senders' clocks that latency cannot explain [s].
_CLOCKS_DIFFER = 0.1
#: Drift or step of a clock that is removed [s], and the number of messages needed to detect it.
_DRIFTS = 5e-3
_ENOUGH_FOR_DRIFT = 400
#: Relative drift that no clock has: another unit of time, for example.
_IMPOSSIBLE = 0.01
#: Deviation from a steady drift that latencies explain [s], and as a share of the drift.
_STEADY, _STEADY_SHARE = 3e-3, 0.15
#: Change of the latency from one message to the next at which a step is looked for [s]; messages
#: on either side that show its size, the quantile of their latencies that does, and how many of
#: them have one shortest latency.
_SUDDEN, _BESIDE, _SHORT, _LEAST = 2.5e-3, 240, 0.1, 20
#: Quantiles of shortest latencies between which they spread.
_SPREAD = (0.1, 0.9)
#: Share of a step that other latencies may add to the change at its message, or their size [s].
_BLURRED, _BLUR = 0.5, 3e-3
#: Durations after which clocks begin again: half a day, a day, and counters of 32 bits in ns, µs
#: and ms; and the longest pause in which they may [ns].
_TURNS = (43_200 * SECOND_NS, 86_400 * SECOND_NS, 2**32, 2**32 * 10**3, 2**32 * 10**6)
_LONGEST_PAUSE = SECOND_NS
#: Time around a pose in which the commands' arrivals show a step of the recorder's clock [s].
_NEAR = 0.3


@dataclass(frozen=True, eq=False)
class Aligned:
    """Time stamps of two streams on one axis."""

    #: Seconds since `epoch`.
    pose_time: Float[np.ndarray, " N"]
    command_time: Float[np.ndarray, " K"]
    #: The earlier of the two first stamps [s since 1970].
    epoch: float
    warnings: tuple[str, ...]
    #: The recorder's clock at `epoch` [s since 1970]: the same, unless the two clocks differ by
    #: more than latencies explain.
    recorder_epoch: float


def seconds(stamp_ns: Int64[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Convert stamps to seconds in double precision, as ROS does.

    At today's epoch a double resolves 2⁻²² s = 0.24 µs. Motion capture drivers compute stamps in
    doubles and truncate them to nanoseconds; converting back restores the driver's number.
    """
    whole, rest = np.divmod(stamp_ns, SECOND_NS)
    return whole + rest * 1e-9


def align_clocks(pose: Stream, command: Stream) -> Aligned:
    """Put header stamps of poses and commands on one time axis.

    Header stamps are used unchanged if both senders' clocks agree. The recorder saw both: the
    smallest difference between its time of arrival and a sender's stamp is that clock's offset plus
    the shortest latency. Offsets more than 0.1 s apart mean different clocks, and the commands are
    moved to the poses' clock. A clock that steps or drifts against the recorder's is set right.
    """
    (pose, rolled), (command, also) = continued(pose, "pose"), continued(command, "command")
    pose, command, said = _without_recorder_steps(pose, command)
    warnings = [*rolled, *also, *said]
    latency = float(np.quantile(command.received_ns - command.stamp_ns, 0.01)) / SECOND_NS
    pose, said = _steady(pose, "pose", latency)
    warnings += said
    command, said = _steady(command, "command", latency)
    warnings += said
    pose_time, command_time = seconds(pose.stamp_ns), seconds(command.stamp_ns)
    base = {
        "pose": _lowest(seconds(pose.received_ns) - pose_time),
        "command": _lowest(seconds(command.received_ns) - command_time),
    }
    correction = base["command"] - base["pose"]
    if abs(correction) > _CLOCKS_DIFFER:
        warnings.append(
            f"the clocks of poses and commands differ by {correction:.3f} s; "
            "command stamps were moved by that much, and the transport delay is relative to it"
        )
    else:
        correction = 0.0
    command_time = command_time + correction
    epoch = float(min(pose_time[0], command_time[0]))
    # The axis is the poses' clock; shifted commands are on the recorder's clock up to latency.
    ahead = base["pose"] if correction or abs(base["pose"]) > _CLOCKS_DIFFER else 0.0
    return Aligned(pose_time - epoch, command_time - epoch, epoch, tuple(warnings), epoch + ahead)


def continued(stream: Stream, name: str) -> tuple[Stream, tuple[str, ...]]:
    """Continue stamps of a clock that begins again, such as a counter of microseconds."""
    steps, turned, begun = np.diff(stream.stamp_ns), np.zeros(len(stream), np.int64), [0]
    for k in np.flatnonzero(np.abs(steps) > _LONGEST_PAUSE).tolist():
        step = int(steps[k])
        turn = next((one for one in _TURNS if 0 <= step + one <= _LONGEST_PAUSE), 0)
        if turn:
            begun.append(turn)
            turned[k + 1] = turn
        elif abs(step - begun[-1]) <= _LONGEST_PAUSE:  # a late message from before
            turned[k + 1] = -begun.pop()
    if not turned.any():
        return stream, ()
    after = (stream.stamp_ns[np.argmax(turned != 0) - 1] - stream.stamp_ns[0]) / SECOND_NS
    warning = (
        f"the clock of the {name} stream begins again after {after:.1f} s, as it does every "
        f"{turned.max() / SECOND_NS:g} s; its stamps were continued"
    )
    later = np.cumsum(turned)
    own = (stream.stamp_ns == stream.received_ns).all()
    received = stream.received_ns + later if own else stream.received_ns
    return replace(stream, stamp_ns=stream.stamp_ns + later, received_ns=received), (warning,)


def _steady(stream: Stream, name: str, usual: float) -> tuple[Stream, list[str]]:
    """Remove steps and drift of a sender's clock against the recorder's; return warnings.

    The part of the recording whose latency is closest to the `usual` one [s] counts as right.
    """
    if len(stream) < _ENOUGH_FOR_DRIFT or (stream.stamp_ns == stream.received_ns).all():
        return stream, []
    offset, warnings = (stream.received_ns - stream.stamp_ns) / SECOND_NS, []
    steps = [(k, size) for k, size, of_sender in _clock_steps(stream, offset) if of_sender]
    late = np.zeros(len(stream))
    for k, size in steps:
        late[k:] += size
        when = (stream.received_ns[k] - stream.received_ns[0]) / SECOND_NS
        warnings.append(
            f"the clock of the {name} stream steps by {-1e3 * size:.1f} ms after {when:.1f} s, as "
            "times of arrival show; the step was removed"
        )
    if steps:
        parts = [slice(*ends) for ends in pairwise([0, *(k for k, _ in steps), len(stream)])]
        right = min(parts, key=lambda part: abs(_lowest(offset[part]) - usual))
        late -= late[right.start]
    first, *_, last = np.array_split(offset - late, 4)
    drift = _lowest(last) - _lowest(first)
    elapsed = (stream.received_ns - stream.received_ns[0]) / SECOND_NS
    # From the middle of the first quarter to the middle of the last.
    begin, *_, end = (float(np.median(quarter)) for quarter in np.array_split(elapsed, 4))
    if _DRIFTS < abs(drift) < _IMPOSSIBLE * (end - begin):
        steady = drift * (elapsed - begin) / (end - begin)
        levels = np.array([_lowest(part) for part in np.array_split(offset - late - steady, 8)])
        bent = float(np.max(np.abs(levels - np.median(levels))))
        if bent > max(_STEADY, _STEADY_SHARE * abs(drift)):
            warnings.append(
                f"times of arrival of the {name} stream move by {1e3 * drift:.1f} ms against its "
                "stamps, but not steadily: a clock was corrected, or the recorder fell behind; "
                "nothing was removed"
            )
            return _moved(stream, late), warnings
        warnings.append(
            f"the clock of the {name} stream drifts against the recorder's by "
            f"{1e3 * drift:.1f} ms over the recording; the drift was removed"
        )
        late += steady
        begun, ended = (abs(_lowest(part) - usual) for part in (first, last))
        late -= late[-1] if ended < begun else late[0]
    return _moved(stream, late), warnings


def _moved(stream: Stream, late: Float[np.ndarray, " N"]) -> Stream:
    """Return a stream with later stamps [s]."""
    return replace(stream, stamp_ns=stream.stamp_ns + np.rint(late * SECOND_NS).astype(np.int64))


def _without_recorder_steps(pose: Stream, command: Stream) -> tuple[Stream, Stream, list[str]]:
    """Remove steps of the recorder's clock, and of commands' stamps if made by the same clock.

    Arrivals of both streams show them; an arrival that is only late moves one.
    """
    warnings = []
    for k, size, of_sender in _clock_steps(pose, (pose.received_ns - pose.stamp_ns) / SECOND_NS):
        near = np.abs(command.received_ns - pose.received_ns[k - 1]) < _NEAR * SECOND_NS
        pause = np.diff(command.received_ns) / SECOND_NS
        off = np.where(near[:-1] & near[1:], np.abs(pause - np.median(pause) - size), np.inf)
        if of_sender or not len(off) or off.min() > max(_BLURRED * abs(size), _BLUR):
            continue
        later = np.arange(len(command)) > np.argmin(off)
        beside = slice(max(int(np.argmin(off)) - _BESIDE, 0), int(np.argmin(off)) + _BESIDE)
        offset = ((command.received_ns - command.stamp_ns) / SECOND_NS)[beside]
        change = np.subtract(*(_lowest(offset[later[beside] == part]) for part in (True, False)))
        moved = round(size * SECOND_NS)
        received = command.received_ns - moved * later
        stamps = command.stamp_ns - moved * later * (abs(change) < _BLURRED * abs(size))
        command = replace(command, stamp_ns=stamps, received_ns=received)
        pose = replace(pose, received_ns=pose.received_ns - moved * (np.arange(len(pose)) >= k))
        warnings.append(
            f"the recorder's clock steps by {1e3 * size:.1f} ms after "
            f"{(pose.received_ns[k] - pose.received_ns[0]) / SECOND_NS:.1f} s; the step was removed"
        )
    return pose, command, warnings


def _clock_steps(stream: Stream, offset: Float[np.ndarray, " N"]) -> list[tuple[int, float, bool]]:
    """Return the messages from which on latencies are longer, by how much [s], and for whom.

    The sender's clock stepped if its stamps break their rhythm there, and the recorder's do not.
    A step exceeds the spread of the shortest latencies on both sides.
    """
    if len(stream) < _ENOUGH_FOR_DRIFT:
        return []
    sudden = np.diff(offset)
    sent, received = (np.diff(s) / SECOND_NS for s in (stream.stamp_ns, stream.received_ns))
    usual = float(np.median(received))
    broken = np.abs(sent - usual) > np.abs(received - usual)
    around = np.pad(offset, _BESIDE, constant_values=np.inf)
    least = np.lib.stride_tricks.sliding_window_view(around, _BESIDE).min(axis=1)
    before, after = least[1 : len(offset)], least[_BESIDE + 1 :]
    moves = np.abs(after[: len(before)] - before) > _SUDDEN  # few do, and the rest takes longer
    found: list[tuple[int, float, bool]] = []
    for k in (np.flatnonzero((np.abs(sudden) > _SUDDEN) & moves) + 1).tolist():
        sides = offset[max(k - _BESIDE, 0) : k], offset[k : k + _BESIDE]
        if min(map(len, sides)) < _LEAST:
            continue
        levels = [
            [part.min() for part in np.array_split(side, len(side) // _LEAST)] for side in sides
        ]
        size = float(np.subtract(*(np.quantile(side, _SHORT) for side in reversed(sides))))
        spread = max(float(np.ptp(np.quantile(level, _SPREAD))) for level in levels)
        blur = max(_BLURRED * abs(size), _BLUR)
        if abs(size) < max(_DRIFTS, spread) or abs(sudden[k - 1] - size) > blur:
            continue
        if found and k - found[-1][0] < _BESIDE:
            if abs(size) <= abs(found[-1][1]):
                continue
            found.pop()
        found.append((k, size, bool(broken[k - 1])))
    return found


def _lowest(offset: Float[np.ndarray, " N"]) -> float:
    """Return a low quantile instead of the minimum: one wrong stamp must not set the clock."""
    return float(np.quantile(offset, 0.01))
