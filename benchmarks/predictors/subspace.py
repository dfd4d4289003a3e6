"""A linear state-space model of the velocities in the craft's frame, by a subspace method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airpuck import Trajectory, Vehicle
from airpuck.data.windows import Windows, make_windows

from . import Predictor, to_body, to_table

#: Samples of one step: 60 Hz instead of 240 Hz.
STEP = 4
#: Block rows of the Hankel matrices; order of the model.
_ROWS, _ORDER = 10, 12
_RIDGE = 1e-3


def n4sid(trajectory: Trajectory, vehicle: Vehicle) -> Predictor:
    """Learn a Kalman predictor of the velocities from past and present commands.

    The craft turns, so accelerations in its frame are x' = v' + ω v; the second part is known from
    the outputs and is added by the integration. Inputs are the commands and their squares. Future
    outputs are regressed on past outputs and inputs, and on future inputs; the leading left
    singular vectors of the first part span the states (Van Overschee and De Moor, "Subspace
    Identification for Linear Systems", 1996, chapter 4). A, B, C and the gain follow by regression.
    """
    windows = make_windows([trajectory], 2, 2 * _ROWS * STEP, 2)
    y, u = sequences(windows, 0, 2 * _ROWS + 1)
    mean_y, mean_u = y.mean(axis=(0, 1)), u.mean(axis=(0, 1))
    scale_y, scale_u = y.std(axis=(0, 1)), u.std(axis=(0, 1))
    y, u = (y - mean_y) / scale_y, (u - mean_u) / scale_u
    count = len(y)
    past = np.concatenate(
        [y[:, :_ROWS].reshape(count, -1), u[:, :_ROWS].reshape(count, -1)], axis=1
    )
    future = u[:, _ROWS : 2 * _ROWS].reshape(count, -1)
    target = y[:, _ROWS : 2 * _ROWS].reshape(count, -1)
    regressors = np.concatenate([past, future], axis=1)
    along = _solve(regressors, target)[: past.shape[1]]
    _, values, right = np.linalg.svd(past @ along, full_matrices=False)
    to_state = along @ right[:_ORDER].T / values[:_ORDER] * np.sqrt(count)
    # States of one sample and the next, from pasts that are one sample apart.
    state, after = past @ to_state, _past(y, u, 1) @ to_state
    advance = _solve(np.concatenate([state, u[:, _ROWS]], axis=1), after)
    output = _solve(np.concatenate([state, u[:, _ROWS]], axis=1), y[:, _ROWS])

    def predict(windows: Windows) -> np.ndarray:
        steps = windows.prediction_length // STEP
        y, u = sequences(windows, windows.encoder_length - 1 - _ROWS * STEP, _ROWS + steps)
        y, u = (y - mean_y) / scale_y, (u - mean_u) / scale_u
        many = len(y)
        state = (
            np.concatenate([y[:, :_ROWS].reshape(many, -1), u[:, :_ROWS].reshape(many, -1)], axis=1)
            @ to_state
        )
        forces = []
        for k in range(steps):
            seen = np.concatenate([state, u[:, _ROWS + k]], axis=1)
            forces.append(seen @ output * scale_y + mean_y)
            state = seen @ advance
        return moved(windows, forces)

    return Predictor(predict, advance.size + output.size + to_state.size)


def _past(y: np.ndarray, u: np.ndarray, first: int) -> np.ndarray:
    """Return outputs and inputs of a block of rows, one row for each window."""
    parts = [part[:, first : first + _ROWS].reshape(len(y), -1) for part in (y, u)]
    return np.concatenate(parts, axis=1)


def _solve(columns: np.ndarray, values: np.ndarray) -> np.ndarray:
    normal = columns.T @ columns
    return np.linalg.solve(normal + _RIDGE * len(columns) * np.eye(len(normal)), columns.T @ values)


def sequences(windows: Windows, first: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return accelerations in the craft's frame and inputs of each step, shape (W, steps, k)."""
    index = windows.starts[:, None] + first + STEP * np.arange(steps + 1)
    index = np.clip(index, 0, len(windows.time) - 1)
    _, _, yaw, vx, vy, spin = np.moveaxis(windows.state[index], 2, 0)
    h = np.maximum(np.diff(windows.time[index]), 1e-6)
    middle = yaw[:, :-1] + np.diff(yaw) / 2
    ax, ay = to_body(middle, np.diff(vx) / h, np.diff(vy) / h)
    output = np.stack([ax, ay, np.diff(spin) / h], axis=2)
    command = np.stack(
        [windows.input[np.minimum(index[:, :-1] + k, len(windows.input) - 1)] for k in range(STEP)]
    ).mean(axis=0)
    return output, np.concatenate([command, command**2], axis=2)


def moved(windows: Windows, forces: Sequence[np.ndarray]) -> np.ndarray:
    """Return the poses after accelerations in the craft's frame, each (W, 3) for one step."""
    now = windows.present
    pose, (vx, vy, spin) = windows.state[now, :3].T, windows.state[now, 3:].T
    velocity = np.stack([*to_body(pose[2], vx, vy), spin])
    for k, force in enumerate(forces):
        index = now + k * STEP
        h = windows.time[index + STEP] - windows.time[index]
        middle = velocity + h / 2 * (force.T + _turning(velocity))
        dx, dy = to_table(pose[2] + h / 2 * middle[2], middle[0], middle[1])
        pose = pose + h * np.stack([dx, dy, middle[2]])
        velocity = velocity + h * (force.T + _turning(middle))
    return pose


def _turning(velocity: np.ndarray) -> np.ndarray:
    """Return how a velocity changes in the craft's frame because the frame turns."""
    along, across, spin = velocity
    return np.stack([spin * across, -spin * along, 0 * spin])
