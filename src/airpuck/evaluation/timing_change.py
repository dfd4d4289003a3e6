"""Whether commands act after the same time throughout a recording.

A clock that steps or drifts in mid-flight gives a recording two delays, and a fit learns their mean
with a small standard error. The change shows in the residuals: those along the effect of a delay
have one sign in one part of the recording, and the other sign in the other part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

#: Fewest blocks of time in a part.
_FEWEST = 4


@dataclass(frozen=True)
class TimingChange:
    """The clearest change of the time after which commands act."""

    #: Later part minus earlier part, and its standard error [s].
    change: float
    error: float
    #: When it happens [s].
    at: float

    @property
    def certainty(self) -> float:
        """Size of the change in standard errors."""
        return abs(self.change) / self.error if self.error > 0 else 0.0


def timing_change(
    columns: Float[np.ndarray, "M 3 m"],
    left: Float[np.ndarray, "M 3"],
    timing: Float[np.ndarray, " m"],
    start: Float[np.ndarray, " W"],
    block: float,
) -> TimingChange:
    """Compare the timing before and after each possible change.

    `columns` are the effects of all errors on the poses of W windows, `left` what the errors in the
    whole recording leave; `timing` is the direction of a delay. Windows that begin within `block`
    [s] count as one observation.
    """
    late = columns @ timing
    flat = columns.reshape(-1, columns.shape[2])
    # What other errors explain of a delay tells nothing about it.
    others = flat - np.outer(flat @ timing, timing) / (timing @ timing)
    known, *_ = np.linalg.lstsq(others, late.ravel(), rcond=1e-8)
    late = late - (others @ known).reshape(late.shape)
    owner = ((start - start[0]) / block).astype(int)
    shape = len(start), -1
    score = _summed((late * left).reshape(shape).sum(axis=1), owner)
    weight = _summed((late * late).reshape(shape).sum(axis=1), owner)
    score, weight = score[weight > 0], weight[weight > 0]
    times = start[0] + block * np.flatnonzero(_summed(np.ones(len(start)), owner) > 0)
    best = TimingChange(0.0, 0.0, float(start[0]))
    for cut in range(_FEWEST, len(score) - _FEWEST + 1):
        means, variance = [], 0.0
        for part in (slice(0, cut), slice(cut, None)):
            mean = score[part].sum() / weight[part].sum()
            count = len(score[part])
            rest = np.sum((score[part] - mean * weight[part]) ** 2)
            variance += count / (count - 1) * rest / weight[part].sum() ** 2
            means.append(mean)
        found = TimingChange(float(means[1] - means[0]), float(np.sqrt(variance)), times[cut])
        if found.certainty > best.certainty:
            best = found
    return best


def _summed(values: Float[np.ndarray, " W"], owner: Int[np.ndarray, " W"]) -> np.ndarray:
    """Sum up the values of each owner."""
    return np.bincount(owner, values)
