"""Time-optimal plans: the shortest flight found, and a lower bound on the flight time."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.boundary.arguments import checked_class, numbers_of
from airpuck.boundary.errors import InputError, about
from airpuck.boundary.files import Section, load_toml, read_toml, write_toml
from airpuck.boundary.results import Result
from airpuck.control.reference import Numbers, Target
from airpuck.craft.table import Table
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration
from airpuck.planning.certificate import lower_bound, lower_bound_through
from airpuck.planning.request import Goal, Request, checked_request
from airpuck.planning.search import Start, further, search
from airpuck.planning.settings import Limits
from airpuck.planning.transcription import Path, Solved
from airpuck.planning.yaw_program import Weight

_FORMAT = "airpuck plan 1"
#: If the bound is below this fraction of a plan's time, the plan may not be the best: try more
#: starts.
_DOUBTFUL = 0.92
#: Time between samples of a plan [s].
_SAMPLE = 1e-3
#: A plan meets its goal only within a tolerance, so it may be faster than possible by this
#: fraction.
_INACCURATE = 1e-3
#: Commands may exceed their limits by this.
_ROUNDING = 1e-6
#: Multipliers of rails that count as zero, as a fraction of the largest price.
_TOUCH = 1e-3


@partial(checked_class, finite=False)
@dataclass(frozen=True, eq=False)
class Plan(Result):
    """A time-optimal flight; a reference that a controller can track.

    Attributes
    ----------
    model : Model
        The craft that the plan is for.
    time : array, shape (N + 1,)
        Times of the nodes from the start on [s].
    states : array, shape (N + 1, 6 + n)
        x, y [m], γ [rad], their rates and the motor speeds at the nodes.
    commands : array, shape (N, n)
        Commands that reach the motors between the nodes, without the transport delay.
    lower_bound : float or None
        Lower bound [s] on the duration, over all controls of these motors within the same limits of
        yaw rate and speed; None if an effect of the model states no bounds.
    starts : tuple of Start
        The starts of the search and their results.
    reserve : float
        Fraction of every motor's thrust that the plan reserves for feedback.
    begin : float, default 0
        When the flight begins, on the clock of the controller [s].
    via : tuple of (x, y)
        Points that the craft passes, in this order [m].
    keep_out : tuple of (x, y, radius)
        Discs that the craft avoids [m].

    Raises
    ------
    InputError
        If a number is not finite, times do not increase from 0, or arrays do not fit together.

    Examples
    --------
    >>> coast = airpuck.Plan(  # without thrust from (0, 0) at 0.4 m/s
    ...     model,
    ...     time=np.array([0.0, 0.5]),
    ...     states=np.array([[0, 0, 0, 0.4, 0, 0], [0.2, 0, 0, 0.4, 0, 0]]) @ np.eye(6, 12),
    ...     commands=np.zeros((1, 6)),
    ...     lower_bound=None,
    ... )
    >>> coast.duration
    0.5
    >>> controller = airpuck.TrackingController(model, coast.starting(2.0))  # it is a reference
    """

    JSON = "time_s=duration lower_bound_s=lower_bound gap reserve starts spread converged"

    model: Model
    time: Float[np.ndarray, " nodes"]
    states: Float[np.ndarray, "nodes s"]
    commands: Float[np.ndarray, "intervals n"]
    lower_bound: float | None
    starts: tuple[Start, ...] = ()
    reserve: float = 0.0
    begin: float = 0.0
    via: tuple[tuple[float, ...], ...] = ()
    keep_out: tuple[tuple[float, ...], ...] = ()
    #: True, since a plan that did not converge is an error.
    converged: ClassVar = True

    def __post_init__(self) -> None:
        n, nodes = self.model.vehicle.n_propellers, np.size(self.time)
        if nodes < 2:
            raise InputError("must have two entries or more", field="time")
        shapes = {"time": (nodes,), "states": (nodes, 6 + n), "commands": (nodes - 1, n)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, numbers_of(getattr(self, name), shape, name))
        if self.time[0] != 0 or (np.diff(self.time) <= 0).any():
            raise InputError("must increase from 0", field="time")
        if not (self.commands.min() >= -_ROUNDING and self.commands.max() <= 1 + _ROUNDING):
            raise InputError("must lie in [0, 1]", field="commands")
        numbers.RESERVE.check(self.reserve, "reserve")
        if self.lower_bound is not None:
            numbers.check_finite(lower_bound=self.lower_bound)
        if math.isnan(self.begin):  # infinite: it waits for a departure
            raise InputError("must be a number", field="begin")
        numbers_of(self.via or np.zeros((0, 2)), (None, 2), "via")
        numbers_of(self.keep_out or np.zeros((0, 3)), (None, 3), "keep_out")

    @property
    def visits(self) -> Float[np.ndarray, "nodes 3"]:
        """The poses at the nodes."""
        return self.states[:, :3]

    @property
    def duration(self) -> float:
        """Duration of the flight [s]."""
        return float(self.time[-1])

    def path(self, legs: int = 1) -> Path:
        """Return nodes and commands as a path.

        Parameters
        ----------
        legs : int, default 1
            Number of legs, each with the same number of intervals.

        Returns
        -------
        Path
            Durations of the legs, states at the nodes, commands between them.

        Raises
        ------
        InputError
            If the intervals cannot be divided among the legs.
        """
        if legs < 1 or len(self.commands) % legs:
            problem = f"must divide the plan's {len(self.commands)} intervals, but is {legs}"
            raise InputError(problem, field="legs")
        return Path(np.diff(self.time[:: (len(self.time) - 1) // legs]), self.states, self.commands)

    @property
    def spread(self) -> float:
        """Return by what fraction the worst start that converged is slower than the best."""
        times = [start.time_s for start in self.starts if start.time_s is not None]
        return max(times) / min(times) - 1 if times else 0.0

    def starting(self, begin: float) -> Plan:
        """Return the plan with another time of departure.

        Parameters
        ----------
        begin : float
            When the flight begins, on the clock of the controller [s].

        Returns
        -------
        Plan
            A copy.
        """
        moved = replace(self, begin=begin)
        # Cache times relative to the beginning: a controller that departs has no time to recompute
        # them.
        vars(moved)["samples"] = self.samples
        return moved

    @cached_property
    def samples(self) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M s"]]:
        """Return times [s] and simulated states of the flight, a millisecond apart."""
        parts = int(np.ceil(np.diff(self.time).max() / _SAMPLE))
        return self.path().simulated(self.model, self.time, parts)

    def at(self, now: float, ahead: float) -> Target:
        """Return the planned state and acceleration at ``now + ahead``; see `Reference.at`.

        Before the beginning and after the end the craft stands still there.
        """
        state = self.state_at(now, ahead)
        if not 0 <= now + ahead - self.begin <= self.duration:
            return Target(np.append(state[:3], np.zeros(3)), np.zeros(3))
        rates = acceleration(np, self.model.dynamics, state[2:6], state[6:])
        return Target(state[:6].copy(), np.array(rates))

    def state_at(
        self, now: float, ahead: float | Float[np.ndarray, "*K"]
    ) -> Float[np.ndarray, "*K s"]:
        """Return the whole planned state at ``now + ahead``, motor speeds included.

        Parameters
        ----------
        now : float
            Present time [s].
        ahead : float or array, shape (...)
            Time ahead of now [s].

        Returns
        -------
        array, shape (..., 6 + n)
            States; before the beginning the initial one, after the end the final one.
        """
        times, states = self.samples
        inside = np.clip(now + ahead - self.begin, 0.0, times[-1])
        last = np.minimum(np.searchsorted(times, inside, side="right") - 1, len(times) - 2)
        share = np.expand_dims((inside - times[last]) / (times[last + 1] - times[last]), -1)
        return (1 - share) * states[last] + share * states[last + 1]

    def motors_at(
        self, now: float, ahead: float | Float[np.ndarray, "*K"]
    ) -> Float[np.ndarray, "*K n"]:
        """Return the commands that are planned to reach the motors at ``now + ahead``.

        Parameters
        ----------
        now : float
            Present time [s].
        ahead : float or array, shape (...)
            Time ahead of now [s].

        Returns
        -------
        array, shape (..., n)
            Commands; idle before the beginning and after the end.
        """
        time = now + ahead - self.begin
        last = np.searchsorted(self.time, time, side="right") - 1
        flying = np.expand_dims((time >= 0) & (time < self.duration), -1)
        commands = self.commands[np.clip(last, 0, len(self.commands) - 1)]
        return np.where(flying, commands, self.model.vehicle.command_min)

    @property
    def gap(self) -> float | None:
        """Relative difference between duration and lower bound; None without a bound."""
        return None if self.lower_bound is None else 1 - self.lower_bound / self.duration

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan as TOML; `read_plan` restores every number bit for bit.

        Parameters
        ----------
        path : path-like
            The file to write.
        """
        content = {
            "format": _FORMAT,
            "motors": list(self.model.vehicle.propeller_names),
            **({} if self.lower_bound is None else {"lower_bound_s": self.lower_bound}),
            "reserve": self.reserve,
            "via_m": [list(point) for point in self.via],
            "keep_out_m": [list(disc) for disc in self.keep_out],
            "times_s": self.time.tolist(),
            "states": self.states.tolist(),
            "commands": self.commands.tolist(),
        }
        write_toml(path, content, header="An airpuck plan: a time-optimal flight.")


class _PlanFile(Section):
    """A time-optimal flight."""

    format: Literal["airpuck plan 1"]
    #: Names of the columns of the commands.
    motors: tuple[str, ...]
    #: Lower bound on the time of any such flight; missing where none is known.
    lower_bound_s: float | None = None
    #: Fraction of thrust reserved for feedback.
    reserve: float
    #: Points to pass, in order.
    via_m: tuple[tuple[float, float], ...] = ()
    #: Discs to avoid: x and y of the centre, radius.
    keep_out_m: tuple[tuple[float, float, float], ...] = ()
    #: Times of the states.
    times_s: tuple[float, ...]
    #: x, y, yaw, their rates, motor speeds.
    states: tuple[tuple[float, ...], ...]
    #: Commands at the motors between these times, without the transport delay.
    commands: tuple[tuple[float, ...], ...]


def is_plan(path: str) -> bool:
    """Return whether this is a plan file, rather than a model file or a model's name."""
    return path.endswith(".toml") and load_toml(path).get("format") == _FORMAT


def read_plan(path: str | os.PathLike[str], model: Model) -> Plan:
    """Read a plan file.

    Parameters
    ----------
    path : path-like
        A file written by `Plan.save`.
    model : Model
        Model of the craft that will fly the plan.

    Returns
    -------
    Plan
        The plan, without the starts of its search.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or is for other motors.

    Examples
    --------
    >>> at_rest = airpuck.Plan(
    ...     model, np.array([0.0, 0.5]), np.zeros((2, 12)), np.zeros((1, 6)), lower_bound=None
    ... )
    >>> at_rest.save("plan.toml")
    >>> airpuck.read_plan("plan.toml", model).duration
    0.5
    """
    content = read_toml(path, _PlanFile)
    if content.motors != model.vehicle.propeller_names:
        raise InputError(
            f"is for the motors {', '.join(content.motors)}; use the model it was made with",
            file=path,
            field="motors",
        )
    rows: dict[str, Any] = {"time": content.times_s, "states": content.states}
    rows |= {"commands": content.commands, "via": content.via_m, "keep_out": content.keep_out_m}
    with about(path, lambda field: "times_s" if field == "time" else field):
        return Plan(model, **rows, lower_bound=content.lower_bound_s, reserve=content.reserve)


def plan(
    model: Model,
    start: Numbers,
    goal: Goal | Numbers,
    *,
    via: Sequence[Numbers] = (),
    table: Table | None = None,
    keep_out: Sequence[Numbers] = (),
    limits: Limits | None = None,
    intervals: int = 40,
    warm: Plan | None = None,
) -> Plan:
    """Plan the fastest flight from one state to another, with a lower bound on its time.

    Local optima exist. The search therefore begins from several paths on a coarse grid, and refines
    the best. `Plan.starts` lists these paths and their durations.

    Parameters
    ----------
    model : Model
        The craft.
    start : array, shape (3,), (6,) or (6 + n,)
        x, y [m], γ [rad]; their rates, by default 0; the motor speeds, by default idle.
    goal : Goal or array, shape (3,) or (6,)
        Goal. Plain numbers mean the shorter turn to the yaw, and rates that are 0 by default.
    via : sequence of (x, y), optional
        Points that the craft's centre passes, in this order [m].
    table : Table, optional
        Table whose rails the craft must not touch; by default there are no rails.
    keep_out : sequence of (x, y, radius), optional
        Discs that the craft must not touch [m].
    limits : Limits, optional
        Reserve of thrust, limits of yaw rate and speed, margin.
    intervals : int, default 40
        Intervals of constant commands in each leg, 10 to 400.
    warm : Plan, optional
        A neighbouring plan to start from instead of all other starts.

    Returns
    -------
    Plan
        A converged flight.

    Raises
    ------
    InputError
        If the request is invalid or infeasible, or if no start converged.

    Examples
    --------
    >>> plan = airpuck.plan(model, (0, 0, 0), airpuck.Goal(0.3, 0.1, yaw=None))
    >>> 0.3 < plan.lower_bound < plan.duration < 1.0
    True
    """
    numbers.INTERVALS.check(intervals, "intervals")
    if warm is not None and len(warm.commands) % (len(via) + 1):
        raise InputError("has a different number of legs from this request", field="warm")
    request = checked_request(model, start, goal, via, table, keep_out, limits or Limits())
    near = None if warm is None else warm.path(len(request.via) + 1)
    solved, tried = search(request, intervals, near)
    bound = _bound(request, solved)
    if warm is None and bound is not None and bound < _DOUBTFUL * solved.path.times[-1]:
        for begun, other in further(request, intervals, solved.time):
            tried = (*tried, begun)
            # Several starts lead to the same flight.
            if other is not None and not math.isclose(other.time, solved.time):
                # The bound holds whatever weight it comes from.
                bound = max(bound, _bound(request, other) or 0.0)
                solved = min(solved, other, key=lambda one: float(one.path.times[-1]))
    path = solved.path
    _check_bound(bound, path)
    return Plan(
        model,
        path.times,
        path.states,
        path.commands,
        bound,
        tried,
        request.limits.reserve,
        via=tuple(tuple(map(float, point)) for point in via),
        keep_out=tuple(tuple(map(float, disc)) for disc in keep_out),
    )


def _check_bound(bound: float | None, path: Path) -> None:
    """Raise an internal error if a flight is faster than its lower bound."""
    duration = float(path.times[-1])
    if bound is not None and bound > duration * (1 + _INACCURATE):
        raise RuntimeError(
            f"the lower bound, {bound:.6f} s, is above the time of a flight, {duration:.6f} s: "
            "one of them is wrong; please report this request"
        )


def _bound(request: Request, solved: Solved) -> float | None:
    """Return a lower bound on the flight time, using the costates of a plan."""
    if len(request.via):
        return lower_bound_through(request, solved.path.durations)
    return lower_bound(request, _weight(request, solved), float(solved.path.times[-1]))


def _weight(request: Request, solved: Solved) -> Weight:
    """Read a weight for the certificate off a plan's costates.

    The multipliers of the velocity steps; kinks occur where the path touches a rail.
    """
    times, prices = solved.path.times, solved.prices
    touch = np.abs(solved.touching[1:-1]).max(axis=1)
    scale = np.abs(prices[:, :2]).max() + np.abs(solved.touching[1:-1]).max(initial=0.0)
    kinks = times[1:-1][touch > _TOUCH * max(scale, 1e-9)]
    values = prices[:, 3] + 1j * prices[:, 4]
    return Weight.fitted(times[1:], values, kinks, yaw_price=float(prices[0, 2]))
