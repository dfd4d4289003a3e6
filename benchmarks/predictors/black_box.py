"""A neural network of the craft's accelerations that knows no physics but the kinematics."""

from __future__ import annotations

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import optax

from airpuck import Trajectory, Vehicle
from airpuck.data.windows import Windows, make_windows

from . import Predictor

#: Blocks of past commands that the network sees, and samples of each: 100 ms at 240 Hz.
_BLOCKS, _BLOCK = 8, 3
#: Units of the two hidden layers.
_HIDDEN = (64, 24)
#: Weights of x, y and yaw errors, as in the fits of models.
_WEIGHTS = jnp.array([1.0, 1.0, 0.1])
#: Steps of the optimiser, windows of each, and steps between looks at the held-out quarter.
_STEPS, _BATCH, _LOOK = 6000, 128, 200
_AHEAD = 48


def accelerations(trajectory: Trajectory, vehicle: Vehicle) -> Predictor:
    """Learn the accelerations in the craft's frame from commands of the last 100 ms and velocities.

    The loss is that of predictions over 0.2 s. The last quarter of the recording stops the
    training.
    """
    windows = make_windows([trajectory], _BLOCKS * _BLOCK + 1, _AHEAD, 3)
    data = _data(windows)
    held = 3 * len(windows) // 4
    early = [part[: held - 24] for part in data]
    late = [part[held:] for part in data]
    weights = _start(np.random.default_rng(0), data[1].shape[2] * _BLOCKS + 3)
    optimiser = optax.adam(optax.cosine_decay_schedule(3e-3, _STEPS))
    state = optimiser.init(weights)

    @jax.jit
    def step(weights, state, *batch):
        slope = jax.grad(_loss)(weights, *batch)
        change, state = optimiser.update(slope, state)
        return optax.apply_updates(weights, change), state

    draw = np.random.default_rng(1)
    best, best_loss = weights, np.inf
    for number in range(_STEPS):
        chosen = draw.integers(0, len(early[0]), _BATCH)
        weights, state = step(weights, state, *[part[chosen] for part in early])
        if number % _LOOK == _LOOK - 1:
            loss = float(_loss(weights, *late))
            if loss < best_loss:
                best, best_loss = weights, loss

    def predict(windows: Windows) -> np.ndarray:
        return np.asarray(_rollout(best, *_data(windows)[:3]))[:, -1].T

    return Predictor(predict, sum(part.size for part in jax.tree.leaves(weights)))


def _start(draw: np.random.Generator, inputs: int) -> list:
    sizes = (inputs, *_HIDDEN, 3)
    layers = []
    for low, high in pairwise(sizes):
        scale = 0.01 if high == 3 else np.sqrt(1 / low)
        layers.append((jnp.asarray(scale * draw.standard_normal((low, high))), jnp.zeros(high)))
    return layers


def _data(windows: Windows) -> tuple[np.ndarray, ...]:
    """Return present states, commands of past and future, durations, and future poses."""
    past, now = _BLOCKS * _BLOCK, windows.present
    ahead = np.arange(windows.prediction_length)
    index = now[:, None] + np.arange(-past, windows.prediction_length)
    durations = np.diff(windows.time[now[:, None] + np.arange(windows.prediction_length + 1)])
    poses = windows.state[now[:, None] + ahead + 1, :3]
    return windows.state[now], windows.input[index], durations, poses


@jax.jit
def _rollout(weights, state, commands, durations):
    """Integrate the network's accelerations from the present on; poses, shape (W, T, 3)."""
    past = _BLOCKS * _BLOCK

    def acceleration(seen, spin, along, across):
        features = jnp.concatenate([seen, jnp.stack([along, across, spin / 5], axis=1)], axis=1)
        for layer, bias in weights[:-1]:
            features = jnp.tanh(features @ layer + bias)
        return (features @ weights[-1][0] + weights[-1][1]) * jnp.array([1.0, 1.0, 30.0])

    def step(state, k):
        yaw, vx, vy, spin = state.T[2:]
        recent = jax.lax.dynamic_slice_in_dim(commands, k + 1, past, axis=1)
        seen = recent.reshape(len(recent), _BLOCKS, _BLOCK, -1).mean(axis=2)
        cos, sin = jnp.cos(yaw), jnp.sin(yaw)
        body = acceleration(
            seen.reshape(len(recent), -1), spin, cos * vx + sin * vy, cos * vy - sin * vx
        )
        h = durations[:, k]
        ax, ay = cos * body[:, 0] - sin * body[:, 1], sin * body[:, 0] + cos * body[:, 1]
        velocity = jnp.stack([vx, vy, spin])
        change = jnp.stack([ax, ay, body[:, 2]])
        pose = state[:, :3].T + h * velocity + h**2 / 2 * change
        state = jnp.concatenate([pose, velocity + h * change]).T
        return state, state[:, :3]

    _, poses = jax.lax.scan(step, state, jnp.arange(durations.shape[1]))
    return jnp.swapaxes(poses, 0, 1)


@jax.jit
def _loss(weights, state, commands, durations, poses):
    errors = _WEIGHTS * (_rollout(weights, state, commands, durations) - poses)
    return 1e4 * jnp.mean(errors**2)
