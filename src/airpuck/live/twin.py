"""The twin as a process: a simulated table on the graph, in real time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from airpuck.boundary.errors import InputError
from airpuck.boundary.extensions import loaded
from airpuck.boundary.results import Result
from airpuck.compute.process import prioritize
from airpuck.fleet.scenario import Fleet
from airpuck.live.process import Inbox, Outbox, Process
from airpuck.live.settings import LiveSettings
from airpuck.model.model_file import Model
from airpuck.physics.puck import PuckState
from airpuck.recording.mapping import Topics
from airpuck.twin.play import World
from airpuck.twin.settings import TwinSettings
from airpuck.twin.twin import Twin

#: Initial position of the mallet [m].
BEGINS = 0.85
NAME = "airpuck twin"
#: Measurements are lost if this process could not send them for this long [s].
_LOST = 0.05
#: Time simulated before the start, so that everything is compiled [s].
_WARM_UP = 0.1


class Opponent(Protocol):
    """The other side of a twin that has a puck and a mallet; entry points add them by name.

    An entry point of ``airpuck.opponents`` is called with twin, process, its own name and a seed.
    """

    #: Target of the mallet on the graph; None if the graph does not move it.
    targets: Inbox | None

    def act(self, now: float) -> None:
        """Move the mallet, and serve the puck."""
        ...


def serve_twin(
    model: Model,
    settings: LiveSettings | None = None,
    twin_settings: TwinSettings | None = None,
    *,
    seed: int = 0,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    puck: PuckState | None = None,
    human: str | None = None,
) -> dict[str, Any]:
    """Put a simulated table on the graph, until time is over, SIGINT or SIGTERM.

    Parameters
    ----------
    model : Model
        Truth of the simulated craft.
    settings : LiveSettings, optional
        How to join the graph, and for how long.
    twin_settings : TwinSettings, optional
        Table, sensors, radio and faults; by default the paper's.
    seed : int, default 0
        Seed of all random numbers.
    pose : tuple of float, default (0, 0, 0)
        Initial pose of the craft: x, y [m], yaw [rad].
    puck : PuckState, optional
        A puck, which returns to this position from a goal; by default there is no puck.
    human : str, optional
        An opponent on the right, with a mallet; airpuck-hockey adds ``easy``, ``medium``, ``hard``
        and, for the person at a page, ``page``. By default there is no opponent.

    Returns
    -------
    dict
        Results for ``--json``.

    Raises
    ------
    InputError
        If the graph cannot be joined, or another process publishes poses.
    """
    start: dict[str, Any] = {"seed": seed, "pose": pose, "puck": puck}
    if human is not None:
        start["mallet"] = BEGINS, 0.0
    twin = _compiled(model, twin_settings, **start)
    prioritize(first=True)
    with Process(NAME, settings or LiveSettings()) as process:
        process.refuse_second("pose", (), "motion capture")
        if puck is not None:
            process.refuse_second("puck", (), "motion capture of a puck")
        table = _Table(twin, process, puck, human, seed)
        process.start(f": {model.name}")
        _simulate(process, [table])
        return table.to_json()


def serve_fleet(
    fleet: Fleet, settings: LiveSettings | None = None, *, seed: int = 0
) -> dict[str, Any]:
    """Put all craft of a scenario on one simulated table, each with topics in its namespace.

    Parameters
    ----------
    fleet : Fleet
        The scenario.
    settings : LiveSettings, optional
        How to join the graph, and for how long.
    seed : int, default 0
        Seed of all random numbers.

    Returns
    -------
    dict
        Results for ``--json``.

    Raises
    ------
    InputError
        If the graph cannot be joined, or another process publishes poses.
    """
    settings = settings or LiveSettings()
    topics, world = settings.topics or Topics(), World(fleet.settings, logs=False)
    twins, names = [], dict[int, str]()
    for k, one in enumerate(fleet.members):
        pose, own = tuple(one.start.pose.tolist()), 1000 * seed + k
        twins.append(_compiled(one.truth, fleet.settings, world, pose=pose, seed=own))
        names[id(twins[-1].craft)] = one.name
    prioritize(first=True)
    with Process(f"{NAME} of a fleet", settings) as process:
        tables = []
        for name, twin in zip(fleet.names, twins, strict=True):
            own = process.with_topics(topics.within(name))
            own.refuse_second("pose", (), f"motion capture of {name}")
            tables.append(_Table(twin, own, None, None, seed, name))
        process.start(f": {', '.join(fleet.names)}")

        def report() -> None:
            for _, one, other, speed in world.met[len(touched) :]:
                touched.append((names[id(one)], names[id(other)], speed))
                text = "{} and {} touch, closing at {:.2f} m/s".format(*touched[-1])
                process.events.log("error", text)

        touched: list[tuple[str, str, float]] = []
        _simulate(process, tables, report)
        own = {name: table.to_json() for name, table in zip(fleet.names, tables, strict=True)}
        return {"duration_s": process.clock.now, "contacts": touched, "craft": own}


def _compiled(
    model: Model, settings: TwinSettings | None, world: World | None = None, **start: Any
) -> Twin:
    """Return a twin, alone or in a world, after another one has compiled its plant."""
    warm = Twin(model, settings, **start)
    warm.wait_until(_WARM_UP)
    return Twin(model, settings, **start, world=world, plant=warm.plant, logs=False)


def _simulate(
    process: Process, tables: Sequence[_Table], then: Callable[[], None] = lambda: None
) -> None:
    """Simulate craft on one table until the process ends."""
    while process.goes_on:
        due = min(process.beat.due, *(table.due for table in tables))
        process.graph.wait(due - process.clock.now)
        beats = process.beat.begins(process.clock.now)
        for table in tables:
            table.turn(due, beats)
        then()


class _Table(Result):
    """A twin and its streams."""

    JSON = (
        "poses=_poses commands=_commands.good refused=_commands.bad stops=_stops "
        "duration_s=_process.clock.now"
    )

    def __init__(
        self,
        twin: Twin,
        process: Process,
        puck: PuckState | None,
        human: str | None,
        seed: int,
        name: str = "",
    ) -> None:
        self._twin, self._process, self._puck = twin, process, puck
        #: Name of the craft in events, and in the name of its heartbeat.
        self._name, self._whose = (f"{NAME} {name}", f" of {name}") if name else (NAME, "")
        self._human: Opponent | None = None
        if human is not None:
            self._human = loaded("airpuck.opponents", human)(twin, process, human, seed)
        kinds = ["pose", "imu", "mouse"] + ["puck"] * (puck is not None)
        kinds += ["mallet"] * (human is not None)
        self._sensors = {kind: Outbox(process, kind) for kind in kinds}
        self._commands = Inbox(process, "command", twin.model.vehicle.columns, wakes=True)
        self._poses = self._stops = 0
        self._running = False
        process.events.state("info", "starting", {}, name=self._name)

    @property
    def due(self) -> float:
        """Time of the next measurement [s]."""
        return self._twin.next_event

    def turn(self, due: float, beats: bool) -> None:
        """Simulate up to the present; `due` is when this was to happen, `beats` if to report."""
        process = self._process
        commands = self._commands.take_commands()
        now = process.clock.now
        arrived = self._twin.wait_until(now)
        if now - due > _LOST:
            process.events.log("warning", f"paused for {now - due:.3f} s, measurements lost")
            arrived = []
        for measurement in arrived:
            self._sensors[measurement.kind].send(measurement.values, measurement.stamp)
            self._poses += measurement.kind == "pose"
        for command in commands:
            try:
                self._twin.send(command)
            except InputError as error:
                self._commands.reject(f"a command that {error.problem}")
        if self._human is not None:
            self._human.act(now)
        else:
            self._serve()
        self._report_contact()
        if beats:
            self._commands.report_strangers()
            if self._human is not None and self._human.targets is not None:
                self._human.targets.report_strangers()
            speeds = " ".join(f"{speed:.3f}" for speed in self._twin.state[6:].tolist())
            process.events.flush()
            process.events.state(
                "info",
                "motors run" if self._running else "motors stopped: no commands",
                {"poses": self._poses, "motor speeds": speeds},
                name=self._name,
            )

    def _serve(self) -> None:
        """Return a puck in a goal to its initial position."""
        puck = self._twin.world.puck
        if puck is not None and self._puck is not None and puck.goal:
            side = "right" if puck.goal > 0 else "left"
            self._process.events.log(
                "info", f"the puck is in the {side} goal, and returns to its start"
            )
            puck.place(self._puck)

    def _report_contact(self) -> None:
        """Log when commands begin and stop reaching the motors."""
        running = self._twin.in_contact
        if running == self._running:
            return
        self._running = running
        if running:
            self._process.events.log("info", f"commands arrive, motors{self._whose} run")
        else:
            self._stops += 1
            timeout = 1e3 * self._twin.settings.radio.timeout_s
            text = f"no command for {timeout:.0f} ms, motors{self._whose} stopped"
            self._process.events.log("warning", text)
