"""What a process says to others: events on ``/rosout``, a heartbeat on ``/diagnostics``."""

from __future__ import annotations

import math
import re
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from airpuck.live.graph import LOG, STATE, Graph
from airpuck.recording.message import MessageCodec
from airpuck.recording.message_types import definitions

#: ROS 2's own topics for events and for heartbeats; tools know them by name.
EVENTS, HEARTBEAT = "/rosout", "/diagnostics"
EVENT_TYPE, HEARTBEAT_TYPE = "rcl_interfaces/msg/Log", "diagnostic_msgs/msg/DiagnosticArray"
#: Of both kinds of message, by name.
Level = Literal["info", "warning", "error"]
_LOG_LEVELS = {"info": 20, "warning": 30, "error": 40}
_STATUS_LEVELS = {"info": 0, "warning": 1, "error": 2}
#: What happens again within this time is held back [s].
_AGAIN_AFTER = 1.0
_SECOND_NS = 10**9
_NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True)
class _Held:
    """An event that was told less than a second ago, and has happened again since."""

    level: Level
    text: str
    count: int


class EventLog:
    """Tells events and heartbeats on the graph, and events on standard error.

    An event that repeats is told at once the first time; its repetitions within a second are
    counted, and told as one with the next heartbeat, in the order in which they last happened. So
    what is told last is what is so.
    """

    def __init__(self, graph: Graph, name: str, *, quiet: bool = False) -> None:
        self._name, self._quiet = name, quiet
        types = definitions("")
        self._event = MessageCodec(EVENT_TYPE, types)
        self._heartbeat = MessageCodec(HEARTBEAT_TYPE, types)
        self._events = graph.publisher(EVENTS, EVENT_TYPE, types, LOG)
        self._heartbeats = graph.publisher(HEARTBEAT, HEARTBEAT_TYPE, types, STATE)
        self._told: dict[str, float] = {}
        self._held: dict[str, _Held] = {}
        #: How many events of each level there were, repetitions included.
        self.counts: dict[str, int] = dict.fromkeys(_LOG_LEVELS, 0)

    def tell(self, level: Level, text: str, *, kind: str | None = None) -> None:
        """Tell an event."""
        self.counts[level] += 1
        kind = _NUMBER.sub("#", text) if kind is None else kind
        if time.monotonic() - self._told.get(kind, -math.inf) < _AGAIN_AFTER:
            before = self._held.pop(kind, None)
            self._held[kind] = _Held(level, text, 1 if before is None else before.count + 1)
            return
        # Those held back that happened before come first.
        self.tell_held()
        self._tell_now(level, text, kind)

    def tell_held(self) -> None:
        """Tell the repetitions that were held back; `heartbeat` does."""
        held, self._held = self._held, {}
        for kind, event in held.items():
            often = f" ({event.count} times)" if event.count > 1 else ""
            self._tell_now(event.level, event.text + often, kind)

    def _tell_now(self, level: Level, text: str, kind: str) -> None:
        """Tell an event, and note when."""
        now = time.monotonic()
        self._told = {k: told for k, told in self._told.items() if now - told < _AGAIN_AFTER}
        self._told[kind] = now
        event = self._event.blank()
        event.stamp.sec, event.stamp.nanosec = divmod(time.time_ns(), _SECOND_NS)
        event.level, event.name, event.msg = _LOG_LEVELS[level], self._name, text
        self._events.send(self._event.encode(event))
        if not self._quiet:
            print(f"{self._name}: {text}", file=sys.stderr, flush=True)

    def heartbeat(self, level: Level, text: str, values: Mapping[str, object]) -> None:
        """Say that the process is alive, and how it fares; once a second."""
        self.tell_held()
        message = self._heartbeat.blank()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), _SECOND_NS)
        pairs = [
            self._heartbeat.message("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
            for key, value in values.items()
        ]
        message.status = [
            self._heartbeat.message(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=_STATUS_LEVELS[level],
                name=self._name,
                message=text,
                values=pairs,
            )
        ]
        self._heartbeats.send(self._heartbeat.encode(message))
