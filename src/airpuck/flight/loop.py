"""The flight loop, used for both the twin and the real table, and checks of users' pilots."""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.boundary.arguments import numbers_of
from airpuck.boundary.errors import InputError
from airpuck.boundary.extensions import UserCode
from airpuck.boundary.signals import Progress
from airpuck.control.law import Law, Pilot, Prediction, Status, Step
from airpuck.control.laws import check_law
from airpuck.control.reference import Reference, asked, check_inside, sheltered
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.data.measurement import Measurement, MeasurementKind
from airpuck.estimate.estimator import Estimate
from airpuck.flight.track import SetPointResult, Track
from airpuck.model.model_file import Model
from airpuck.recording.stream import Recording

#: Number of steps between predictions that are stored or published.
PREDICTIONS_EVERY = 10


@runtime_checkable
class Link(Protocol):
    """A connection to a craft, simulated or real."""

    @property
    def now(self) -> float:
        """The current time, on the controller's clock [s]."""
        ...

    def wait_until(self, time: float) -> list[Measurement]:
        """Let time pass.

        Parameters
        ----------
        time : float
            When to return [s].

        Returns
        -------
        list of Measurement
            Measurements that have arrived since the last call, in order of arrival.
        """
        ...

    def send(self, command: Float[np.ndarray, " n"]) -> None:
        """Send a command now.

        Parameters
        ----------
        command : array, shape (n,)
            Motor commands.
        """

    def announce(self, reference: Float[np.ndarray, " 6"]) -> None:
        """Publish the current reference.

        Parameters
        ----------
        reference : array, shape (6,)
            x, y, yaw and their rates.
        """


@dataclass(frozen=True, eq=False, repr=False)
class FlightLog:
    """Commands of a flight and outcomes of the control steps.

    Examples
    --------
    >>> log = airpuck.track(model, airpuck.SetPoint(0.1, 0.0, 0.0), duration=2.0)
    >>> isinstance(log, airpuck.FlightLog)
    True
    >>> [result] = log.metrics()
    >>> bool(result.settling_time < 1.0)
    True
    """

    #: Time at which each command was sent [s].
    time: Float[np.ndarray, " K"]
    #: Motor commands.
    command: Float[np.ndarray, "K n"]
    #: Outcome of each step.
    status: tuple[Status, ...]
    #: Desired pose.
    reference: Float[np.ndarray, "K 3"]
    #: The pilot's computing time for each step [s].
    took: Float[np.ndarray, " K"]
    #: Predictions of a predictive law, by step number; every tenth step.
    predictions: Mapping[int, Prediction]
    #: Problems that did not prevent the flight.
    warnings: tuple[str, ...] = ()
    #: What a recorder on the network logged, with the craft; None without a recorder.
    recorded: Recording | None = None
    vehicle: Vehicle | None = None

    def __repr__(self) -> str:
        worst = 1e3 * float(np.max(self.took, initial=0.0))
        inexact = sum(status not in ("exact", "optimal") for status in self.status)
        lasting = float(np.ptp(self.time)) if len(self.time) else 0.0
        return (
            f"FlightLog({len(self.time)} commands in {lasting:.1f} s, {inexact} inexact; "
            f"steps took at most {worst:.1f} ms)"
        )

    def __iter__(self) -> NoReturn:
        problem = "track returns one object now: log = airpuck.track(…), then log.recording"
        raise InputError(problem)

    @property
    def recording(self) -> Recording:
        """What a recorder on the network logged; InputError without a recorder."""
        if self.recorded is None:
            problem = "this flight was not recorded; a twin has its own, twin.recording()"
            raise InputError(f"{problem}, and airpuck.track returns one with the log")
        return self.recorded

    def metrics(self) -> list[SetPointResult]:
        """Measure how the craft reached each set point.

        Returns
        -------
        list of SetPointResult
            Settling time [s], overshoot and error at the end [m, m, rad], and effort. Empty for a
            path, which has no set points to settle at.

        Raises
        ------
        InputError
            If the flight was not recorded.
        """
        return Track.of(self.recording, self.vehicle or default_vehicle(), "").results()


@dataclass(frozen=True, eq=False)
class Action:
    """One period of a flight."""

    #: Scheduled start [s].
    due: float
    #: Time for which its command was computed [s].
    time: float
    #: The command, with its status.
    step: Step
    #: The current reference: x, y, yaw and their rates.
    reference: Float[np.ndarray, " 6"]
    #: The pilot's computing time [s].
    took: float


def fly(
    pilot: Pilot, link: Link, duration: float, period: float = 0.01, *, on_board: bool = False
) -> FlightLog:
    """Fly for a given time.

    In each period the loop takes new measurements, computes a command and sends it. It announces
    the reference when that changes.

    Parameters
    ----------
    pilot : Pilot
        Computes the commands.
    link : Link
        The craft.
    duration : float
        Duration [s].
    period : float, default 0.01
        Time between commands [s].
    on_board : bool, default False
        Whether the pilot gets the measurements of the on-board sensors.

    Returns
    -------
    FlightLog
        The sent commands and their status.

    Raises
    ------
    InputError
        If the pilot lacks a method, its command is not one finite number for each motor within the
        motor's range, its reference gives no finite numbers, or leads beyond the rails of a link
        that has rails; or if the duration is shorter than a period.

    Examples
    --------
    >>> controller = airpuck.TrackingController(model, airpuck.SetPoint(0.2, 0.0, 0.0))
    >>> log = airpuck.fly(controller, airpuck.Twin(model), duration=0.5)
    >>> log.command.shape
    (50, 6)
    """
    check_pilot(pilot)
    if not 0 < period <= duration:
        problem = f"must be above 0 and at most the duration, {duration:g} s, but is {period:g} s"
        raise InputError(problem, field="period")
    border = getattr(link, "border", None)
    if border is not None:
        check_inside(pilot.reference, border, "the table")
    start = link.now
    actions = list(
        _with_progress(control(pilot, link, duration, period, on_board=on_board), link, duration)
    )
    link.wait_until(start + duration)
    command = np.array([action.step.command for action in actions])
    return FlightLog(
        time=np.array([action.time for action in actions]),
        command=command,
        warnings=_clipped(pilot, link, command),
        status=tuple(action.step.status for action in actions),
        reference=np.array([action.reference[:3] for action in actions]),
        took=np.array([action.took for action in actions]),
        predictions={
            k: action.step.prediction
            for k, action in enumerate(actions)
            if k % PREDICTIONS_EVERY == 0 and action.step.prediction is not None
        },
    )


def _with_progress(actions: Iterator[Action], link: Link, duration: float) -> Iterator[Action]:
    """Yield all actions; report the time left if the flight is slower than real time."""
    start, progress = link.now, None
    for action in actions:
        yield action
        progress = progress or Progress()  # the first step compiles
        flown, took = action.time - start, time.monotonic() - progress.began
        if 0 < flown < took:
            left = took * (duration / flown - 1)
            progress(f"flown {flown:.1f} of {duration:g} s, about {left:.0f} s left")


def control(
    pilot: Pilot,
    link: Link,
    duration: float,
    period: float = 0.01,
    *,
    on_board: bool = False,
    early: float = 0.0,
) -> Iterator[Action]:
    """Act once per period; `fly` without a log.

    The times at which an action is due are fixed at the start: a late one does not delay the
    following ones. Periods that became due meanwhile are skipped.
    """
    check_pilot(pilot)
    start, announced = link.now, np.full(6, np.nan)
    told = {"pose", *pilot.watches, *(("imu", "mouse") if on_board else ())}
    count = math.inf if math.isinf(duration) else round(duration / period)
    k = 0
    while k < count:
        due = start + k * period
        ahead = early > 0 and due - early > link.now
        for moment in (due - early, due) if ahead else (due,):
            for measurement in link.wait_until(moment):
                if measurement.kind in told:
                    pilot.measured(measurement)
        now = link.now
        wanted = _wanted(pilot, now)
        if not np.array_equal(wanted, announced):
            _check_target(pilot, wanted)
            link.announce(wanted)
            announced = wanted
        began = time.perf_counter()
        step = checked_step(pilot, pilot.step(now))
        took = time.perf_counter() - began
        try:
            link.send(step.command)
        except InputError as error:
            problem = f"step() at {now:.2f} s: its command {error.problem}"
            raise InputError(problem, field=called(pilot)) from error
        pilot.sent(now, step.command)
        yield Action(due, now, step, wanted, took)
        k = max(k + 1, math.floor((link.now - start) / period))


def _clipped(pilot: Pilot, link: Link, command: Float[np.ndarray, "K n"]) -> tuple[str, ...]:
    """Return a warning if commands were outside the range of a link that states its range."""
    span = getattr(link, "command_range", None)
    if span is None or not ((command < span[0]) | (command > span[1])).any():
        return ()
    low, high = command.min(), command.max()
    limits = f"[{span[0].min():g}, {span[1].max():g}]"
    return (f"commands of {called(pilot)} from {low:.3g} to {high:.3g} were clipped to {limits}",)


def _wanted(pilot: Pilot, now: float) -> Float[np.ndarray, " 6"]:
    """Return the desired state now; raise InputError if the pilot has no reference any more."""
    try:
        return asked(pilot.reference, now)
    except AttributeError:
        check_pilot(pilot)
        raise


def _check_target(pilot: Pilot, wanted: Float[np.ndarray, " 6"]) -> None:
    """Raise InputError that names the pilot if its reference does not give a state."""
    try:
        numbers_of(wanted, (6,), "reference")
    except InputError as error:
        raise InputError(f"its reference {error.problem}", field=called(pilot)) from None


#: Methods of a pilot, and the number of arguments of each.
_METHODS = {"measured": 1, "step": 1, "sent": 2}


def called(pilot: Any) -> str:
    """Return the name of a pilot in messages."""
    return getattr(pilot, "called", f"pilot {type(pilot).__name__}")


def check_pilot(pilot: Any) -> None:
    """Raise InputError if an object is not a pilot, naming what it lacks."""
    reference = getattr(pilot, "reference", None)
    if not isinstance(reference, Reference):
        raise InputError(
            "must have a `reference`, such as airpuck.SetPoint(0, 0, 0); inherit from "
            "airpuck.Pilot for a default",
            field=called(pilot),
        )
    watches = getattr(pilot, "watches", None)
    if not isinstance(watches, tuple) or not set(watches) <= set(get_args(MeasurementKind)):
        raise InputError(
            'must have `watches`, a tuple such as ("puck", "mallet"), or () for poses of the craft '
            "alone; inherit from airpuck.Pilot for a default",
            field=called(pilot),
        )
    for method, count in _METHODS.items():
        found = getattr(pilot, method, None)
        if not callable(found):
            raise InputError(
                f"lacks {method}(); inherit from airpuck.Pilot, or see docs/control.md",
                field=called(pilot),
            )
        try:
            inspect.signature(found).bind(*range(count))
        except TypeError:
            raise InputError(
                f"{method}() must take {count} argument{'s' * (count > 1)} beside self; see "
                "docs/control.md",
                field=called(pilot),
            ) from None


def checked_step(pilot: Any, step: Any) -> Step:
    """Return a pilot's step, or raise InputError if it is not a Step."""
    problem = _what_is_wrong(step)
    if problem:
        raise InputError(f"step() {problem}", field=called(pilot))
    return step


def _what_is_wrong(step: Any) -> str:
    """Describe why an object is not a valid step; empty if it is one."""
    if not isinstance(step, Step):
        return f"must return airpuck.Step(command), not {type(step).__name__}"
    try:
        real = np.asarray(step.command).dtype.kind in "fiu"
    except ValueError:
        real = False
    if not real:
        return "gave a command that is not an array of numbers"
    kinds = {"status": str, "estimate": Estimate | None, "prediction": Prediction | None}
    for name, kind in kinds.items():
        if not isinstance(getattr(step, name), kind):
            return f"gave a {type(getattr(step, name)).__name__} as {name}"
    return ""


class UserPilot(Pilot):
    """A pilot from a user's class, with its results checked; a `Pilot`."""

    def __init__(self, own: Any, code: UserCode) -> None:
        self._own, self._code, self.called = own, code, code.name
        self.watches = own.watches

    @property
    def reference(self) -> Reference:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The reference that the craft tracks."""
        own = self._code.run("reference", lambda: self._own.reference)
        return sheltered(own, self._code)

    def measured(self, measurement: Measurement) -> None:
        """Receive a measurement; see `Pilot.measured`."""
        what = f"{measurement.kind} at {measurement.stamp:.2f} s"
        self._code.run(what, self._own.measured, measurement)

    def step(self, time: float) -> Step:
        """Compute the command to send now; see `Pilot.step`."""
        step = self._code.run(f"step() at {time:.2f} s", self._own.step, time)
        problem = self._code.run(f"step() at {time:.2f} s", _what_is_wrong, step)
        if problem:
            self._code.refuse(f"step() at {time:.2f} s {problem}")
        return step

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Receive the command that was actually sent; see `Pilot.sent`."""
        self._code.run(f"sent() at {time:.2f} s", self._own.sent, time, command)


#: A factory of pilots.
PilotMaker = Callable[[Model, Reference], Pilot]


def pilot_named(name: str) -> PilotMaker | None:
    """Return a factory for a user's pilot, named FILE.py:NAME; None if it names a law."""
    if ".py:" not in check_law(name, "law"):
        return None
    kind = UserCode(name, "--law").kind
    is_law = isinstance(kind, type) and issubclass(kind, Law)
    return None if is_law else pilot_maker(name)


def pilot_maker(name: str) -> PilotMaker:
    """Return a factory for a user's pilot, named FILE.py:NAME, from a model and a reference."""
    code = UserCode(name, "--law")

    def make(model: Model, reference: Reference) -> Pilot:
        pilot = code.run("cannot be made from (model, reference)", code.kind, model, reference)
        code.run("is no pilot", check_pilot, pilot)
        return UserPilot(pilot, code)

    # Flights are labelled by the class.
    make.__name__ = name.rpartition(":")[2]
    return make
