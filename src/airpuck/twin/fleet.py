"""A fleet: many craft at once, each with its own parameters, radio and noise, without feedback.

The plant is the twin's (`airpuck.twin.plant`) with the batch as last axis, on the cores of a CPU or
on a GPU. Each craft steps from event to event, where an event is a motion-capture frame or an
arriving command, so that delays are exact and differ between craft.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from numbers import Integral
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.kinds import unknown
from airpuck.compute.compiled import for_batches
from airpuck.compute.process import usable_cores
from airpuck.craft.table import Table
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics, register_pytrees
from airpuck.recording.stream import Recording
from airpuck.twin.plant import LONGEST_STEP, CraftBody, Plant, advance, build_plant, scaled
from airpuck.twin.radio import heard_commands
from airpuck.twin.sensors import command_stream, pose_sensor
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import check_seed

#: Number of craft in one batch on a CPU: enough that the loop costs little, few enough for its
#: cache.
BATCH = 512
#: Number of events of all craft between two transfers of their states.
SEGMENT = 256


@dataclass(frozen=True, eq=False)
class FleetFlight:
    """Result of a fleet's flight."""

    #: Times of the stored frames [s].
    time: Float[np.ndarray, " N"]
    #: True states at these times: x, y, γ, vx, vy, ω and the motor speeds.
    state: Float[np.ndarray, "N s B"]
    #: Truth of each craft.
    models: tuple[Model, ...]
    #: Seed of the radio and the sensors of each craft.
    seeds: tuple[int, ...]
    #: Times at which commands were sent [s].
    command_time: Float[np.ndarray, " K"]
    #: The sent commands.
    command: Float[np.ndarray, "K n B"]
    #: Table, sensors, radio, effects.
    settings: TwinSettings
    #: Number of integration steps of all craft together.
    steps: int
    #: Interval between stored frames.
    every: int = 1

    def __len__(self) -> int:
        return self.state.shape[2]

    def recording(self, craft: int) -> Recording:
        """Return the recording of one craft."""
        if self.every != 1:
            raise InputError("a recording needs every frame; fly with every=1", field="every")
        sensor = pose_sensor(self.settings.motion_capture, self.seeds[craft])
        for pose in self.state[:, :3, craft].astype(float):
            sensor.measure(pose)
        sent = list(zip(self.command_time.tolist(), self.command[:, :, craft], strict=True))
        names = self.models[craft].vehicle.propeller_names
        streams = {"pose": sensor.stream(), "command": command_stream(sent, names)}
        return Recording(streams=streams, source=f"craft {craft} of a fleet")


def fly_fleet(
    models: Model | Sequence[Model],
    command: Float[np.ndarray, "K n"] | Float[np.ndarray, "K n B"],
    *,
    period: float = 0.01,
    seeds: Sequence[int] = (0,),
    delays: Float[np.ndarray, " B"] | None = None,
    poses: Float[np.ndarray, "3 B"] | None = None,
    settings: TwinSettings | None = None,
    every: int = 1,
    precision: Literal["double", "single"] = "double",
) -> FleetFlight:
    """Fly many craft at once with given commands.

    Values that are given once apply to all craft; values for each craft determine their number.

    Parameters
    ----------
    models : Model or sequence of Model
        Truth, one for all or one for each craft. Craft of a fleet share the number of propellers,
        the degree of the thrust, the frame of the centre of mass, the mass, the radius and the
        kinds of effects.
    command : array, shape (K, n) or (K, n, B)
        Commands, sent every `period`; the flight ends one period after the last.
    period : float, default 0.01
        Time between commands [s].
    seeds : sequence of int, default (0,)
        Seed of radio and sensors, one for all or one for each craft.
    delays : array, shape (B,), optional
        Mean delay of each craft's radio; by default the settings' delay, or else the transport
        delay of its model [s].
    poses : array, shape (3, B), optional
        Initial poses, by default at the origin [m, m, rad].
    settings : TwinSettings, optional
        Table, sensors, radio, effects; by default the packaged ones.
    every : int, default 1
        Store one in `every` frames of the motion capture.
    precision : {"double", "single"}, default "double"
        Precision of the arithmetic.

    Returns
    -------
    FleetFlight
        True states at the frames, and recordings of them.

    Raises
    ------
    InputError
        If sizes do not agree, a number is out of range, or the settings ask for motors that start
        late or stall, which only `Twin` supports.

    Notes
    -----
    A `Twin` without on-board sensors takes the same steps; the states agree up to rounding.
    Runs on JAX's default device.

    Examples
    --------
    >>> fleet = airpuck.fly_fleet(model, np.full((10, 6), 0.2), seeds=(1, 2))
    >>> fleet.state.shape[-1]  # craft
    2
    """
    settings = settings or default_twin_settings()
    models = (models,) if isinstance(models, Model) else tuple(models)
    command = np.asarray(command, dtype=float)
    poses = np.zeros((3, 1)) if poses is None else np.asarray(poses, dtype=float)
    delays = np.array(_delays(settings, models) if delays is None else delays, dtype=float)
    check_models(models, settings)
    n = models[0].vehicle.n_propellers
    _check_arrays(command, delays, poses, n)
    _check_numbers(period, seeds, every, precision)
    size = _common_size(
        models=len(models),
        command=command.shape[2] if command.ndim == 3 else 1,
        seeds=len(seeds),
        delays=len(delays),
        poses=poses.shape[1],
    )
    sent = period * np.arange(len(command))
    frames, stride = _frames(settings.motion_capture.rate_hz, len(command) * period, every)
    # Craft of one seed and one delay share their radio.
    radios = max(len(seeds), len(delays))
    times, heard = heard_commands(
        settings, sent, _each(seeds, radios), _each(delays.tolist(), radios)
    )
    dtype = np.dtype("float64" if precision == "double" else "float32")
    # One more, for motors that stop.
    commands = np.concatenate([command, np.zeros((1, *command.shape[1:]))])
    begin = np.concatenate([np.broadcast_to(poses, (3, size)), np.zeros((3 + n, size))])
    fleet = _Fleet(
        dynamics=stacked(models, settings, dtype),
        inertia=np.array([float(model.parameters.inertia) for model in models], dtype),
        commands=commands.reshape(len(commands), n, -1).astype(dtype),
        times=times,
        heard=heard,
        state=begin.astype(dtype),
    )
    state, steps = _integrate(fleet, models[0], settings, frames, stride)
    return FleetFlight(
        time=frames[::stride],
        state=state,
        models=_each(models, size),
        seeds=_each(seeds, size),
        command_time=sent,
        command=np.broadcast_to(command.reshape(len(command), n, -1), (len(command), n, size)),
        settings=settings,
        steps=steps,
        every=every,
    )


def _delays(settings: TwinSettings, models: tuple[Model, ...]) -> list[float]:
    """Return the mean delay of the radio: one value, or one for each craft if models differ."""
    delays = [settings.with_delay(model.transport_delay).radio.delay_s or 0.0 for model in models]
    # Craft that share their radio are simulated faster.
    return delays[:1] if len(set(delays)) == 1 else delays


def _each(values: Sequence[Any], size: int) -> tuple[Any, ...]:
    """Repeat a value that is given once."""
    return tuple(values) * size if len(values) == 1 else tuple(values)


def _common_size(**sizes: int) -> int:
    """Return the number of craft."""
    several = {name: size for name, size in sizes.items() if size != 1}
    if len(set(several.values())) > 1:
        found = ", ".join(f"{size} {name}" for name, size in several.items())
        raise InputError(f"these should be as many as there are craft: {found}")
    return max(several.values(), default=1)


def check_models(models: tuple[Model, ...], settings: TwinSettings) -> None:
    """Raise InputError for craft that cannot share a program, or faults that need a `Twin`."""
    if not models:
        raise InputError("is empty", field="models")
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
            "craft of a fleet must have the same number of propellers, degree of the thrust, frame "
            "of the centre of mass, mass, radius and kinds of effects",
            field="models",
        )
    if any(model.vehicle.actuation.kinds != ("propeller",) for model in models):
        raise InputError(
            "on/off thrusters, wheels and reversible propellers cannot fly in a fleet; use Twin",
            field="models",
        )
    if settings.motors.starting_delay_s or settings.motors.stalls or settings.motors.weak:
        raise InputError(
            "motors of a fleet neither start late nor stall; use Twin", field="settings.motors"
        )


def _check_arrays(command: np.ndarray, delays: np.ndarray, poses: np.ndarray, n: int) -> None:
    """Raise InputError for arrays of a wrong shape, or with numbers out of range."""
    if command.ndim not in (2, 3) or command.shape[1] != n or not command.size:
        raise InputError(f"must have the shape (K, {n}) or (K, {n}, B)", field="command")
    if not ((command >= 0) & (command <= 1)).all():
        raise InputError("must lie in [0, 1]", field="command")
    if delays.ndim != 1 or not delays.size or not np.isfinite(delays).all() or (delays < 0).any():
        raise InputError("must be a list of numbers that are not negative", field="delays")
    if poses.ndim != 2 or len(poses) != 3 or not poses.size or not np.isfinite(poses).all():
        raise InputError("must have the shape (3, B) and be finite", field="poses")


def _check_numbers(period: float, seeds: Sequence[int], every: int, precision: str) -> None:
    """Raise InputError for numbers out of range."""
    if not len(seeds):
        raise InputError("is empty", field="seeds")
    for seed in seeds:
        check_seed(seed, "seeds")
    if not (math.isfinite(period) and period > 0):
        raise InputError("must be positive", field="period")
    if not isinstance(every, Integral) or every < 1:
        raise InputError("must be a whole number, at least 1", field="every")
    if precision not in ("double", "single"):
        raise InputError(unknown(precision, ("double", "single")), field="precision")


def _frames(rate: float, duration: float, every: int) -> tuple[Float[np.ndarray, " F"], int]:
    """Return event times, and how many events lie between stored frames."""
    pieces = math.ceil(1 / (rate * LONGEST_STEP) - 1e-9)
    count = math.floor(duration * rate * (1 + 1e-12)) + 1
    frames = np.arange((count - 1) * pieces + 1) / (rate * pieces)
    return frames, pieces * every


class _Fleet(NamedTuple):
    """Everything that may differ between craft, along the last axis of every array."""

    #: Coefficients.
    dynamics: Dynamics
    #: Moment of inertia about the centre of mass [kg m²].
    inertia: Any
    #: Sent commands, and zeros.
    commands: Any
    #: Times at which the command that the motors follow changes; infinite at the end [s].
    times: Any
    #: Index of the command that they follow from then on.
    heard: Any
    #: At first.
    state: Any

    @property
    def size(self) -> int:
        """Number of craft."""
        return self.state.shape[-1]

    def batches(self, size: int) -> Iterator[tuple[_Fleet, slice]]:
        """Divide the fleet into batches of one size; the last is padded with the last craft."""
        import jax

        for begin in range(0, self.size, size):
            chosen = np.minimum(np.arange(begin, begin + size), self.size - 1)
            part = jax.tree.map(lambda a, c=chosen: a[..., c] if a.shape[-1] > 1 else a, self)
            yield part, slice(begin, min(begin + size, self.size))


def stacked(models: tuple[Model, ...], settings: TwinSettings, dtype: np.dtype) -> Dynamics:
    """Stack the coefficients of all craft."""
    import jax

    register_pytrees()
    each = [build_plant(model, settings).dynamics for model in models]
    return jax.tree.map(lambda *values: np.stack(values, axis=-1).astype(dtype), *each)


@cache
def _program(table: Table, mass: float, radius: float, sag: float) -> Any:
    """Compile many steps: ``(fleet, frames, carry) -> (carry, (states, frames reached))``."""
    import jax
    import jax.numpy as jnp

    def segment(fleet: _Fleet, frames: Any, carry: Any) -> Any:
        radio, craft = jnp.arange(fleet.times.shape[-1]), jnp.arange(fleet.commands.shape[-1])
        disc, dtype = CraftBody(mass, fleet.inertia, radius), fleet.state.dtype

        def one(carry: Any, _: Any) -> Any:
            state, now, frame, change, following = carry
            due, arrival = frames[frame + 1], fleet.times[change, radio]
            # Frames end with the flight; from then on steps have no length.
            until = jnp.minimum(due, arrival)
            command = fleet.commands[following, :, craft].T
            truth = fleet.dynamics
            if sag:
                truth = scaled(truth, jnp.maximum(1 - sag * now, 0.0).astype(dtype))
            duration = (until - now).astype(dtype)
            state = advance(jnp, Plant(truth, disc, table), state, command, duration)
            seen, hears = due <= until, arrival <= until
            following = jnp.where(hears, fleet.heard[change, radio], following)
            frame = jnp.minimum(frame + seen, len(frames) - 2)
            carry = state, until, frame, change + hears, following
            # Keep the state of each craft contiguous: it is faster to extract from the batch.
            return carry, (state.T, jnp.where(seen, frame, -1))

        return jax.lax.scan(one, carry, length=SEGMENT)

    return for_batches(segment)


def _integrate(
    fleet: _Fleet,
    model: Model,
    settings: TwinSettings,
    frames: Float[np.ndarray, " F"],
    stride: int,
) -> tuple[Float[np.ndarray, "N s B"], int]:
    """Integrate all craft; return states at every `stride`-th frame, and the number of steps."""
    import jax

    on_cpu = jax.default_backend() == "cpu"
    cores = usable_cores() if on_cpu else 1
    size = min(BATCH, math.ceil(fleet.size / cores)) if on_cpu else fleet.size
    vehicle, sag = model.vehicle, settings.effects.battery_sag_1_s
    # A frozen pydantic model has a hash, which the type checker does not see.
    rails: Any = settings.table
    program = _program(rails, vehicle.mass_kg, vehicle.radius_m, sag)
    shape = -(-len(frames) // stride), fleet.size, len(fleet.state)
    state = np.empty(shape, fleet.state.dtype)
    steps = len(frames) - 1 + np.count_nonzero(fleet.times < frames[-1], axis=0)

    def fly(batch: tuple[_Fleet, slice]) -> None:
        part, place = batch
        _fly_batch(program, part, frames, stride, int(steps.max()), state[:, place])

    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(fly, fleet.batches(size)))
    return state.transpose(0, 2, 1), int(np.broadcast_to(steps, fleet.size).sum())


def _fly_batch(
    program: Any,
    fleet: _Fleet,
    frames: Float[np.ndarray, " F"],
    stride: int,
    steps: int,
    state: Float[np.ndarray, "N b s"],
) -> None:
    """Fly one batch, segment by segment, and store the selected states."""
    wanted = state.shape[1]
    state[0] = fleet.state.T[:wanted]
    counts = np.zeros(fleet.times.shape[1], dtype=np.int32)
    carry = (fleet.state, np.zeros(len(counts)), counts, counts, counts + len(fleet.commands) - 1)
    # The time of the flight's end is repeated: later events take no time.
    frames = np.append(frames, frames[-1])
    for _ in range(0, steps, SEGMENT):
        carry, (states, reached) = program(fleet, frames, carry)
        states, reached = np.asarray(states), np.asarray(reached)
        reached = np.broadcast_to(reached, states.shape[:2])[:, :wanted]
        step, craft = np.nonzero((reached >= 0) & (reached % stride == 0))
        state[reached[step, craft] // stride, craft] = states[step, craft]
