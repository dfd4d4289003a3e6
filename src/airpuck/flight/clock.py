"""Clocks on a graph: a steady clock, stamps of other clocks, and timing statistics of a loop."""

from __future__ import annotations

import math
import time

import numpy as np

from airpuck.boundary.results import Result
from airpuck.recording.conversion import SECOND_NS

#: A stamp may lie this far ahead of its arrival: clocks in one laboratory agree to this [s].
_AHEAD = 0.01
#: A stamp older than this is late, or from another clock [s].
_BEHIND = 0.1
#: Another clock is accepted after its stamps have agreed for this long [s], and number this many.
_BELIEVED_AFTER, _BELIEVED_COUNT = 0.5, 20
#: Period of corrections to the difference between drifting clocks [s].
_BLOCK = 2.0
#: Timing targets on two quiet cores [s].
JITTER_P99, LATENCY_P99, DEADLINE = 2e-3, 5e-3, 1e-2

#: Width of a bin [s], and number of bins.
_BIN, _BINS = 1e-5, 5000


class Clock:
    """Seconds since its start; corrections of the system's time do not disturb it."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Restart at 0."""
        self._start_ns = time.monotonic_ns()
        #: System time at the start [ns since the epoch].
        self._epoch_ns = time.time_ns()

    @property
    def now(self) -> float:
        """Time since the start [s]."""
        return (time.monotonic_ns() - self._start_ns) / SECOND_NS

    def stamp_ns(self, moment: float) -> int:
        """Return the stamp [ns since the epoch] of a time on this clock [s]."""
        return self._epoch_ns + round(moment * SECOND_NS)

    def of(self, stamp_ns: int) -> float:
        """Return the time of a stamp on this clock [s]."""
        return (stamp_ns - self._epoch_ns) / SECOND_NS

    def sleep_until(self, due: float) -> None:
        """Sleep until a time on this clock [s]; return at once if it has passed."""
        left = due - self.now
        if left > 0:
            time.sleep(left)


class Every:
    """A period that a loop polls."""

    def __init__(self, period: float) -> None:
        self._period = period
        #: Time at which the next period begins [s].
        self.due = 0.0

    def begins(self, now: float) -> bool:
        """Return whether a new period begins now [s]; if so, schedule the next one."""
        if now < self.due:
            return False
        self.due = now + self._period
        return True


class TokenBucket:
    """A rate limit: `rate` tokens per second are earned, and at most `burst` are kept."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left, self._counted = burst, -math.inf

    def take(self, now: float) -> bool:
        """Spend a token at a time [s]; return whether one was available."""
        earned = self._rate * (now - self._counted)
        self._left, self._counted = min(self._burst, self._left + earned), now
        if self._left < 1:
            return False
        self._left -= 1
        return True


class StampClock:
    """Converts the stamps of one sender to the receiver's clock.

    A sender on the same clock is accepted at once. One on another clock is accepted when its stamps
    have agreed with each other for half a second. From then on its shortest latency counts as zero,
    as in preprocessing, and its drift is followed.
    """

    def __init__(self) -> None:
        #: Receiver's clock minus sender's [s].
        self.offset = 0.0
        #: Arrivals and ages of messages that do not fit, but agree with each other [s].
        self._odd: list[tuple[float, float]] = []
        #: Start of the present block, and the smallest age in it.
        self._block = (-math.inf, math.inf)

    def time(self, stamp: float, arrival: float) -> float | None:
        """Return when a message was stamped, on the receiver's clock; None if implausible."""
        age = arrival - stamp - self.offset
        if -_AHEAD <= age <= _BEHIND:
            self._odd.clear()
            self._follow_drift(age, arrival)
            return stamp + self.offset
        if not math.isfinite(age):
            return None
        self._odd.append((arrival, age))
        ages = [age for _, age in self._odd]
        if max(ages) - min(ages) > _BEHIND:
            self._odd = [(arrival, age)]
        elif arrival - self._odd[0][0] >= _BELIEVED_AFTER and len(ages) >= _BELIEVED_COUNT:
            self.offset += min(ages)
            self._odd.clear()
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


class Histogram:
    """A histogram of durations, to 10 µs; memory does not grow with their number."""

    def __init__(self) -> None:
        self.count = 0
        #: The longest duration [s].
        self.longest = 0.0
        #: The last bin is for all longer durations.
        self._bins = np.zeros(_BINS + 1, np.int64)

    def add(self, duration: float) -> None:
        """Count a duration [s]."""
        self.count += 1
        self.longest = max(self.longest, duration)
        self._bins[min(int(duration / _BIN), _BINS)] += 1

    def percentile(self, percent: float) -> float:
        """Return a percentile [s]; nan if there are no durations."""
        if self.count == 0:
            return math.nan
        rank = max(math.ceil(self.count * percent / 100), 1)
        place = int(np.cumsum(self._bins).searchsorted(rank))
        return self.longest if place >= _BINS else min((place + 1) * _BIN, self.longest)

    def to_json(self) -> dict[str, float]:
        """Return median, 99th percentile and maximum [ms]."""
        p50, p99 = self.percentile(50), self.percentile(99)
        return {"p50": 1e3 * p50, "p99": 1e3 * p99, "max": 1e3 * self.longest}


class LoopTiming(Result):
    """Timing of a loop that should act once per period."""

    JSON = (
        "periods=latency.count missed_deadlines=missed period_jitter_ms=jitter "
        "pose_to_command_ms=latency pose_age_ms=pose_age"
    )

    def __init__(self, period: float) -> None:
        self._period = period
        #: | time since the previous action - period |.
        self.jitter = Histogram()
        #: Time from the moment an action was due, with its newest pose waiting, until it was done.
        self.latency = Histogram()
        #: Time from the measurement of the newest pose until the command was sent.
        self.pose_age = Histogram()
        #: Number of actions more than 10 ms late, including skipped ones.
        self.missed = 0
        #: Times at which the last action was due, and done [s].
        self._last: tuple[float, float] | None = None

    def add(self, due: float, done: float, pose: float | None) -> None:
        """Record an action: when it was due, when it was done, and the newest pose's stamp [s]."""
        if self._last is not None:
            due_before, done_before = self._last
            self.jitter.add(abs(done - done_before - self._period))
            self.missed += max(round((due - due_before) / self._period) - 1, 0)
        self._last = due, done
        self.latency.add(max(done - due, 0.0))
        self.missed += done - due > DEADLINE
        if pose is not None:
            self.pose_age.add(max(done - pose, 0.0))

    def warning(self) -> str | None:
        """Describe timing outside the targets; None if all is well."""
        jitter, latency = self.jitter.percentile(99), self.latency.percentile(99)
        late = {
            f"period jitter {1e3 * jitter:.1f} ms": jitter > JITTER_P99,
            f"latency {1e3 * latency:.1f} ms": latency > LATENCY_P99,
            f"{self.missed} missed deadlines": self.missed > 0,
        }
        problems = ", ".join(words for words, is_late in late.items() if is_late)
        return f"the loop is late: {problems} (99th percentiles)" if problems else None
