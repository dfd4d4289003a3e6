"""Guarded flights of one craft on one link, each kept as a recording."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Finding, Result
from airpuck.control.law import Pilot
from airpuck.control.pose_gate import BLIND
from airpuck.control.reference import SetPoint
from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.data.measurement import Measurement
from airpuck.flight.loop import Action, Link, control
from airpuck.judgement.study import Study
from airpuck.live.fly import LAST_COMMANDS
from airpuck.live.safety import Guard, GuardedPilot, SafetyLimits, within_rails
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.uncertainty import Cameras
from airpuck.physics.rigid_body import pose_difference
from airpuck.recording.stream import COLUMNS, Recording
from airpuck.twin.sensors import log_stream

#: Without a pose for this long the run ends [s].
_NO_POSE = 1.0
#: Time over which velocities are measured [s].
_LOOK = 0.1
#: Time between looks at what has arrived [s].
_POLL = 0.02
#: How much of the log is replayed to a new pilot [s].
_MOMENTS = 0.4
#: A command this far above idle counts as motors on.
_ON = 1e-3


class Ended(Exception):
    """The run cannot continue; `finding` names the cause and what a person has to do."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.sentence)
        self.finding = finding


class Work:
    """Runs a long computation while the craft flies.

    For the twin: computes at once, and lets the computing time pass on the link's clock. Counts
    processor time, so that other programs do not lengthen the flight.
    """

    def start(self, now: float, function: Callable[..., Any], *arguments: Any) -> None:
        """Start a computation at a time of the link [s]."""
        begun = time.process_time()
        self._found = function(*arguments)
        self._until = now + time.process_time() - begun

    def done(self, now: float) -> bool:
        """Return whether it is done at a time of the link [s]."""
        return now >= self._until

    def result(self) -> Any:
        """Return its result."""
        return self._found


@dataclass(frozen=True, eq=False)
class KeptFlight:
    """A flight of the run."""

    name: str
    recording: Recording
    #: Time of its start and its end, from the start of the run [s].
    span: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Learned(Result):
    """What is known after a step."""

    JSON = "step result=words time_s=time flight_s"

    step: str
    #: The step's result in one line.
    words: str
    #: Time since the start of the run, and flight time so far [s].
    time: float
    flight_s: float
    #: The model, if one was identified.
    model: Model | None = None


class _LoggedLink:
    """A link whose poses and commands are kept; a `Link`."""

    def __init__(self, link: Link, vehicle: Vehicle) -> None:
        self._link, self._vehicle = link, vehicle
        self.border = getattr(link, "border", None)
        self.heard = self._last = link.now
        #: Seconds with motors on.
        self.flight_s, self._runs = 0.0, False
        self.clear()

    def clear(self) -> None:
        """Begin a new recording."""
        #: Stamps, poses and commands of the present flight.
        self.poses: list[tuple[float, Any]] = []
        self.commands: list[tuple[float, Any]] = []
        self._wanted: list[tuple[float, Any]] = []

    @property
    def now(self) -> float:
        """The link's time [s]."""
        return self._link.now

    def wait_until(self, time: float) -> list[Measurement]:
        """Let time pass; see `Link`."""
        arrived = self._link.wait_until(time)
        for one in arrived:
            # A logger faster than the cameras repeats poses.
            if one.kind == "pose" and (not self.poses or one.stamp != self.poses[-1][0]):
                self.poses.append((one.stamp, one.values))
                self.heard = self._link.now
        return arrived

    def send(self, command: Float[np.ndarray, " n"]) -> None:
        """Send a command; see `Link`."""
        now = self._link.now
        self.flight_s += (now - self._last) * self._runs
        self._last, self._runs = now, bool((np.abs(command) > self._vehicle.idle + _ON).any())
        self._link.send(command)
        self.commands.append((now, np.array(command, dtype=float)))

    def announce(self, reference: Float[np.ndarray, " 6"]) -> None:
        """Announce the reference; see `Link`."""
        self._link.announce(reference)
        self._wanted.append((self._link.now, np.array(reference)))

    def recording(self, source: str) -> Recording:
        """Return what was logged; the stamps are on the controller's clock."""
        logs = {"pose": self.poses, "command": self.commands, "reference": self._wanted}
        columns = {**COLUMNS, "command": self._vehicle.columns}
        streams = {k: log_stream(log, columns[k], latency=0.0) for k, log in logs.items() if log}
        return Recording(streams, source)


@dataclass(eq=False)
class Commissioned:
    """One craft on one link: what is known of it, its guard, and its flights.

    Attributes
    ----------
    vehicle : Vehicle
        The craft as now believed; steps correct it.
    table : Table
        The table with its rails.
    seed : int
        Seed of the excitations.
    cameras : Cameras or None
        Rate and noise of the poses, once they are known.
    late : float
        Largest sum of lag and delay that pulses leave likely [s].
    slope : array, shape (2,)
        Acceleration of the resting craft along x and y [m/s²].
    study : Study or None
        The last study.
    flights : list of KeptFlight
        All flights so far.
    learned : list of Learned
        What each step found.
    findings : list of Finding
        What was wrong and has been corrected.
    """

    link: Link
    vehicle: Vehicle
    table: Table
    seed: int
    tell: Callable[[str], object]
    stopped: Callable[[], bool]
    work: Work
    early: float
    cameras: Cameras | None = None
    late: float = 0.0
    slope: Float[np.ndarray, " 2"] = field(default_factory=lambda: np.zeros(2))
    study: Study | None = None
    flights: list[KeptFlight] = field(default_factory=list)
    learned: list[Learned] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._log = _LoggedLink(self.link, self.vehicle)
        self._start = self.link.now
        fence = within_rails(self.table, self.vehicle.radius_m)
        # The pilots stop sooner unless the craft moves.
        self._guard = Guard(SafetyLimits(geofence=fence, pose_timeout=BLIND))
        #: The last pose.
        self.position: Float[np.ndarray, " 3"] | None = None

    @property
    def model(self) -> Model:
        """The best model at hand: the identified one, otherwise the nominal one."""
        if self.study is not None:
            return self.study.model
        return replace(nominal_model(self.vehicle), cameras=self.cameras)

    @property
    def flight_s(self) -> float:
        """Seconds flown with motors on."""
        return self._log.flight_s

    @property
    def here(self) -> SetPoint:
        """The middle of the table, with the craft's present yaw."""
        return SetPoint(0.0, 0.0, 0.0 if self.position is None else float(self.position[2]))

    @property
    def poses(self) -> list[tuple[float, Float[np.ndarray, " 3"]]]:
        """Stamps and poses of the present or the last flight [s, (m, m, rad)]."""
        return self._log.poses

    @property
    def motion(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]] | None:
        """Last pose and the velocity until then [m/s, m/s, rad/s]; None until it is known."""
        log = self._log.poses
        for stamp, pose in reversed(log):
            if (passed := log[-1][0] - stamp) >= _LOOK:
                return log[-1][1], pose_difference(np, log[-1][1], pose) / passed
        return None

    def fly(
        self,
        name: str,
        pilot: Pilot,
        duration: float,
        *,
        until: Callable[[float], bool] = lambda _: False,
        guarded: bool = True,
    ) -> Recording:
        """Fly a pilot behind the guard, keep the recording and return it.

        Raises
        ------
        Ended
            If the operator stops it, or poses stop coming.
        """
        self._log.clear()
        begun, judged = self.link.now, 0
        lowest = self.vehicle.command_range[0]
        flown = GuardedPilot(pilot, self._guard, lowest, lambda *_: None) if guarded else pilot
        try:
            for action in control(flown, self._log, duration, early=self.early):
                for pose in self._log.poses[judged:] if not guarded else ():
                    self._guard.pose(*pose)  # So that the next flight starts at once.
                judged = len(self._log.poses)
                self._watch(action)
                if until(action.time):
                    break
        finally:
            name = f"{len(self.flights) + 1:02d}_{name}"
            span, log = (begun - self._start, self.link.now - self._start), self._log
            self.flights.append(KeptFlight(name, log.recording(name), span))
            # On the graph the next pilot takes a moment to make.
            log.send(self.vehicle.idle)
        return self.flights[-1].recording

    def brief(self, pilot: Pilot) -> None:
        """Replay the last poses and commands to a new pilot, so that it knows the speed at once."""
        since = self.link.now - _MOMENTS
        seen = [(stamp, pilot.pose, pose) for stamp, pose in self._log.poses if stamp > since]
        sent = [(stamp, pilot.sent, one) for stamp, one in self._log.commands if stamp > since]
        for stamp, told, values in sorted([*seen, *sent], key=lambda one: one[0]):
            told(stamp, values)

    def listen(self, duration: float, enough: float = math.inf) -> list[float]:
        """Listen for a time, or until enough poses have come; return their stamps."""
        self._log.clear()
        until = self.link.now + duration
        while self.link.now < until and len(self._log.poses) < enough:
            # A pose that waits too long in the link counts as late.
            self._log.wait_until(min(self.link.now + _POLL, until))
            self.check_operator()
        return [stamp for stamp, _ in self._log.poses]

    def land(self) -> None:
        """Let the motors idle."""
        # One may be lost.
        for _ in range(LAST_COMMANDS):
            self._log.send(self.vehicle.idle)
            self._log.wait_until(self.link.now + 0.01)

    def note(self, step: str, words: str, model: Model | None = None) -> None:
        """Note what a step found, and tell it."""
        now = self.link.now - self._start
        self.learned.append(Learned(step, words, now, self.flight_s, model))
        self.tell(f"{now:6.1f} s  {step}: {words}")

    def check_operator(self) -> None:
        """End the run if the operator demands it."""
        if self.stopped():
            raise Ended(Finding("control", "Stopped by the operator", "", "Start again."))

    def _watch(self, action: Action) -> None:
        """End the run if the operator or the cameras demand it."""
        self.position = self._log.poses[-1][1] if self._log.poses else self.position
        self.check_operator()
        silent = action.time - self._log.heard
        if silent > _NO_POSE:
            cause = f"No pose has arrived for {silent:.1f} s"
            remedy = "Check that the motion capture sends the craft's pose, and start again."
            raise Ended(Finding("poses", cause, "", remedy))
