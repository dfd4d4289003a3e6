"""References: what the craft should do over time."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.boundary.arguments import numbers_of
from airpuck.boundary.errors import InputError, about
from airpuck.boundary.extensions import UserCode
from airpuck.boundary.files import Section, read_toml
from airpuck.boundary.numbers import check_finite
from airpuck.boundary.results import Brief

#: A little over three turns; the largest yaw that may be requested at once [rad].
_MOST_YAW = 20.0
#: Largest position or yaw that is accepted [m, rad]. Larger ones are mistakes, and squares of far
#: larger numbers overflow.
_FARTHEST = 1e6
#: Largest time; stamps count from 1970 [s].
_LATEST = 1e10
#: Number of times at which a path is compared with a border.
_LOOKS = 200
#: Values that callers may pass for a one-dimensional array.
Numbers = Sequence[float] | np.ndarray


@dataclass(frozen=True, eq=False)
class Target:
    """A reference's target at one instant."""

    #: x, y [m], γ [rad] and their rates.
    state: Float[np.ndarray, " 6"]
    #: Accelerations to feed forward [m/s², m/s², rad/s²].
    acceleration: Float[np.ndarray, " 3"]


@dataclass(frozen=True, eq=False)
class Arrival:
    """A state to reach at a given time, and how precisely."""

    #: Time until the arrival [s].
    remaining: float
    #: Precision of x, y, γ and their rates; infinite: free.
    precision: Float[np.ndarray, " 6"]


@dataclass(frozen=True, eq=False)
class Preview:
    """Targets of a reference at times ahead, as a predictive law needs them."""

    states: Float[np.ndarray, "N 6"]
    accelerations: Float[np.ndarray, "N 3"]
    #: Set if only the state at one later time matters.
    arrival: Arrival | None = None


@runtime_checkable
class Reference(Protocol):
    """Gives the desired pose and motion of the craft over time."""

    def at(self, now: float, ahead: float) -> Target:
        """Return the target.

        Parameters
        ----------
        now : float
            Present time [s].
        ahead : float
            Delay until the command will have acted [s]. A reference that is known in advance may
            use it; a set point must not anticipate its own change.

        Returns
        -------
        Target
            Desired state and acceleration.
        """
        ...


@dataclass(frozen=True, eq=False)
class Unturned:
    """A reference with the yaw and the spin of a state, the craft's own: all thrust can push."""

    reference: Reference
    state: Float[np.ndarray, " 6"]

    def at(self, now: float, ahead: float) -> Target:
        """Return the target; see `Reference.at`."""
        target = self.reference.at(now, ahead)
        turns = np.array([False, False, True] * 2)
        return replace(target, state=np.where(turns, self.state, target.state))


@dataclass(frozen=True)
class SetPoint:
    """A single pose to hold.

    Attributes
    ----------
    x, y : float
        Position [m].
    yaw : float
        Orientation [rad].

    Raises
    ------
    InputError
        If a value is not finite, or far from any table.

    Examples
    --------
    >>> log = airpuck.track(model, airpuck.SetPoint(0.1, 0.0, 0.0), duration=1.0)
    >>> bool(log.recording["pose"].values[-1, 0] > 0.02)  # [m], on its way
    True
    """

    x: float
    y: float
    yaw: float

    def __post_init__(self) -> None:
        check_finite(x=self.x, y=self.y, yaw=self.yaw)
        if max(abs(self.x), abs(self.y), abs(self.yaw)) > _FARTHEST:
            raise _too_far("setpoint")

    @property
    def visits(self) -> list[tuple[float, float, float]]:
        """Poses that it leads through."""
        return [(self.x, self.y, self.yaw)]

    def at(self, now: float, ahead: float) -> Target:
        """Return the pose, at rest; see `Reference.at`."""
        return Target(np.array([self.x, self.y, self.yaw, 0.0, 0.0, 0.0]), np.zeros(3))

    def over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        """Return the pose, at rest, for all times; see `preview`."""
        return _held(self.at(now, 0.0), len(ahead))


class SetPoints(Brief):
    """A sequence of poses, each held from its own time on.

    Parameters
    ----------
    times : sequence of float
        Increasing start times of the set points [s]. The first set point also holds before its
        time.
    poses : sequence of (x, y, yaw)
        The set points [m, m, rad].

    Raises
    ------
    InputError
        If the list is empty, a set point is not three numbers, times do not increase, or a number
        is not finite.

    Examples
    --------
    >>> points = airpuck.SetPoints([0.0, 2.0], [(0.0, 0.0, 0.0), (0.5, 0.2, 1.0)])
    >>> points.at(2.5, 0.0).state[:3].tolist()
    [0.5, 0.2, 1.0]
    """

    def __init__(self, times: Numbers, poses: Sequence[Numbers] | np.ndarray) -> None:
        self.times, self.poses = _checked(times, poses, 1, "setpoint")
        #: The file that they come from, for messages.
        self.file: str | os.PathLike[str] | None = None
        at_rest = np.concatenate([self.poses, np.zeros_like(self.poses)], axis=1)
        self._targets = [Target(state, np.zeros(3)) for state in at_rest]

    @property
    def visits(self) -> Float[np.ndarray, "N 3"]:
        """Poses that it leads through."""
        return self.poses

    def at(self, now: float, ahead: float) -> Target:
        """Return the set point in force now; see `Reference.at`."""
        return self._targets[max(int(self.times.searchsorted(now, side="right")) - 1, 0)]

    def over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        """Return the present set point for all times; see `preview`."""
        return _held(self.at(now, 0.0), len(ahead))


class TimedPath(Brief):
    """A trajectory to follow: poses at given times, joined by cubic splines.

    Velocity and acceleration of the splines are fed forward. Before the beginning and after the end
    the craft stands still at the first or last pose.

    Parameters
    ----------
    times : array, shape (N,)
        Increasing times [s].
    poses : array, shape (N, 3)
        x, y [m], yaw [rad]; the yaw is continuous and may exceed a full turn.

    Raises
    ------
    InputError
        If there are fewer than two poses, a pose is not three numbers, times do not increase, or a
        number is not finite.

    Examples
    --------
    >>> t = np.linspace(0.0, 4.0, 41)
    >>> circle = np.column_stack([0.3 * np.cos(t), 0.3 * np.sin(t), t])
    >>> path = airpuck.TimedPath(t, circle)
    >>> path.at(0.0, 0.0).state[:3].tolist()
    [0.3, 0.0, 0.0]
    """

    SHOWN = "first_s=_first last_s=_last"

    def __init__(self, times: Numbers, poses: Sequence[Numbers] | np.ndarray) -> None:
        from scipy.interpolate import CubicSpline

        known, through = _checked(times, poses, 2, "path")
        self._first, self._last = float(known[0]), float(known[-1])
        spline = CubicSpline(known, through, bc_type="clamped")
        self._splines = (spline, spline.derivative(), spline.derivative(2))

    @property
    def visits(self) -> Float[np.ndarray, "N 3"]:
        """Poses that it leads through."""
        return self._splines[0](np.linspace(self._first, self._last, _LOOKS))

    def at(self, now: float, ahead: float) -> Target:
        """Return pose, velocity and acceleration at ``now + ahead``; see `Reference.at`."""
        wanted = self.over(now, np.array([ahead], dtype=float))
        return Target(wanted.states[0], wanted.accelerations[0])

    def over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        """Return pose, velocity and acceleration at several times; see `preview`."""
        times = now + ahead
        inside = times.clip(self._first, self._last)
        pose, velocity, acceleration = (spline(inside) for spline in self._splines)
        moving = (inside == times)[:, None]
        return Preview(np.hstack([pose, velocity * moving]), acceleration * moving)


class Rendezvous(Brief):
    """A state to reach at a given time, along any path: to meet something that moves.

    Until then, a predictive law considers nothing else. Other laws chase a target that moves
    through the state at its velocity.

    Parameters
    ----------
    time : float
        When to arrive [s].
    state : array, shape (6,)
        x, y, γ and their rates.
    precision : array, shape (6,), optional
        Errors that are equally important; infinite: free, for example if the yaw does not matter.
    then : Reference, optional
        Reference to track afterwards; by default the pose of the arrival.

    Raises
    ------
    InputError
        If a number is not finite, or a precision is not positive.

    Examples
    --------
    >>> meet = airpuck.Rendezvous(1.0, (0.3, 0.1, 0.0, 0.5, 0.0, 0.0))  # after 1 s, at 0.5 m/s
    >>> log = airpuck.track(model, meet, duration=0.1)
    >>> len(log.status)
    10
    """

    def __init__(
        self,
        time: float,
        state: Numbers,
        *,
        precision: Numbers = (0.002, 0.002, 0.05, 0.05, 0.05, 1.0),
        then: Reference | None = None,
    ) -> None:
        if not isinstance(time, Real) or not abs(time) <= _LATEST:
            raise InputError(f"must be a number within ±{_LATEST:g} s", field="time")
        self.time, self.state = float(time), numbers_of(state, (6,), "state")
        if max(map(abs, self.state.tolist())) > _FARTHEST:
            raise _too_far("state")
        try:
            self.precision = np.array(precision, dtype=float)
        except (TypeError, ValueError):
            self.precision = np.zeros(0)
        if self.precision.shape != (6,) or not (self.precision > 0).all():
            raise InputError(
                "must be six positive numbers; inf frees a component", field="precision"
            )
        if not (then is None or isinstance(then, Reference)):
            problem = f"must be a reference, such as a SetPoint, not {type(then).__name__}"
            raise InputError(problem, field="then")
        self.then = then or SetPoint(*self.state[:3].tolist())

    @property
    def visits(self) -> list[Sequence[float]]:
        """Poses that it leads through."""
        return [self.state[:3].tolist(), *getattr(self.then, "visits", ())]

    def asked(self, now: float) -> Float[np.ndarray, " 6"]:
        """Return the state to reach, or the target afterwards; see `asked`."""
        return asked(self.then, now) if self.time < now else self.state

    def at(self, now: float, ahead: float) -> Target:
        """Return a state on the line through the arrival, or a later target; see `Reference.at`."""
        if self.time < now + ahead:
            return self.then.at(now, ahead)
        wanted = self.over(now, np.array([ahead]))
        return Target(wanted.states[0], wanted.accelerations[0])

    def over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        """Return the targets at several times, and the arrival; see `preview`."""
        left = self.time - now - ahead[:, None]
        if left[0] < 0:
            return preview(self.then, now, ahead)
        poses = self.state[:3] - left * self.state[3:]
        states = np.hstack([poses, np.tile(self.state[3:], (len(ahead), 1))])
        return Preview(states, np.zeros_like(poses), Arrival(self.time - now, self.precision))


def asked(reference: Reference, now: float) -> Float[np.ndarray, " 6"]:
    """Return the desired state now, for display and logging.

    If a reference has a method `asked`, use its result: a state to reach later is one place,
    although `Reference.at` gives a path through it.
    """
    own = getattr(reference, "asked", None)
    return reference.at(now, 0.0).state if own is None else own(now)


def preview(reference: Reference, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
    """Return the targets of a reference at times ahead.

    Uses the reference's method `over` if it has one, otherwise calls `Reference.at` for each time.
    """
    over = getattr(reference, "over", None)
    if over is not None:
        return over(now, ahead)
    targets = [reference.at(now, each) for each in ahead.tolist()]
    states = np.stack([target.state for target in targets])
    return Preview(states, np.stack([target.acceleration for target in targets]))


class UserReference:
    """A reference from a user's class, with its results checked."""

    def __init__(self, own: Reference, code: UserCode) -> None:
        self._own, self._code = own, code

    def at(self, now: float, ahead: float) -> Target:
        """Return the target; see `Reference.at`."""
        return self._code.run(f"reference.at() at {now:.2f} s", self._at, now, ahead)

    def asked(self, now: float) -> Float[np.ndarray, " 6"]:
        """Return the desired state now; see `asked`."""
        what = f"reference.asked() at {now:.2f} s"
        return self._code.run(what, lambda: numbers_of(asked(self._own, now), (6,), "state"))

    def over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        """Return the targets at several times; see `preview`."""
        return self._code.run(f"reference.over() at {now:.2f} s", self._over, now, ahead)

    def _at(self, now: float, ahead: float) -> Target:
        target = self._own.at(now, ahead)
        if not isinstance(target, Target):
            raise InputError(f"must return a Target, not {type(target).__name__}")
        return Target(
            numbers_of(target.state, (6,), "state"),
            numbers_of(target.acceleration, (3,), "acceleration"),
        )

    def _over(self, now: float, ahead: Float[np.ndarray, " N"]) -> Preview:
        found, count = preview(self._own, now, ahead), len(ahead)
        states = numbers_of(found.states, (count, 6), "states")
        accelerations = numbers_of(found.accelerations, (count, 3), "accelerations")
        if not (found.arrival is None or isinstance(found.arrival, Arrival)):
            raise InputError("must be an Arrival or None", field="arrival")
        return Preview(states, accelerations, found.arrival)


def sheltered(reference: Reference, code: UserCode) -> Reference:
    """Return a user's reference; wrap it if its results need checking."""
    if not isinstance(reference, Reference):
        code.refuse("must give a reference, such as airpuck.SetPoint(-0.9, 0, 0)")
    if type(reference) is Rendezvous:
        then = sheltered(reference.then, code)
        if then is reference.then:
            return reference
        time, state = reference.time, reference.state
        return Rendezvous(time, state, precision=reference.precision, then=then)
    ours = type(reference).__module__.startswith("airpuck.")
    return reference if ours else UserReference(reference, code)


def _too_far(field: str) -> InputError:
    """Return the error for poses that are far from any table."""
    problem = f"must lie within ±{_FARTHEST:g} m and rad; is it in another unit?"
    return InputError(problem, field=field)


def _held(target: Target, count: int) -> Preview:
    """Return the same target for several times."""
    return Preview(np.tile(target.state, (count, 1)), np.tile(target.acceleration, (count, 1)))


def _checked(
    times: Numbers, poses: Sequence[Numbers] | np.ndarray, least: int, field: str
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N 3"]]:
    """Return times and poses as arrays, or raise InputError."""
    try:
        pose = np.array(poses, dtype=float)
    except (TypeError, ValueError):
        pose = np.zeros((1, 1))  # rows of different lengths
    if pose.size and pose.shape[1:] != (3,):
        raise InputError("each pose must be three numbers: x, y, yaw", field=field)
    try:
        time, pose = np.array(times, dtype=float), pose.reshape(-1, 3)
    except (TypeError, ValueError):
        raise InputError("times must be numbers", field=field) from None
    if time.shape != (len(pose),) or len(time) < least:
        raise InputError(f"needs as many times as poses, and at least {least}", field=field)
    if not (np.isfinite(time).all() and np.isfinite(pose).all()):
        raise InputError("times and poses must be finite numbers", field=field)
    if (np.diff(time) <= 0).any():
        raise InputError("times must increase", field=field)
    if np.abs(pose).max() > _FARTHEST:
        raise _too_far(field)
    return time, pose


class _Entry(Section):
    """A pose to hold from a time on."""

    #: From the start of the flight.
    at_s: float
    #: Pose.
    x_m: float
    y_m: float
    yaw_rad: float


class _SetPointsFile(Section):
    """Poses to fly to, one after the other."""

    #: In the order of their times.
    setpoints: tuple[_Entry, ...]


def read_setpoints(path: str | os.PathLike[str]) -> SetPoints:
    """Read set points from a TOML file."""
    entries = read_toml(path, _SetPointsFile).setpoints
    with about(path, "setpoints"):
        points = SetPoints([e.at_s for e in entries], [(e.x_m, e.y_m, e.yaw_rad) for e in entries])
    points.file = path
    return points


def check_inside(
    reference: Reference, reach: tuple[float, float], border: str = "the geofence"
) -> None:
    """Reject references beyond a border at ±x, ±y [m], and set points that must be in degrees.

    A reference that is known in advance has `visits`: the poses that it leads through.
    """
    turns = not isinstance(reference, SetPoint | SetPoints)
    with about(reference.file if isinstance(reference, SetPoints) else None, "setpoint"):
        for x, y, yaw in map(tuple, getattr(reference, "visits", ())):
            if abs(x) > reach[0] or abs(y) > reach[1]:
                border = f"{border}, ±{reach[0]:g} m by ±{reach[1]:g} m"
                raise InputError(f"({x:g}, {y:g}) is outside {border}")
            if abs(yaw) > _MOST_YAW and not turns:
                turned = f"{abs(yaw) / math.tau:.0f} turns"
                raise InputError(f"yaw = {yaw:g} rad is {turned}; is it in degrees?")
