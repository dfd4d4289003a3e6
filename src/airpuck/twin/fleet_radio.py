"""What the craft of a fleet hear of their commands, and when."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from airpuck.twin.radio import passage
from airpuck.twin.settings import TwinSettings

#: Craft that are handled together: enough that calls cost little, few enough that arrays of a long
#: flight stay small.
_TOGETHER = 64


def heard_commands(
    settings: TwinSettings,
    sent: Float[np.ndarray, " K"],
    seeds: Sequence[int],
    delays: Sequence[float],
) -> tuple[Float[np.ndarray, "E B"], Int[np.ndarray, "E B"]]:
    """Say which command the motors of each craft follow, and from when on."""
    batches = [slice(begin, begin + _TOGETHER) for begin in range(0, len(seeds), _TOGETHER)]
    changes = []
    for craft in batches:
        # The very numbers that a `RadioLink` draws.
        chance = [np.random.default_rng([s, 0]).random((len(sent), 2)) for s in seeds[craft]]
        delay = np.array(delays[craft])[:, None]
        arrival = passage(settings.radio, delay, sent, np.array(chance))
        changes.append(_changes(arrival, settings.radio.timeout_s, settings.motors.unarmed_s))
    # There is always one more to wait for.
    times = np.full((max(when.shape[1] for when, _ in changes) + 1, len(seeds)), np.inf)
    heard = np.full(times.shape, len(sent), dtype=np.int32)
    for craft, (when, what) in zip(batches, changes, strict=True):
        times[: when.shape[1], craft], heard[: what.shape[1], craft] = when.T, what.T
    return times, heard


def _changes(
    arrival: Float[np.ndarray, "B K"], timeout: float, unarmed: float
) -> tuple[Float[np.ndarray, "B E"], Int[np.ndarray, "B E"]]:
    """Return when what each craft's motors follow changes, and the number of the command, K: stop.

    Arrivals are infinite where a packet is lost; so are the times after the last change.
    """
    size, packets = arrival.shape
    # No packet overtakes another.
    latest = np.maximum.accumulate(np.where(np.isinf(arrival), -np.inf, arrival), axis=1)
    arrival = np.where(np.isinf(arrival), np.inf, latest)
    following = np.full_like(arrival, np.inf)
    following[:, :-1] = np.minimum.accumulate(arrival[:, :0:-1], axis=1)[:, ::-1]
    stop = np.where(following > arrival + timeout, arrival + timeout, np.inf)
    times = np.concatenate([arrival, stop], axis=1)
    commands = np.minimum(np.arange(2 * packets), packets)
    order = np.argsort(times, axis=1, kind="stable")
    times, commands = np.take_along_axis(times, order, axis=1), commands[order]
    if unarmed > 0:
        # What was in force by then, perhaps nothing, is from then on.
        times = np.concatenate([np.full((size, 1), unarmed), times], axis=1)
        commands = np.concatenate([np.full((size, 1), packets), commands], axis=1)
        late = np.count_nonzero(times <= unarmed, axis=1) - 1
        kept = np.minimum(np.arange(times.shape[1]) + late[:, None], times.shape[1] - 1)
        times, commands = (np.take_along_axis(all_, kept, axis=1) for all_ in (times, commands))
        times[:, 0] = unarmed
    most = np.isfinite(times).sum(axis=1).max()
    return times[:, :most], commands[:, :most]
