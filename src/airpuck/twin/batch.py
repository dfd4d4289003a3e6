"""A batch of twins of one craft, stepped together by control periods, with feedback.

`fly_fleet` integrates flights whose commands are known; a batch receives the next commands of all
craft, and returns the latest measured poses. The events of the craft are handled in rounds: in
each, every craft advances to its own next event.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.compute.compiled import for_batches
from airpuck.model.model_file import Model
from airpuck.physics.angle import wrapped
from airpuck.twin.fleet import check_models, stacked
from airpuck.twin.plant import LONGEST_STEP, Plant, advance, build_plant, scaled
from airpuck.twin.radio import heard_commands, radio_delay
from airpuck.twin.settings import TwinSettings

#: Events this much later than the longest step are rounding errors of times [relative].
_ROUNDING = 1e-9
#: Random latencies beyond this multiple of their mean are neglected: probability 4e-18.
_RAREST = 40.0


class TwinBatch:
    """Twins of one craft that are stepped together.

    Each craft flies like a `Twin` of the same seed without on-board sensors: with the same radio,
    and the same poses except for their noise and latency, which are drawn for the whole batch.

    Parameters
    ----------
    model : Model
        The truth.
    settings : TwinSettings
        Table, sensors, radio, effects.
    size : int
        Number of craft.
    longest : float
        Longest flight between two resets [s].
    period : float
        Time between commands [s].
    rng : numpy.random.Generator
        Noise and latency of the poses; may be replaced.

    Attributes
    ----------
    state : array, shape (6 + n, size)
        True states, as of the last event of each craft.
    steps : array, shape (size,)
        Number of periods since each craft's reset.

    Raises
    ------
    InputError
        If the craft or a fault is supported only by `Twin`.
    """

    def __init__(
        self,
        model: Model,
        settings: TwinSettings,
        size: int,
        longest: float,
        period: float,
        rng: np.random.Generator,
    ) -> None:
        check_models((model,), settings)
        self.settings = settings = settings.with_delay(radio_delay(model))
        n, self.rng = model.vehicle.n_propellers, rng
        self._delay = settings.radio.delay_s or 0.0
        self._period, self._rows = period, np.arange(size)
        self._sent_at = period * np.arange(math.ceil(longest / period - _ROUNDING))
        self._advance = _program(model, settings)
        capture = settings.motion_capture
        late = capture.latency_s + _RAREST * capture.latency_jitter_s
        kept = math.ceil((late + period) * capture.rate_hz) + 2
        packets = len(self._sent_at)
        self.state = np.zeros((6 + n, size))
        self.steps = np.zeros(size, dtype=int)
        self._now = np.zeros(size)
        #: All commands sent, with zeros for motors that stop; the command that motors follow.
        self._sent, self._followed = np.zeros((packets + 1, size, n)), np.zeros((n, size))
        #: Times at which the followed command changes, its index, and the number of changes.
        self._times = np.full((2 * packets + 2, size), np.inf)
        self._heard = np.full(self._times.shape, packets)
        self._changes = np.zeros(size, dtype=int)
        #: Number of frames, and of frames that were not missed; arrival, number and pose of the
        #: latest.
        self._frames, self._seen = np.zeros(size, dtype=int), np.zeros(size, dtype=int)
        self._arrival, self._number = np.full((kept, size), np.inf), np.zeros((kept, size), int)
        self._poses, self._last_arrival = np.zeros((kept, size, 3)), np.zeros(size)

    def reset(
        self, rows: Int[np.ndarray, " R"], poses: Float[np.ndarray, "R 3"], seeds: Sequence[int]
    ) -> None:
        """Begin new flights of some craft, at rest.

        Parameters
        ----------
        rows : array, shape (R,)
            Which craft.
        poses : array, shape (R, 3)
            Their initial poses [m, m, rad].
        seeds : sequence of int
            Seed of each craft's radio.
        """
        self.state[:, rows] = 0.0
        self.state[:3, rows] = poses.T
        self._sent[:, rows], self._followed[:, rows] = 0.0, 0.0
        for counts in (self.steps, self._now, self._changes, self._frames, self._seen):
            counts[rows] = 0
        delays = [self._delay] * len(seeds)
        times, heard = heard_commands(self.settings, self._sent_at, seeds, delays)
        self._times[:, rows], self._arrival[:, rows] = np.inf, np.inf
        self._times[: len(times), rows], self._heard[: len(heard), rows] = times, heard
        self._last_arrival[rows] = -np.inf

    def step(self, commands: Float[np.ndarray, "B n"], moving: Bool[np.ndarray, " B"]) -> None:
        """Send commands, and advance the craft that are `moving` by one period."""
        rows = self._rows[moving]
        self._sent[self.steps[rows], rows] = commands[rows]
        self.steps[rows] += 1
        end = np.where(moving, self._period * self.steps, -np.inf)
        rate = self.settings.motion_capture.rate_hz
        sag, stop = self.settings.effects.battery_sag_1_s, len(self._sent_at)
        while True:
            frame, change = self._frames / rate, self._times[self._changes, self._rows]
            heard = self._heard[self._changes, self._rows]
            # A command without delay arrives when it is sent: at the start of the next period.
            change = np.where((heard < self.steps) | (heard == stop), change, np.inf)
            due = np.minimum(frame, change)
            active = due <= end
            if not active.any():
                return
            at_once = due <= self._now + LONGEST_STEP * (1 + _ROUNDING)
            until = np.where(at_once, due, self._now + LONGEST_STEP)
            until = np.where(active, until, self._now)
            scale = np.maximum(1 - sag * self._now, 0.0)
            duration = until - self._now
            self.state = np.array(self._advance(self.state, self._followed, duration, scale))
            self._now = until
            self._measure(self._rows[active & (frame <= until)])
            hear = self._rows[active & (change <= until)]
            self._followed[:, hear] = self._sent[heard[hear], hear].T
            self._changes[hear] += 1

    def measured(
        self,
    ) -> tuple[Bool[np.ndarray, " B"], Float[np.ndarray, " B"], Float[np.ndarray, "B 3"]]:
        """Return the latest pose that has arrived: whether there is one, its stamp, its values."""
        there = self._arrival <= self._period * self.steps
        latest = np.where(there, self._number, -1).argmax(axis=0)
        capture = self.settings.motion_capture
        stamp = capture.stamped(self._number[latest, self._rows] / capture.rate_hz)
        return np.asarray(there.any(axis=0)), stamp, self._poses[latest, self._rows]

    def _measure(self, rows: Int[np.ndarray, " R"]) -> None:
        """Take a frame of some craft; see `airpuck.twin.sensors.Sensor.measure`."""
        capture, number = self.settings.motion_capture, self._frames[rows]
        time = number / capture.rate_hz
        deviation = [capture.position_noise_m, capture.position_noise_m, capture.yaw_noise_rad]
        values = self.state[:3, rows].T + deviation * self.rng.standard_normal((len(rows), 3))
        values[:, 2] = wrapped(np, values[:, 2])
        late = capture.latency_s + self.rng.exponential(capture.latency_jitter_s, len(rows))
        seen = self.rng.random(len(rows)) >= capture.dropped
        for start, stop in capture.gaps_s:
            seen &= (time < start) | (time >= stop)
        self._frames[rows] += 1
        number, time, values, late, rows = (v[seen] for v in (number, time, values, late, rows))
        slot = self._seen[rows] % len(self._number)
        self._seen[rows] += 1
        arrival = np.maximum(time + late, self._last_arrival[rows])
        self._last_arrival[rows] = self._arrival[slot, rows] = arrival
        self._number[slot, rows], self._poses[slot, rows] = number, values


def _program(model: Model, settings: TwinSettings) -> Any:
    """Compile one integration step: ``(state, command, duration, scale) -> state``."""
    import jax.numpy as jnp

    plant = build_plant(model, settings)
    dynamics = stacked((model,), settings, np.dtype(float))

    def step(state: Any, command: Any, duration: Any, scale: Any) -> Any:
        truth = Plant(scaled(dynamics, scale), plant.disc, settings.table)
        return advance(jnp, truth, state, command, duration)

    return for_batches(step)
