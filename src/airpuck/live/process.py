"""A process on the graph: joining, streams as numbers, events, clock and shutdown."""

from __future__ import annotations

import gc
import math
import signal
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.signals import SIGNALS
from airpuck.flight.clock import Clock, Every, StampClock
from airpuck.live.dds import LEASE
from airpuck.live.events import EventLog
from airpuck.live.graph import SENSOR, STATE, Endpoint, Graph, Quality
from airpuck.live.settings import LiveSettings
from airpuck.recording.mapping import Topics
from airpuck.recording.message import StreamCodec

if TYPE_CHECKING:
    from airpuck.control.reference import Numbers

#: Estimates and references are sent again when lost; of other streams only the newest message
#: counts.
_QUALITY = {"estimate": STATE, "reference": STATE}
#: Time between heartbeats [s].
_HEARTBEAT = 1.0
#: Time for discovery to find other processes before concluding that there are none [s].
_LOOK_AROUND = 0.6
#: Larger numbers are garbage: squares of some finite ones overflow. Commands go to 1, poses to
#: metres and some turns.
_LARGEST = 1e6
#: A difference between clocks that is worth a warning [s].
_NOTABLE_OFFSET = 0.1
#: A process that did not poll for this long was suspended [s]; messages from the system's buffers
#: keep arriving for this long afterwards [s].
_STOOD_STILL, _COMES_LATE = 0.1, 0.05
#: Period for resending the last message to late subscribers [s].
_REMIND = 1.0


class Process:
    """A process on the graph, to be used as a context manager.

    From `start` on, SIGINT, SIGTERM and SIGHUP end its loop instead of the process.
    """

    def __init__(self, name: str, settings: LiveSettings) -> None:
        self.settings = settings
        self.topics = settings.topics or Topics()
        self.graph = Graph(name, domain=settings.domain, interface=settings.interface)
        self.events = EventLog(self.graph, name, quiet=settings.quiet)
        self.clock = Clock()
        self.beat = Every(_HEARTBEAT)
        #: Whether one of these signals has arrived.
        self.interrupted = False
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self.graph.close()

    def refuse_second(self, stream: str, motors: tuple[str, ...], role: str) -> None:
        """Raise InputError if another process already publishes a stream."""
        topic, codec, quality = _wire(self, stream, motors)
        heard = self.graph.subscription(topic, codec.msgtype, codec.types, quality)
        start = time.monotonic()
        while (others := self.graph.publishers(topic)) or self.graph.age < _LOOK_AROUND:
            # A killed process is silent, and leaves the graph after its lease.
            silent = time.monotonic() - start
            if others and (heard.take() or silent > LEASE + 1.0):
                raise InputError(
                    f"there is another {role} already: {self.graph.describe(others[0])}; end it "
                    "first, or use another --domain",
                    field=topic,
                )
            time.sleep(0.02)

    def start(self, text: str) -> None:
        """Start the clock; all slow work has been done."""
        for number in SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN or number == signal.SIGINT:
                self._handlers[number] = signal.signal(number, self._interrupt)
        self.events.log("info", f"on domain {self.graph.domain}{text}")
        # The garbage collector need not scan existing objects.
        gc.collect()
        gc.freeze()
        self.clock.restart()

    @property
    def goes_on(self) -> bool:
        """Whether time is left, and no signal has come."""
        duration = self.settings.duration
        return not self.interrupted and (duration is None or self.clock.now < duration)

    def _interrupt(self, *_: object) -> None:
        self.interrupted = True


def _wire(
    process: Process, stream: str, motors: tuple[str, ...]
) -> tuple[str, StreamCodec, Quality]:
    """Return topic, codec and quality of service of a stream."""
    topic = process.topics.by_stream[stream]
    return topic, StreamCodec(stream, motors), _QUALITY.get(stream, SENSOR)


class Inbox:
    """One stream as it arrives; problems with its messages are logged, unless it is quiet."""

    def __init__(
        self,
        process: Process,
        stream: str,
        motors: tuple[str, ...] = (),
        *,
        wakes: bool = False,
        quiet: bool = False,
    ) -> None:
        self._graph, self._clock = process.graph, process.clock
        self._events = None if quiet else process.events
        self._topic, self._codec, quality = _wire(process, stream, motors)
        self._subscription = self._graph.subscription(
            self._topic, self._codec.msgtype, self._codec.types, quality, wakes=wakes
        )
        self._stamps, self._reported_offset = StampClock(), 0.0
        self._looked, self._late_until = self._clock.now, -math.inf
        self._strangers: set[Endpoint] = set()
        #: Number of usable messages, and of unusable ones.
        self.good = self.bad = 0

    def discard(self) -> None:
        """Drop pending messages."""
        self._subscription.take()

    def take(self) -> list[tuple[float, Float[np.ndarray, " k"]]]:
        """Take new messages: the time of each stamp on our clock [s], and its numbers."""
        taken = []
        for arrival, stamp_ns, values in self._decoded():
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
            self._warn(f"the clock behind {self._topic} differs by {-offset:.3f} s; compensated")
        return taken

    def take_commands(self) -> list[Float[np.ndarray, " k"]]:
        """Take numbers that act on arrival, whatever their stamps and the sender's clock."""
        before, self._looked = self._looked, self._clock.now
        if self._looked - before > _STOOD_STILL:
            self._late_until = self._looked + _COMES_LATE
        late = self._looked < self._late_until
        taken = []
        for _, _, values in self._decoded():
            if not np.isfinite(values).all():
                self._refuse("finite", f"numbers on {self._topic} that are not finite")
            elif late:
                self._refuse("late", f"late messages on {self._topic}")
            else:
                taken.append(values)
        self.good += len(taken)
        return taken

    def report_strangers(self) -> None:
        """Warn once about each publisher of another type on the topic: it is ignored."""
        for endpoint in self._graph.publishers(self._topic):
            if endpoint.msgtype != self._codec.msgtype and endpoint not in self._strangers:
                self._strangers.add(endpoint)
                text = (
                    f"{self._graph.describe(endpoint)} publishes {endpoint.msgtype} on "
                    f"{self._topic}, which should be {self._codec.msgtype}; it is ignored"
                )
                self._warn(text, kind=text)

    def _decoded(self) -> Iterator[tuple[float, int | None, Float[np.ndarray, " k"]]]:
        """Take arrivals [s], stamps [ns since the epoch] and numbers of well-formed messages."""
        for sample in self._subscription.take():
            arrival = self._clock.now
            try:
                stamp_ns, values = self._codec.decode(sample.data)
            except ValueError as error:
                self._refuse("garbage", f"garbage on {self._topic}: {error}")
                continue
            if (np.isfinite(values) & (np.abs(values) > _LARGEST)).any():
                self._refuse("size", f"numbers on {self._topic} beyond {_LARGEST:g}")
            else:
                yield arrival, stamp_ns, values

    def reject(self, text: str) -> None:
        """Count a message that was taken as unusable, and warn."""
        self.good -= 1
        self._refuse("content", f"refused on {self._topic}: {text}")

    def _refuse(self, kind: str, text: str) -> None:
        """Count an unusable message, and warn."""
        self.bad += 1
        self._warn(text, kind=f"{kind} {self._topic}")

    def _warn(self, text: str, kind: str | None = None) -> None:
        if self._events is not None:
            self._events.log("warning", text, kind=kind)


class Outbox:
    """One outgoing stream."""

    def __init__(self, process: Process, stream: str, motors: tuple[str, ...] = ()) -> None:
        self._clock = process.clock
        topic, self._codec, quality = _wire(process, stream, motors)
        types = self._codec.types
        self._publisher = process.graph.publisher(topic, self._codec.msgtype, types, quality)
        self._last: Numbers | None = None
        #: Time at which the last message was sent [s].
        self.sent = -math.inf

    def send(self, values: Numbers, moment: float | None = None) -> None:
        """Send numbers, stamped with a time on our clock [s], by default now."""
        moment = self._clock.now if moment is None else moment
        self._publisher.send(self._codec.encode(self._clock.stamp_ns(moment), values))
        self._last, self.sent = values, self._clock.now

    def remind(self) -> None:
        """Resend the last numbers every second, for late subscribers."""
        if self._last is not None and self._clock.now - self.sent > _REMIND:
            self.send(self._last)
