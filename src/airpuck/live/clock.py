"""Time on a graph: one steady clock in a process, and stamps of senders with other clocks."""

from __future__ import annotations

import math
import time

SECOND_NS = 10**9
#: A stamp may lie this far ahead of its arrival: clocks of one laboratory agree to this [s].
_AHEAD = 0.01
#: A stamp older than this is late, or from another clock [s].
_BEHIND = 0.1
#: Another clock is believed when its stamps have agreed for this long [s], and were this many.
_BELIEVED_AFTER, _BELIEVED_COUNT = 0.5, 20
#: How often a difference between clocks that drift is corrected [s].
_BLOCK = 2.0


class Clock:
    """Seconds since its start; corrections of the system's time do not disturb it."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin at 0 again."""
        self._start_ns = time.monotonic_ns()
        #: System time at the start [ns since the epoch].
        self._epoch_ns = time.time_ns()

    @property
    def now(self) -> float:
        """Time since the start [s]."""
        return (time.monotonic_ns() - self._start_ns) / SECOND_NS

    def stamp_ns(self, moment: float) -> int:
        """Return the stamp [ns since the epoch] of a moment on this clock [s]."""
        return self._epoch_ns + round(moment * SECOND_NS)

    def of(self, stamp_ns: int) -> float:
        """Return the moment of a stamp on this clock [s]."""
        return (stamp_ns - self._epoch_ns) / SECOND_NS

    def sleep_until(self, due: float) -> None:
        """Sleep until a moment on this clock [s]; return at once if it has passed."""
        left = due - self.now
        if left > 0:
            time.sleep(left)


class Every:
    """A period that a loop asks about."""

    def __init__(self, period: float, due: float = 0.0) -> None:
        self._period = period
        #: When the next one begins [s].
        self.due = due

    def begins(self, now: float) -> bool:
        """Return whether a new period begins now [s]; then the next is one period later."""
        if now < self.due:
            return False
        self.due = now + self._period
        return True


class StampClock:
    """Brings the stamps of one sender to the receiver's clock.

    A sender on the same clock is believed at once. One on another clock is believed when its
    stamps have agreed with each other for half a second. From then on its shortest latency counts
    as zero, as in preprocessing, and its drift is followed.
    """

    def __init__(self) -> None:
        #: Receiver's clock minus sender's [s].
        self.offset = 0.0
        #: Stamps that do not fit: arrival of the first, least and greatest age, their number.
        self._odd: tuple[float, float, float, int] | None = None
        #: Begin of the present block, and the least age in it.
        self._block = (-math.inf, math.inf)

    def time(self, stamp: float, arrival: float) -> float | None:
        """Return when a message was stamped, on the receiver's clock; None if unbelievable."""
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
        """Keep the shortest latency of another clock at zero."""
        if self.offset == 0.0:
            return
        began, least = self._block
        if arrival - began > _BLOCK:
            if math.isfinite(least):
                self.offset += least
            began, least = arrival, math.inf
        self._block = began, min(least, age)
