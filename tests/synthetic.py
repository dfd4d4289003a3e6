"""A small flight made up for the tests, with known truth: no noise, no faults."""

from __future__ import annotations

import numpy as np

from airpuck.model.rollout import rollout
from airpuck.model_file import Model, published_model
from airpuck.recording.stream import COLUMNS, Recording, Stream
from airpuck.trajectory import Trajectory

RATE = 240.0
EPOCH = 1_700_000_000


def random_commands(model: Model, duration: float, seed: int, hold: int = 20):
    """Random commands at 100 Hz, each held `hold` periods; one motor of each pair at a time."""
    rng = np.random.default_rng(seed)
    n = model.vehicle.n_propellers
    time = np.arange(round(duration * 100)) / 100
    held = rng.uniform(-1, 1, (len(time) // hold + 1, (n + 1) // 2)).repeat(hold, axis=0)
    signal = np.stack([held, -held], axis=2).reshape(len(held), -1)[: len(time), :n]
    return time, np.clip(signal, 0.03, 1)


def fly(model: Model, duration: float = 6.0, seed: int = 0, delay: float = 0.0) -> Trajectory:
    """Integrate the model from rest; exact states, no smoothing. Commands change on the grid."""
    command_time, command = random_commands(model, duration, seed, hold=24)
    time = np.arange(round(duration * RATE)) / RATE
    index = np.clip(np.searchsorted(command_time, time - delay + 1e-9, side="right") - 1, 0, None)
    held = command[index]
    n = model.vehicle.n_propellers
    start = np.concatenate([np.zeros(6), held[0]])
    steps = rollout(np, model.dynamics, start, held[:-1], np.diff(time))
    states = np.concatenate([start[None], steps])
    return Trajectory(
        time=time,
        state=states[:, :6],
        acceleration=np.gradient(states[:, 3:6], time, axis=0),
        command_time=time,
        command=held,
        propellers=model.vehicle.propeller_names,
        source=f"synthetic flight {seed}",
        hashes={"synthetic": f"{n}-{seed}"},
    )


def record(
    model: Model | None = None,
    duration: float = 6.0,
    seed: int = 0,
    delay: float = 5 / RATE,
    noise: float = 0.0,
) -> Recording:
    """Record a synthetic flight as a lab would: wrapped yaw, stamps in nanoseconds."""
    model = model or published_model("M3")
    flight = fly(model, duration, seed, delay)
    rng = np.random.default_rng(seed + 1000)
    pose = flight.state[:, :3] + noise * rng.normal(size=(len(flight), 3))
    pose[:, 2] = (pose[:, 2] + np.pi) % (2 * np.pi) - np.pi
    command_time, command = random_commands(model, duration, seed, hold=24)
    names = model.vehicle.propeller_names

    def stream(time, values, columns, latency_ns):
        stamp = EPOCH * 10**9 + np.rint(time * 1e9).astype(np.int64)
        return Stream(stamp, stamp + latency_ns, np.ascontiguousarray(values), columns)

    return Recording(
        streams={
            "pose": stream(flight.time, pose, COLUMNS["pose"], 1_000_000),
            "command": stream(command_time, command, names, 100_000),
        },
        source="synthetic",
        hashes={"synthetic": "0"},
    )
