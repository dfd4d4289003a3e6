"""Interfaces of what commands a craft: a control law, the result of its steps, and a pilot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.boundary.arguments import numbers_of
from airpuck.boundary.errors import InputError
from airpuck.boundary.extensions import UserCode
from airpuck.boundary.results import Brief
from airpuck.compute.compiled import program
from airpuck.control.allocation import AllocationStatus
from airpuck.control.laws import check_law, law_class
from airpuck.control.limits import Limit
from airpuck.control.reference import Reference, SetPoint
from airpuck.control.tuning import LawSettings, Tuning
from airpuck.craft.table import Table
from airpuck.data.measurement import Measurement, MeasurementKind
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import register_pytrees

#: Status of a prediction. ``optimal``: within all limits. ``softened``: exceeds a limit of the
#: craft's motion by as little as possible. ``iteration limit``: the solver found no solution; the
#: plan of the previous step continues. ``fallback``: there is no plan; an LQR steers.
SolverStatus = Literal["optimal", "softened", "iteration limit", "fallback"]
_Refused = Literal["no pose", "stale pose", "jumping pose", "bad input", "open loop", "unsafe"]
#: Status of a control step. With a status of allocation or prediction the craft flies; all others
#: idle the motors. A guard around the controller sets ``unsafe``, a landing ``cannot steer``.
Status = AllocationStatus | SolverStatus | _Refused | Literal["cannot steer"]
#: Kinds of limits of a plan.
Bound = Literal["nothing", "motor", "motion"]
FLYING: tuple[Status, ...] = ("exact", "scaled", "nearest", *get_args(SolverStatus), "open loop")


@dataclass(frozen=True, eq=False)
class Prediction(Brief):
    """The trajectory that a predictive law expects.

    Attributes
    ----------
    times : array, shape (N,)
        Times, from when the command begins to act [s].
    states : array, shape (N, 6)
        x, y, γ and their rates at these times.
    active : tuple of str
        Limits that are active somewhere in the plan: ``motor``, ``rail``, ``speed``, ``spin``,
        ``disc``, ``half plane``.
    """

    times: Float[np.ndarray, " N"]
    states: Float[np.ndarray, "N 6"]
    active: tuple[str, ...]

    @property
    def bound_by(self) -> Bound:
        """The strongest limit of the plan: a limit of the craft's motion, the motors, or none."""
        if set(self.active) - {"motor"}:
            return "motion"
        return "motor" if self.active else "nothing"


@dataclass(frozen=True, eq=False)
class Step(Brief):
    """Result of a control step.

    Attributes
    ----------
    command : array, shape (n,)
        Motor commands to send, finite and within the vehicle's limits; the caller owns the array
        and may change it.
    status : str, default "open loop"
        ``exact``, ``scaled``, ``nearest`` (`LQR`), ``optimal``, ``softened``, ``iteration limit``,
        ``fallback`` (`MPC`): the craft flies; ``open loop``: it flies without a law; any other
        status is the reason why the motors idle.
    request : array, shape (3,), default 0
        Acceleration requested of the allocation (`LQR`), or expected from the shifted plan of the
        previous step (`MPC`) [m/s², m/s², rad/s²]; zero when idle.
    estimate : Estimate or None
        State when the command will begin to act; None when idle.
    prediction : Prediction or None
        The trajectory that a predictive law expects from then on.

    Examples
    --------
    >>> airpuck.Step(np.zeros(6)).status
    'open loop'
    """

    command: Float[np.ndarray, " n"]
    status: Status = "open loop"
    request: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    estimate: Estimate | None = None
    prediction: Prediction | None = None

    @property
    def flies(self) -> bool:
        """Whether the command steers the craft, rather than idling its motors."""
        return self.status in FLYING


class Moment(NamedTuple):
    """The inputs of one control step, as a law sees them."""

    reference: Reference
    #: Time at which the command is sent, and the delay until it acts [s].
    now: float
    delay: float
    #: Takes the inputs of the law's stage. Returns the craft as predicted for when the command
    #: begins to act, and the results of the stage.
    foresee: Callable[..., tuple[Estimate, Sequence[Any]]]
    #: Limits of the craft's motion at this moment; see `Law.obeys_limits`.
    limits: Sequence[Limit] = ()


@dataclass(frozen=True, eq=False)
class LawOptions:
    """Settings that a controller passes to its law."""

    #: The table whose rails a predictive law avoids.
    table: Table = field(default_factory=Table)
    #: Limits of the craft's motion at the beginning.
    limits: Sequence[Limit] = ()
    #: Gain of the LQR; by default computed from the tuning's weights.
    gain: Float[np.ndarray, "3 6"] | None = None
    #: Whether the estimated disturbance is compensated.
    reject_disturbance: bool = True
    #: Whether to compile the mathematics or run it in NumPy.
    compiled: bool = True


class Law(Brief):
    """Computes a command from the state predicted for the time at which the command begins to act.

    A step takes the law's state and returns the next one; the law itself does not change. Pure
    functions of the prediction belong in `stage`: the controller compiles them together with the
    prediction of its estimator, since every call of a program costs time.

    Parameters
    ----------
    model : Model
        The craft.
    tuning : Tuning
        Period, weights and the other chosen settings.
    options : LawOptions, optional
        Settings from the controller.

    Attributes
    ----------
    Settings : subclass of LawSettings, or None
        The law's table in a tuning file; the law reads it by ``tuning.of(Settings)``.
    title : str
        The law in a sentence.
    looks_ahead : bool
        Whether the law considers the reference beyond its next step. If not, it leaves the flight
        of a plan to `PlanTracker`, and is quick to compute without compilation.
    c_modules : sequence of str, optional
        Modules of ``packaged/c`` that compute this law, besides those of each controller. By
        default there are none, and the law cannot be exported to C.
    obeys_limits : bool
        Whether the law keeps the craft within `Moment.limits`; by default False, and a controller
        then takes no hard limits.
    gain : array or None
        Gain of a linear law, which may be fitted to a flight.
    stage : callable or None
        (array namespace, state, motor speeds, disturbance, effectiveness, inputs) to arrays; None
        if the law has no stage.
    inputs : tuple of array
        Inputs of the stage besides the estimate, as examples of their shapes.

    Examples
    --------
    >>> class Coast(airpuck.Law):
    ...     def __init__(self, model, tuning, options=None):
    ...         self.off = np.zeros(6)
    ...     def init(self):
    ...         return None
    ...     def step(self, state, moment):
    ...         return airpuck.Step(self.off), state
    ...
    >>> from airpuck.control.tuning import default_tuning
    >>> step, state = Coast(model, default_tuning()).step(None, None)
    >>> step.status
    'open loop'
    """

    Settings: ClassVar[type[LawSettings] | None] = None
    title: ClassVar[str] = "a law of its own"
    looks_ahead: ClassVar[bool] = True
    c_modules: ClassVar[Sequence[str] | None] = None
    obeys_limits: bool = False
    gain: Float[np.ndarray, "3 6"] | None = None
    stage: Callable[..., tuple[Any, ...]] | None = None
    inputs: tuple[np.ndarray, ...] = ()

    def __init__(self, model: Model, tuning: Tuning, options: LawOptions | None = None) -> None: ...

    def init(self) -> Any:
        """Return the state before the first step.

        Returns
        -------
        object
            By default None, for a law without memory.
        """
        return None

    def step(self, state: Any, moment: Moment) -> tuple[Step, Any]:
        """Compute the command to send now.

        Parameters
        ----------
        state : object
            State from `init` or the previous step.
        moment : Moment
            Reference, time and limits, and the prediction of the craft.

        Returns
        -------
        step : Step
            The command.
        state : object
            State for the next step.
        """
        raise NotImplementedError


class UserLaw(Law):
    """A law from a user's class, with its results checked."""

    SHOWN = "law=_own"

    def __init__(self, own: Law, code: UserCode) -> None:
        self._own, self._code = own, code
        self.stage, self.inputs, self.obeys_limits = own.stage, own.inputs, own.obeys_limits

    def init(self) -> Any:
        """Return the state before the first step; see `Law.init`."""
        return self._code.run("init()", self._own.init)

    def step(self, state: Any, moment: Moment) -> tuple[Step, Any]:
        """Compute the command; see `Law.step`."""
        what = f"step() at {moment.now:.2f} s"
        found = self._code.run(what, self._own.step, state, moment)
        if not (isinstance(found, tuple) and len(found) == 2 and isinstance(found[0], Step)):
            self._code.refuse(f"{what} must return an airpuck.Step and the next state")
        self._code.run(what, numbers_of, found[0].command, (None,), "command")
        return found


def staged(
    law: Law, model: Model, compiled: bool, inputs: Sequence[Any] | None = None
) -> Callable[..., tuple[Estimate, Sequence[Any]]]:
    """Return a law's stage for given estimates: (estimate, *inputs) → the result of `foresee`."""
    if law.stage is None:
        return lambda estimate: (estimate, ())
    axes, motors = np.zeros(3), np.zeros(model.vehicle.n_propellers)
    given = np.zeros(6), motors, axes, motors, *(law.inputs if inputs is None else inputs)
    if compiled:
        register_pytrees()
    compute = program(law.stage, *given, compiled=compiled)

    def computed(e: Estimate, *inputs: Any) -> tuple[Estimate, Sequence[Any]]:
        return e, compute(e.state, e.motor_speed, e.disturbance, e.effectiveness, *inputs)

    return computed


def make_law(law: str | type[Law] | Law, model: Model, tuning: Tuning, options: LawOptions) -> Law:
    """Make a law from its name or class; a law that exists already is copied."""
    if isinstance(law, Law):
        return copy(law)
    made = (law_named(law) if isinstance(law, str) else law)(model, tuning, options)
    if not isinstance(made, Law) or type(made) is Law:
        raise InputError("must inherit from airpuck.Law; see docs/control.md", field="law")
    return made


def law_named(name: str) -> Callable[..., Any]:
    """Return a factory that makes the named law from model, tuning and options."""
    return _users_law(name) if ".py:" in check_law(name, "law") else law_class(name)


def _users_law(name: str) -> Callable[..., Any]:
    """Return a factory that makes a user's law and checks its results."""
    code = UserCode(name, "--law")

    def make(*given: Any) -> Any:
        law = code.run("cannot be made from (model, tuning, options)", code.kind, *given)
        if not isinstance(law, Law):
            code.refuse("must inherit from airpuck.Law; see docs/control.md")
        return UserLaw(law, code)

    return make


@runtime_checkable
class Pilot(Protocol):
    """Computes commands: a `TrackingController`, or a user's class.

    A class that inherits from it only needs `step`. Override `pose` to receive the poses of the
    craft, or `measured` to receive all measurements.

    Examples
    --------
    >>> class Off(airpuck.Pilot):
    ...     def step(self, time):
    ...         return airpuck.Step(np.zeros(6))
    ...
    >>> log = airpuck.fly(Off(), airpuck.Twin(model), duration=0.05)
    >>> log.command.shape
    (5, 6)
    """

    #: The reference that the craft tracks; by default the middle of the table.
    reference: Reference = SetPoint(0.0, 0.0, 0.0)
    #: Other bodies that it sees by motion capture: the ``puck``, the other side's ``mallet``.
    watches: tuple[MeasurementKind, ...] = ()

    def measured(self, measurement: Measurement) -> None:
        """Receive a measurement; by default, pass the craft's poses to `pose`.

        Parameters
        ----------
        measurement : Measurement
            Poses of the craft and of the bodies that the pilot `watches`; readings of on-board
            sensors if the flight uses them.
        """
        if measurement.kind == "pose":
            self.pose(measurement.stamp, measurement.values)

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Receive a pose of the craft.

        Parameters
        ----------
        time : float
            Time stamp of the pose [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """

    def step(self, time: float) -> Step:
        """Compute the command to send now.

        Parameters
        ----------
        time : float
            Current time, on the clock of the poses [s].

        Returns
        -------
        Step
            The command; ``Step(command)`` is enough.
        """
        ...

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Receive the command that was actually sent.

        Parameters
        ----------
        time : float
            When [s].
        command : array, shape (n,)
            Motor commands.
        """
