"""Clock alignment: poses and commands on one time axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from airpuck.recording.stream import Stream

#: Difference between two senders' clocks that cannot be latency [s].
_CLOCKS_DIFFER = 0.1


@dataclass(frozen=True, eq=False)
class Aligned:
    """Stamps of two streams on one axis."""

    #: Seconds since `epoch`.
    pose_time: Float[np.ndarray, " N"]
    command_time: Float[np.ndarray, " K"]
    #: The earlier of the two first stamps [s since 1970].
    epoch: float
    #: What was found.
    warnings: tuple[str, ...]
    #: What the recorder's clock showed at `epoch`: the same, unless the two clocks differ by more
    #: than latencies explain [s since 1970].
    recorder_epoch: float


def seconds(stamp_ns: Int64[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Convert stamps to seconds in double precision, as ROS does.

    At today's epoch a double resolves 2⁻²² s = 0.24 µs. Motion capture drivers compute stamps in
    doubles and truncate them to nanoseconds; converting back restores the driver's number.
    """
    whole, rest = np.divmod(stamp_ns, 1_000_000_000)
    return whole + rest * 1e-9


def align_clocks(pose: Stream, command: Stream) -> Aligned:
    """Put header stamps of poses and commands on one time axis.

    Header stamps are used as they are when both senders' clocks agree. The recorder saw both: the
    smallest difference between its time of arrival and a sender's stamp is that clock's offset plus
    the shortest latency. Offsets more than 0.1 s apart are different clocks, and the commands are
    moved to the poses' clock.
    """
    offsets = {
        name: seconds(stream.received_ns) - seconds(stream.stamp_ns)
        for name, stream in (("pose", pose), ("command", command))
    }
    # A low quantile rather than the minimum: one wrong stamp must not set the clock.
    base = {name: float(np.quantile(offset, 0.01)) for name, offset in offsets.items()}
    warnings = []
    correction = base["command"] - base["pose"]
    if abs(correction) > _CLOCKS_DIFFER:
        warnings.append(
            f"the clocks of poses and commands differ by {correction:.3f} s; "
            "command stamps were moved by that much, and the transport delay is relative to it"
        )
    else:
        correction = 0.0
    for name, offset in offsets.items():
        if len(offset) < 400:
            continue
        ends = np.array_split(offset, 4)
        drift = float(np.quantile(ends[-1], 0.01) - np.quantile(ends[0], 0.01))
        if abs(drift) > 5e-3:
            warnings.append(
                f"the clock of the {name} stream drifts against the recorder's by "
                f"{1e3 * drift:.1f} ms over the recording"
            )
    pose_time, command_time = seconds(pose.stamp_ns), seconds(command.stamp_ns) + correction
    epoch = float(min(pose_time[0], command_time[0]))
    # The axis is the poses' clock, and commands that were moved came along from the recorder's.
    ahead = base["pose"] if correction or abs(base["pose"]) > _CLOCKS_DIFFER else 0.0
    return Aligned(pose_time - epoch, command_time - epoch, epoch, tuple(warnings), epoch + ahead)
