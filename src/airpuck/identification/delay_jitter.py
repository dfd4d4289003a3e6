"""How much the transport delay differs from packet to packet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airpuck.identification.packet_delays import PacketDelays
from airpuck.uncertainty_section import DelayJitter

#: Fewer packets than this have no spread to speak of.
_FEWEST = 10


def delay_jitter(delays: Sequence[PacketDelays]) -> DelayJitter | None:
    """Estimate the standard deviation of the packets' delays by a random-effects model.

    The deviations of a recording are normal about their mean with variance σ² + v, v the variance
    of each estimate. σ² is the one at which Σ (δ - mean)²/(σ² + v) is its expectation, the degrees
    of freedom (Paule and Mandel, Journal of Research of the NBS 87, 1982); zero where the noise
    explains the spread. The standard error is that of a sample variance, by the fourth moment.

    Parameters
    ----------
    delays : sequence of PacketDelays
        From each recording.

    Returns
    -------
    DelayJitter or None
        None where fewer than ten packets switched a motor.
    """
    delays = [found for found in delays if len(found)]
    if sum(map(len, delays)) < _FEWEST:
        return None
    # Each recording has a mean of its own.
    deviation = np.concatenate([d.deviation - np.mean(d.deviation) for d in delays])
    noise = np.concatenate([d.standard_error**2 for d in delays])
    degrees = len(deviation) - len(delays)
    low, high = 0.0, float(np.sum(deviation**2))
    for _ in range(100):
        middle = (low + high) / 2
        if np.sum(deviation**2 / (middle + noise)) > degrees:
            low = middle
        else:
            high = middle
    jitter, square = float(np.sqrt(high)), deviation**2
    error = float(np.sqrt(np.var(square) / len(square)))
    return DelayJitter(
        standard_deviation_s=jitter,
        # σ is not normal near zero: there, what a variance of one standard error would be.
        standard_error_s=error / max(2 * jitter, error**0.5),
        packets=len(deviation),
    )
