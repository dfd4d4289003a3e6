"""Exact flights of the published M4 for the tests of filters."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from airpuck.estimate.axis_filter import Noise
from airpuck.model.model_file import read_model
from airpuck.physics.rigid_body import derivative

MODEL = read_model("paper:M4")
DELAY = MODEL.transport_delay
TAU = float(MODEL.dynamics.motor_time_constant)
IDLE = np.full(6, MODEL.vehicle.command_min)
NOISE = Noise(pose=(1e-4, 2e-4, 6e-4), acceleration=(0.02, 0.03, 0.6), disturbance=(0.2, 0.3, 6.0))
Commands = list[tuple[float, np.ndarray]]


def some_commands(duration: float, seed: int = 0) -> Commands:
    """Return new commands a hundred times a second, never at the time of a pose."""
    random = np.random.default_rng(seed)
    times = 0.0037 + 0.01 * np.arange(round(100 * duration))
    return [(float(t), random.uniform(0.03, 0.6, 6)) for t in times]


def acting(commands: Commands, time: float) -> np.ndarray:
    """The command in force at a time."""
    sent = [c for t, c in commands if t + DELAY <= time]
    return sent[-1] if sent else IDLE


def switches(commands: Commands, start: float, end: float) -> list[float]:
    """Return both ends, and all times in between at which the command changes."""
    return [start, *(t + DELAY for t, _ in commands if start < t + DELAY < end), end]


def simulate(
    commands: Commands,
    start: np.ndarray,
    times: np.ndarray,
    push: Callable[[float], np.ndarray] = lambda t: np.zeros(3),
) -> np.ndarray:
    """Exact states of the craft with motors, under an extra acceleration."""

    def rhs(t: float, z: np.ndarray, command: np.ndarray) -> np.ndarray:
        rate = derivative(np, MODEL.dynamics, z, command)
        rate[3:6] += push(t)
        return rate

    states, z = [start], start
    for begin, end in pairwise(times.tolist()):
        for a, b in pairwise(switches(commands, begin, end)):
            command = acting(commands, (a + b) / 2)
            z = solve_ivp(rhs, (a, b), z, args=(command,), rtol=1e-9, atol=1e-12).y[:, -1]
        states.append(z)
    return np.array(states)
