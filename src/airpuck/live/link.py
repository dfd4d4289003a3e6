"""The link to a craft on the graph, real or a twin."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from airpuck.flight.link import Kind, Measurement
from airpuck.live.clock import Clock
from airpuck.live.events import EventLog
from airpuck.live.graph import SENSOR, STATE, Graph
from airpuck.live.inbox import Inbox
from airpuck.recording.message import StreamCodec
from airpuck.recording.topics import Topics

#: A reference is told again this often, for those that came late [s].
_REMIND = 1.0


class GraphLink:
    """Poses from the graph, commands to the graph; a `Link`."""

    def __init__(
        self,
        graph: Graph,
        topics: Topics,
        motors: tuple[str, ...],
        clock: Clock,
        events: EventLog,
        *,
        on_board: bool = False,
        announces: bool = True,
    ) -> None:
        self._clock = clock
        names = topics.by_stream
        kinds: tuple[Kind, ...] = ("pose", "imu", "mouse") if on_board else ("pose",)
        self.inboxes: dict[Kind, Inbox] = {
            kind: Inbox(graph, names[kind], StreamCodec(kind), SENSOR, clock, events)
            for kind in kinds
        }
        self._command = StreamCodec("command", motors)
        self._estimate, self._reference = StreamCodec("estimate"), StreamCodec("reference")
        self._commands = graph.publisher(
            topics.command, self._command.msgtype, self._command.types, SENSOR
        )
        self._estimates = graph.publisher(
            topics.estimate, self._estimate.msgtype, self._estimate.types, STATE
        )
        self._references = None
        if announces:
            self._references = graph.publisher(
                topics.reference, self._reference.msgtype, self._reference.types, STATE
            )
        self._announced: tuple[float, bytes] | None = None
        self.newest: float | None = None
        self.sent = 0.0

    @property
    def now(self) -> float:
        """The present, on this process's clock [s]."""
        return self._clock.now

    def wait_until(self, time: float) -> list[Measurement]:
        """Sleep; then take what has come; see `airpuck.flight.link.Link`."""
        self._clock.sleep_until(time)
        arrived = [
            Measurement(kind, stamp, values)
            for kind, inbox in self.inboxes.items()
            for stamp, values in inbox.take()
        ]
        for measurement in arrived:
            if measurement.kind == "pose":
                self.newest = measurement.stamp
        if self._announced is not None and self.now - self._announced[0] > _REMIND:
            self._publish_reference(self._announced[1])
        return arrived

    def send(self, command: Float[np.ndarray, " n"]) -> None:
        """Publish a command; see `airpuck.flight.link.Link`."""
        self._commands.send(self._command.encode(self._clock.now_ns, command))
        self.sent = self._clock.now

    def announce(self, reference: Float[np.ndarray, " 6"]) -> None:
        """Publish what the craft is asked to do; see `airpuck.flight.link.Link`."""
        self._publish_reference(self._reference.encode(self._clock.now_ns, reference))

    def tell_estimate(self, state: Float[np.ndarray, " 6"]) -> None:
        """Publish the state estimate."""
        self._estimates.send(self._estimate.encode(self._clock.now_ns, state))

    def _publish_reference(self, message: bytes) -> None:
        """Publish a reference, and note when."""
        if self._references is not None:
            self._references.send(message)
            self._announced = self.now, message
