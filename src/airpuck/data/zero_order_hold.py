"""Zero-order hold of commands (subsec:data_preprocessing): at a time, and over a step."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


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
        Before the first event, the first value.
    """
    index = np.searchsorted(event_time, time, side="right") - 1
    return values[np.clip(index, 0, None)]


def mean_hold(
    event_time: Float[np.ndarray, " K"],
    values: Float[np.ndarray, "K n"],
    time: Float[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "N n"], Float[np.ndarray, "N n"]]:
    """Mean of the held values from each time to the next, and its derivative by a delay [1/s].

    For events that come ``d`` later, ``u_k(d) = 1/h ∫ u(s - d) ds`` over ``[t_k, t_{k+1}]`` is
    continuous and piecewise linear in ``d``, whereas `hold` jumps whenever an event passes a
    sample. The mean keeps the impulse of an event at the fraction x of a step, and spreads it in
    time by a variance of x (1 - x) h²: as a change of a motor lag of 28 ms by at most 0.08 ms.
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
