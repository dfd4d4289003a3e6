"""A batch of twins of one kind of craft, stepped together by control periods.

The events of the craft are handled in rounds: in each, every craft advances to its own next event,
which is a frame of the motion capture or an arriving command. So delays are exact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.arguments import numbers_of
from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Brief
from airpuck.compute.compiled import for_batches
from airpuck.craft.table import Table
from airpuck.model.model_file import Model
from airpuck.physics.puck import Disc
from airpuck.physics.rigid_body import Dynamics, register_pytrees, wrapped
from airpuck.recording.stream import Recording, Stream
from airpuck.twin.plant import LONGEST_STEP, Plant, advance, build_plant, scaled
from airpuck.twin.radio import heard_commands, radio_delay
from airpuck.twin.sensors import log_stream, nanoseconds
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import check_seed

#: Events this much later than the longest step are rounding errors of times [relative].
_ROUNDING = 1e-9
#: Random latencies beyond this multiple of their mean are neglected: probability 4e-18.
_RAREST = 40.0


class TwinBatch(Brief):
    """Many twins that are stepped together, each with its own parameters, radio and noise.

    Each craft flies like a `Twin` of the same seed without on-board sensors: with the same radio,
    and the same poses except for their noise and latency, which are drawn for the whole batch.

    Parameters
    ----------
    models : Model or sequence of Model
        Truth, one for all or one for each craft. Craft of a batch share the number of propellers,
        the degree of the thrust, the frame of the centre of mass, the mass, the radius and the
        kinds of effects.
    size : int
        Number of craft.
    longest : float
        Longest flight between two resets [s].
    settings : TwinSettings, optional
        Table, sensors, radio, effects; by default the paper's.
    period : float, default 0.01
        Time between commands [s].
    rng : numpy.random.Generator, optional
        Noise and latency of the poses, by default of seed 0; may be replaced.
    logs : bool, default False
        Whether to keep all poses, for `recording`.

    Attributes
    ----------
    state : array, shape (6 + n, size)
        True states (x, y, γ, vx, vy, ω and the motor speeds), as of the last event of each craft.
    steps : array, shape (size,)
        Number of periods since each craft's reset.

    Raises
    ------
    InputError
        If the craft differ too much, or a craft or a fault is supported only by `Twin`.

    Examples
    --------
    >>> batch = airpuck.TwinBatch(model, size=2, longest=1.0)
    >>> batch.reset(np.arange(2), np.zeros((2, 3)), seeds=(1, 2))
    >>> batch.step(np.full((2, 6), 0.2))
    >>> batch.state.shape
    (12, 2)
    """

    def __init__(
        self,
        models: Model | Sequence[Model],
        size: int,
        longest: float,
        *,
        settings: TwinSettings | None = None,
        period: float = 0.01,
        rng: np.random.Generator | None = None,
        logs: bool = False,
    ) -> None:
        models = (models,) if isinstance(models, Model) else tuple(models)
        self.settings = settings = settings or default_twin_settings()
        _check_models(models, size, settings)
        if not (math.isfinite(period) and period > 0):
            raise InputError("must be positive", field="period")
        self.rng = rng or np.random.default_rng(0)
        vehicle, n = models[0].vehicle, models[0].vehicle.n_propellers
        self._names = vehicle.propeller_names
        delays = [settings.with_usual_delay(radio_delay(m)).radio.delay_s or 0.0 for m in models]
        self._delays = np.broadcast_to(delays, size)
        self._period, self._rows, self._logs = period, np.arange(size), logs
        self._sent_at = period * np.arange(math.ceil(longest / period - _ROUNDING))
        # A frozen pydantic model has a hash, which the type checker does not see.
        rails: Any = settings.table
        self._advance = _program(rails, vehicle.mass_kg, vehicle.radius_m)
        inertia = np.array([float(model.parameters.inertia) for model in models])
        self._truth = _stacked(models, settings), inertia
        capture = settings.motion_capture
        late = capture.latency_s + _RAREST * capture.latency_jitter_s
        kept = math.ceil(((longest if logs else late) + period) * capture.rate_hz) + 2
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
        for seed in seeds:
            check_seed(seed, "seeds")
        if len(seeds) != len(rows):
            raise InputError(f"must be {len(rows)} numbers, one for each craft", field="seeds")
        self.state[:, rows] = 0.0
        self.state[:3, rows] = numbers_of(poses, (len(rows), 3), "poses").T
        self._sent[:, rows], self._followed[:, rows] = 0.0, 0.0
        for counts in (self.steps, self._now, self._changes, self._frames, self._seen):
            counts[rows] = 0
        times, heard = heard_commands(self.settings, self._sent_at, seeds, self._delays[rows])
        self._times[:, rows], self._arrival[:, rows] = np.inf, np.inf
        self._times[: len(times), rows], self._heard[: len(heard), rows] = times, heard
        self._last_arrival[rows] = -np.inf

    def step(
        self, commands: Float[np.ndarray, "B n"], moving: Bool[np.ndarray, " B"] | None = None
    ) -> None:
        """Send commands, and advance the craft by a period.

        Parameters
        ----------
        commands : array, shape (B, n)
            Motor commands, 0 to 1.
        moving : array of bool, shape (B,), optional
            Which craft fly; by default all.
        """
        commands = numbers_of(commands, self._sent.shape[1:], "commands")
        if not ((commands >= 0) & (commands <= 1)).all():
            raise InputError("must lie in [0, 1]", field="commands")
        moving = np.ones(len(self._rows), bool) if moving is None else moving
        rows, stop = self._rows[moving], len(self._sent_at)
        if self.steps[rows].max(initial=0) >= stop:
            raise InputError(f"is over after {stop} steps; reset it", field="flight")
        self._sent[self.steps[rows], rows] = commands[rows]
        self.steps[rows] += 1
        end = np.where(moving, self._period * self.steps, -np.inf)
        rate = self.settings.motion_capture.rate_hz
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
            self.state = self._at(until)
            self._now = until
            self._measure(self._rows[active & (frame <= until)])
            hear = self._rows[active & (change <= until)]
            self._followed[:, hear] = self._sent[heard[hear], hear].T
            self._changes[hear] += 1

    def measured(
        self,
    ) -> tuple[Bool[np.ndarray, " B"], Float[np.ndarray, " B"], Float[np.ndarray, "B 3"]]:
        """Return the latest pose of each craft that has arrived.

        Returns
        -------
        tuple of array
            Whether there is one; its stamp [s]; x, y [m] and yaw [rad].
        """
        there = self._arrival <= self._period * self.steps
        latest = np.where(there, self._number, -1).argmax(axis=0)
        capture = self.settings.motion_capture
        stamp = capture.stamped(self._number[latest, self._rows] / capture.rate_hz)
        return np.asarray(there.any(axis=0)), stamp, self._poses[latest, self._rows]

    def final_state(self) -> Float[np.ndarray, "s B"]:
        """Return the true states at the end of the latest period.

        Returns
        -------
        array, shape (6 + n, B)
            As `state`, which may be older: of the last event.
        """
        return self._at(self._period * self.steps)

    def recording(self, row: int) -> Recording:
        """Return what a recorder would have logged of one craft since its reset.

        Parameters
        ----------
        row : int
            Which craft.

        Returns
        -------
        Recording
            Poses and commands.
        """
        if not self._logs:
            raise InputError("keeps no poses; make it with logs=True", field="batch")
        seen, capture = self._seen[row], self.settings.motion_capture
        stamps = capture.stamped(self._number[:seen, row] / capture.rate_hz)
        arrivals, poses = self._arrival[:seen, row], self._poses[:seen, row]
        pose = Stream(nanoseconds(stamps), nanoseconds(arrivals), poses, ("x", "y", "yaw"))
        sent = list(zip(self._sent_at.tolist(), self._sent[: self.steps[row], row], strict=False))
        streams = {"pose": pose, "command": log_stream(sent, self._names)}
        return Recording(streams=streams, source=f"craft {row} of a batch")

    def _at(self, until: Float[np.ndarray, " B"]) -> Float[np.ndarray, "s B"]:
        """Return the states at some times, at most an integration step ahead."""
        scale = np.maximum(1 - self.settings.effects.battery_sag_1_s * self._now, 0.0)
        duration = until - self._now
        return np.array(self._advance(self._truth, self.state, self._followed, duration, scale))

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


def _check_models(models: tuple[Model, ...], size: int, settings: TwinSettings) -> None:
    """Raise InputError for craft that cannot share a program, or faults that need a `Twin`."""
    if size < 1 or len(models) not in (1, size):
        raise InputError(f"must be one, or as many as there are craft ({size})", field="models")
    kinds = {
        (
            m.frame,
            m.parameters.thrust.shape,
            m.vehicle.mass_kg,
            m.vehicle.radius_m,
            tuple(map(type, m.dynamics.effects)),
        )
        for m in models
    }
    if len(kinds) > 1:
        raise InputError(
            "craft of a batch must have the same number of propellers, degree of the thrust, frame "
            "of the centre of mass, mass, radius and kinds of effects",
            field="models",
        )
    if any(model.vehicle.actuation.kinds != ("propeller",) for model in models):
        raise InputError(
            "on/off thrusters, wheels and reversible propellers cannot fly in a batch; use Twin",
            field="models",
        )
    motors = settings.motors
    if motors.starting_delay_s or motors.stalls or motors.weak or any(settings.starts.failed):
        raise InputError(
            "motors of a batch neither start late nor stall; use Twin", field="settings.motors"
        )


def _stacked(models: tuple[Model, ...], settings: TwinSettings) -> Dynamics:
    """Stack the coefficients of all craft along the last axis."""
    import jax

    register_pytrees()
    each = [build_plant(model, settings).dynamics for model in models]
    return jax.tree.map(lambda *values: np.stack(values, axis=-1).astype(float), *each)


@cache
def _program(table: Table, mass: float, radius: float) -> Any:
    """Compile one integration step: ``(truth, state, command, duration, scale) -> state``."""
    import jax.numpy as jnp

    def step(truth: Any, state: Any, command: Any, duration: Any, scale: Any) -> Any:
        dynamics, inertia = truth
        disc = Disc(0.0, 0.0, radius=radius, mass=mass, inertia=inertia)
        plant = Plant(scaled(dynamics, scale), disc, table)
        return advance(jnp, plant, state, command, duration)

    return for_batches(step)
