"""The twin as a process: a simulated table on the graph, in real time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from airpuck.live.clock import Clock
from airpuck.live.events import EventLog
from airpuck.live.graph import SENSOR, Graph
from airpuck.live.inbox import Inbox
from airpuck.live.process import hurry, orderly, refuse_second, settle_memory
from airpuck.model.model_file import Model
from airpuck.recording.message import StreamCodec
from airpuck.recording.topics import Topics
from airpuck.twin.settings import TwinSettings
from airpuck.twin.twin import Twin

NAME = "airpuck twin"
#: Measurements that this process could not send for as long are lost [s].
_LOST = 0.05
_HEARTBEAT = 1.0
#: Simulated before the start, so that everything is compiled [s].
_WARM_UP = 0.1


@dataclass(frozen=True)
class TwinReport:
    """What a twin did."""

    #: How long it ran [s].
    duration: float
    #: Poses that were sent.
    poses: int
    #: Commands that were received, and messages that were none.
    commands: int
    refused: int
    #: How often the motors stopped since no command came.
    stops: int

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        figures = dict(vars(self))
        figures["duration_s"] = figures.pop("duration")
        return figures


def serve_twin(
    model: Model,
    settings: TwinSettings | None = None,
    *,
    topics: Topics | None = None,
    domain: int | None = None,
    interface: str | None = None,
    duration: float = float("inf"),
    seed: int = 0,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    quiet: bool = False,
) -> TwinReport:
    """Put a simulated table on the graph, until SIGINT or SIGTERM."""
    topics = topics or Topics()
    warm = Twin(model, settings, seed=seed, pose=pose)
    warm.wait_until(_WARM_UP)
    twin = Twin(model, settings, seed=seed, pose=pose, plant=warm.plant, logs=False)
    hurry()
    graph = Graph(NAME, domain=domain, interface=interface)
    try:
        with orderly() as ending:
            refuse_second(graph, topics.pose, StreamCodec("pose"), "motion capture")
            table = _Table(twin, graph, topics, EventLog(graph, NAME, quiet=quiet))
            while not ending.asked and table.clock.now < duration:
                table.turn()
            return table.report()
    finally:
        graph.close()


class _Table:
    """A twin, and the topics it lives on."""

    def __init__(self, twin: Twin, graph: Graph, topics: Topics, events: EventLog) -> None:
        self._twin, self._graph, self._events = twin, graph, events
        names = topics.by_stream
        self._codecs = {kind: StreamCodec(kind) for kind in ("pose", "imu", "mouse")}
        self._publishers = {
            kind: graph.publisher(names[kind], codec.msgtype, codec.types, SENSOR)
            for kind, codec in self._codecs.items()
        }
        motors = StreamCodec("command", twin.model.vehicle.propeller_names)
        events.heartbeat("info", "starting", {})
        events.tell("info", f"on domain {graph.domain}: {twin.model.name}")
        settle_memory()
        self.clock = Clock()
        self._commands = Inbox(
            graph, topics.command, motors, SENSOR, self.clock, events, wakes=True
        )
        self._counts = dict.fromkeys(self._codecs, 0)
        self._running = False
        self._stops = 0
        self._beat = 0.0

    def turn(self) -> None:
        """Wait for a command or the next measurement; simulate to the present."""
        due = min(self._twin.next_event, self._beat)
        self._graph.wait(due - self.clock.now)
        commands = self._commands.take_commands()
        now = self.clock.now
        arrived = self._twin.wait_until(now)
        if now - due > _LOST:
            self._events.tell("warning", f"stood still for {now - due:.3f} s, measurements lost")
            arrived = []
        for kind, stamp, values in ((m.kind, m.stamp, m.values) for m in arrived):
            message = self._codecs[kind].encode(self.clock.epoch_ns + round(1e9 * stamp), values)
            self._publishers[kind].send(message)
            self._counts[kind] += 1
        for command in commands:
            self._twin.send(command)
        self._tell_contact()
        if now >= self._beat:
            self._beat = now + _HEARTBEAT
            self._commands.tell_strangers()
            state = self._twin.state.tolist()
            speeds = " ".join(f"{speed:.3f}" for speed in state[6:])
            self._events.heartbeat(
                "info",
                "motors run" if self._running else "motors stopped: no commands",
                {"poses": self._counts["pose"], "motor speeds": speeds},
            )

    def report(self) -> TwinReport:
        """Say what was done."""
        commands = self._commands
        return TwinReport(
            self.clock.now, self._counts["pose"], commands.good, commands.bad, self._stops
        )

    def _tell_contact(self) -> None:
        """Tell when commands begin and stop to reach the motors."""
        running = self._twin.in_contact
        if running == self._running:
            return
        self._running = running
        if running:
            self._events.tell("info", "commands arrive, motors run")
        else:
            self._stops += 1
            timeout = 1e3 * self._twin.settings.radio.timeout_s
            self._events.tell("warning", f"no command for {timeout:.0f} ms, motors stopped")
