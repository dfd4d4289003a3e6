"""How well a loop keeps its time: jitter, latency, deadlines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

#: Targets on two quiet cores [s].
JITTER_P99, LATENCY_P99, DEADLINE = 2e-3, 5e-3, 1e-2

#: Width of a bin [s], and how many there are.
_BIN, _BINS = 1e-5, 5000


class Histogram:
    """Counts of durations, to 10 µs; memory does not grow with their number."""

    def __init__(self) -> None:
        self.count = 0
        #: The longest one [s].
        self.longest = 0.0
        #: The last bin is for all that are longer.
        self._bins = np.zeros(_BINS + 1, np.int64)

    def add(self, duration: float) -> None:
        """Count a duration [s]."""
        self.count += 1
        self.longest = max(self.longest, duration)
        self._bins[min(int(duration / _BIN), _BINS)] += 1

    def percentile(self, percent: float) -> float:
        """Return a percentile [s]; nan of nothing."""
        if self.count == 0:
            return math.nan
        rank = max(math.ceil(self.count * percent / 100), 1)
        place = int(np.cumsum(self._bins).searchsorted(rank))
        return self.longest if place >= _BINS else min((place + 1) * _BIN, self.longest)


class LoopTiming:
    """Timing of a loop that should act once a period."""

    def __init__(self, period: float) -> None:
        self._period = period
        #: | time since the action before - period |.
        self.jitter = Histogram()
        #: From when an action was due, its newest pose waiting, to when it was done.
        self.latency = Histogram()
        #: From when the newest pose was measured to when the command was sent.
        self.pose_age = Histogram()
        #: Actions later than 10 ms, and those left out since the one before was.
        self.missed = 0
        #: When the last action was due and when it was done [s].
        self._last: tuple[float, float] | None = None

    def add(self, due: float, done: float, pose: float | None) -> None:
        """Count an action: when it was due, when it was done, and the newest pose's stamp [s]."""
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
        """Return what is worse than it should be, in words; None if nothing is."""
        jitter, latency = self.jitter.percentile(99), self.latency.percentile(99)
        problems = []
        if jitter > JITTER_P99:
            problems.append(f"period jitter {1e3 * jitter:.1f} ms")
        if latency > LATENCY_P99:
            problems.append(f"latency {1e3 * latency:.1f} ms")
        if self.missed:
            problems.append(f"{self.missed} missed deadlines")
        return f"the loop is late: {', '.join(problems)} (99th percentiles)" if problems else None

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        figures: dict[str, Any] = {"periods": self.latency.count, "missed_deadlines": self.missed}
        for name, histogram in (
            ("period_jitter_ms", self.jitter),
            ("pose_to_command_ms", self.latency),
            ("pose_age_ms", self.pose_age),
        ):
            figures[name] = {
                "p50": 1e3 * histogram.percentile(50),
                "p99": 1e3 * histogram.percentile(99),
                "max": 1e3 * histogram.longest,
            }
        return figures
