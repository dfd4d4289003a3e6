"""A graph without a network: one process, whose clock goes on only while it waits."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from operator import itemgetter

import pytest

from airpuck.flight.clock import Clock
from airpuck.live import process
from airpuck.live.graph import Endpoint, Graph, Sample
from airpuck.live.process import EVENTS, HEARTBEATS
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.message import MessageCodec, StreamCodec

from .processes import CODECS, EVENT

#: When clocks start [ns].
_EPOCH_NS = 1_700_000_000 * SECOND_NS
STATES = MessageCodec(HEARTBEATS.msgtype)


class PacedClock(Clock):
    """Goes on while the process waits; whatever is due meanwhile happens.

    It starts so much later than other clocks [s].
    """

    def __init__(self, later: float) -> None:
        self._due, self._later = list[tuple[float, Callable[[], None]]](), later
        super().__init__()

    def restart(self) -> None:
        self._now, self._epoch_ns = 0.0, _EPOCH_NS + round(self._later * SECOND_NS)

    @property
    def now(self) -> float:
        return self._now

    def at(self, time: float, act: Callable[[], None]) -> None:
        """Do something at a time [s]."""
        self._due.append((float(time), act))
        self._due.sort(key=itemgetter(0))

    def sleep_until(self, due: float) -> None:
        while self._due and self._due[0][0] <= due:
            time, act = self._due.pop(0)
            self._now = max(self._now, time)
            act()
        self._now = max(self._now, due)


class GraphInMemory(Graph):
    """Keeps what the process publishes, and hands it what others publish."""

    age = 1e9

    def __init__(self, later: float = 0.0) -> None:
        self.clock, self.domain = PacedClock(later), 0
        self.sent: dict[str, list[bytes]] = defaultdict(list)
        #: Times at which they were sent [s].
        self.times: dict[str, list[float]] = defaultdict(list)
        self.waiting: dict[str, list[Sample]] = defaultdict(list)
        #: Publishers of other processes.
        self.others: list[Endpoint] = []

    def publisher(self, topic, *_):
        graph = self

        class Publisher:
            def send(self, data):
                graph.sent[topic].append(data)
                graph.times[topic].append(graph.clock.now)

        return Publisher()

    def subscription(self, topic, *_, **__):
        graph = self

        class Subscription:
            def take(self):
                return graph.waiting.pop(topic, [])

        return Subscription()

    def publishers(self, topic=None, **_):
        return [other for other in self.others if topic in (None, other.topic)]

    def describe(self, endpoint):
        return "somebody"

    def wait(self, seconds):
        self.clock.sleep_until(self.clock.now + seconds)

    def close(self):
        pass

    def publish(self, time: float, topic: str, values, within: str = "") -> None:
        """Let others publish numbers at a time [s], on a topic of a craft's namespace."""

        def act() -> None:
            stamp = self.clock.stamp_ns(time)
            self.waiting[within + topic].append(Sample(stamp, CODECS[topic].encode(stamp, values)))

        self.clock.at(time, act)

    def replay(self, other: GraphInMemory, topic: str) -> None:
        """Let another process publish what it published on its graph, at the same times."""
        for time, data in zip(other.times[topic], other.sent[topic], strict=True):
            sample = Sample(other.clock.stamp_ns(time), data)
            self.clock.at(
                self.clock.of(sample.sent_ns), lambda one=sample: self.waiting[topic].append(one)
            )

    def values(self, topic: str, stream: str = "") -> list:
        """The numbers of each message that the process published on a topic."""
        codec = StreamCodec(stream) if stream else CODECS[topic]
        return [codec.decode(data)[1] for data in self.sent[topic]]

    @property
    def events(self) -> list[str]:
        return [EVENT.decode(data).msg for data in self.sent[EVENTS.name]]

    @property
    def states(self) -> list[tuple[str, str, dict[str, str]]]:
        """Name, state and figures of each heartbeat."""
        found = [STATES.decode(data).status[0] for data in self.sent[HEARTBEATS.name]]
        return [(s.name, s.message, {pair.key: pair.value for pair in s.values}) for s in found]


def joined(monkeypatch: pytest.MonkeyPatch, later: float = 0.0) -> GraphInMemory:
    """Let the next process join a graph in memory, with a clock that starts later [s]."""
    graph = GraphInMemory(later)
    monkeypatch.setattr(process, "Graph", lambda *_, **__: graph)
    monkeypatch.setattr(process, "Clock", lambda: graph.clock)
    return graph
