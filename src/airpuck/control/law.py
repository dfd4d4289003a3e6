"""What a law of the controller is, and what a control step gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float

from airpuck.boundary.user_code import UserCode
from airpuck.compute.compiled import program
from airpuck.control.allocation import Outcome
from airpuck.control.reference import Reference
from airpuck.control.tuning import Tuning
from airpuck.craft.table import Table
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model

#: What became of a prediction. ``optimal``: within all limits. ``softened``: beyond a limit of the
#: craft's motion, by as little as possible. ``iteration limit``: the solver gave nothing usable,
#: the plan of the step before is flown on. ``fallback``: there is none, an LQR steers.
Predicted = Literal["optimal", "softened", "iteration limit", "fallback"]
_Refused = Literal["no pose", "stale pose", "jumping pose", "bad input", "open loop", "unsafe"]
#: How a control step ended. The outcomes of allocation and prediction fly; all others idle the
#: motors; a guard around the controller sets ``unsafe``.
Status = Outcome | Predicted | _Refused
#: What holds a plan back.
Bound = Literal["nothing", "motor", "motion"]
FLYING: tuple[Status, ...] = ("exact", "scaled", "nearest", *get_args(Predicted), "open loop")


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a predictive law expects.

    Attributes
    ----------
    times : array, shape (N,)
        From when the command begins to act [s].
    states : array, shape (N, 6)
        x, y, γ and their rates at these times.
    active : tuple of str
        Limits at which the plan is somewhere: ``motor``, ``rail``, ``speed``, ``spin``, ``disc``.
    """

    times: Float[np.ndarray, " N"]
    states: Float[np.ndarray, "N 6"]
    active: tuple[str, ...]

    @property
    def bound_by(self) -> Bound:
        """What holds the plan back most: the craft's motion is limited, its motors are, nothing."""
        if set(self.active) - {"motor"}:
            return "motion"
        return "motor" if self.active else "nothing"


@dataclass(frozen=True, eq=False)
class Step:
    """Result of a control step.

    Attributes
    ----------
    command : array, shape (n,)
        Motor commands to send, finite and within the vehicle's limits; an array of the caller's
        own, to change at will.
    status : str, default "open loop"
        ``exact``, ``scaled``, ``nearest`` (`LQR`), ``optimal``, ``softened``, ``iteration limit``,
        ``fallback`` (`MPC`): the craft flies, ``open loop``: without a law; anything else: the
        motors idle, and this is why.
    request : array, shape (3,), default 0
        Acceleration asked of the allocation (`LQR`), or expected of the plan of the step before,
        moved on (`MPC`) [m/s², m/s², rad/s²]; zero when idle.
    estimate : Estimate or None
        State at the time at which the command will begin to act; None when idle.
    prediction : Prediction or None
        What a predictive law expects from then on.
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
    """One control step, as a law sees it."""

    reference: Reference
    #: When the command is sent, and how much later it begins to act [s].
    now: float
    delay: float
    #: Takes the inputs of the law's stage. Returns the craft as predicted for when the command
    #: begins to act, and the results of the stage there.
    foresee: Callable[..., tuple[Estimate, Sequence[Any]]]


@dataclass(frozen=True, eq=False)
class LawOptions:
    """What a controller passes on to its law."""

    #: Whose rails a predictive law keeps to.
    table: Table = field(default_factory=Table)
    #: Of the LQR; by default that of the tuning's weights.
    gain: Float[np.ndarray, "3 6"] | None = None
    #: Whether the estimated disturbance is compensated.
    reject_disturbance: bool = True
    #: Whether to compile the mathematics or to run it in NumPy.
    compiled: bool = True


class Law:
    """Finds the command for a craft whose state is predicted to when the command begins to act.

    A step takes the law's state and returns the next one; the law itself stays as it is. Whatever
    can be a pure function of the prediction goes into `stage`: the controller compiles it together
    with the prediction of its estimator, since every call of a program costs time.

    Parameters
    ----------
    model : Model
        The craft.
    tuning : Tuning
        Period, weights, and what else is chosen.
    options : LawOptions, optional
        What the controller was told.

    Attributes
    ----------
    stage : callable or None
        (array namespace, state, motor speeds, disturbance, effectiveness, *inputs) to arrays; None:
        there is none.
    inputs : tuple of array
        Inputs of the stage beside the estimate, as examples of their shapes.
    """

    stage: Callable[..., tuple[Any, ...]] | None = None
    inputs: tuple[np.ndarray, ...] = ()

    def __init__(self, model: Model, tuning: Tuning, options: LawOptions | None = None) -> None: ...

    def init(self) -> Any:
        """Return the state before the first step.

        Returns
        -------
        object
            By default None: such a law remembers nothing.
        """
        return None

    def step(self, state: Any, moment: Moment) -> tuple[Step, Any]:
        """Find the command to send now.

        Parameters
        ----------
        state : object
            From `init` or the step before.
        moment : Moment
            Reference and time, and the prediction of the craft.

        Returns
        -------
        step : Step
            The command.
        state : object
            For the next step.
        """
        raise NotImplementedError


class UserLaw(Law):
    """A law of a user's class, behind the boundary."""

    def __init__(self, own: Law, code: UserCode) -> None:
        self._own, self._code = own, code
        self.stage, self.inputs = own.stage, own.inputs

    def init(self) -> Any:
        """Return the state before the first step; see `Law.init`."""
        return self._code.run("init()", self._own.init)

    def step(self, state: Any, moment: Moment) -> tuple[Step, Any]:
        """Find the command; see `Law.step`."""
        what = f"step() at {moment.now:.2f} s"
        found = self._code.run(what, self._own.step, state, moment)
        if not (isinstance(found, tuple) and len(found) == 2 and isinstance(found[0], Step)):
            self._code.refuse(f"{what} must return an airpuck.Step and the next state")
        return found


def staged(law: Law, model: Model, compiled: bool) -> Callable[..., tuple[Estimate, Sequence[Any]]]:
    """Return the stage of a law for estimates that are given: (estimate, *inputs) → `foresee`'s."""
    if law.stage is None:
        return lambda estimate: (estimate, ())
    axes, motors = np.zeros(3), np.zeros(model.vehicle.n_propellers)
    compute = program(law.stage, np.zeros(6), motors, axes, motors, *law.inputs, compiled=compiled)

    def computed(e: Estimate, *inputs: Any) -> tuple[Estimate, Sequence[Any]]:
        return e, compute(e.state, e.motor_speed, e.disturbance, e.effectiveness, *inputs)

    return computed
