"""Recording the graph's traffic while it runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from airpuck.boundary.outputs import check_output, unwritable
from airpuck.flight.clock import Every
from airpuck.live.listener import Listener
from airpuck.live.process import Process
from airpuck.live.settings import LiveSettings
from airpuck.recording.bag_writer import BagFile

NAME = "airpuck record"
#: A recorder that is killed loses at most this much [s], and what the disk had not written.
_FLUSH = 0.5
#: How long to wait for messages [s].
_WAIT = 0.05


def record(
    folder: str | os.PathLike[str],
    settings: LiveSettings | None = None,
    *,
    motors: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Record every topic of the graph as a rosbag2 folder, until its time is over, SIGINT, SIGTERM.

    What was received half a second ago is in the file, whatever happens: `read_recording` reads a
    file whose recorder was killed. Returns the figures for ``--json``.
    """
    path = Path(folder)
    check_output(path, "new folder")
    with Process(NAME, settings or LiveSettings()) as process:
        try:
            path.absolute().parent.mkdir(parents=True, exist_ok=True)
            return _record(process, BagFile(path.absolute()), motors)
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
    process.events.flush()
    process.events.log("info", f"ends after {process.clock.now:.1f} s")
    _take(listener, bag, places)
    bag.close()
    return {"duration_s": process.clock.now, "messages": bag.counts, "notes": notes}


def _take(listener: Listener, bag: BagFile, places: dict[str, int]) -> None:
    """Record what has come; `places` are the topics in the bag."""
    for heard in listener.listen(_WAIT):
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
