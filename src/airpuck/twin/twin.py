"""The twin: a simulated table that a flight loop cannot distinguish from a real one."""

from __future__ import annotations

import math
from dataclasses import replace
from numbers import Integral
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.boundary.arguments import checked_class, numbers_of
from airpuck.boundary.errors import InputError
from airpuck.craft.table import Table
from airpuck.craft.vehicle import GRAVITY
from airpuck.data.measurement import Measurement, MeasurementKind
from airpuck.model.model_file import Model
from airpuck.physics.puck import PuckState
from airpuck.physics.rigid_body import acceleration
from airpuck.recording.stream import COLUMNS, Recording
from airpuck.twin.craft import Craft
from airpuck.twin.plant import Plant, build_plant, scaled
from airpuck.twin.play import HandMallet, World
from airpuck.twin.sensors import SensorSet, build_sensors, log_stream
from airpuck.twin.settings import TwinSettings, default_twin_settings

#: Commands may exceed their range by this; a law that saturates may give such, percent and pulse
#: widths are larger.
_EXCESS = 1.0
#: Largest speed and spin of a puck [m/s, rad/s]; air-hockey players hit it at up to 20 m/s.
_FASTEST = 1000.0


@checked_class
class Twin:
    """A simulated craft with its sensors and radio; a `Link`.

    Parameters
    ----------
    model : Model
        The truth of this world.
    settings : TwinSettings, optional
        Table, sensors, radio, effects, faults; by default the paper's.
    seed : int, default 0
        Seed of all random numbers: the same seed gives the same flight.
    pose : tuple of float, default (0, 0, 0)
        Initial pose of the craft [m, m, rad].
    plant : Plant, optional
        From `build_plant` for the same model and settings, to compile only once.
    puck : PuckState, optional
        Initial state of the puck; by default there is no puck.
    mallet : tuple of float, optional
        Initial position of the human's mallet [m]; by default there is no mallet. It needs a puck.
    logs : bool, default True
        Whether to keep everything for `recording` and `truth`; turn off for runs of hours.
    world : World, optional
        The table that it shares with another disc; by default its own.

    Attributes
    ----------
    play : World or None
        Puck and mallet: ``play.puck.state``, ``play.puck.goal``, ``play.puck.place(…)``,
        ``play.mallet.target = x, y``.

    Raises
    ------
    InputError
        If the seed is invalid, or the craft or the puck would not be on the table.

    Examples
    --------
    >>> twin = airpuck.Twin(model, seed=1, pose=(0.1, 0.0, 0.0))
    >>> controller = airpuck.TrackingController(model, airpuck.SetPoint(0.2, 0.0, 0.0))
    >>> log = airpuck.fly(controller, twin, duration=0.1)
    """

    SHOWN = "model=model.name now_s=now state settings"

    def __init__(
        self,
        model: Model,
        settings: TwinSettings | None = None,
        *,
        seed: int = 0,
        pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
        plant: Plant | None = None,
        puck: PuckState | None = None,
        mallet: tuple[float, float] | None = None,
        logs: bool = True,
        world: World | None = None,
    ) -> None:
        check_seed(seed)
        self.model = model
        self._lowest = np.where(model.vehicle.actuation.two_way, -1.0, 0.0)
        settings = (settings or default_twin_settings()).with_usual_delay(model.radio_delay)
        self.settings = settings
        self.plant = plant or build_plant(model, settings)
        check_pose(pose, settings.table, model.vehicle.radius_m)
        # An accelerometer senses forces on the craft, but not the pull of gravity along a slope.
        pushed = tuple(e for e in self.plant.dynamics.effects if e.gravity is None)
        self._felt = replace(self.plant.dynamics, effects=pushed)
        shared = world is not None
        if world is None:
            played = _played(puck, mallet, settings.table)
            world = World(settings, puck, logs=logs)
        elif puck is not None or mallet is not None:
            raise InputError("come with the world; leave them out", field="puck and mallet")
        else:
            played = () if world.puck is None else ("puck", "mallet")
        self.now = 0.0
        self.world = world
        # In a game, another object records contacts and drops them afterwards.
        self.craft = Craft(model, settings, self.plant, seed, pose, logs or shared)
        world.bodies.append(self.craft)
        if mallet is not None:
            world.bodies.append(HandMallet(settings.mallet, settings.table, *mallet))
        world.observers.append(self)
        self._logs = logs
        self._sensors = SensorSet(build_sensors(settings, seed, logs, played), self._true_value)
        self._sent: list[tuple[float, Float[np.ndarray, " n"]]] = []
        self._announced: list[tuple[float, Float[np.ndarray, " 6"]]] = []
        self._truth: list[tuple[float, Float[np.ndarray, " s"]]] = []

    @property
    def play(self) -> World | None:
        """Puck and mallet, if there are any."""
        return None if self.world.puck is None else self.world

    @property
    def state(self) -> Float[np.ndarray, " s"]:
        """True pose, rates and motor speeds, as of the last frame, packet or other event."""
        return self.craft.state

    @property
    def border(self) -> tuple[float, float]:
        """The edge of the table: ±x, ±y [m]."""
        return self.settings.table.reach(0.0)

    @property
    def command_range(self) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
        """Smallest and largest commands that the motors take."""
        return self._lowest, np.ones_like(self._lowest)

    @property
    def contacts(self) -> list[float]:
        """Times at which the craft met a rail [s]."""
        return [time for time, _ in self.craft.contacts]

    def wait_until(self, time: float) -> list[Measurement]:
        """Simulate until a time; see `airpuck.flight.loop.Link`."""
        numbers.check_finite(time=time)
        self.world.run(time)
        self.now = time
        return self._sensors.arrived(time)

    @property
    def due(self) -> float:
        """Time of the next measurement; see `airpuck.twin.play.WorldObserver` [s]."""
        return self._sensors.due

    def observe(self, time: float) -> None:
        """Take the due samples; see `airpuck.twin.play.WorldObserver`."""
        if self._logs and self._sensors.sensors[0].due <= time:
            self._truth.append((time, self.state))
        self._sensors.observe(time)

    def send(self, command: Float[np.ndarray, " n"]) -> None:
        """Send a command by radio, now; see `airpuck.flight.loop.Link`.

        Parameters
        ----------
        command : array, shape (c,)
            A command for each actuator; values slightly outside its range are clipped, as by a real
            radio.

        Raises
        ------
        InputError
            If there is not one finite number for each motor, or one is so large that it must be in
            another unit.
        """
        command, lowest = np.array(command), self._lowest
        n = len(lowest)
        real = command.dtype.kind in "fiu"
        if command.shape != (n,) or not real or not np.isfinite(command).all():
            raise InputError(f"needs {n} finite numbers, one for each motor", field="command")
        least, most = command.min(), command.max()
        if most > 1 + _EXCESS or (command < lowest - _EXCESS).any():
            raise InputError(
                f"goes from {least:g} to {most:g}, but motors take {lowest.min():g} to 1; is it "
                "a pulse width, or in percent?",
                field="command",
            )
        command = np.clip(command, lowest, 1.0)
        if self._logs:
            self._sent.append((self.now, command))
        self.craft.radio.send(self.now, command)

    def announce(self, reference: Float[np.ndarray, " 6"]) -> None:
        """Log the reference; see `airpuck.flight.loop.Link`."""
        if self._logs:
            self._announced.append((self.now, numbers_of(reference, (6,), "reference")))

    @property
    def next_event(self) -> float:
        """Time at which a sensor next measures, or a measurement arrives [s]."""
        return self._sensors.next_event

    @property
    def in_contact(self) -> bool:
        """Whether the craft's electronics receive commands and have not timed out."""
        return self.craft.radio.in_contact(self.now)

    @property
    def truth(self) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N s"]]:
        """Times [s] and true states of all frames of the motion capture."""
        times, states = zip(*self._truth, strict=True)
        return np.array(times), np.array(states)

    def recording(self) -> Recording:
        """Return the flight as a recorder on the network would log it.

        Returns
        -------
        Recording
            Streams ``pose``, ``command``, and if present ``reference``, ``imu``, ``mouse``,
            ``puck``, ``mallet``. Stamps are the senders'; arrivals are on the recorder's clock.
        """
        names = self.model.vehicle.columns
        streams = self._sensors.streams()
        if self._sent:
            streams["command"] = log_stream(self._sent, names)
        if self._announced:
            streams["reference"] = log_stream(self._announced, COLUMNS["reference"], latency=0.0)
        return Recording(streams=streams, source=f"twin of {self.model.name}")

    def _true_value(self, kind: str) -> Float[np.ndarray, " k"]:
        """Return noise-free readings."""
        if kind == "pose":
            return self.craft.pose()
        if kind == "puck":
            return self.world.puck_pose()
        if kind == "mallet":
            return self.world.other(self.craft).pose()
        yaw, vx, vy, spin = self.state[2:6].tolist()
        cos, sin = math.cos(yaw), math.sin(yaw)
        if kind == "mouse":
            return np.array([cos * vx + sin * vy, cos * vy - sin * vx])
        felt = scaled(self._felt, self.craft.thrust_left(self.world.time)[:, None])
        ax, ay, _ = acceleration(np, felt, self.state[2:6], self.state[6:])
        return np.array([cos * ax + sin * ay, cos * ay - sin * ax, GRAVITY, 0.0, 0.0, spin])


def _played(
    puck: PuckState | None, mallet: tuple[float, float] | None, table: Table
) -> tuple[MeasurementKind, ...]:
    """Return the other bodies beside the craft; raise InputError for invalid positions."""
    if puck is None:
        if mallet is not None:
            raise InputError("needs a puck; add a puck, too", field="mallet")
        return ()
    discs = {"puck": puck, "mallet": mallet}
    for field, place in discs.items():
        if place is None:
            continue
        x, y, *motion = numbers_of(place, (len(place),), field).tolist()
        if motion and max(map(abs, motion[1:])) > _FASTEST:
            problem = f"moves faster than {_FASTEST:g} m/s, or spins faster than {_FASTEST:g} rad/s"
            raise InputError(problem, field=field)
        reach = table.reach(0.0)
        if abs(x) > reach[0] or abs(y) > reach[1]:
            problem = f"({x:g}, {y:g}) is outside the table, ±{reach[0]:g} m by ±{reach[1]:g} m"
            raise InputError(problem, field=field)
    return ("puck",) if mallet is None else ("puck", "mallet")


def check_seed(seed: Any, field: str = "seed", limits: numbers.Range = numbers.SEED) -> None:
    """Raise InputError if a seed cannot start a random generator."""
    if not isinstance(seed, Integral):
        raise InputError(f"must be a whole number, not {seed!r}", field=field)
    limits.check(int(seed), field)


def check_pose(pose: Any, table: Table, radius: float, field: str = "pose") -> None:
    """Raise InputError for a pose off the table."""
    try:
        pose = numbers_of(pose, (3,), field).tolist()
    except InputError:
        problem = "needs three finite numbers, x, y [m] and yaw [rad]"
        raise InputError(problem, field=field) from None
    reach = table.reach(radius)
    if min(reach) < 0:
        raise InputError("is smaller than the craft", field="table")
    if abs(pose[0]) > reach[0] or abs(pose[1]) > reach[1]:
        raise InputError(
            f"is beyond the rails; x must lie within ±{reach[0]:g} m, y within ±{reach[1]:g} m",
            field=field,
        )
