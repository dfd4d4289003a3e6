"""How the craft fares, a line a second."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from airpuck.live.events import EventLog
from airpuck.live.graph import Graph
from airpuck.live.observer import Observer
from airpuck.live.process import orderly, settle_memory
from airpuck.model.model_file import Model
from airpuck.recording.topics import Topics

NAME = "airpuck watch"
_PERIOD = 0.02
_LINE = 1.0


def watch_live(
    model: Model,
    tell: Callable[[str], Any],
    *,
    topics: Topics | None = None,
    domain: int | None = None,
    interface: str | None = None,
    duration: float = float("inf"),
) -> dict[str, Any]:
    """Compare a craft in flight with its model, until SIGINT or SIGTERM; nothing is commanded.

    What differs beyond doubt is told on the graph, too, when it changes.
    """
    graph = Graph(NAME, domain=domain, interface=interface)
    try:
        with orderly() as ending:
            events = EventLog(graph, NAME, quiet=True)
            observer = Observer(graph, model, topics or Topics())
            settle_memory()
            clock, known = observer.clock, ()
            due = clock.now + _LINE
            while not ending.asked and clock.now < duration:
                clock.sleep_until(clock.now + _PERIOD)
                observer.look()
                if clock.now < due:
                    continue
                due += _LINE
                health = observer.health
                tell(str(health))
                named = tuple(finding.split(" at ")[0] for finding in health.findings)
                if named != known:
                    known = named
                    text = ", ".join(health.findings) or "motors and delay as the model says"
                    events.tell("warning" if named else "info", text)
                events.heartbeat("warning" if named else "info", str(health), {})
            return observer.to_json()
    finally:
        graph.close()
