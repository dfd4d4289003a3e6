"""Sensors: they sample at their own rate and on their own clock, with noise, and arrive late."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from airpuck.data.measurement import Measurement, MeasurementKind
from airpuck.recording.stream import COLUMNS, POSES, Stream
from airpuck.twin.settings import MotionCapture, TwinSettings

#: Time of the recorder at the start of a flight [ns since 1970].
EPOCH_NS = 1_700_000_000_000_000_000
#: Time from the sending of a command to its record [s].
_COMMAND_LATENCY = 1e-4


@dataclass(eq=False)
class Sensor:
    """One sensor."""

    kind: MeasurementKind
    _: KW_ONLY
    #: Samples per second.
    rate: float
    #: Standard deviation of each channel.
    noise: tuple[float, ...]
    #: Delay from the sample to the controller: minimum, and mean of the random part [s].
    latency: tuple[float, float]
    rng: np.random.Generator
    #: Fraction of missing samples.
    dropped: float = 0.0
    #: Intervals without samples [s].
    gaps: tuple[tuple[float, float], ...] = ()
    #: Stamp of a sample at a time on the recorder's clock.
    stamped: Callable[[float], float] = float
    #: Whether to store delivered samples.
    logs: bool = True

    def __post_init__(self) -> None:
        """Begin without any samples."""
        self._count = self._delivered = 0
        #: Time of the next sample [s].
        self.due = 0.0
        self._deviation = np.array(self.noise)
        self._last_arrival = -math.inf
        self._logged: list[tuple[float, float, Float[np.ndarray, " k"]]] = []

    @property
    def next_arrival(self) -> float:
        """Arrival time of the next measurement in transit; infinite if there is none [s]."""
        waits = self._delivered < len(self._logged)
        return self._logged[self._delivered][1] if waits else math.inf

    def measure(self, truth: Float[np.ndarray, " k"]) -> None:
        """Take the due sample; a truth of NaN gives none."""
        time = self.due
        self._count += 1
        self.due = self._count / self.rate
        # All numbers are always drawn, so that one setting does not change the draws of another.
        values = truth + self._deviation * self.rng.standard_normal(len(self._deviation))
        late, luck = self.rng.exponential(self.latency[1]), self.rng.random()
        unseen = luck < self.dropped or any(map(math.isnan, values.tolist()))
        if unseen or any(start <= time < stop for start, stop in self.gaps):
            return
        if self.kind in POSES:
            values[2] = (values[2] + math.pi) % (2 * math.pi) - math.pi
        arrival = self._last_arrival = max(time + self.latency[0] + late, self._last_arrival)
        self._logged.append((self.stamped(time), arrival, values))

    def arrived(self, now: float) -> list[tuple[float, Measurement]]:
        """Return the measurements that have arrived since the last call."""
        found = []
        while self._delivered < len(self._logged) and self._logged[self._delivered][1] <= now:
            stamp, arrival, values = self._logged[self._delivered]
            found.append((arrival, Measurement(self.kind, stamp, values)))
            self._delivered += 1
        if not self.logs:
            del self._logged[: self._delivered]
            self._delivered = 0
        return found

    def stream(self) -> Stream:
        """Return all measurements."""
        columns = COLUMNS[self.kind]
        stamps, arrivals, values = zip(*self._logged, strict=True) if self._logged else ((), (), ())
        table = np.array(values).reshape(-1, len(columns))
        return Stream(nanoseconds(stamps), nanoseconds(arrivals), table, columns)


class SensorSet:
    """Sensors, with a function that gives noise-free readings."""

    def __init__(
        self, sensors: Sequence[Sensor], truth: Callable[[MeasurementKind], Float[np.ndarray, " k"]]
    ) -> None:
        self.sensors = sensors
        self._truth = truth

    @property
    def due(self) -> float:
        """Time of the next measurement of any sensor [s]."""
        return min(sensor.due for sensor in self.sensors)

    @property
    def next_event(self) -> float:
        """Time at which a sensor next measures, or a measurement arrives [s]."""
        return min(min(sensor.due, sensor.next_arrival) for sensor in self.sensors)

    def observe(self, time: float) -> None:
        """Take the due samples."""
        for sensor in self.sensors:
            if sensor.due <= time:
                sensor.measure(self._truth(sensor.kind))

    def arrived(self, now: float) -> list[Measurement]:
        """Return new measurements in order of arrival."""
        found = [entry for sensor in self.sensors for entry in sensor.arrived(now)]
        found.sort(key=lambda entry: entry[0])
        return [measurement for _, measurement in found]

    def streams(self) -> dict[str, Stream]:
        """Return all measurements, by kind."""
        streams = {sensor.kind: sensor.stream() for sensor in self.sensors}
        return {kind: stream for kind, stream in streams.items() if len(stream)}


def nanoseconds(times: Sequence[float] | Float[np.ndarray, " N"]) -> Int[np.ndarray, " N"]:
    """Convert times of the flight to the recorder's clock."""
    return EPOCH_NS + np.rint(np.array(times, dtype=float) * 1e9).astype(np.int64)


def pose_sensor(
    capture: MotionCapture,
    seed: int,
    logs: bool = True,
    *,
    kind: MeasurementKind = "pose",
    number: int = 1,
) -> Sensor:
    """Build the motion capture of a twin, for its craft or another body."""
    return Sensor(
        kind,
        rate=capture.rate_hz,
        noise=(capture.position_noise_m, capture.position_noise_m, capture.yaw_noise_rad),
        latency=(capture.latency_s, capture.latency_jitter_s),
        rng=np.random.default_rng([seed, number]),
        dropped=capture.dropped,
        gaps=capture.gaps_s,
        stamped=capture.stamped,
        logs=logs,
    )


def build_sensors(
    settings: TwinSettings, seed: int, logs: bool, played: Sequence[MeasurementKind] = ()
) -> list[Sensor]:
    """Build the sensors, each with its own random numbers; `played`: puck, mallet or none."""
    board = settings.on_board
    sensors = [pose_sensor(settings.motion_capture, seed, logs)]
    noises: dict[MeasurementKind, tuple[float, ...]] = {
        "imu": (board.acceleration_noise_m_s2,) * 3 + (board.gyro_noise_rad_s,) * 3,
        "mouse": (board.mouse_noise_m_s,) * 2,
    }
    rate, latency = board.rate_hz, (board.latency_s, 0.0)
    for number, (kind, noise) in enumerate(noises.items() if rate else (), start=2):
        rng = np.random.default_rng([seed, number])
        sensors.append(Sensor(kind, rate=rate, noise=noise, latency=latency, rng=rng, logs=logs))
    for number, kind in enumerate(played, start=4):
        sensors.append(pose_sensor(settings.motion_capture, seed, logs, kind=kind, number=number))
    return sensors


def log_stream(
    logged: list[tuple[float, Any]], columns: tuple[str, ...], latency: float = _COMMAND_LATENCY
) -> Stream:
    """Return messages with the controller's time, recorded `latency` [s] later."""
    times, values = zip(*logged, strict=True)
    stamp = nanoseconds(times)
    return Stream(stamp, stamp + round(latency * 1e9), np.array(values), columns)
