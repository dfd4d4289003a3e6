"""Small flights made up for the tests, with known truth."""

from dataclasses import replace

import numpy as np

from airpuck import Model, Recording, Stream, Trajectory
from airpuck.model.model_file import published_model
from tests.apparatus.random_flights import POSE_RATE as RATE
from tests.apparatus.random_flights import random_flight, random_recording

__all__ = ["RATE", "bad_value", "edited", "fly", "record", "shuffled"]


def fly(model: Model, duration: float = 6.0, seed: int = 0) -> Trajectory:
    """A random flight with exact states: no noise, no smoothing, no delay."""
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


def edited(recording: Recording, name: str, edit) -> Recording:
    """Change the rows of a stream: `edit` takes and returns stamp_ns, received_ns and values."""
    old = recording[name]
    stamp, received, values = edit(old.stamp_ns, old.received_ns, old.values.copy())
    new = Stream(stamp, received, np.ascontiguousarray(values), old.columns)
    return replace(recording, streams={**recording.streams, name: new})


def bad_value(row: int, column: int, value: float):
    """An edit that changes one number of a stream."""

    def edit(stamp, received, values):
        values[row, column] = value
        return stamp, received, values

    return edit


def shuffled(recording: Recording) -> Recording:
    """The recording with its six motors in another order."""
    old, order = recording["command"], [3, 1, 0, 2, 5, 4]
    values = np.ascontiguousarray(old.values[:, order])
    new = replace(old, values=values, columns=tuple(old.columns[k] for k in order))
    return replace(recording, streams={**recording.streams, "command": new})
