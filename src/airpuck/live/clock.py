"""Time on a graph: one steady clock in a process, and stamps of senders with other clocks."""

from __future__ import annotations

import math
import time

_SECOND_NS = 10**9
#: A stamp may lie this far ahead of its arrival: clocks of one laboratory agree to this [s].
_AHEAD = 0.01
#: A stamp older than this is late, or of another clock [s].
_BEHIND = 0.1
#: Another clock is believed when all stamps fit it for this long [s], and there were as many.
_BELIEVED_AFTER, _BELIEVED_COUNT = 0.5, 20
#: How often a difference between clocks that drift is corrected [s].
_BLOCK = 2.0


class Clock:
    """Seconds since it was made, which no correction of the system's time can disturb."""

    def __init__(self) -> None:
        self._start_ns = time.monotonic_ns()
        #: The wall's time at the start [ns since the epoch].
        self.epoch_ns = time.time_ns()

    @property
    def now(self) -> float:
        """Time since the start [s]."""
        return (time.monotonic_ns() - self._start_ns) / _SECOND_NS

    @property
    def now_ns(self) -> int:
        """Time for a stamp [ns since the epoch]."""
        return self.epoch_ns + time.monotonic_ns() - self._start_ns

    def of(self, stamp_ns: int) -> float:
        """Return a stamp on this clock."""
        return (stamp_ns - self.epoch_ns) / _SECOND_NS

    def sleep_until(self, due: float) -> None:
        """Sleep."""
        left = due - self.now
        if left > 0:
            time.sleep(left)


class StampClock:
    """Brings the stamps of one sender to the receiver's clock.

    A sender on the same clock is taken at its word. One on another clock is believed once its
    stamps have agreed with each other for half a second; from then on the shortest latency counts
    as none, as in preprocessing, and drift is followed.
    """

    def __init__(self) -> None:
        self.offset = 0.0
        self._odd: tuple[float, float, float, int] | None = None
        self._block = (-math.inf, math.inf)

    def time(self, stamp: float, arrival: float) -> float | None:
        """Return when a message was stamped."""
        age = arrival - stamp - self.offset
        if -_AHEAD <= age <= _BEHIND:
            self._odd = None
            self._follow_drift(age, arrival)
            return stamp + self.offset
        if not math.isfinite(age):
            return None
        first, least, most, count = self._odd or (arrival, age, age, 0)
        least, most = min(least, age), max(most, age)
        if most - least > _BEHIND:
            first, least, most, count = arrival, age, age, 0
        self._odd = first, least, most, count + 1
        if arrival - first >= _BELIEVED_AFTER and count + 1 >= _BELIEVED_COUNT:
            self.offset += least
            self._odd = None
            self._block = (-math.inf, math.inf)
            return stamp + self.offset
        return None

    def _follow_drift(self, age: float, arrival: float) -> None:
        """Let the shortest latency of another clock stay none."""
        if self.offset == 0.0:
            return
        begun, least = self._block
        if arrival - begun > _BLOCK:
            if math.isfinite(least):
                self.offset += least
            begun, least = arrival, math.inf
        self._block = begun, min(least, age)
