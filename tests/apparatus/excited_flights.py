"""Excitation flights on the twin, with their true velocities and the true delay of each packet."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest
from jaxtyping import Float

from airpuck import Fit, Preparation, Trajectory, Twin, TwinSettings
from airpuck.identification.fit import identify
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin import craft as craft_module
from airpuck.twin import experiments
from airpuck.twin.plant import Plant, build_plant
from airpuck.twin.radio import RadioLink
from airpuck.twin.settings import default_twin_settings

from .changes import changed
from .once import once

PUBLISHED = published_model("M3")
#: The craft: the published M3 with a centre of mass away from the origin, fixed to the body.
TRUTH = replace(
    PUBLISHED,
    frame="body",
    indexing="start",
    parameters=replace(PUBLISHED.parameters, center_of_mass=np.array([1.5e-3, -1e-3])),
)


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight.

    Attributes
    ----------
    trajectory : Trajectory
        As preprocessed.
    delay : array, shape (K,)
        True delay of each packet [s].
    rates : array, shape (N, 3)
        True vx, vy [m/s], ω [rad/s].
    """

    trajectory: Trajectory
    delay: Float[np.ndarray, " K"]
    rates: Float[np.ndarray, "N 3"]


@lru_cache(maxsize=1)
def plant() -> Plant:
    """Compile once for all flights."""
    return build_plant(TRUTH)


def settings(jitter: float, noise: bool = True) -> TwinSettings:
    """The packaged twin with another jitter [s], or with perfect cameras."""
    perfect = {} if noise else {"position_noise_m": 0.0, "yaw_noise_rad": 0.0}
    radio = {"jitter_s": jitter}
    return changed(default_twin_settings(), radio=radio, motion_capture=perfect)


@once
def flown(jitter: float, duration: float, seed: int = 0, noise: bool = True) -> Flown:
    """Fly with a radio of a given jitter [s], and record the true delays."""
    delay: list[float] = []
    twins: list[Twin] = []

    class WatchedRadio(RadioLink):
        def send(self, time, command):
            super().send(time, command)
            delay.append(self._last_arrival - time)

    class WatchedTwin(Twin):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            twins.append(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(craft_module, "RadioLink", WatchedRadio)
        patch.setattr(experiments, "Twin", WatchedTwin)
        recording = experiments.excite(
            TRUTH, duration, seed, settings=settings(jitter, noise), plant=plant()
        )
    trajectory = preprocess(recording)
    assert len(trajectory.command_time) == len(delay)
    # Commands are sent at whole hundredths of a second, the first at zero.
    time, state = twins[0].truth
    frame = np.searchsorted(time, trajectory.time - trajectory.command_time[0] - 1e-4)
    return Flown(trajectory, np.array(delay), state[frame, 3:6])


@once
def fit_of_flown(jitter: float, duration: float) -> Fit:
    """M3 of such a flight, which has no faults."""
    return identify(flown(jitter, duration).trajectory, preparation=Preparation(faults="keep"))
