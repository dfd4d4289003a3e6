"""The radio: commands arrive late, in order, or not at all."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri

from airpuck.model.model_file import Model
from airpuck.twin.settings import Radio, TwinSettings


def passage(
    settings: Radio,
    delay: float | Float[np.ndarray, "*batch 1"] | None,
    time: Float[np.ndarray, " K"],
    chance: Float[np.ndarray, "*batch K 2"],
) -> Float[np.ndarray, "*batch K"]:
    """Return the arrival times of independent packets; infinite if a packet is lost.

    `chance`: two uniform random numbers for each packet.
    """
    assert delay is not None
    arrival = time + np.maximum(delay + settings.jitter_s * ndtri(chance[..., 0]), 0.0)
    lost = chance[..., 1] < settings.loss
    for start, stop in settings.outages_s:
        lost |= (start <= arrival) & (arrival < stop)
    return np.where(lost, np.inf, arrival)


def queued_delay(settings: Radio, period: float, packets: int = 200_000) -> tuple[float, float]:
    """Simulate delays of packets that do not overtake each other.

    A packet waits for earlier packets. That makes delays longer on average, and less variable: at a
    hundred packets a second 21.7 ± 6.3 ms, instead of 20.8 ± 7 ms for single packets.
    """
    sent = period * np.arange(packets)
    chance = np.random.default_rng(0).random((packets, 2))
    arrival = passage(settings, settings.delay_s, sent, chance)
    there = np.isfinite(arrival)
    delay = np.maximum.accumulate(arrival[there]) - sent[there]
    return float(delay.mean()), float(delay.std())


def as_received(model: Model, settings: TwinSettings, period: float) -> Model:
    """Return a model with the mean delay of its packets, which is the delay that fits find."""
    radio = settings.with_usual_delay(model.radio_delay).radio
    return model.with_delay(queued_delay(radio, period)[0] + model.vehicle.actuators.dead_time_s)


class RadioLink:
    """Packets in transit, and the last packet that the craft received."""

    def __init__(self, settings: Radio, rng: np.random.Generator, n_columns: int) -> None:
        self._settings, self._rng = settings, rng
        self._flying: deque[tuple[float, Float[np.ndarray, " n"]]] = deque()
        self._stopped = np.zeros(n_columns)
        self._received, self._received_at = self._stopped, -math.inf
        self._last_arrival = -math.inf

    def send(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Send a packet."""
        chance = self._rng.random((1, 2))
        alone = float(passage(self._settings, self._settings.delay_s, np.array([time]), chance)[0])
        if math.isinf(alone):
            return
        arrival = max(alone, self._last_arrival)
        self._last_arrival = arrival
        self._flying.append((arrival, command))

    def command(self, now: float) -> Float[np.ndarray, " n"]:
        """Return the command in force: the last one received, or zeros after the timeout."""
        self._receive(now)
        return self._received if self.in_contact(now) else self._stopped

    def in_contact(self, now: float) -> bool:
        """Return whether a packet came within the timeout."""
        return bool(now < self._received_at + self._settings.timeout_s)

    def next_change(self, now: float) -> float:
        """Return when the command in force can change next."""
        self._receive(now)
        arrival = self._flying[0][0] if self._flying else math.inf
        timeout = self._received_at + self._settings.timeout_s
        return min(time for time in (arrival, timeout, math.inf) if time > now)

    def _receive(self, now: float) -> None:
        """Process the packets that have arrived."""
        while self._flying and self._flying[0][0] <= now:
            self._received_at, self._received = self._flying.popleft()


def heard_commands(
    settings: TwinSettings,
    sent: Float[np.ndarray, " K"],
    seeds: Sequence[int],
    delays: Float[np.ndarray, " B"],
) -> tuple[Float[np.ndarray, "E B"], Int[np.ndarray, "E B"]]:
    """Return which command the motors of each craft of a batch follow, and from when on.

    Equivalent to a `RadioLink` for each craft; commands by index, ``len(sent)``: stop.
    """
    # The same random numbers as in a `RadioLink`.
    chance = np.array([np.random.default_rng([s, 0]).random((len(sent), 2)) for s in seeds])
    arrival = passage(settings.radio, delays[:, None], sent, chance)
    times, heard = _changes(arrival, settings.radio.timeout_s, settings.motors.unarmed_s)
    return times.T, heard.T


def _changes(
    arrival: Float[np.ndarray, "B K"], timeout: float, unarmed: float
) -> tuple[Float[np.ndarray, "B E"], Int[np.ndarray, "B E"]]:
    """Return when each craft's command changes, and the index of the new command, K: stop.

    Arrivals of lost packets are infinite; so are the times after the last change.
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
        # The command in force before, possibly none, continues.
        times = np.concatenate([np.full((size, 1), unarmed), times], axis=1)
        commands = np.concatenate([np.full((size, 1), packets), commands], axis=1)
        late = np.count_nonzero(times <= unarmed, axis=1) - 1
        kept = np.minimum(np.arange(times.shape[1]) + late[:, None], times.shape[1] - 1)
        times, commands = (np.take_along_axis(each, kept, axis=1) for each in (times, commands))
        times[:, 0] = unarmed
    most = np.isfinite(times).sum(axis=1).max()
    return times[:, :most], commands[:, :most]
