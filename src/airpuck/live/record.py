"""Recording the graph's traffic while it runs."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.boundary.outputs import check_output, unwritable
from airpuck.flight.clock import Every
from airpuck.live.graph import Endpoint, Graph, Quality, Sample, Subscription
from airpuck.live.process import Process
from airpuck.live.settings import LiveSettings
from airpuck.recording.bag import BagFile
from airpuck.recording.cdr import Types, flatten
from airpuck.recording.message import command_type, definitions

#: Interval between searches for new topics [s].
_LOOK = 0.1
#: Queue length of each topic, in messages.
_DEPTH = 2000
NAME = "airpuck record"
#: A killed recorder loses at most this much [s], and what the disk had not written.
_FLUSH = 0.5
#: Timeout of waiting for messages [s].
_WAIT = 0.05


@dataclass
class _Topic:
    """A topic with a subscription."""

    #: The first publisher.
    first: Endpoint
    quality: Quality
    subscription: Subscription
    #: Messages from an earlier subscription that were not handed out yet.
    waiting: list[Sample]


@dataclass(frozen=True)
class Heard:
    """A received message."""

    #: The first publisher on its topic.
    first: Endpoint
    #: Times of arrival and of sending [ns since the epoch].
    received_ns: int
    sent_ns: int
    #: Messages in CDR, with encapsulation.
    data: bytes


class Listener:
    """Subscribes to all topics that others publish; with `own`, to our own, too.

    `motors` are the propellers of a craft whose commands do not use the authors' message.
    """

    def __init__(self, graph: Graph, motors: tuple[str, ...] = (), *, own: bool = False) -> None:
        self._graph, self._own = graph, own
        self.types: Types = command_type(motors)[1] if motors else definitions("")
        #: Topics that cannot be recorded, with reasons; the caller empties the list.
        self.notes: list[str] = []
        self._topics: dict[str, _Topic] = {}
        self._refused: set[tuple[str, str]] = set()
        self._look = Every(_LOOK)

    def listen(self, seconds: float) -> Iterator[Heard]:
        """Wait for messages, at most this long [s], and take them."""
        if self._look.begins(time.monotonic()):
            self._subscribe()
        self._graph.wait(min(seconds, _LOOK))
        for topic in self._topics.values():
            earlier, topic.waiting = topic.waiting, []
            # While there were two subscriptions, both received.
            taken = earlier + [one for one in topic.subscription.take() if one not in earlier]
            # Read the clock after taking: nothing is received before it was sent, however slow the
            # caller.
            received = time.time_ns()
            for sample in taken:
                yield Heard(topic.first, received, sample.sent_ns, sample.data)

    def _subscribe(self) -> None:
        """Subscribe to new topics, and lower the requested quality if a publisher offers less."""
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
                    self.notes.append(f"{name} of {whose}, {msgtype}, is not recorded: {error}")

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


def record(
    folder: str | os.PathLike[str],
    settings: LiveSettings | None = None,
    *,
    motors: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Record every topic of the graph as a rosbag2 folder, until time is over, SIGINT or SIGTERM.

    Messages are in the file half a second after their arrival, whatever happens: `read_recording`
    can read the file of a killed recorder. Returns the results for ``--json``.
    """
    path = Path(folder)
    check_output(path, "new folder")
    with Process(NAME, settings or LiveSettings()) as process:
        try:
            path.absolute().parent.mkdir(parents=True, exist_ok=True)
            return _record(process, BagFile(path.absolute()), motors)
        except FileExistsError as error:
            problem = "another process has just begun to record into it; choose a new folder"
            raise InputError(problem, file=folder) from error
        except OSError as error:
            raise unwritable(folder, error) from error


def _record(process: Process, bag: BagFile, motors: tuple[str, ...]) -> dict[str, Any]:
    """Record until the process ends."""
    listener = Listener(process.graph, motors, own=True)
    notes: list[str] = []
    places: dict[str, int] = {}
    flush = Every(_FLUSH)
    process.start(f", into {bag.folder}")
    while process.goes_on:
        _take(listener, bag, places)
        for note in listener.notes:
            process.events.log("warning", note, kind=note)
        notes += listener.notes
        listener.notes.clear()
        now = process.clock.now
        if flush.begins(now):
            bag.flush()
        if process.beat.begins(now):
            process.events.heartbeat("info", "recording", bag.counts)
    process.events.log("info", f"ends after {process.clock.now:.1f} s")
    _take(listener, bag, places)
    bag.close()
    return {"duration_s": process.clock.now, "messages": bag.counts, "notes": notes}


def _take(listener: Listener, bag: BagFile, places: dict[str, int]) -> None:
    """Record new messages; `places` are the topics in the bag."""
    for heard in listener.listen(_WAIT):
        first = heard.first
        if first.topic not in places:
            places[first.topic] = bag.add_topic(
                first.topic,
                first.msgtype,
                listener.types,
                best_effort=not first.reliable,
                transient_local=first.transient_local,
            )
        bag.add(places[first.topic], heard.received_ns, heard.sent_ns, heard.data)
