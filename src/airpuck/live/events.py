"""What a process says to others: events on ``/rosout``, a heartbeat on ``/diagnostics``."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
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
#: The same event is told once in this time [s].
_AGAIN_AFTER = 1.0
_SECOND_NS = 10**9


class EventLog:
    """Tells events and heartbeats on the graph, and events on standard error.

    Parameters
    ----------
    graph : Graph
        Where.
    name : str
        Of this process.
    quiet : bool, default False
        Whether to leave standard error alone.
    """

    def __init__(self, graph: Graph, name: str, *, quiet: bool = False) -> None:
        self._name, self._quiet = name, quiet
        types = definitions("")
        self._event = MessageCodec(EVENT_TYPE, types)
        self._heartbeat = MessageCodec(HEARTBEAT_TYPE, types)
        self._events = graph.publisher(EVENTS, EVENT_TYPE, types, LOG)
        self._heartbeats = graph.publisher(HEARTBEAT, HEARTBEAT_TYPE, types, STATE)
        self._told: dict[str, float] = {}
        #: How many events of each level there were, repetitions included.
        self.counts: dict[str, int] = dict.fromkeys(_LOG_LEVELS, 0)

    def tell(self, level: Level, text: str, *, kind: str | None = None) -> None:
        """Tell an event.

        Parameters
        ----------
        level : {"info", "warning", "error"}
            How bad it is.
        text : str
            What happened.
        kind : str, optional
            Events of one kind are told once a second; by default none are held back.
        """
        self.counts[level] += 1
        if kind is not None:
            now = time.monotonic()
            if now - self._told.get(kind, -_AGAIN_AFTER) < _AGAIN_AFTER:
                return
            self._told[kind] = now
        event = self._event.blank()
        event.stamp.sec, event.stamp.nanosec = divmod(time.time_ns(), _SECOND_NS)
        event.level, event.name, event.msg = _LOG_LEVELS[level], self._name, text
        self._events.send(self._event.encode(event))
        if not self._quiet:
            print(f"{self._name}: {text}", file=sys.stderr, flush=True)

    def heartbeat(self, level: Level, text: str, values: Mapping[str, object]) -> None:
        """Say that the process is alive, and how it fares.

        Parameters
        ----------
        level : {"info", "warning", "error"}
            How bad it is.
        text : str
            In a few words.
        values : mapping of str to object
            Figures by name.
        """
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
