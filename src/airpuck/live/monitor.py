"""How well a loop keeps its time: jitter, latency, deadlines."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

#: Targets on two quiet cores [s].
JITTER_P99, LATENCY_P99, DEADLINE = 2e-3, 5e-3, 1e-2

_BIN = 1e-5
_BINS = 5000


@dataclass
class Histogram:
    """Counts of durations, to 10 µs; memory does not grow with their number."""

    #: How many.
    count: int = 0
    #: The longest one [s].
    longest: float = 0.0
    _bins: np.ndarray = field(default_factory=lambda: np.zeros(_BINS + 1, np.int64))

    def add(self, duration: float) -> None:
        """Count a duration."""
        self.count += 1
        self.longest = max(self.longest, duration)
        self._bins[min(int(duration / _BIN), _BINS)] += 1

    def percentile(self, percent: float) -> float:
        """Return a percentile."""
        if self.count == 0:
            return math.nan
        rank = max(math.ceil(self.count * percent / 100), 1)
        place = int(np.cumsum(self._bins).searchsorted(rank))
        return self.longest if place >= _BINS else min((place + 1) * _BIN, self.longest)


@dataclass
class LoopTiming:
    """Timing of a loop that should act once a period."""

    #: Time between actions [s].
    period: float
    #: Of | time since the action before - period |.
    jitter: Histogram = field(default_factory=Histogram)
    #: From when an action was due, its newest pose waiting, to when it was done.
    latency: Histogram = field(default_factory=Histogram)
    #: From when the newest pose was measured to when the command was sent.
    pose_age: Histogram = field(default_factory=Histogram)
    #: Actions later than 10 ms, and those left out since the one before was.
    missed: int = 0
    _last: tuple[float, float] | None = None

    def add(self, due: float, done: float, pose: float | None) -> None:
        """Count an action."""
        if self._last is not None:
            due_before, done_before = self._last
            self.jitter.add(abs(done - done_before - self.period))
            self.missed += max(round((due - due_before) / self.period) - 1, 0)
        self._last = due, done
        self.latency.add(max(done - due, 0.0))
        self.missed += done - due > DEADLINE
        if pose is not None:
            self.pose_age.add(max(done - pose, 0.0))

    def warning(self) -> str | None:
        """Say what is worse than it should be."""
        jitter, latency = self.jitter.percentile(99), self.latency.percentile(99)
        told = []
        if jitter > JITTER_P99:
            told.append(f"period jitter {1e3 * jitter:.1f} ms")
        if latency > LATENCY_P99:
            told.append(f"latency {1e3 * latency:.1f} ms")
        if self.missed:
            told.append(f"{self.missed} missed deadlines")
        return f"the loop is late: {', '.join(told)} (99th percentiles)" if told else None

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
