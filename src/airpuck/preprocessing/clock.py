"""Clock alignment: poses and commands on one time axis (subsec:data_preprocessing)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.stream import Stream

#: Difference between two senders' clocks that latency cannot explain [s].
_CLOCKS_DIFFER = 0.1
#: Drift of a clock that is reported [s], and the number of messages needed to detect it.
_DRIFTS = 5e-3
_ENOUGH_FOR_DRIFT = 400


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
    moved to the poses' clock.
    """
    pose_time, command_time = seconds(pose.stamp_ns), seconds(command.stamp_ns)
    offsets = {
        "pose": seconds(pose.received_ns) - pose_time,
        "command": seconds(command.received_ns) - command_time,
    }
    base = {name: _lowest(offset) for name, offset in offsets.items()}
    correction = base["command"] - base["pose"]
    warnings = []
    if abs(correction) > _CLOCKS_DIFFER:
        warnings.append(
            f"the clocks of poses and commands differ by {correction:.3f} s; "
            "command stamps were moved by that much, and the transport delay is relative to it"
        )
    else:
        correction = 0.0
    for name, offset in offsets.items():
        first, *_, last = np.array_split(offset, 4)
        drift = _lowest(last) - _lowest(first) if len(offset) >= _ENOUGH_FOR_DRIFT else 0.0
        if abs(drift) > _DRIFTS:
            warnings.append(
                f"the clock of the {name} stream drifts against the recorder's by "
                f"{1e3 * drift:.1f} ms over the recording"
            )
    command_time = command_time + correction
    epoch = float(min(pose_time[0], command_time[0]))
    # The axis is the poses' clock; shifted commands are on the recorder's clock up to latency.
    ahead = base["pose"] if correction or abs(base["pose"]) > _CLOCKS_DIFFER else 0.0
    return Aligned(pose_time - epoch, command_time - epoch, epoch, tuple(warnings), epoch + ahead)


def _lowest(offset: Float[np.ndarray, " N"]) -> float:
    """Return a low quantile instead of the minimum: one wrong stamp must not set the clock."""
    return float(np.quantile(offset, 0.01))
