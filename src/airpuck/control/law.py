"""What a law of the controller is, and what a control step gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, get_args

import numpy as np
from jaxtyping import Float

from airpuck.control.allocation import Outcome
from airpuck.control.reference import Reference
from airpuck.estimate.estimator import Estimate

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


class Law(Protocol):
    """Gives the command to a craft whose state is known for when the command begins to act.

    A step has three parts, so that the controller can compile the second together with its
    estimator's prediction.
    """

    @property
    def stage(self) -> Callable[..., tuple[Any, ...]]:
        """What is computed before the quadratic program, as a pure function.

        (xp, state, motor speeds, disturbance, effectiveness, *what `asked` returns) → arrays.
        """
        ...

    def asked(self, reference: Reference, now: float, delay: float) -> tuple[np.ndarray, ...]:
        """Return what the stage needs beside the estimate; always of the same shapes.

        ``now`` is when the command is sent, ``delay`` how much later it begins to act [s].
        """
        ...

    def finished(self, estimate: Estimate, staged: Sequence[Any]) -> Step:
        """Return the command, from what the stage computed."""
        ...
