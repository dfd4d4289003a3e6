"""One craft of a fleet on the graph: messages of the others, their poses, and a common start."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from airpuck.boundary.results import Result
from airpuck.control.law import Pilot
from airpuck.control.pose_gate import longest_pause
from airpuck.fleet.agreement import SILENT, Letter, Message, digest, on_clock
from airpuck.fleet.pilot import FleetPilot, Sighting, sighted
from airpuck.fleet.scenario import Fleet
from airpuck.flight.loop import Action
from airpuck.live.fly import Spectator, fly_live
from airpuck.live.graph import SENSOR
from airpuck.live.process import Inbox, MessageOutbox, MessageTopic, Process, well_formed
from airpuck.live.safety import SafetyLimits, within_rails
from airpuck.live.settings import LiveSettings
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.mapping import Topics

#: Topic of messages in the namespace of their sender.
TOPIC = "fleet/message"
#: Time from when all are ready to the start [s]; the announcement reaches all craft meanwhile.
_NOTICE = 1.0
#: A craft is ready once it has flown this close to its start [m] for this time without a break [s].
_AT_START, _STEADY = 0.05, 0.5


class FleetOnGraph(Result, Spectator):
    """Connects the pilot of a craft with the others; a `airpuck.live.fly.Spectator`.

    The first craft of the scenario says when the flight begins, once all are ready at their starts.
    """

    JSON = "start_s=_start messages=_heard"

    def __init__(self, fleet: Fleet, name: str, topics: Topics) -> None:
        self._fleet, self._name, self._topics = fleet, name, topics
        self._others = [other for other in fleet.names if other != name]
        self._opening = digest(fleet.opening)
        #: Flies the craft.
        self.pilot = FleetPilot(fleet, name, self._tell, seed=fleet.names.index(name), start=None)
        self._letters: dict[str, tuple[float, Letter]] = {}
        self._seen: dict[str, Sighting] = {}
        self._start: float | None = None
        #: Since when it has flown at its start [s], if it does.
        self._steady = math.inf
        self._ready, self._heard = False, 0

    def begin(self, process: Process, pilot: Pilot) -> None:
        """Join the topics of all craft; see `airpuck.live.fly.Spectator`."""
        self._events, self._clock = process.events, process.clock
        self._outbox = MessageOutbox(process.graph, _topic_of(self._name))
        self._arriving = {
            name: well_formed(process.graph, _topic_of(name)) for name in self._others
        }
        self._poses = {
            name: Inbox(process.with_topics(self._topics.within(name)), "pose", quiet=True)
            for name in self._others
        }

    def after(self, action: Action) -> None:
        """Receive what has arrived; see `airpuck.live.fly.Spectator`."""
        now = self._clock.now
        for name, inbox in self._poses.items():
            for stamp, pose in inbox.take():
                if np.isfinite(pose).all():
                    self._seen[name] = sighted(self._seen.get(name), stamp, pose)
        self.pilot.saw(self._seen)
        read = (
            self._read(name, one.data) for name in self._others for one in self._arriving[name]()
        )
        letters = [letter for letter in read if letter is not None]
        for letter in letters:
            self._letters[letter.message.sender] = now, letter
        if self._start is None:
            estimate, start = action.step.estimate, self.pilot.member.start.pose
            there = estimate is not None and math.dist(estimate.state[:2], start[:2]) < _AT_START
            self._steady = min(self._steady, now) if action.step.flies and there else math.inf
            self._ready = now - self._steady >= _STEADY
            self._await(now)
        epoch_ns = self._clock.stamp_ns(0.0)
        heard = [on_clock(one.message, (one.epoch_ns - epoch_ns) / SECOND_NS) for one in letters]
        self.pilot.heard(heard, now)

    def _read(self, sender: str, text: str) -> Letter | None:
        """Read a message; None for garbage."""
        try:
            letter = Letter.read(text)
            if letter.message.sender != sender:
                raise ValueError(f"it says that it is from {letter.message.sender!r}")
        except ValueError as error:
            self._events.log("warning", f"rejected message from {sender}: {error}", kind="message")
            return None
        self._heard += 1
        return letter

    def _await(self, now: float) -> None:
        """Begin when the others do, or when all are ready."""
        epoch_ns = self._clock.stamp_ns(0.0)
        known = [one.start_ns for _, one in self._letters.values() if one.start_ns is not None]
        if known:
            start = (known[0] - epoch_ns) / SECOND_NS
            if start > now:
                self._begin(start)
            else:
                self._events.log("error", "the others have begun without this craft", kind="start")
            return
        waits = [] if self._ready else [self._name]
        for name in self._others:
            heard, letter = self._letters.get(name, (-math.inf, None))
            if letter is None or now - heard > SILENT or not letter.ready:
                waits.append(name)
            elif letter.opening != self._opening:
                text = f"{name} computes other paths: use the same scenario, models and version"
                self._events.log("error", text)
                waits.append(name)
        if waits:
            self._events.log("info", f"waits for {', '.join(waits)}", kind="waits")
        elif self._name == self._fleet.names[0]:
            self._begin(now + _NOTICE)

    def _begin(self, start: float) -> None:
        """Let the flight begin at a time [s]."""
        self._start = start
        self.pilot.begin(start)
        self._events.log("info", f"all are ready, begins in {start - self._clock.now:.1f} s")

    def _tell(self, message: Message) -> None:
        """Send a message to the others."""
        start_ns = None if self._start is None else self._clock.stamp_ns(self._start)
        letter = Letter(message, self._clock.stamp_ns(0.0), start_ns, self._ready, self._opening)
        self._outbox.send(self._outbox.make(data=letter.text()))


def _topic_of(name: str) -> MessageTopic:
    return MessageTopic(f"/{name}/{TOPIC}", "std_msgs/msg/String", SENSOR)


def fly_in_fleet(fleet: Fleet, name: str, settings: LiveSettings | None = None) -> dict[str, Any]:
    """Fly one craft of a fleet on the graph until the time is over, SIGINT or SIGTERM.

    Parameters
    ----------
    fleet : Fleet
        The scenario.
    name : str
        The craft; its topics are in the namespace of this name.
    settings : LiveSettings, optional
        How to join the graph, and for how long.

    Returns
    -------
    dict
        Results for ``--json``.

    Raises
    ------
    InputError
        If the scenario has no such craft, the graph cannot be joined, or another process publishes
        the craft's commands.
    """
    member, settings = fleet.member(name), settings or LiveSettings()
    topics = settings.topics or Topics()
    link = FleetOnGraph(fleet, name, topics)
    fence = within_rails(fleet.settings.table, member.reach.radius)
    pause = longest_pause(member.model, member.tuning)
    return fly_live(
        lambda: link.pilot,
        member.model.vehicle,
        SafetyLimits(geofence=fence, pose_timeout=pause),
        replace(settings, topics=topics.within(name)),
        period=member.tuning.period_s,
        name=f"airpuck fly {name}",
        spectators=[link],
    )
