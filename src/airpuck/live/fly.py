"""Flying on the graph: the loop, the guard around it, and what it says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.craft.vehicle import Vehicle
from airpuck.flight.loop import Action, Pilot, control
from airpuck.live.clock import Clock
from airpuck.live.events import EventLog
from airpuck.live.graph import STATE, Graph
from airpuck.live.inbox import Inbox
from airpuck.live.keyboard import Keyboard, keyboard
from airpuck.live.link import GraphLink
from airpuck.live.monitor import LoopTiming
from airpuck.live.process import (
    Ending,
    hurry,
    orderly,
    refuse_second,
    settle_memory,
    unhurried,
)
from airpuck.live.safety import Guard, GuardedPilot, Limits
from airpuck.live.setpoints import FollowedSetPoint, PlannedSetPoints
from airpuck.recording.message import StreamCodec
from airpuck.recording.topics import Topics

NAME = "airpuck fly"
#: Idle commands at the end, since one may be lost.
_LAST_COMMANDS = 5
_HEARTBEAT = 1.0
#: Steps before the flight, and how many of them are left out, for the pilot to forget the others.
_WARM_UP_STEPS, _FORGOTTEN_STEPS = 150, 100
#: Poses that came until then are taken in before a command is due [s].
_EARLY = 0.002
_GO, _QUIT = "g", "q"


@dataclass(frozen=True)
class FlightReport:
    """What a flight was like."""

    #: How long it took [s].
    duration: float
    #: How many periods ended how.
    outcomes: Mapping[str, int]
    #: Jitter and latency.
    timing: LoopTiming
    #: Poses that were used, and messages on their topic that were not.
    poses: int
    refused: int
    #: Events told, by level.
    events: Mapping[str, int]

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        return {
            "duration_s": self.duration,
            "outcomes": dict(self.outcomes),
            **self.timing.to_json(),
            "poses": self.poses,
            "refused": self.refused,
            "events": dict(self.events),
        }


def fly_live(
    make_pilot: Callable[[], Pilot],
    vehicle: Vehicle,
    limits: Limits,
    *,
    period: float = 0.01,
    reference: PlannedSetPoints | FollowedSetPoint | None = None,
    topics: Topics | None = None,
    domain: int | None = None,
    interface: str | None = None,
    duration: float = float("inf"),
    over: Callable[[float], bool] = lambda time: False,
    on_board: bool = False,
    quiet: bool = False,
    name: str = NAME,
    warm_up: bool = True,
) -> FlightReport:
    """Fly a craft on the graph, until SIGINT or SIGTERM."""
    topics = topics or Topics()
    motors = StreamCodec("command", vehicle.propeller_names)
    hurry()
    graph = Graph(name, domain=domain, interface=interface)
    try:
        refuse_second(graph, topics.command, motors, "controller")
        with unhurried():
            pilot = make_pilot()
            if warm_up:
                _warm_up(pilot, period)
        # Somebody else may have begun meanwhile.
        refuse_second(graph, topics.command, motors, "controller")
        with orderly() as ending, keyboard() as keys:
            events = EventLog(graph, name, quiet=quiet)
            flight = _Flight(
                graph, topics, vehicle, limits, period, reference, keys, events, on_board
            )
            return flight.run(pilot, duration, over, ending)
    finally:
        graph.close()


class _Flight:
    """One flight: the guard, the link, and what others are told."""

    def __init__(
        self,
        graph: Graph,
        topics: Topics,
        vehicle: Vehicle,
        limits: Limits,
        period: float,
        reference: PlannedSetPoints | FollowedSetPoint | None,
        keys: Keyboard,
        events: EventLog,
        on_board: bool,
    ) -> None:
        self._graph, self._topics, self._vehicle = graph, topics, vehicle
        self._period, self._keys, self._events = period, keys, events
        self._on_board, self._reference = on_board, reference
        self._followed = reference if isinstance(reference, FollowedSetPoint) else None
        self._clock = Clock()
        self._link = GraphLink(
            graph,
            topics,
            vehicle.propeller_names,
            self._clock,
            events,
            on_board=on_board,
            announces=self._followed is None,
        )
        self._inboxes = list(self._link.inboxes.values())
        if self._followed is not None:
            codec = StreamCodec("reference")
            self._wishes = Inbox(graph, topics.reference, codec, STATE, self._clock, events)
            self._inboxes.append(self._wishes)
        self._guard = Guard(limits)
        self._timing, self._recent = LoopTiming(period), LoopTiming(period)
        self._outcomes: dict[str, int] = {}
        self._beat = 0.0
        self._quit = False

    def run(
        self, pilot: Pilot, duration: float, over: Callable[[float], bool], ending: Ending
    ) -> FlightReport:
        """Fly."""
        guarded = GuardedPilot(
            pilot,
            self._guard,
            self._vehicle.command_min,
            self._vehicle.n_propellers,
            lambda severe, text: self._events.tell("error" if severe else "info", text),
        )
        self._events.tell("info", f"on domain {self._graph.domain}{self._usage()}")
        # What takes long the first time is done before the motors may run; the poses that have
        # come meanwhile are old.
        self._give_way()
        self._look_around("starting")
        settle_memory()
        for inbox in self._inboxes:
            inbox.discard()
        start = self._clock.now
        try:
            for action in control(
                guarded,
                self._link,
                duration,
                self._period,
                on_board=self._on_board,
                early=_EARLY,
            ):
                self._after(action)
                if ending.asked or self._quit or over(action.time):
                    break
        finally:
            self._idle()
        inbox = self._link.inboxes["pose"]
        self._events.tell_held()
        self._events.tell("info", "landed: motors idle")
        return FlightReport(
            self._clock.now - start,
            self._outcomes,
            self._timing,
            inbox.good,
            inbox.bad,
            self._events.counts,
        )

    def _after(self, action: Action) -> None:
        """Do what can wait until the command is sent."""
        done = self._link.sent
        for timing in (self._timing, self._recent):
            timing.add(action.due, done, self._link.newest)
        status = action.step.status
        self._outcomes[status] = self._outcomes.get(status, 0) + 1
        if action.step.estimate is not None:
            self._link.tell_estimate(action.step.estimate.state)
        if self._followed is not None:
            self._follow(self._followed)
        elif isinstance(self._reference, PlannedSetPoints) and action.step.flies:
            self._reference.begin(action.time)
        for key in self._keys.pressed():
            self._obey(key)
        self._give_way()
        if done >= self._beat:
            self._beat = done + _HEARTBEAT
            self._look_around(status)

    def _follow(self, followed: FollowedSetPoint) -> None:
        """Move the set point to where the graph wants it; at first, to where the craft is."""
        if not followed.known and self._guard.position is not None:
            followed.move(self._guard.position)
        for _, wish in self._wishes.take():
            refusal = followed.move(wish)
            if refusal is not None:
                self._events.tell("warning", f"refused: {refusal}", kind="set point")

    def _obey(self, key: str) -> None:
        """Do what the operator says: any key stops."""
        if key == _GO:
            self._guard.release("operator")
        elif key == _QUIT:
            self._quit = True
        else:
            self._guard.stop("operator", "stopped by the operator")

    def _give_way(self) -> None:
        """Leave the motors to another controller, as long as there is one."""
        rivals = self._graph.publishers(self._topics.command)
        if rivals:
            whose = self._graph.describe(rivals[0])
            self._guard.stop("rival", f"another controller is on the graph: {whose}")
        else:
            self._guard.release("rival")

    def _look_around(self, status: str) -> None:
        """Once a second: who cannot be heard, and how the loop fares."""
        for inbox in self._inboxes:
            inbox.tell_strangers()
        warning = self._recent.warning()
        if warning is not None:
            self._events.tell("warning", warning, kind="timing")
        figures = self._recent.to_json()
        figures = {
            name: f"{value['p99']:.2f} (p99)" if isinstance(value, dict) else value
            for name, value in figures.items()
        }
        self._events.heartbeat("warning" if warning else "info", status, figures)
        self._recent = LoopTiming(self._period)

    def _idle(self) -> None:
        """Leave the motors idle, whatever happened."""
        idle = np.full(self._vehicle.n_propellers, self._vehicle.command_min)
        for _ in range(_LAST_COMMANDS):
            self._link.send(idle)
            self._clock.sleep_until(self._clock.now + self._period)

    def _usage(self) -> str:
        """Say which keys do what."""
        if not self._keys.listens:
            return ""
        return f"; any key stops the motors, {_GO} lets them run, {_QUIT} ends"


def _warm_up(pilot: Pilot, period: float) -> None:
    """Fly some steps on the spot before time begins, so that everything is compiled and loaded."""
    pose = np.zeros(3)
    for k in range(-_WARM_UP_STEPS, -_FORGOTTEN_STEPS):
        now = k * period
        pilot.pose(now, pose)
        pilot.sent(now, pilot.step(now).command)
