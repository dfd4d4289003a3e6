"""Commands with their own times, cut to the intervals between samples."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck.physics.motor import motor_step


def cut_at_commands(
    time: Float[np.ndarray, " N"],
    event_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N S n"]]:
    """Cut the time before each sample into pieces with one command each."""
    inside = (event_time > time[0]) & (event_time < time[-1])
    moments, which = event_time[inside], np.flatnonzero(inside)
    interval = np.searchsorted(time, moments, side="left")
    counts = np.bincount(interval, minlength=len(time))
    place = np.arange(len(moments)) - (np.cumsum(counts) - counts)[interval]
    size = int(counts.max(initial=0)) + 1
    ends = np.repeat(time[:, None], size, axis=1)
    ends[interval, place] = moments
    begins = np.concatenate([[time[0]], time[:-1]])
    durations = np.diff(ends, axis=1, prepend=begins[:, None])
    at_begin = np.clip(np.searchsorted(event_time, begins, side="right") - 1, 0, None)
    chosen = np.repeat(at_begin[:, None], size, axis=1)
    chosen[interval, np.minimum(place + 1, size - 1)] = which
    # Pieces after the last event of an interval keep its command.
    chosen = np.maximum.accumulate(chosen, axis=1)
    return durations, command[chosen]


def speed_before(
    time: float,
    event_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
    time_constant: float,
) -> Float[np.ndarray, " n"]:
    """Let motors follow all commands before a time."""
    past = int(np.searchsorted(event_time, time, side="right"))
    ends = np.append(event_time[1:past], time)
    speed = command[0]
    for held, begin, end in zip(command[:past], event_time[:past], ends, strict=True):
        speed = motor_step(np, speed, held, end - begin, time_constant)
    return speed
