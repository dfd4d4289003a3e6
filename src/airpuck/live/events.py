"""Reports to other processes: events on ``/rosout``, a heartbeat on ``/diagnostics``."""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Literal

from airpuck.boundary.errors import escaped
from airpuck.live.graph import LOG, STATE, Graph
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.message import MessageCodec, definitions

#: ROS 2's own topics for events and for heartbeats; tools know them by name.
EVENTS, HEARTBEAT = "/rosout", "/diagnostics"
EVENT_TYPE, HEARTBEAT_TYPE = "rcl_interfaces/msg/Log", "diagnostic_msgs/msg/DiagnosticArray"
Level = Literal["info", "warning", "error"]
#: ROS's numeric levels of an event, and of a heartbeat.
EVENT_LEVELS: dict[Level, int] = {"info": 20, "warning": 30, "error": 40}
_HEARTBEAT_LEVELS: dict[Level, int] = {"info": 0, "warning": 1, "error": 2}
#: A repeated event within this time is held back [s].
_REPEATS = 1.0
_NUMBER = re.compile(r"\d+(\.\d+)?")


class EventLog:
    """Publishes events and heartbeats, and prints events on standard error.

    An event is published at once the first time. Its repetitions within a second are counted, and
    published as one with the next heartbeat, in the order in which they last happened: the last
    event published is the present state.
    """

    def __init__(self, graph: Graph, name: str, *, quiet: bool = False) -> None:
        self._name, self._quiet = name, quiet
        types = definitions("")
        self._event = MessageCodec(EVENT_TYPE, types)
        self._heartbeat = MessageCodec(HEARTBEAT_TYPE, types)
        self._events = graph.publisher(EVENTS, EVENT_TYPE, types, LOG)
        self._heartbeats = graph.publisher(HEARTBEAT, HEARTBEAT_TYPE, types, STATE)
        #: Time at which each kind of event was last published [s].
        self._published: dict[str, float] = {}
        #: Events held back by kind: level, last text, and count.
        self._held: dict[str, tuple[Level, str, int]] = {}
        #: Number of events of each level, repetitions included.
        self.counts: dict[str, int] = dict.fromkeys(EVENT_LEVELS, 0)

    def log(self, level: Level, text: str, *, kind: str | None = None) -> None:
        """Publish an event; by default, texts that differ only in numbers are of the same kind."""
        self.counts[level] += 1
        kind = _NUMBER.sub("#", text) if kind is None else kind
        if time.monotonic() - self._published.get(kind, -math.inf) < _REPEATS:
            # Move to the end of the order, if it was held before.
            _, _, count = self._held.pop(kind, (level, text, 0))
            self._held[kind] = level, text, count + 1
            return
        # Events that were held back happened before this one.
        self.flush()
        self._publish(level, text, kind)

    def flush(self) -> None:
        """Publish the repetitions that were held back; `heartbeat` calls this."""
        held, self._held = self._held, {}
        for kind, (level, text, count) in held.items():
            self._publish(level, f"{text} ({count} times)" if count > 1 else text, kind)

    def heartbeat(self, level: Level, text: str, values: Mapping[str, object]) -> None:
        """Publish that the process is alive, its state, and some figures; once a second."""
        self.flush()
        self.state(level, text, values)

    def state(
        self, level: Level, text: str, values: Mapping[str, object], *, name: str = ""
    ) -> None:
        """Publish a state and some figures; `name` is a part of the process."""
        message = self._heartbeat.message()
        set_stamp(message.header.stamp, time.time_ns())
        status = self._heartbeat.message("diagnostic_msgs/msg/DiagnosticStatus")
        status.level, status.message = _HEARTBEAT_LEVELS[level], text
        status.name = name or self._name
        status.values = [
            self._heartbeat.message("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
            for key, value in values.items()
        ]
        message.status = [status]
        self._heartbeats.send(self._heartbeat.encode(message))

    def _publish(self, level: Level, text: str, kind: str) -> None:
        """Publish an event, and record the time."""
        now = time.monotonic()
        self._published = {k: t for k, t in self._published.items() if now - t < _REPEATS}
        self._published[kind] = now
        event = self._event.message()
        set_stamp(event.stamp, time.time_ns())
        event.level, event.name, event.msg = EVENT_LEVELS[level], self._name, text
        self._events.send(self._event.encode(event))
        if not self._quiet:
            with suppress(OSError):  # the terminal may be gone
                print(f"{self._name}: {escaped(text)}", file=sys.stderr, flush=True)


def set_stamp(stamp: Any, time_ns: int) -> None:
    """Set a message's stamp to a time [ns since the epoch]."""
    stamp.sec, stamp.nanosec = divmod(time_ns, SECOND_NS)
