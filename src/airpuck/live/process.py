"""What the live processes share: settings, joining the graph, an orderly end, real-time care."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.live.clock import Clock, Every
from airpuck.live.dds import LEASE, domain_config, domain_id
from airpuck.live.events import EventLog
from airpuck.live.graph import SENSOR, STATE, Graph, Quality
from airpuck.live.streams import Inbox, Outbox
from airpuck.recording.message import StreamCodec
from airpuck.recording.stream import Topics

#: Estimates and references are sent again when lost; of other streams only the newest counts.
_QUALITY = {"estimate": STATE, "reference": STATE}
#: Time between heartbeats [s].
_HEARTBEAT = 1.0
#: Time for discovery to find who is there, before one may say that nobody is [s].
_LOOK_AROUND = 0.6
#: Priority above ordinary processes, below the system's own.
_PRIORITY = 10


@dataclass(frozen=True)
class LiveSettings:
    """How a process joins a graph, and for how long.

    Parameters
    ----------
    topics : Topics
        Names of the topics; by default those of the authors' table.
    domain : int, optional
        DDS domain; by default ``ROS_DOMAIN_ID``, or 0.
    interface : str, optional
        Network interface; by default loopback, so that nothing leaves the machine.
    duration : float, optional
        How long to go on [s]; by default until SIGINT or SIGTERM.
    quiet : bool, default False
        Whether to print no events on standard error.

    Raises
    ------
    InputError
        If the domain or the interface does not exist, or the duration is not above 0.
    """

    topics: Topics = field(default_factory=Topics)
    domain: int | None = None
    interface: str | None = None
    duration: float | None = None
    quiet: bool = False

    def __post_init__(self) -> None:
        domain_id(self.domain)
        domain_config(self.interface)
        if self.duration is not None and not 0 < self.duration < math.inf:
            raise InputError("must be a number of seconds above 0", field="--duration")


class Process:
    """A process on the graph: its streams, its events, its clock, and its end.

    Use it as a context manager. From `start` on, SIGINT and SIGTERM end the loop rather than the
    process.
    """

    def __init__(self, name: str, settings: LiveSettings) -> None:
        self.settings = settings
        self.graph = Graph(name, domain=settings.domain, interface=settings.interface)
        self.events = EventLog(self.graph, name, quiet=settings.quiet)
        self.clock = Clock()
        self.beat = Every(_HEARTBEAT)
        #: Whether SIGINT or SIGTERM has come.
        self.interrupted = False
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self.graph.close()

    def inbox(
        self, stream: str, motors: tuple[str, ...] = (), *, wakes: bool = False, quiet: bool = False
    ) -> Inbox:
        """Subscribe to a stream; a quiet inbox does not report what is wrong with messages."""
        events = None if quiet else self.events
        return Inbox(self.graph, *self._stream(stream, motors), self.clock, events, wakes=wakes)

    def outbox(self, stream: str, motors: tuple[str, ...] = ()) -> Outbox:
        """Publish a stream."""
        return Outbox(self.graph, *self._stream(stream, motors), self.clock)

    def _stream(self, stream: str, motors: tuple[str, ...]) -> tuple[str, StreamCodec, Quality]:
        """Return topic, codec and quality of service of a stream."""
        topic = self.settings.topics.by_stream[stream]
        return topic, StreamCodec(stream, motors), _QUALITY.get(stream, SENSOR)

    def refuse_second(self, stream: str, motors: tuple[str, ...], role: str) -> None:
        """Raise an InputError if another process publishes a stream; it has one publisher only."""
        topic, codec, quality = self._stream(stream, motors)
        heard = self.graph.subscription(topic, codec.msgtype, codec.types, quality)
        start = time.monotonic()
        while (others := self.graph.publishers(topic)) or self.graph.age < _LOOK_AROUND:
            # One that was killed says nothing, and leaves the graph after a while.
            silent = time.monotonic() - start
            if others and (heard.take() or silent > LEASE + 1.0):
                raise InputError(
                    f"there is another {role} already: {self.graph.describe(others[0])}; end it "
                    "first, or take another --domain",
                    field=topic,
                )
            time.sleep(0.02)

    def start(self, text: str) -> None:
        """Let time begin; everything slow has been done."""
        for number in (signal.SIGINT, signal.SIGTERM):
            self._handlers[number] = signal.signal(number, self._interrupt)
        self.events.log("info", f"on domain {self.graph.domain}{text}")
        # The garbage collector need not look through what exists now.
        gc.collect()
        gc.freeze()
        self.clock.restart()

    @property
    def goes_on(self) -> bool:
        """Whether its time is not over, and no signal has come."""
        duration = self.settings.duration
        return not self.interrupted and (duration is None or self.clock.now < duration)

    def _interrupt(self, *_: object) -> None:
        self.interrupted = True


def hurry() -> None:
    """Ask the system to run this process first; continue without, where it may not."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))


@contextlib.contextmanager
def unhurried() -> Iterator[None]:
    """Let others run first for a while, such as during compilation."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except (OSError, AttributeError):
        yield
        return
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, *before)
