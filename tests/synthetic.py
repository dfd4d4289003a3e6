"""Small flights made up for the tests, with known truth."""

from __future__ import annotations

import numpy as np

from airpuck.data.trajectory import Trajectory
from airpuck.model.model_file import Model, published_model
from airpuck.recording.stream import Recording
from tests.random_flight import POSE_RATE as RATE
from tests.random_flight import random_flight, random_recording

__all__ = ["RATE", "fly", "record"]


def fly(model: Model, duration: float = 6.0, seed: int = 0) -> Trajectory:
    """A random flight with exact states: no noise, no smoothing, the delay taken out already."""
    flight = random_flight(model, duration, seed)
    return Trajectory(
        time=flight.time,
        state=flight.state,
        acceleration=np.gradient(flight.state[:, 3:], flight.time, axis=0),
        command_time=flight.time,
        command=flight.command,
        propellers=model.vehicle.propeller_names,
        delay_known=False,
        source=f"synthetic flight {seed}",
        hashes={"synthetic": str(seed)},
    )


def record(
    model: Model | None = None, duration: float = 6.0, seed: int = 0, noise: float = 0.0
) -> Recording:
    """A recording of a random flight, by default of the published M3."""
    return random_recording(model or published_model("M3"), duration, seed, noise=noise)
