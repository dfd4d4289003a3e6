"""How much the transport delay differs from packet to packet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from airpuck.identification.packet_delays import PacketDelays
from airpuck.model.uncertainty_section import DelayJitter

#: Fewer degrees of freedom than this have no spread to speak of.
_FEWEST = 9


def delay_jitter(delays: Sequence[PacketDelays]) -> DelayJitter | None:
    """Estimate the standard deviation of the packets' delays by a random-effects model.

    The deviations of a recording are normal about their mean with variance σ² + v, v the variance
    of each estimate. σ² is the one at which Σ (δ - mean)²/(σ² + v), with the mean weighted by
    1/(σ² + v), is its expectation, the degrees of freedom (Paule and Mandel, Journal of Research
    of the NBS 87, 1982); zero where the noise explains the spread. The standard error is that of a
    sample variance, by the fourth moment.
    """
    delays = [found for found in delays if len(found)]
    degrees = sum(len(found) - 1 for found in delays)
    if degrees < _FEWEST:
        return None
    noise = np.concatenate([d.standard_error**2 for d in delays])
    low, high = 0.0, sum(float(np.sum((d.deviation - np.mean(d.deviation)) ** 2)) for d in delays)
    for _ in range(100):
        middle = (low + high) / 2
        if np.sum(_centred(delays, middle) ** 2 / (middle + noise)) > degrees:
            low = middle
        else:
            high = middle
    deviation = _centred(delays, high)
    jitter, square = float(np.sqrt(high)), deviation**2
    error = float(np.sqrt(np.var(square) / len(square)))
    return DelayJitter(
        standard_deviation_s=jitter,
        # σ is not normal near zero: there, what a variance of one standard error would be.
        standard_error_s=error / max(2 * jitter, error**0.5),
        packets=len(deviation),
    )


def spread_of(delays: Sequence[PacketDelays]) -> float:
    """Return the standard deviation of the packets' delays."""
    jitter = delay_jitter(delays)
    return jitter.standard_deviation_s if jitter else 0.0


def variance_of_mean(delays: Sequence[PacketDelays], jitter: float) -> float:
    """Return the variance of the known packets' mean delay about that of all packets.

    A fit to packets at the times of their arrival knows the mean delay of those that it knows,
    as exactly as poses tell. These are a sample of B of the radio's packets: σ²/B where all are
    known equally well, σ² Σ w²/(Σ w)² with the weights w = 1/(σ² + v) of their mean.
    """
    if not jitter > 0 or not any(map(len, delays)):
        return 0.0
    weight = 1 / (jitter**2 + np.concatenate([d.standard_error**2 for d in delays]))
    return float(jitter**2 * np.sum(weight**2) / np.sum(weight) ** 2)


def _centred(delays: Sequence[PacketDelays], variance: float) -> Float[np.ndarray, " B"]:
    """Return deviations from the weighted mean of their recording: each has one of its own."""
    means = [np.average(d.deviation, weights=1 / (variance + d.standard_error**2)) for d in delays]
    return np.concatenate([d.deviation - m for d, m in zip(delays, means, strict=True)])
