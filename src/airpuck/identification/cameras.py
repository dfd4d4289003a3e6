"""Rate, noise and stamp errors of the cameras, as a recording shows them.

Third differences of the poses, minus the model's accelerations integrated twice, contain nothing
but noise: at rest only the cameras', in motion the stamps' as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import integration_parts, refined
from airpuck.deviation.motor_regression import integrated
from airpuck.identification.retiming import modelled_acceleration
from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Cameras

#: Samples of a third difference.
_SAMPLES = 4
#: Median of the square of a standard normal number.
_MEDIAN_SQUARE = 0.4549
#: Number of groups by speed, and fewest differences in a group.
_GROUPS, _FEWEST = 8, 12
#: Passes of the weighted least squares: each weights by the fit of the one before.
_PASSES = 10
#: Smallest variance of a group, relative to the mean of all.
_LEAST = 0.01
#: Standard errors by which the variance must grow with the squared speed for stamps to err.
_CERTAIN = 3.0


def cameras_of(model: Model, trajectories: Sequence[Trajectory]) -> Cameras | None:
    """Estimate rate, noise and stamp errors of the poses; None if there are too few poses."""
    found = [_differences(model, trajectory) for trajectory in trajectories]
    noise, speed, steps = (np.concatenate(part) for part in zip(*found, strict=True))
    if len(noise) < 2 * _FEWEST:
        return None
    channels = [
        _grouped(np.ravel(noise[:, columns]) ** 2, np.ravel(speed[:, columns]) ** 2)
        for columns in (slice(0, 2), slice(2, 3))
    ]
    (position, yaw), jitter = _variances(channels)
    return Cameras(
        rate_hz=float(1 / np.mean(steps)),
        position_noise_m=float(np.sqrt(position)),
        yaw_noise_rad=float(np.sqrt(yaw)),
        stamp_jitter_s=float(np.sqrt(jitter)),
    )


def _differences(
    model: Model, trajectory: Trajectory
) -> tuple[Float[np.ndarray, "D 3"], Float[np.ndarray, "D 3"], Float[np.ndarray, " D"]]:
    """Return third differences with the noise of one pose, the speeds there, and the steps."""
    parts = integration_parts(trajectory)
    fine = refined(trajectory, parts)
    modelled = modelled_acceleration(fine, model)
    time, period = trajectory.time, trajectory.sample_period
    known = np.append(trajectory.measured, np.zeros(_SAMPLES - 1, dtype=bool))
    whole = np.asarray(np.lib.stride_tricks.sliding_window_view(known, _SAMPLES).all(axis=1))
    first = trajectory.window_starts(_SAMPLES, 1, whole)
    index = first + np.arange(_SAMPLES)[:, None]
    inner = parts * first + np.arange((_SAMPLES - 1) * parts + 1)[:, None]
    acceleration = np.moveaxis(modelled[inner], 2, 1)
    moved = integrated(acceleration, np.diff(fine.time[inner], axis=0))[1][::parts]
    rest = np.moveaxis(trajectory.state[index, :3], 2, 1) - moved
    at = (time[index] - time[first]) / period
    # Divided differences: exact for cubics, however the stamps are spaced.
    gaps = at[:, None] - at[None] + np.eye(_SAMPLES)[..., None]
    weight = 1 / np.prod(gaps, axis=1)
    weight /= np.linalg.norm(weight, axis=0)
    noise = np.einsum("eb,ecb->bc", weight, rest)
    speed = trajectory.state[index, 3:].mean(axis=0)
    return noise, speed, np.diff(time[index], axis=0).mean(axis=0)


def _grouped(
    square: Float[np.ndarray, " D"], speed: Float[np.ndarray, " D"]
) -> Float[np.ndarray, "3 G"]:
    """Return mean squared speed, variance of the noise and its relative error, by speed.

    Medians ignore what the model cannot explain: contacts, motors that fail.
    """
    count = max(min(_GROUPS, len(square) // _FEWEST), 1)
    groups = np.array_split(np.argsort(speed, kind="stable"), count)
    return np.array(
        [
            (speed[g].mean(), np.median(square[g]) / _MEDIAN_SQUARE, (2.5 / len(g)) ** 0.5)
            for g in groups
        ]
    ).T


def _variances(
    channels: Sequence[Float[np.ndarray, "3 _"]],
) -> tuple[Float[np.ndarray, " 2"], float]:
    """Return the variances of position [m²] and yaw [rad²] at rest, and of the stamps [s²]."""
    usual = np.array([found[1].mean() for found in channels])
    scale = np.maximum(usual, 1e-18)
    table = np.concatenate(
        [
            np.column_stack([np.tile(np.eye(2)[k], (len(found[0]), 1)), found[0] / scale[k]])
            for k, found in enumerate(channels)
        ]
    )
    # In units in which the stamps' error is typical, too.
    unit = 1 / max(float(table[:, 2].max()), 1e-300)
    table[:, 2] *= unit
    aim = np.concatenate([found[1] / scale[k] for k, found in enumerate(channels)])
    error = np.concatenate([found[2] for found in channels])
    fitted, best, spread = np.maximum(aim, _LEAST), np.zeros(3), np.zeros((3, 3))
    for _ in range(_PASSES):
        weight = 1 / (error * fitted)
        spread = np.linalg.pinv((table * weight[:, None] ** 2).T @ table)
        best = spread @ table.T @ (weight**2 * aim)
        fitted = np.maximum(table @ best, _LEAST)
    if best[2] < _CERTAIN * np.sqrt(spread[2, 2]):
        return usual, 0.0
    return np.maximum(best[:2], 0.0) * scale, float(best[2]) * unit
