"""Listening to a graph: every topic whose message type is known, as bytes; nothing is published."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from airpuck.flight.clock import Every
from airpuck.live.graph import Endpoint, Graph, Quality, Sample, Subscription
from airpuck.recording.cdr import Types, flatten
from airpuck.recording.message import command_type, definitions

#: How often to look for new topics [s].
_LOOK = 0.1
#: How many messages of a topic may wait for the listener.
_DEPTH = 2000


@dataclass
class _Topic:
    """A topic that is listened to."""

    #: Who published on it first.
    first: Endpoint
    quality: Quality
    subscription: Subscription
    #: Taken from an earlier subscription, and not yet handed out.
    waiting: list[Sample]


@dataclass(frozen=True)
class Heard:
    """A received message."""

    #: ROS names.
    topic: str
    msgtype: str
    #: When it came and when it was sent [ns since the epoch].
    received_ns: int
    sent_ns: int
    #: In CDR, with encapsulation.
    data: bytes


class Listener:
    """Subscribes to whatever others publish, as they begin to; with `own`, to our own, too.

    `motors` are the propellers of a craft whose commands are not the authors' message.
    """

    def __init__(self, graph: Graph, motors: tuple[str, ...] = (), *, own: bool = False) -> None:
        self._graph, self._own = graph, own
        self.types: Types = command_type(motors)[1] if motors else definitions("")
        #: What is not heard and why; the user empties it.
        self.notes: list[str] = []
        self._topics: dict[str, _Topic] = {}
        self._refused: set[tuple[str, str]] = set()
        self._look = Every(_LOOK)

    def topic(self, name: str) -> Endpoint:
        """Return the first publisher on a topic that is listened to."""
        return self._topics[name].first

    def listen(self, seconds: float) -> Iterator[Heard]:
        """Wait for messages, at most this long [s], and take them."""
        if self._look.begins(time.monotonic()):
            self._subscribe()
        self._graph.wait(min(seconds, _LOOK))
        for name, topic in self._topics.items():
            earlier, topic.waiting = topic.waiting, []
            # While there were two subscriptions, both received.
            taken = earlier + [one for one in topic.subscription.take() if one not in earlier]
            # Read after taking: nothing is received before it was sent, however slow the caller.
            received = time.time_ns()
            for sample in taken:
                yield Heard(name, topic.first.msgtype, received, sample.sent_ns, sample.data)

    def _subscribe(self) -> None:
        """Subscribe to new topics, and ask for less where a publisher offers less."""
        for endpoint in self._graph.publishers(own=self._own):
            name, msgtype = endpoint.topic, endpoint.msgtype
            offered = Quality(endpoint.reliable, endpoint.transient_local, _DEPTH)
            topic = self._topics.get(name)
            if topic is not None and topic.first.msgtype == msgtype:
                self._ask_less(topic, offered)
            elif (name, msgtype) not in self._refused:
                try:
                    flatten(self.types, msgtype)
                    self._topics[name] = _Topic(endpoint, offered, self._ask(endpoint, offered), [])
                except ValueError as error:
                    self._refused.add((name, msgtype))
                    whose = self._graph.describe(endpoint)
                    self.notes.append(f"{name} of {whose}, {msgtype}, is not heard: {error}")

    def _ask(self, endpoint: Endpoint, quality: Quality) -> Subscription:
        """Subscribe to an endpoint's topic."""
        return self._graph.subscription(
            endpoint.topic, endpoint.msgtype, self.types, quality, wakes=True
        )

    def _ask_less(self, topic: _Topic, offered: Quality) -> None:
        """Resubscribe if a publisher offers less than requested: it would not be matched."""
        asked = topic.quality
        reliable = asked.reliable and offered.reliable
        quality = Quality(reliable, asked.transient_local and offered.transient_local, _DEPTH)
        if quality == asked:
            return
        before, topic.quality = topic.subscription, quality
        # The new one first, so that nothing falls between the two.
        topic.subscription = self._ask(topic.first, quality)
        topic.waiting += before.take()
        self._graph.unsubscribe(before)
