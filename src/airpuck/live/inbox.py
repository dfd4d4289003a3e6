"""Messages from the graph as numbers, with everything that is wrong with them sorted out."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from airpuck.live.clock import Clock, StampClock
from airpuck.live.discovery import Endpoint
from airpuck.live.events import EventLog
from airpuck.live.graph import Graph, Quality
from airpuck.recording.message import StreamCodec

#: A difference between clocks that is told [s].
_WORTH_TELLING = 0.1
#: A process that did not look for this long stood still [s], and what waited for it in the system's
#: buffers still comes for this long after [s].
_STOOD_STILL, _COMES_LATE = 0.1, 0.05


class Inbox:
    """One stream as it arrives."""

    def __init__(
        self,
        graph: Graph,
        topic: str,
        codec: StreamCodec,
        quality: Quality,
        clock: Clock,
        events: EventLog,
        *,
        wakes: bool = False,
    ) -> None:
        self._graph, self._topic, self._codec = graph, topic, codec
        self._clock, self._events = clock, events
        self._subscription = graph.subscription(
            topic, codec.msgtype, codec.types, quality, wakes=wakes
        )
        self._stamps, self._offset = StampClock(), 0.0
        self._looked, self._late_until = clock.now, -math.inf
        self._strangers: set[Endpoint] = set()
        #: Messages that could be used, and that could not.
        self.good = self.bad = 0

    def discard(self) -> None:
        """Take what has come, and leave it aside."""
        self._subscription.take()

    def take(self) -> list[tuple[float, Float[np.ndarray, " k"]]]:
        """Take what has come."""
        taken = []
        for sample in self._subscription.take():
            arrival = self._clock.now
            try:
                stamp_ns, values = self._codec.decode(sample.data)
            except ValueError as error:
                self._refuse("garbage", f"garbage on {self._topic}: {error}")
                continue
            if stamp_ns is None:
                taken.append((arrival, values))
                continue
            stamp = self._clock.of(stamp_ns)
            placed = self._stamps.time(stamp, arrival)
            if placed is None:
                late = f"{arrival - stamp - self._stamps.offset:.3f} s"
                self._refuse("stamp", f"wrong or late stamp on {self._topic}: {late} old")
                continue
            taken.append((placed, values))
        self.good += len(taken)
        if abs(self._stamps.offset - self._offset) > _WORTH_TELLING:
            self._offset = self._stamps.offset
            self._events.tell(
                "warning",
                f"the clock behind {self._topic} differs by {-self._offset:.3f} s; allowed for",
            )
        return taken

    def take_commands(self) -> list[Float[np.ndarray, " k"]]:
        """Take numbers that act on arrival, whatever their stamps and the sender's clock say."""
        before, self._looked = self._looked, self._clock.now
        if self._looked - before > _STOOD_STILL:
            self._late_until = self._looked + _COMES_LATE
        late = self._looked < self._late_until
        taken = []
        for sample in self._subscription.take():
            try:
                _, values = self._codec.decode(sample.data)
            except ValueError as error:
                self._refuse("garbage", f"garbage on {self._topic}: {error}")
                continue
            if not np.isfinite(values).all():
                self._refuse("finite", f"numbers on {self._topic} that are not finite")
            elif late:
                self._refuse("late", f"late messages on {self._topic}")
            else:
                taken.append(values)
        self.good += len(taken)
        return taken

    def tell_strangers(self) -> None:
        """Tell once of each publisher of another type on the topic: it is not heard."""
        for endpoint in self._graph.publishers(self._topic):
            if endpoint.msgtype != self._codec.msgtype and endpoint not in self._strangers:
                self._strangers.add(endpoint)
                text = (
                    f"{self._graph.describe(endpoint)} publishes {endpoint.msgtype} on "
                    f"{self._topic}, which should be {self._codec.msgtype}; it is not heard"
                )
                self._events.tell("warning", text, kind=text)

    def _refuse(self, kind: str, text: str) -> None:
        """Count a message that cannot be used, and tell."""
        self.bad += 1
        self._events.tell("warning", text, kind=f"{kind} {self._topic}")
