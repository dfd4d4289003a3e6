"""Lost frames of the cameras: samples without a measurement, instead of gaps.

A prediction needs a start and commands, but not every pose. A sample stands for each lost frame, so
that windows of equally many samples last equally long. Its state is interpolated and marked as not
measured. Only a long pause remains a gap.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from airpuck.data.sampling import longest_bridge, usual_period

#: Longest pause that is no gap [s]: 0.1 s of lost frames. Longer ones hide what the craft does.
_LONGEST = 0.125
#: Fraction of lost frames that is mentioned.
_MENTIONED = 0.001


def longest_pause(period: float) -> float:
    """Return the longest pause between poses that is no gap [s]."""
    return max(_LONGEST, longest_bridge(period))


def with_lost_frames(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N k"]
) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M k"], Bool[np.ndarray, " M"]]:
    """Add a sample for each lost frame; return times, values, and which are measured."""
    pause, period = np.diff(time), usual_period(time)
    lost = np.where(pause <= longest_pause(period), np.rint(pause / period) - 1, 0)
    lost = np.maximum(lost, 0).astype(int)
    before = np.repeat(np.arange(len(pause)), lost)
    number = 1 + np.arange(len(before)) - np.repeat(np.cumsum(lost) - lost, lost)
    added = time[before] + pause[before] * number / (lost[before] + 1)
    order = np.argsort(np.concatenate([time, added]), kind="stable")
    measured = order < len(time)
    between = np.concatenate([values, np.zeros((len(added), values.shape[1]))])[order]
    times = np.concatenate([time, added])[order]
    if len(added):
        rates = np.zeros_like(between)
        rates[measured] = np.gradient(values, time, axis=0)
        between, _ = interpolated(times, between, rates, measured)
    return times, between, measured


def interpolated(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N k"],
    rates: Float[np.ndarray, "N k"],
    known: Bool[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "N k"], Float[np.ndarray, "N k"]]:
    """Fill in unknown values and rates from cubics between their known neighbours."""
    places, unknown = np.flatnonzero(known), np.flatnonzero(~known)
    # Unknown samples beyond the first or the last known one keep what they have.
    unknown = unknown[(unknown > places[0]) & (unknown < places[-1])]
    after = np.searchsorted(places, unknown)
    begin, end = places[after - 1], places[after]
    length = (time[end] - time[begin])[:, None]
    u = (time[unknown] - time[begin])[:, None] / length
    step = values[end] - values[begin]
    first, last = length * rates[begin] - step, step - length * rates[end]
    values, rates = values.copy(), rates.copy()
    values[unknown] = values[begin] + u * step + u * (1 - u) * (first * (1 - u) + last * u)
    slope = (1 - 2 * u) * (first * (1 - u) + last * u) + u * (1 - u) * (last - first)
    rates[unknown] = (step + slope) / length
    return values, rates


def lost_frames_words(
    time: Float[np.ndarray, " N"], measured: Bool[np.ndarray, " N"]
) -> tuple[str, ...]:
    """Return a warning that states how many frames are lost, if any number worth mentioning."""
    share = 1 - float(measured.mean())
    if share < _MENTIONED:
        return ()
    known = time[measured]
    pause = np.diff(known)
    longest = float(pause[pause <= longest_pause(usual_period(known))].max())
    return (
        f"{100 * share:.1f} % of the frames are lost (up to {longest:.3f} s in a row); they count "
        "as poses that were not measured",
    )
