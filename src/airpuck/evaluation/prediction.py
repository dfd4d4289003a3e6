"""Predict windows with a model, and measure the errors."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import Windows
from airpuck.estimate.encoder import Encoder
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics
from airpuck.physics.rollout import rollout

#: Windows predicted at once, which bounds the memory.
_BATCH = 1024


def delay_for(model: Model, trajectory: Trajectory) -> float:
    """Return how long after its time in a trajectory a command acts, as a model wants it."""
    if not model.delay_learned:
        return trajectory.delay
    return trajectory.acting_delay(model.transport_delay, model.vehicle.nominal.transport_delay_s)


def hold_for(model: Model, windows: Windows) -> Windows:
    """Hold the commands of windows as a model wants them."""
    if not model.delay_learned:
        return windows
    return windows.delayed(model.transport_delay, model.vehicle.nominal.transport_delay_s)


def prediction_errors(
    dynamics: Dynamics,
    windows: Windows,
    encoder: Encoder,
    past: Int[np.ndarray, " W"] | None = None,
) -> Float[np.ndarray, "T 3 W"]:
    """Predict every window and compare with what was measured."""
    errors = np.empty((windows.prediction_length, 3, len(windows)))
    if past is None:
        past = np.full(len(windows), windows.encoder_length)
    for length in np.unique(past).tolist():
        alike = np.flatnonzero(past == length)
        for first in range(0, len(alike), _BATCH):
            part = alike[first : first + _BATCH]
            starts = windows.starts[part]
            state, now = encoder.begin(dynamics, windows.past(starts, length))
            commands, durations, measured = windows.future(starts)
            predicted = rollout(np, now, state, commands, durations)
            errors[:, :, part] = predicted[:, :3] - measured[:, :3]
    return errors
