"""Somebody who watches the graph: the newest of everything, and how the craft fares."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.flight.health import Health, HealthMonitor
from airpuck.live.clock import Clock
from airpuck.live.events import (
    EVENT_TYPE,
    EVENTS,
    HEARTBEAT,
    HEARTBEAT_TYPE,
    EventLog,
    Level,
)
from airpuck.live.graph import LOG, SENSOR, STATE, Graph, Subscription
from airpuck.live.inbox import Inbox
from airpuck.model.model_file import Model
from airpuck.recording.message import MessageCodec, StreamCodec
from airpuck.recording.message_types import definitions
from airpuck.recording.topics import Topics

#: Rates are counted over this long [s].
_COUNTED = 1.0
_EVENTS = 200
#: How bad an event is, from ROS's numbers on.
_LEVELS = ((40, "error"), (30, "warning"), (0, "info"))


@dataclass(frozen=True)
class Event:
    """What a process said on ``/rosout``."""

    #: When it came [s].
    time: float
    #: ``info``, ``warning`` or ``error``.
    level: str
    #: Who said it, and what.
    name: str
    text: str


@dataclass
class Sight:
    """The newest of everything; what has not come yet is None."""

    #: x, y [m], yaw [rad], and of the last two their rates.
    pose: Float[np.ndarray, " 3"] | None = None
    #: Motor commands.
    command: Float[np.ndarray, " n"] | None = None
    reference: Float[np.ndarray, " 6"] | None = None
    estimate: Float[np.ndarray, " 6"] | None = None
    #: When each of them came [s].
    heard: dict[str, float] = field(default_factory=dict)
    #: How often they come [Hz].
    rates: dict[str, float] = field(default_factory=dict)
    #: Newest heartbeat of each process: when it came, what it said, its figures.
    beats: dict[str, tuple[float, str, Mapping[str, str]]] = field(default_factory=dict)
    #: The last ones.
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=_EVENTS))


class _Unheard(EventLog):
    """Tells nothing: what is wrong with messages is for the controller to tell."""

    def __init__(self) -> None:
        pass

    def tell(self, level: Level, text: str, *, kind: str | None = None) -> None:
        """Leave it untold."""


class Observer:
    """Listens to a craft and whoever flies it."""

    def __init__(self, graph: Graph, model: Model, topics: Topics) -> None:
        self._graph = graph
        # What takes long comes before time begins.
        self._monitor = HealthMonitor(model)
        self.clock = Clock()
        self.sight = Sight()
        motors = model.vehicle.propeller_names
        # Commands before poses: a pose may show what a command that came with it has done.
        streams = {
            "command": (StreamCodec("command", motors), SENSOR),
            "pose": (StreamCodec("pose"), SENSOR),
            "reference": (StreamCodec("reference"), STATE),
            "estimate": (StreamCodec("estimate"), STATE),
        }
        self._inboxes = {
            kind: Inbox(graph, topics.by_stream[kind], codec, quality, self.clock, _Unheard())
            for kind, (codec, quality) in streams.items()
        }
        types = definitions("")
        self._event, self._beat = (
            MessageCodec(EVENT_TYPE, types),
            MessageCodec(HEARTBEAT_TYPE, types),
        )
        self._events = graph.subscription(EVENTS, EVENT_TYPE, types, LOG)
        self._beats = graph.subscription(HEARTBEAT, HEARTBEAT_TYPE, types, STATE)
        self._counts = dict.fromkeys(streams, 0)
        self._counted = self.clock.now

    @property
    def health(self) -> Health:
        """How the craft fares."""
        return self._monitor.health()

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        return {"duration_s": self.clock.now, **self.health.to_json()}

    def look(self) -> list[Float[np.ndarray, " 3"]]:
        """Take in what has come."""
        sight, now = self.sight, self.clock.now
        poses = []
        for kind, inbox in self._inboxes.items():
            taken = [(stamp, values) for stamp, values in inbox.take() if np.isfinite(values).all()]
            for stamp, values in taken:
                if kind == "command":
                    self._monitor.command(stamp, values)
                elif kind == "pose":
                    self._monitor.pose(stamp, values)
                    poses.append(values)
            if taken:
                setattr(sight, kind, taken[-1][1])
                sight.heard[kind] = now
                self._counts[kind] += len(taken)
        self._listen(now)
        if now - self._counted >= _COUNTED:
            elapsed = now - self._counted
            sight.rates = {kind: count / elapsed for kind, count in self._counts.items()}
            self._counts, self._counted = dict.fromkeys(self._counts, 0), now
        return poses

    def age(self, kind: str) -> float:
        """Say how long ago something came."""
        return self.clock.now - self.sight.heard.get(kind, -math.inf)

    def _listen(self, now: float) -> None:
        """Take in events and heartbeats."""
        for event in _decoded(self._events, self._event):
            level = next(name for number, name in _LEVELS if event.level >= number)
            self.sight.events.append(Event(now, level, event.name, event.msg))
        for message in _decoded(self._beats, self._beat):
            for status in message.status:
                figures = {pair.key: pair.value for pair in status.values}
                self.sight.beats[status.name] = now, status.message, figures


def _decoded(subscription: Subscription, codec: MessageCodec) -> list:
    """Take messages; garbage is left aside."""
    messages = []
    for sample in subscription.take():
        try:
            messages.append(codec.decode(sample.data))
        except ValueError:
            continue
    return messages
