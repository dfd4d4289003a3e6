"""Flights on the twin: published M3 from a pose, at rest, to a target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, default_tuning
from airpuck.flight.loop import fly
from airpuck.model.model_file import Model, published_model
from airpuck.physics.rigid_body import pose_difference
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import Twin

#: Tolerance within which a flight has settled [m, m, rad].
SETTLED = (0.01, 0.01, 0.05)

Pose = tuple[float, float, float]


@cache
def craft() -> Model:
    """Return the published M3 with its centre of mass fixed to the body, as in a real craft."""
    return replace(published_model("M3"), frame="body")


@cache
def _plant() -> Any:
    return build_plant(craft())


@cache
def law(kind: str, **changes: Any) -> Tuning:
    """Return the packaged tuning with a law, some of its settings changed."""
    return default_tuning().with_law(kind, **changes)


def calm() -> TwinSettings:
    """Return the packaged settings without noise, jitter and latency."""
    settings = default_twin_settings()
    quiet = {"position_noise_m": 0.0, "yaw_noise_rad": 0.0}
    quiet |= {"latency_s": 0.0, "latency_jitter_s": 0.0}
    radio = settings.radio.model_copy(update={"jitter_s": 0.0})
    cameras = settings.motion_capture.model_copy(update=quiet)
    return settings.model_copy(update={"radio": radio, "motion_capture": cameras})


def lossy(share: float) -> TwinSettings:
    """Return the packaged settings with packet loss."""
    settings = default_twin_settings()
    radio = settings.radio.model_copy(update={"loss": share})
    return settings.model_copy(update={"radio": radio})


@dataclass(frozen=True, eq=False)
class Flight:
    """Result of a flight."""

    #: Times of the motion capture's frames [s]; true states with motor speeds.
    time: np.ndarray
    state: np.ndarray
    #: Times of the commands, and the commands.
    sent: np.ndarray
    command: np.ndarray
    target: np.ndarray
    contacts: int
    status: tuple[str, ...]

    @property
    def error(self) -> np.ndarray:
        """State minus target, yaws the shorter way, (N, 6)."""
        wanted = np.append(self.target, np.zeros(3))
        return pose_difference(np, self.state[:, :6].T, wanted[:, None]).T

    @property
    def settling(self) -> float:
        """Settling time [s]; infinite if it has not settled."""
        outside = np.flatnonzero((np.abs(self.error[:, :3]) > SETTLED).any(axis=1))
        if len(outside) == 0:
            return 0.0
        last = outside[-1] + 1
        return float(self.time[last]) if last < len(self.time) else np.inf

    @property
    def overshoot(self) -> float:
        """Overshoot beyond the target, along the line from the start [m]."""
        way = -self.error[0, :2]
        return float(np.max(self.error[:, :2] @ way / max(float(np.linalg.norm(way)), 1e-9)))

    def steady(self, last: float = 1.0) -> np.ndarray:
        """Root mean square error of the last while [m, m, rad]."""
        late = self.time > self.time[-1] - last
        return np.sqrt(np.mean(self.error[late, :3] ** 2, axis=0))


Maker = Callable[[SetPoint, Tuning], TrackingController]


def _usual(target: SetPoint, tuning: Tuning) -> TrackingController:
    return TrackingController(craft(), target, tuning)


def flown(
    start: Pose,
    target: Pose,
    tuning: Tuning,
    duration: float,
    *,
    settings: TwinSettings | None = None,
    seed: int = 0,
    make: Maker = _usual,
) -> Flight:
    """Fly once."""
    settings = settings or default_twin_settings()
    twin = Twin(craft(), settings, seed=seed, pose=start, plant=_plant())
    log = fly(make(SetPoint(*target), tuning), twin, duration, tuning.period_s)
    time, state = twin.truth
    return Flight(
        time, state, log.time, log.command, np.array(target), len(twin.contacts), log.status
    )
