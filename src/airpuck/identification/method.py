"""What every optimiser takes and returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.model.parameters import Parameters


@dataclass(frozen=True)
class Iteration:
    """One step of an optimiser."""

    #: 0 is the start. A step of Levenberg-Marquardt, an epoch of Adam.
    number: int
    #: Prediction loss on the training windows.
    loss: float
    #: The same on windows held out, where the optimiser holds some out.
    test_loss: float | None = None


@dataclass(frozen=True)
class Outcome:
    """Result of an optimiser."""

    #: The best ones found.
    parameters: Parameters
    #: Their prediction loss, without any regulariser.
    loss: float
    #: The way there, beginning with the start.
    history: tuple[Iteration, ...]
    #: Whether the optimiser stopped by its own criterion.
    converged: bool
    #: Why it stopped.
    message: str
    #: The loss that was minimised, at `parameters`; None where the optimiser does not evaluate it.
    quadratic: Quadratic | None = None


@runtime_checkable
class Method(Protocol):
    """An optimiser, with its settings."""

    def minimize(
        self,
        loss: PredictionLoss,
        parameters: Parameters,
        free: Bool[np.ndarray, " P"],
        progress: Callable[[Iteration], None] = ...,
    ) -> Outcome:
        """Minimise a prediction loss."""
        ...


def minimize_on(
    method: Method,
    loss: PredictionLoss,
    outcome: Outcome,
    free: Bool[np.ndarray, " P"],
    progress: Callable[[Iteration], None] = lambda _: None,
) -> Outcome:
    """Go on from an optimum with another loss, and with the count of iterations."""
    begun = outcome.history[-1].number

    def renumbered(iteration: Iteration) -> None:
        if iteration.number:  # its start is the end of the last fit, which was reported
            progress(replace(iteration, number=begun + iteration.number))

    after = method.minimize(loss, outcome.parameters, free, renumbered)
    steps = (replace(step, number=begun + step.number) for step in after.history if step.number)
    return replace(after, history=(*outcome.history, *steps))
