"""Streams on the graph as numbers: what comes in, checked, and what goes out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from airpuck.live.clock import Clock, StampClock
from airpuck.live.events import EventLog
from airpuck.live.graph import Endpoint, Graph, Quality
from airpuck.recording.message import StreamCodec

#: A difference between clocks that is worth a warning [s].
_NOTABLE_OFFSET = 0.1
#: A process that did not look for this long stood still [s]; messages that waited for it in the
#: system's buffers go on coming for this long [s].
_STOOD_STILL, _COMES_LATE = 0.1, 0.05
#: How often the last message is sent again, for those that came late [s].
_REMIND = 1.0


class Inbox:
    """One stream as it arrives; what is wrong with its messages goes to the event log, if any."""

    def __init__(
        self,
        graph: Graph,
        topic: str,
        codec: StreamCodec,
        quality: Quality,
        clock: Clock,
        events: EventLog | None = None,
        *,
        wakes: bool = False,
    ) -> None:
        self._graph, self._topic, self._codec = graph, topic, codec
        self._clock, self._events = clock, events
        self._subscription = graph.subscription(
            topic, codec.msgtype, codec.types, quality, wakes=wakes
        )
        self._stamps, self._reported_offset = StampClock(), 0.0
        self._looked, self._late_until = clock.now, -math.inf
        self._strangers: set[Endpoint] = set()
        #: Messages that could be used, and that could not.
        self.good = self.bad = 0

    def discard(self) -> None:
        """Drop what has come."""
        self._subscription.take()

    def take(self) -> list[tuple[float, Float[np.ndarray, " k"]]]:
        """Take what has come: when each message was stamped, on our clock [s], and its numbers."""
        taken = []
        for stamp_ns, values in self._decoded():
            arrival = self._clock.now
            if stamp_ns is None:
                taken.append((arrival, values))
                continue
            stamp = self._clock.of(stamp_ns)
            placed = self._stamps.time(stamp, arrival)
            if placed is None:
                age = arrival - stamp - self._stamps.offset
                self._refuse("stamp", f"wrong or late stamp on {self._topic}: {age:.3f} s old")
            else:
                taken.append((placed, values))
        self.good += len(taken)
        offset = self._stamps.offset
        if abs(offset - self._reported_offset) > _NOTABLE_OFFSET:
            self._reported_offset = offset
            self._warn(f"the clock behind {self._topic} differs by {-offset:.3f} s; allowed for")
        return taken

    def take_commands(self) -> list[Float[np.ndarray, " k"]]:
        """Take numbers that act on arrival, whatever their stamps and the sender's clock say."""
        before, self._looked = self._looked, self._clock.now
        if self._looked - before > _STOOD_STILL:
            self._late_until = self._looked + _COMES_LATE
        late = self._looked < self._late_until
        taken = []
        for _, values in self._decoded():
            if not np.isfinite(values).all():
                self._refuse("finite", f"numbers on {self._topic} that are not finite")
            elif late:
                self._refuse("late", f"late messages on {self._topic}")
            else:
                taken.append(values)
        self.good += len(taken)
        return taken

    def report_strangers(self) -> None:
        """Warn once of each publisher of another type on the topic: it is not heard."""
        for endpoint in self._graph.publishers(self._topic):
            if endpoint.msgtype != self._codec.msgtype and endpoint not in self._strangers:
                self._strangers.add(endpoint)
                text = (
                    f"{self._graph.describe(endpoint)} publishes {endpoint.msgtype} on "
                    f"{self._topic}, which should be {self._codec.msgtype}; it is not heard"
                )
                self._warn(text, kind=text)

    def _decoded(self) -> Iterator[tuple[int | None, Float[np.ndarray, " k"]]]:
        """Take stamps [ns since the epoch] and numbers; garbage is refused."""
        for sample in self._subscription.take():
            try:
                message = self._codec.decode(sample.data)
            except ValueError as error:
                self._refuse("garbage", f"garbage on {self._topic}: {error}")
            else:
                yield message

    def _refuse(self, kind: str, text: str) -> None:
        """Count a message that cannot be used, and warn."""
        self.bad += 1
        self._warn(text, kind=f"{kind} {self._topic}")

    def _warn(self, text: str, kind: str | None = None) -> None:
        if self._events is not None:
            self._events.log("warning", text, kind=kind)


class Outbox:
    """One stream as it leaves."""

    def __init__(
        self, graph: Graph, topic: str, codec: StreamCodec, quality: Quality, clock: Clock
    ) -> None:
        self._codec, self._clock = codec, clock
        self._publisher = graph.publisher(topic, codec.msgtype, codec.types, quality)
        self._last: Sequence[float] | Float[np.ndarray, " k"] | None = None
        #: When the last message was sent [s].
        self.sent = -math.inf

    def send(
        self, values: Sequence[float] | Float[np.ndarray, " k"], moment: float | None = None
    ) -> None:
        """Send numbers of some moment on our clock [s], by default now."""
        moment = self._clock.now if moment is None else moment
        self._publisher.send(self._codec.encode(self._clock.stamp_ns(moment), values))
        self._last, self.sent = values, self._clock.now

    def remind(self) -> None:
        """Send the last numbers again, if that was a second ago, for those that came late."""
        if self._last is not None and self._clock.now - self.sent > _REMIND:
            self.send(self._last)
