"""Recording the graph's traffic while it runs."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.live.events import EventLog
from airpuck.live.graph import Graph
from airpuck.live.listener import Listener
from airpuck.live.process import orderly
from airpuck.recording.bag_file import BagFile

NAME = "airpuck record"
#: What a recorder that is killed loses at most [s]; some of the second is the disk's.
_FLUSH = 0.5
_HEARTBEAT = 1.0


@dataclass(frozen=True)
class RecordingReport:
    """What was recorded."""

    #: How long the recorder ran [s].
    duration: float
    #: By topic.
    messages: Mapping[str, int]
    #: What could not be recorded, and why.
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        return {
            "duration_s": self.duration,
            "messages": dict(self.messages),
            "notes": list(self.notes),
        }


def record(
    folder: str | os.PathLike[str],
    *,
    motors: tuple[str, ...] = (),
    domain: int | None = None,
    interface: str | None = None,
    duration: float = float("inf"),
    quiet: bool = False,
) -> RecordingReport:
    """Record every topic of the graph as a rosbag2 folder, until SIGINT or SIGTERM.

    What was received half a second ago is in the file, whatever happens; `read_recording` reads a
    file whose recorder was killed.
    """
    path = Path(folder)
    if path.exists() or path.is_symlink():
        raise InputError("exists already; give another name or remove it", file=folder)
    graph = Graph(NAME, domain=domain, interface=interface)
    try:
        try:
            path.absolute().parent.mkdir(parents=True, exist_ok=True)
            bag = BagFile(path.absolute())
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", file=folder) from error
        with orderly() as ending:
            events = EventLog(graph, NAME, quiet=quiet)
            listener = Listener(graph, motors, own=True)
            start = flushed = beat = time.monotonic()
            events.tell("info", f"on domain {graph.domain}, into {folder}")
            notes: list[str] = []
            places: dict[str, int] = {}
            while not ending.asked and time.monotonic() - start < duration:
                _take(listener, bag, places)
                notes += listener.notes
                for note in listener.notes:
                    events.tell("warning", note, kind=note)
                listener.notes.clear()
                now = time.monotonic()
                if now - flushed >= _FLUSH:
                    bag.flush()
                    flushed = now
                if now - beat >= _HEARTBEAT:
                    beat = now
                    events.heartbeat("info", "recording", bag.counts)
            events.tell_held()
            events.tell("info", f"ends after {time.monotonic() - start:.1f} s")
            _take(listener, bag, places)
            bag.close()
            return RecordingReport(time.monotonic() - start, bag.counts, tuple(notes))
    finally:
        graph.close()


def _take(listener: Listener, bag: BagFile, places: dict[str, int]) -> None:
    """Record what has come."""
    for heard in listener.listen(0.05):
        if heard.topic not in places:
            first = listener.topic(heard.topic)
            places[heard.topic] = bag.add_topic(
                heard.topic,
                heard.msgtype,
                listener.types,
                best_effort=not first.reliable,
                transient_local=first.transient_local,
            )
        bag.add(places[heard.topic], heard.received_ns, heard.sent_ns, heard.data)
