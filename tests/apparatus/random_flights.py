"""A flight under random signals that needs no controller: made-up data with known truth."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics, register_pytrees, rollout
from airpuck.recording.stream import COLUMNS, Recording, Stream

#: Rates of motion capture and commands [Hz].
POSE_RATE, COMMAND_RATE = 240.0, 100.0
#: Each random signal is held this long: whole numbers of samples at both rates [s].
HOLD = 0.1
#: Random signals to choose from.
_CANDIDATES = 6
#: Time stamp of the first pose [ns since 1970].
_EPOCH_NS = 1_700_000_001_000_000_000


@cache
def _program() -> Any:
    """`rollout`, compiled, since most tests need flights and a loop in Python takes seconds."""
    import jax
    import jax.numpy as jnp

    return jax.jit(lambda *arguments: rollout(jnp, *arguments))


def fast_rollout(
    dynamics: Dynamics,
    state: Float[np.ndarray, "z *batch"],
    commands: Float[np.ndarray, "T n *batch"],
    durations: Float[np.ndarray, "T *batch"],
) -> Float[np.ndarray, "T z *batch"]:
    """Do what `airpuck.physics.rigid_body.rollout` does, to rounding errors.

    Parameters
    ----------
    dynamics : Dynamics
        Coefficients.
    state : array, shape (6 + n, ...)
        Extended states to start from.
    commands : array, shape (T, n, ...)
        Command in force over each step.
    durations : array, shape (T, ...)
        Length of each step [s].

    Returns
    -------
    array, shape (T, 6 + n, ...)
        Extended state at the end of each step.
    """
    import jax

    register_pytrees()  # a test may have added an effect
    with jax.enable_x64(True):
        return np.asarray(_program()(dynamics, state, commands, durations))


@dataclass(frozen=True, eq=False)
class RandomFlight:
    """States and commands at the rate of the motion capture, without noise or delay.

    Attributes
    ----------
    time : array, shape (N,)
        Sample times [s].
    state : array, shape (N, 6)
        x, y, γ and their rates.
    command : array, shape (N, n)
        Command in force from each sample to the next.
    """

    time: Float[np.ndarray, " N"]
    state: Float[np.ndarray, "N 6"]
    command: Float[np.ndarray, "N n"]


def random_flight(model: Model, duration: float, seed: int) -> RandomFlight:
    """Integrate a model from rest under random signals.

    One motor of each pair at a time gets a random signal. Of six random signals, fly the best: the
    craft ends nearest to rest in the middle. This is a poor controller, but it keeps speeds
    realistic.

    Parameters
    ----------
    model : Model
        The plant; neighbouring columns of its command are taken as pairs.
    duration : float
        Length, rounded to tenths of a second [s].
    seed : int
        Seed of the signals.

    Returns
    -------
    RandomFlight
        The flight.
    """
    rng = np.random.default_rng(seed)
    vehicle, n, steps = model.vehicle, model.vehicle.n_propellers, round(HOLD * POSE_RATE)
    durations = np.full((steps, _CANDIDATES), 1 / POSE_RATE)
    state = np.concatenate([np.zeros(6), np.full(n, vehicle.command_min)])
    states, held = [state[None]], []
    for _ in range(round(duration / HOLD)):
        signal = rng.uniform(-1, 1, ((n + 1) // 2, _CANDIDATES))
        both = np.stack([signal, -signal], axis=1).reshape(-1, _CANDIDATES)[:n]
        commands = np.clip(both, vehicle.command_min, vehicle.command_max)
        ahead = fast_rollout(
            model.dynamics,
            np.repeat(state[:, None], _CANDIDATES, axis=1),
            np.repeat(commands[None], steps, axis=0),
            durations,
        )
        x, y, _, vx, vy, spin = ahead[-1, :6]
        best = int(np.argmin((x + vx) ** 2 + (y + vy) ** 2 + (0.03 * spin) ** 2))
        states.append(ahead[:, :, best])
        held.append(np.repeat(commands[None, :, best], steps, axis=0))
        state = ahead[-1, :, best]
    command = np.concatenate(held)
    return RandomFlight(
        time=np.arange(len(command)) / POSE_RATE,
        state=np.concatenate(states)[:-1, :6],
        command=command,
    )


def random_recording(
    model: Model, duration: float, seed: int, *, delay: float = 5 / 240, noise: float = 1e-4
) -> Recording:
    """Record a random flight as a lab would: noisy poses, wrapped yaw, commands at 100 Hz.

    Parameters
    ----------
    model : Model
        The plant.
    duration : float
        Length [s].
    seed : int
        Seed of signals and noise.
    delay : float, default 5/240
        Transport delay: a command acts this long after its stamp [s].
    noise : float, default 1e-4
        Standard deviation of the pose noise [m, m, rad].

    Returns
    -------
    Recording
        Streams ``pose`` and ``command``.
    """
    flight = random_flight(model, duration, seed)
    rng = np.random.default_rng([seed, 1])
    pose = flight.state[:, :3] + noise * rng.normal(size=(len(flight.time), 3))
    pose[:, 2] = (pose[:, 2] + np.pi) % (2 * np.pi) - np.pi
    command_time = np.arange(round(duration * COMMAND_RATE)) / COMMAND_RATE
    # The small addition keeps rounding from choosing the sample before.
    command = flight.command[(command_time * POSE_RATE + 1e-6).astype(int)]

    def stream(
        time: Float[np.ndarray, " N"],
        values: Float[np.ndarray, "N k"],
        columns: tuple[str, ...],
        latency: float,
    ) -> Stream:
        stamp = _EPOCH_NS + np.rint(time * 1e9).astype(np.int64)
        return Stream(stamp, stamp + round(latency * 1e9), values, columns)

    return Recording(
        streams={
            "pose": stream(flight.time, pose, COLUMNS["pose"], 1e-3),
            "command": stream(command_time - delay, command, model.vehicle.propeller_names, 1e-4),
        },
        source=f"random flight {seed} of {model.name}",
    )
