"""Blocks of time, nearly independent of each other: what errors are estimated from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from airpuck.data.windows import Windows
from airpuck.identification.objective import BATCH

#: Length of a block [s]. Neighbouring blocks share what reaches across their border
#: (`shared_at_borders`): shorter blocks share more, longer ones are too few in a minute of flight.
BLOCK = 2.0
#: A block is at least this many windows long, for the same reason.
_LENGTHS = 5


def cluster_windows(windows: Windows) -> Int[np.ndarray, " W"]:
    """Group windows into blocks of time."""
    trajectory, stride = _steps(windows)
    period = float(np.median(np.diff(windows.time)))
    span = max(BLOCK, _LENGTHS * period * (windows.encoder_length + windows.prediction_length))
    size = max(1, round(span / (stride * period)))
    # Whole batches, where that is near: half-filled ones would cost as much as full ones.
    if size > 0.75 * BATCH:
        size = BATCH * round(size / BATCH)
    clusters, first = np.zeros(len(windows), dtype=int), 0
    for number in np.unique(trajectory):
        own = np.flatnonzero(trajectory == number)
        for block in np.array_split(own, -(-len(own) // size)):
            clusters[block] = first
            first += 1
    return clusters


def shared_at_borders(windows: Windows, clusters: Int[np.ndarray, " W"]) -> float:
    """Return the share of the scores' variance that blocks of windows miss at their borders.

    Scores of windows of length L that begin ℓ apart have the correlation 1 - ℓ/L where they begin,
    since that much of what disturbs them is common. Pairs across the ends of a block of length B
    are a share (2/B) ∫₀ᴸ ℓ (1 - ℓ/L) dℓ / L = L/(3 B) of all.
    """
    blocks = int(clusters.max()) + 1
    trajectory, stride = _steps(windows)
    inside = np.diff(trajectory) == 0
    length = windows.encoder_length + windows.prediction_length
    borders = int(np.sum(inside & (np.diff(clusters) != 0) & (np.diff(windows.starts) < length)))
    return borders / blocks * length / (3 * max(stride * len(windows) / blocks, length))


def _steps(windows: Windows) -> tuple[Int[np.ndarray, " W"], float]:
    """Return the trajectory of each window, and how many samples on the next begins, typically."""
    trajectory = np.searchsorted(windows.origins, windows.starts, side="right")
    steps = np.diff(windows.starts)[np.diff(trajectory) == 0]
    return trajectory, float(np.median(steps)) if len(steps) else 1.0
