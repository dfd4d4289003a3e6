"""Time axes: steps and pauses of samples, and values held between events.

Zero-order hold of commands (subsec:data_preprocessing): at a time, and over a step.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

#: Steps below this multiple of the median are not pauses; they alternate if their mean differs by
#: this fraction.
_NO_PAUSE, _ALTERNATES = 1.75, 0.05
#: Longest pause between poses across which velocities are known [s], or in sample periods: the
#: motors' thrust changes in 28 ms.
_BRIDGED_S, _BRIDGED_PERIODS = 6.5 / 240, 3.5


def usual_period(time: Float[np.ndarray, " N"]) -> float:
    """Return the usual time between samples [s]: the median, or the mean if steps alternate.

    If a stream is thinned to a rate that does not divide its own, its steps have two lengths, and
    the median is one of them.
    """
    steps = np.diff(time)
    median = float(np.median(steps))
    mean = float(np.mean(steps[steps < _NO_PAUSE * median]))
    return mean if abs(mean - median) > _ALTERNATES * median else median


def longest_bridge(period: float) -> float:
    """Return the longest pause between poses across which velocities are known [s]."""
    return max(_BRIDGED_S, _BRIDGED_PERIODS * period)


def bridged(
    time: Float[np.ndarray, " N"], measured: Bool[np.ndarray, " N"]
) -> Bool[np.ndarray, " N"]:
    """Return where few enough frames are lost in a row for smoothing to bridge them."""
    found, longest = measured.copy(), longest_bridge(usual_period(time))
    for first, last in runs(~measured):
        before, after = max(first - 1, 0), min(last, len(time) - 1)
        found[first:last] = time[after] - time[before] <= longest
    return found


def spaced(places: Int[np.ndarray, " M"], stride: int) -> Int[np.ndarray, " K"]:
    """Choose places at least `stride` apart, each the first possible one."""
    chosen, k = [], 0
    while k < len(places):
        chosen.append(int(places[k]))
        k = int(np.searchsorted(places, places[k] + stride))
    return np.array(chosen, dtype=int)


def runs(marked: Bool[np.ndarray, " N"]) -> list[tuple[int, int]]:
    """Return the index ranges [first, last) of consecutive True."""
    edges = np.diff(np.concatenate([[0], marked.astype(np.int8), [0]]))
    return list(
        zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True)
    )


def hold(
    event_time: Float[np.ndarray, " K"],
    values: Float[np.ndarray, "K n"],
    time: Float[np.ndarray, " N"],
) -> Float[np.ndarray, "N n"]:
    """Zero-order hold: the last value at or before each time.

    Parameters
    ----------
    event_time : array of float64, shape (K,)
        When the values were set, not decreasing [s].
    values : array of float64, shape (K, n)
        The values.
    time : array of float64, shape (N,)
        Where to evaluate [s].

    Returns
    -------
    array of float64, shape (N, n)
        Values in force; before the first event, the first value.
    """
    return values[np.clip(np.searchsorted(event_time, time, side="right") - 1, 0, None)]


def mean_hold(
    event_time: Float[np.ndarray, " K"],
    values: Float[np.ndarray, "K n"],
    time: Float[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "N n"], Float[np.ndarray, "N n"]]:
    """Mean of the held values from each time to the next, and its derivative by a delay [1/s].

    For events that come ``d`` later, ``u_k(d) = 1/h ∫ u(s - d) ds`` over ``[t_k, t_{k+1}]`` is
    continuous and piecewise linear in ``d``, whereas `hold` jumps whenever an event passes a
    sample. The mean keeps the impulse of an event at the fraction x of a step, and spreads it in
    time with a variance of x (1 - x) h². This is equivalent to changing a motor lag of 28 ms by at
    most 0.08 ms.
    """
    held = hold(event_time, values, time)
    length = np.diff(time)[:, None]
    mean, slope = held.copy(), np.zeros_like(held)
    slope[:-1] = (held[:-1] - held[1:]) / length
    # Each change counts for the rest of its interval.
    interval = np.searchsorted(time, event_time, side="left") - 1
    within = (interval >= 0) & (interval < len(time) - 1)
    within[0] = False  # the first value holds before its event, too
    interval, change = interval[within], np.diff(values, axis=0, prepend=values[:1])[within]
    left = (time[interval + 1] - event_time[within])[:, None]
    np.add.at(mean, interval, change * left / length[interval])
    return mean, slope
