"""The loss as the paper defines it: encode, roll out, compare; no batches or sensitivities."""

import numpy as np

from airpuck.identification.settings import PUBLISHED_WEIGHTS
from airpuck.physics.rigid_body import rollout


def plain_residuals(xp, dynamics, windows, encoder, weights=PUBLISHED_WEIGHTS, starts=None):
    """Weighted errors of the poses, (T, 3, W)."""
    commands, durations, measured = windows.future(starts)
    state = encoder.encode(xp, dynamics, windows.past(starts))
    predicted = rollout(xp, dynamics, state, commands, durations)
    return xp.asarray(weights)[:, None] * (predicted[:, :3] - measured[:, :3])


def differences(function, vector, entries, step=1e-5, least=1e-2):
    """Central differences of a function by some entries of a vector, which become the last axis."""
    columns = []
    for entry in entries:
        change = step * max(abs(vector[entry]), least) * np.eye(len(vector))[entry]
        columns.append((function(vector + change) - function(vector - change)) / (2 * change.sum()))
    return np.stack(columns, axis=-1)
