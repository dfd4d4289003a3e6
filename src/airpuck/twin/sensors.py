"""A sensor: samples at its own rate, on its own clock, with noise; its messages arrive later."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from airpuck.flight.link import Kind, Measurement
from airpuck.recording.stream import COLUMNS, Stream


class Sensor:
    """One sensor."""

    def __init__(
        self,
        kind: Kind,
        *,
        rate: float,
        noise: tuple[float, ...],
        latency: tuple[float, float],
        rng: np.random.Generator,
        dropped: float = 0.0,
        gaps: tuple[tuple[float, float], ...] = (),
        clock: tuple[float, float] = (0.0, 0.0),
        logs: bool = True,
    ) -> None:
        self.kind: Kind = kind
        self._rate, self._noise, self._latency = rate, np.array(noise), latency
        self._rng, self._dropped, self._gaps = rng, dropped, gaps
        self._clock, self._logs = clock, logs
        self._count, self._delivered = 0, 0
        self._last_arrival = -math.inf
        self._logged: list[tuple[float, float, Float[np.ndarray, " k"]]] = []

    @property
    def next_arrival(self) -> float:
        """When the next of the measurements on their way arrives; infinite for none [s]."""
        waits = self._delivered < len(self._logged)
        return self._logged[self._delivered][1] if waits else math.inf

    @property
    def due(self) -> float:
        """Time of the next sample [s]."""
        return self._count / self._rate

    def measure(self, truth: Float[np.ndarray, " k"]) -> None:
        """Take the sample that is due."""
        time = self.due
        self._count += 1
        # All numbers are always drawn, so that one setting does not change what another draws.
        values = truth + self._noise * self._rng.standard_normal(len(self._noise))
        late, luck = self._rng.exponential(self._latency[1]), self._rng.random()
        if luck < self._dropped or any(start <= time < stop for start, stop in self._gaps):
            return
        if self.kind == "pose":
            values[2] = (values[2] + math.pi) % (2 * math.pi) - math.pi
        arrival = self._last_arrival = max(time + self._latency[0] + late, self._last_arrival)
        stamp = (1 + self._clock[1]) * time + self._clock[0]
        self._logged.append((stamp, arrival, values))

    def arrived(self, now: float) -> list[tuple[float, Measurement]]:
        """Return what has arrived since the last call."""
        found = []
        while self._delivered < len(self._logged) and self._logged[self._delivered][1] <= now:
            stamp, arrival, values = self._logged[self._delivered]
            found.append((arrival, Measurement(self.kind, stamp, values)))
            self._delivered += 1
        if not self._logs:
            del self._logged[: self._delivered]
            self._delivered = 0
        return found

    def stream(self, epoch_ns: int) -> Stream:
        """Return everything that was measured so far."""
        columns = COLUMNS[self.kind]
        stamps = np.array([entry[0] for entry in self._logged])
        arrivals = np.array([entry[1] for entry in self._logged])
        values = np.array([entry[2] for entry in self._logged]).reshape(-1, len(columns))
        stamp, received = (epoch_ns + np.rint(t * 1e9).astype(np.int64) for t in (stamps, arrivals))
        return Stream(stamp, received, values, columns)
