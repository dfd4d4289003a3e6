"""Whether commands act after the same time throughout a recording.

A clock that steps or drifts in mid-flight gives a recording two delays, and a fit learns their mean
with a small standard error. The change shows in the residuals: those along the effect of a delay
have one sign in one part of the recording, and the other sign in the other part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

#: Fewest blocks of time in a part: together at least 10 s.
_FEWEST = 6
#: Smallest variance [s²].
_TINY = 1e-24


@dataclass(frozen=True)
class TimingChange:
    """The clearest change of the time after which commands act."""

    #: Later part minus earlier part, and its standard error [s].
    change: float
    error: float
    #: When it happens [s].
    at: float
    #: Probability of such a change between these parts by chance.
    p_value: float = 1.0


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
    from scipy.special import stdtr

    late = columns @ timing
    flat = columns.reshape(-1, columns.shape[2])
    # What other errors explain of a delay tells nothing about it.
    others = flat - np.outer(flat @ timing, timing) / (timing @ timing)
    known, *_ = np.linalg.lstsq(others, late.ravel(), rcond=1e-8)
    late = late - (others @ known).reshape(late.shape)
    owner = ((start - start[0]) / block).astype(int)
    shape = len(start), -1
    score, weight = (
        np.bincount(owner, (late * one).reshape(shape).sum(axis=1)) for one in (left, late)
    )
    times = start[0] + block * np.flatnonzero(weight > 0)
    score, weight = score[weight > 0], weight[weight > 0]
    cuts = np.arange(_FEWEST, len(score) - _FEWEST + 1)
    if not len(cuts):
        return TimingChange(0.0, 0.0, float(start[0]))
    early, before = np.cumsum(score)[cuts - 1], np.cumsum(weight)[cuts - 1]
    after = weight.sum() - before
    change = (score.sum() - early) / after - early / before
    # The cut that explains most.
    best = int(np.argmax(change**2 * before * after))
    variances, counts = [], []
    for part in (slice(0, cuts[best]), slice(cuts[best], None)):
        mean = score[part].sum() / weight[part].sum()
        count = len(score[part])
        rest = np.sum((score[part] - mean * weight[part]) ** 2)
        variances.append(max(count / (count - 1) * rest / weight[part].sum() ** 2, _TINY))
        counts.append(count)
    error = float(np.sqrt(sum(variances)))
    # Welch's test: the variance of a few blocks is itself uncertain.
    spread = sum(v**2 / (n - 1) for v, n in zip(variances, counts, strict=True))
    degrees = sum(variances) ** 2 / spread
    p_value = 2 * float(stdtr(degrees, -abs(change[best]) / error))
    return TimingChange(float(change[best]), error, float(times[cuts[best]]), p_value)
