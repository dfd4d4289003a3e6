"""A small flight made up for the tests, with known truth: no noise, no faults."""

from __future__ import annotations

import numpy as np

from airpuck.model.rollout import rollout
from airpuck.model_file import Model, published_model
from airpuck.recording.stream import COLUMNS, Recording, Stream
from airpuck.trajectory import Trajectory

RATE = 240.0
EPOCH = 1_700_000_000


#: Each random signal is held this long: a whole number of samples at 240 Hz and at 100 Hz [s].
HOLD = 0.1


def fly(model: Model, duration: float = 6.0, seed: int = 0) -> Trajectory:
    """Integrate the model from rest under random signals; exact states, no smoothing.

    One motor of each pair at a time gets a random signal. Of six random ones the one that brings
    the craft nearest to rest in the middle is flown: a poor controller, but one that keeps speeds
    realistic.
    """
    rng = np.random.default_rng(seed)
    n, samples = model.vehicle.n_propellers, round(HOLD * RATE)
    durations = np.full((samples, 6), 1 / RATE)
    state = np.concatenate([np.zeros(6), np.full(n, 0.03)])
    states, held = [state[None]], []
    for _ in range(round(duration / HOLD)):
        signal = rng.uniform(-1, 1, ((n + 1) // 2, 6))
        commands = np.clip(np.stack([signal, -signal], axis=1).reshape(-1, 6)[:n], 0.03, 1)
        ahead = rollout(
            np,
            model.dynamics,
            np.repeat(state[:, None], 6, axis=1),
            np.repeat(commands[None], samples, axis=0),
            durations,
        )
        x, y, _, vx, vy, spin = ahead[-1, :6]
        best = int(np.argmin((x + vx) ** 2 + (y + vy) ** 2 + (0.03 * spin) ** 2))
        states.append(ahead[:, :, best])
        held.append(np.repeat(commands[None, :, best], samples, axis=0))
        state = ahead[-1, :, best]
    state, command = np.concatenate(states)[:-1, :6], np.concatenate(held)
    time = np.arange(len(state)) / RATE
    return Trajectory(
        time=time,
        state=state,
        acceleration=np.gradient(state[:, 3:], time, axis=0),
        command_time=time,
        command=command,
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
    """Record a synthetic flight as a lab would: wrapped yaw, stamps in nanoseconds.

    Commands come at 100 Hz and act `delay` after their stamp.
    """
    model = model or published_model("M3")
    flight = fly(model, duration, seed)
    rng = np.random.default_rng(seed + 1000)
    pose = flight.state[:, :3] + noise * rng.normal(size=(len(flight), 3))
    pose[:, 2] = (pose[:, 2] + np.pi) % (2 * np.pi) - np.pi
    command_time = np.arange(round(duration * 100)) / 100
    command = flight.command[(command_time * RATE + 1e-6).astype(int)]
    names = model.vehicle.propeller_names

    def stream(time, values, columns, latency_ns):
        stamp = (EPOCH + 1) * 10**9 + np.rint(time * 1e9).astype(np.int64)
        return Stream(stamp, stamp + latency_ns, np.ascontiguousarray(values), columns)

    return Recording(
        streams={
            "pose": stream(flight.time, pose, COLUMNS["pose"], 1_000_000),
            "command": stream(command_time - delay, command, names, 100_000),
        },
        source="synthetic",
        hashes={"synthetic": "0"},
    )
