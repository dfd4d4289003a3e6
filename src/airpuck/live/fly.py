"""Flying on the graph: the loop, the guard around it, the operator's keys, the preflight check."""

from __future__ import annotations

import contextlib
import math
import os
import select
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.numbers import COORDINATE
from airpuck.compute.process import prioritize
from airpuck.control.law import Pilot
from airpuck.control.reference import SetPoint, SetPoints, Target
from airpuck.craft.vehicle import Vehicle
from airpuck.data.measurement import Measurement, MeasurementKind
from airpuck.estimate.estimator import ActuationEstimate
from airpuck.flight.clock import LoopTiming
from airpuck.flight.loop import PREDICTIONS_EVERY, Action, check_pilot, checked_step, control
from airpuck.flight.preflight import Preflight, judge_test
from airpuck.flight.pulses import PulsePlan, PulseTest
from airpuck.live.process import Inbox, Outbox, PlanOutbox, Process
from airpuck.live.safety import Guard, GuardedPilot, SafetyLimits
from airpuck.live.settings import LiveSettings
from airpuck.model.model_file import Model

NAME = "airpuck fly"
#: Number of idle commands at the end, since one may be lost.
LAST_COMMANDS = 5
#: Number of rehearsal steps, and how many of them are skipped so that the pilot forgets the others.
_WARM_UP_STEPS, _FORGOTTEN_STEPS = 150, 100
#: Poses are processed until this long before a command is due [s].
EARLY = 0.002
_GO, _QUIT = "g", "q"
#: In the preflight check the frame and the units may be wrong. The pilot itself ends the test near
#: a rail, and pulses keep their length even if poses jump.
ANYWHERE = SafetyLimits(geofence=(math.inf, math.inf), jump=(math.inf, math.inf))
#: Time for the check to find the graph, and for the guard to accept the poses [s].
_PATIENCE = 3.0


class PlannedSetPoints:
    """Set points whose times [s] count from the craft's first flight; a `Reference`."""

    def __init__(self, points: SetPoints) -> None:
        self._points = points
        self._start: float | None = None

    def begin(self, start: float) -> None:
        """Start the time of the set points; later calls do nothing."""
        if self._start is None:
            self._start = start

    def at(self, now: float, ahead: float) -> Target:
        """Return the set point in force now; see `Reference.at`."""
        return self._points.at(-np.inf if self._start is None else now - self._start, ahead)


class FollowedSetPoint:
    """A set point that others may move while the craft flies; a `Reference`."""

    def __init__(self, geofence: tuple[float, float]) -> None:
        self._geofence = geofence
        #: None until it is first placed.
        self.point: SetPoint | None = None

    def at(self, now: float, ahead: float) -> Target:
        """Return the set point in force now; see `Reference.at`."""
        return (self.point or SetPoint(0.0, 0.0, 0.0)).at(now, ahead)

    def move(self, pose: Float[np.ndarray, " k"]) -> str | None:
        """Move it to x, y, yaw, at rest; return the reason if that is not allowed."""
        if not np.isfinite(pose[:3]).all():
            return "a set point that is not finite"
        x, y, yaw = pose[:3].tolist()
        if abs(yaw) > COORDINATE.high:
            return f"a set point with a yaw of {yaw:.3g} rad"
        if abs(x) > self._geofence[0] or abs(y) > self._geofence[1]:
            return f"a set point outside the geofence, ({x:.2f}, {y:.2f})"
        self.point = SetPoint(x, y, yaw)
        return None


def fly_live(
    make_pilot: Callable[[], Pilot],
    vehicle: Vehicle,
    limits: SafetyLimits,
    settings: LiveSettings | None = None,
    *,
    period: float = 0.01,
    over: Callable[[float], bool] = lambda time: False,
    name: str = NAME,
    warm_up: bool = True,
    spectators: Sequence[Spectator] = (),
) -> dict[str, Any]:
    """Fly a craft on the graph until the time is over, SIGINT or SIGTERM.

    Parameters
    ----------
    make_pilot : callable
        Makes the pilot; called once no other controller is on the graph.
    vehicle : Vehicle
        The craft.
    limits : SafetyLimits
        Limits enforced by the guard.
    settings : LiveSettings, optional
        How to join the graph, and for how long.
    period : float, default 0.01
        Time between commands [s].
    over : callable, optional
        Maps the time of a command [s] to whether the flight is over.
    name : str, default "airpuck fly"
        Name of the process for others.
    warm_up : bool, default True
        Whether to rehearse some steps, so that everything is compiled.
    spectators : sequence of Spectator, optional
        Spectators of measurements and actions, in order.

    Returns
    -------
    dict
        Results for ``--json``.

    Raises
    ------
    InputError
        If the graph cannot be joined, or another process publishes commands.
    """
    prioritize(first=True)
    with Process(name, settings or LiveSettings()) as process:
        process.refuse_second("command", vehicle.columns, "controller")
        # Other processes on the graph must not wait for the compiler.
        prioritize(first=False)
        pilot = make_pilot()
        check_pilot(pilot)
        if warm_up:
            rehearse_steps(pilot, vehicle.idle, period)
        prioritize(first=True)
        # Another controller may have started meanwhile.
        process.refuse_second("command", vehicle.columns, "controller")
        for spectator in spectators:
            spectator.begin(process, pilot)
        flight = _Flight(process, pilot, vehicle, limits, period, spectators)
        with keyboard() as flight.pressed:
            return flight.run(over)


def preflight_live(
    model: Model, plan: PulsePlan | None = None, settings: LiveSettings | None = None
) -> Preflight:
    """Give each motor of a craft on the graph short pulses, and judge the response."""
    pilot = PulseTest(model.vehicle, plan)
    settings = replace(settings or LiveSettings(), duration=pilot.duration + _PATIENCE)
    fly_live(
        lambda: pilot,
        model.vehicle,
        ANYWHERE,
        settings,
        over=lambda time: pilot.over or (not pilot.poses and time > _PATIENCE),
        name="airpuck preflight",
        warm_up=False,
    )
    return judge_test(pilot, model)


class Spectator:
    """Observes a flight while it runs; it must not delay the loop. The base does nothing."""

    def begin(self, process: Process, pilot: Pilot) -> None:
        """Receive the flight's participants, before time begins."""

    def measured(self, measurement: Measurement) -> None:
        """Receive a pose of the craft or another body."""

    def after(self, action: Action) -> None:
        """Run once a period, after its command was sent."""

    def to_json(self) -> dict[str, Any]:
        """Return results for ``--json``."""
        return {}


class GraphLink:
    """Poses from the graph, of the craft and others; commands to the graph; a `Link`."""

    def __init__(
        self,
        process: Process,
        motors: tuple[str, ...],
        *,
        announces: bool,
        others: Sequence[MeasurementKind] = (),
        spectators: Sequence[Spectator] = (),
    ) -> None:
        self._clock = process.clock
        self.poses = Inbox(process, "pose")
        self.others: dict[MeasurementKind, Inbox] = {kind: Inbox(process, kind) for kind in others}
        self.commands = Outbox(process, "command", motors)
        self._references = Outbox(process, "reference") if announces else None
        self._spectators = spectators
        #: Time at which the newest pose was measured [s].
        self.newest: float | None = None

    @property
    def now(self) -> float:
        """The current time, on this process's clock [s]."""
        return self._clock.now

    def wait_until(self, time: float) -> list[Measurement]:
        """Sleep, then process new messages; see `airpuck.flight.loop.Link`."""
        self._clock.sleep_until(time)
        arrived = [Measurement("pose", stamp, pose) for stamp, pose in self.poses.take()]
        if arrived:
            self.newest = arrived[-1].stamp
        for kind, inbox in self.others.items():
            arrived += [Measurement(kind, stamp, pose) for stamp, pose in inbox.take()]
        for spectator in self._spectators:
            for measurement in arrived:
                spectator.measured(measurement)
        if self._references is not None:
            self._references.remind()
        return arrived

    def send(self, command: Float[np.ndarray, " n"]) -> None:
        """Publish a command; see `airpuck.flight.loop.Link`."""
        self.commands.send(command)

    def announce(self, reference: Float[np.ndarray, " 6"]) -> None:
        """Publish the reference; see `airpuck.flight.loop.Link`."""
        if self._references is not None:
            self._references.send(reference)


class _Flight:
    """One flight: the guard, the link, and reports to others."""

    #: Reads pressed keys; None without a terminal.
    pressed: Callable[[], str] | None = None

    def __init__(
        self,
        process: Process,
        pilot: Pilot,
        vehicle: Vehicle,
        limits: SafetyLimits,
        period: float,
        spectators: Sequence[Spectator] = (),
    ) -> None:
        self._process, self._period, self._reference = process, period, pilot.reference
        follows = isinstance(self._reference, FollowedSetPoint)
        self._wishes = Inbox(process, "reference") if follows else None
        self._link = GraphLink(
            process,
            vehicle.columns,
            announces=not follows,
            others=pilot.watches,
            spectators=spectators,
        )
        self._spectators = spectators
        self._inboxes = [self._link.poses, *self._link.others.values()]
        self._inboxes += [self._wishes] if self._wishes else []
        self._estimates, self._plans = Outbox(process, "estimate"), PlanOutbox(process)
        self._until_plan = 0
        self._propellers = vehicle.propeller_names
        #: What the estimator last found about the motors.
        self._actuation: ActuationEstimate | None = None
        self._guard = Guard(limits)
        self._idle, lowest = vehicle.idle, vehicle.command_range[0]
        self._pilot = GuardedPilot(pilot, self._guard, lowest, process.events.log)
        self._timing, self._recent = LoopTiming(period), LoopTiming(period)
        self._outcomes: Counter[str] = Counter()
        self._quit = False

    def run(self, over: Callable[[float], bool]) -> dict[str, Any]:
        """Fly; return results for ``--json``."""
        process, link = self._process, self._link
        usage = f"; any key stops the motors, {_GO} lets them run, {_QUIT} ends"
        process.start(usage if self.pressed else "")
        # Slow first-time work is done before the motors may run; poses that arrived meanwhile are
        # stale.
        self._give_way()
        self._report("starting")
        for inbox in self._inboxes:
            inbox.discard()
        start = link.now
        duration = process.settings.duration or math.inf
        try:
            for action in control(self._pilot, link, duration, self._period, early=EARLY):
                self._after(action)
                if process.interrupted or self._quit or over(action.time):
                    break
        finally:
            for _ in range(LAST_COMMANDS):
                link.send(self._idle)
                process.clock.sleep_until(link.now + self._period)
        process.events.log("info", "landed: motors idle")
        return {
            "duration_s": link.now - start,
            "outcomes": dict(self._outcomes),
            **self._timing.to_json(),
            "poses": link.poses.good,
            "refused": link.poses.bad,
            "events": process.events.counts,
            **{k: v for spectator in self._spectators for k, v in spectator.to_json().items()},
        }

    def _after(self, action: Action) -> None:
        """Do work that can wait until the command is sent."""
        done, step = self._link.commands.sent, action.step
        for timing in (self._timing, self._recent):
            timing.add(action.due, done, self._link.newest)
        self._outcomes[step.status] += 1
        if step.estimate is not None:
            self._estimates.send(step.estimate.state)
            self._actuation = step.estimate.actuation
        if step.prediction is not None:
            self._until_plan = (self._until_plan or PREDICTIONS_EVERY) - 1
            if not self._until_plan:
                self._plans.send(step)
        if isinstance(self._reference, PlannedSetPoints) and step.flies:
            self._reference.begin(action.time)
        self._follow_wishes()
        for spectator in self._spectators:
            spectator.after(action)
        for key in self.pressed() if self.pressed else "":
            self._obey(key)
        self._give_way()
        if self._process.beat.begins(done):
            self._report(step.status)

    def _follow_wishes(self) -> None:
        """Move the set point to the target on the graph; initially to the craft's position."""
        followed = self._reference
        if self._wishes is None or not isinstance(followed, FollowedSetPoint):
            return
        if followed.point is None and self._guard.position is not None:
            followed.move(self._guard.position)
        for _, wish in self._wishes.take():
            refusal = followed.move(wish)
            if refusal is not None:
                self._process.events.log("warning", f"refused: {refusal}", kind="set point")

    def _obey(self, key: str) -> None:
        """Act on the operator's keys: any other key stops the motors."""
        if key == _GO:
            self._guard.release("operator")
        elif key == _QUIT:
            self._quit = True
        else:
            self._guard.stop("operator", "stopped by the operator")

    def _give_way(self) -> None:
        """Leave the motors to another controller while there is one."""
        graph = self._process.graph
        rivals = graph.publishers(self._process.topics.command)
        if rivals:
            whose = graph.describe(rivals[0])
            self._guard.stop("rival", f"another controller is on the graph: {whose}")
        else:
            self._guard.release("rival")

    def _report(self, status: str) -> None:
        """Report publishers with unreadable types, and the loop's timing; once a second."""
        for inbox in self._inboxes:
            inbox.report_strangers()
        warning = self._recent.warning()
        if warning is not None:
            self._process.events.log("warning", warning, kind="timing")
        figures = {
            name: f"{value['p99']:.2f} (p99)" if isinstance(value, dict) else value
            for name, value in self._recent.to_json().items()
        }
        if self._actuation is not None:
            figures |= self._actuation.figures(self._propellers)
        self._process.events.heartbeat("warning" if warning else "info", status, figures)
        self._recent = LoopTiming(self._period)


def rehearse_steps(pilot: Pilot, idle: Float[np.ndarray, " n"], period: float) -> None:
    """Rehearse steps with the craft at rest before time starts, so that all is compiled.

    The motors idle: otherwise a pilot that learns would take them for dead, since the craft does
    not move.
    """
    pose = np.zeros(3)
    for k in range(-_WARM_UP_STEPS, -_FORGOTTEN_STEPS):
        now = k * period
        pilot.measured(Measurement("pose", now, pose))
        checked_step(pilot, pilot.step(now))
        pilot.sent(now, idle)


@contextlib.contextmanager
def keyboard() -> Iterator[Callable[[], str] | None]:
    """Read single key presses; yield a reader, or None without a terminal."""
    # A process in the background would be stopped for reading.
    if not sys.stdin or not sys.stdin.isatty() or os.tcgetpgrp(0) != os.getpgrp():
        yield None
        return
    import termios
    import tty

    file = sys.stdin.fileno()

    def pressed() -> str:
        try:
            ready, _, _ = select.select([file], [], [], 0)
            return os.read(file, 64).decode(errors="replace") if ready else ""
        except OSError:  # the terminal is gone
            return ""

    before = termios.tcgetattr(file)
    try:
        tty.setcbreak(file)
        yield pressed
    finally:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(file, termios.TCSADRAIN, before)
