"""Watching the graph: the newest data, and how the craft compares with its model."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.estimate.estimator import FOUND
from airpuck.flight.health import Health, HealthMonitor
from airpuck.live.process import EVENTS, HEARTBEATS, PLANS, Inbox, Process, positions, well_formed
from airpuck.live.settings import LiveSettings
from airpuck.model.model_file import Model

NAME = "airpuck watch"
#: Polling period [s].
_LOOK = 0.02
#: Window over which rates are counted [s].
_COUNTED = 1.0
#: Age of the last heartbeat above which a controller counts as gone [s].
GONE = 2.5
#: Events kept.
_EVENTS = 200


class Observer:
    """Keeps the newest data that a craft and its controller publish, and judges the craft."""

    def __init__(self, process: Process, model: Model) -> None:
        self._monitor = HealthMonitor(model)
        self.clock = process.clock
        # Commands before poses: a pose may show the effect of a command that came with it.
        self._inboxes = {
            "command": Inbox(process, "command", model.vehicle.columns, quiet=True),
            **{k: Inbox(process, k, quiet=True) for k in ("pose", "reference", "estimate")},
        }
        #: Newest numbers of each stream, and when they came [s].
        self.newest: dict[str, Float[np.ndarray, " k"]] = {}
        self.heard: dict[str, float] = {}
        #: Message rate of each stream [Hz].
        self.rates: dict[str, float] = {}
        #: Newest heartbeat of each process: when it came [s], its state, its figures.
        self.beats: dict[str, tuple[float, str, Mapping[str, str]]] = {}
        #: Newest events: arrival time [s] and message.
        self.events: deque[tuple[float, Any]] = deque(maxlen=_EVENTS)
        self._take_events = well_formed(process.graph, EVENTS)
        self._take_beats = well_formed(process.graph, HEARTBEATS)
        #: Path of the controller's newest plan [m]; its limits are in `beats` under `PLAN_NAME`.
        self.plan: Float[np.ndarray, "N 2"] | None = None
        self._take_plans = well_formed(process.graph, PLANS)
        self._counts: Counter[str] = Counter()
        self._counted = 0.0

    @property
    def health(self) -> Health:
        """Comparison of the craft with its model."""
        return self._monitor.health()

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``."""
        return {"duration_s": self.clock.now, **self.health.to_json()}

    def look(self) -> list[Float[np.ndarray, " 3"]]:
        """Process new messages; return the poses."""
        now, poses = self.clock.now, []
        for stream, inbox in self._inboxes.items():
            for stamp, values in inbox.take():
                if not np.isfinite(values).all():
                    continue
                if stream == "command":
                    self._monitor.command(stamp, values)
                elif stream == "pose":
                    self._monitor.pose(stamp, values)
                    poses.append(values)
                self.newest[stream], self.heard[stream] = values, now
                self._counts[stream] += 1
        self.events.extend((now, event) for event in self._take_events())
        for path in self._take_plans():
            self.plan, self.heard["plan"] = positions(path), now
        for message in self._take_beats():
            for status in message.status:
                figures = {pair.key: pair.value for pair in status.values}
                self.beats[status.name] = now, status.message, figures
        elapsed = now - self._counted
        if elapsed >= _COUNTED:
            self.rates = {stream: count / elapsed for stream, count in self._counts.items()}
            self._counts.clear()
            self._counted = now
        return poses

    @property
    def found(self) -> dict[str, str]:
        """What controllers say that they have found about motors, delay, drag and slope."""
        recent = [f for came, _, f in self.beats.values() if self.clock.now - came < GONE]
        told = [item for figures in recent for item in figures.items()]
        return {key.removeprefix(FOUND): text for key, text in told if key.startswith(FOUND)}

    def age(self, stream: str) -> float:
        """Return the age of a stream's newest numbers [s]."""
        return self.clock.now - self.heard.get(stream, -math.inf)


def watch_live(
    model: Model, report: Callable[[str], Any], settings: LiveSettings | None = None
) -> dict[str, Any]:
    """Compare a craft in flight with its model, without commanding anything.

    Significant deviations are also published as events when they change.

    Parameters
    ----------
    model : Model
        Model of the craft.
    report : callable
        Receives a line every second.
    settings : LiveSettings, optional
        How to join the graph, and for how long.

    Returns
    -------
    dict
        Figures for ``--json``.
    """
    # The printed lines already contain its events.
    settings = replace(settings or LiveSettings(), quiet=True)
    with Process(NAME, settings) as process:
        observer, events, clock = Observer(process, model), process.events, process.clock
        named: tuple[str, ...] = ()
        process.start("")
        process.beat.begins(clock.now)
        while process.goes_on:
            clock.sleep_until(clock.now + _LOOK)
            observer.look()
            if not process.beat.begins(clock.now):
                continue
            health = observer.health
            report(str(health))
            if found := observer.found:
                report(f"the controller finds: {', '.join(map(' '.join, found.items()))}")
            level = "warning" if health.findings else "info"
            if health.names != named:
                named = health.names
                events.log(level, ", ".join(health.findings) or "no more deviations from the model")
            events.heartbeat(level, str(health), {})
        return observer.to_json()
