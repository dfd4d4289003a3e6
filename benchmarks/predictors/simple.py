"""Methods that know nothing of the craft: coasting, and a direct multi-step ARX model."""

from __future__ import annotations

import numpy as np

from airpuck import Trajectory, Vehicle
from airpuck.data.windows import Windows, make_windows

from . import Predictor, to_body, to_table

#: Samples that are averaged for one regressor, at 240 Hz.
_BLOCK = 4
#: Penalties that are tried, relative to the mean square of the regressors.
_RIDGES = 10.0 ** np.arange(-6, 1)
#: Samples between the windows that are learned from.
_STRIDE = 2


def coasting(trajectory: Trajectory, vehicle: Vehicle) -> Predictor:
    """Predict that the velocity stays."""

    def predict(windows: Windows) -> np.ndarray:
        now = windows.present
        lasted = windows.time[now + windows.prediction_length] - windows.time[now]
        state = windows.state[now].T
        return state[:3] + lasted * state[3:]

    return Predictor(predict, 0)


def arx(trajectory: Trajectory, vehicle: Vehicle, past: int = 40, ahead: int = 48) -> Predictor:
    """Regress the change of pose after the horizon on past velocities and on all commands.

    Everything is in the craft's frame at the present. The penalty is chosen on the last quarter of
    the recording.
    """
    windows = make_windows([trajectory], past, ahead, _STRIDE)
    columns, change = _regressors(windows), _change(windows)
    mean, scale = columns.mean(axis=0), columns.std(axis=0) + 1e-9
    columns = (columns - mean) / scale
    held = 3 * len(columns) // 4
    early, late = slice(0, held - past - ahead), slice(held, None)
    weight = np.empty((columns.shape[1] + 1, 3))
    for channel in range(3):
        values = change[channel]
        tried = [_ridge(columns[early], values[early], ridge) for ridge in _RIDGES]
        errors = [np.mean((_affine(columns[late]) @ w - values[late]) ** 2) for w in tried]
        best = _RIDGES[int(np.argmin(errors))]
        weight[:, channel] = _ridge(columns, values, best)

    def predict(windows: Windows) -> np.ndarray:
        along, across, turn = (_affine((_regressors(windows) - mean) / scale) @ weight).T
        state = windows.state[windows.present].T
        lasted = windows.time[windows.present + ahead] - windows.time[windows.present]
        dx, dy = to_table(state[2], along, across)
        return state[:3] + lasted * state[3:] + np.stack([dx, dy, turn])

    return Predictor(predict, weight.size)


def _affine(columns: np.ndarray) -> np.ndarray:
    return np.column_stack([columns, np.ones(len(columns))])


def _ridge(columns: np.ndarray, values: np.ndarray, ridge: float) -> np.ndarray:
    columns = _affine(columns)
    normal = columns.T @ columns
    return np.linalg.solve(normal + ridge * len(columns) * np.eye(len(normal)), columns.T @ values)


def _change(windows: Windows) -> np.ndarray:
    """Return the change of pose beyond coasting, in the craft's frame at the present."""
    now, end = windows.present, windows.present + windows.prediction_length
    lasted = windows.time[end] - windows.time[now]
    state = windows.state[now].T
    dx, dy, turn = windows.state[end].T[:3] - state[:3] - lasted * state[3:]
    return np.stack([*to_body(state[2], dx, dy), turn])


def _regressors(windows: Windows) -> np.ndarray:
    """Return past velocities in the craft's frame, and all commands averaged over blocks.

    Commands are given also squared, since thrust bends, and times the present yaw rate, since the
    craft turns under its thrust.
    """
    before, ahead = windows.encoder_length, windows.prediction_length
    index = windows.starts[:, None] + np.arange(before + ahead)
    yaw = windows.state[windows.present, 2][:, None]
    _, _, _, vx, vy, spin = np.moveaxis(windows.state[index[:, :before]], 2, 0)
    motion = np.stack([*to_body(yaw, vx, vy), spin], axis=2)
    # The first sample of a block is the last before a new one, so that velocities end at present.
    motion = motion[:, ::-_BLOCK][:, : before // _BLOCK]
    command = windows.input[index]
    command = command[:, : (before + ahead) // _BLOCK * _BLOCK]
    command = command.reshape(len(index), -1, _BLOCK, command.shape[2]).mean(axis=2)
    motion, command = motion.reshape(len(index), -1), command.reshape(len(index), -1)
    command = np.concatenate([command, command**2], axis=1)
    return np.concatenate([motion, command, command * motion[:, 2:3]], axis=1)
