"""What every optimiser takes and returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from airpuck.identification.objective import PredictionLoss, Shares
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
    #: What each cluster contributes to the loss at `parameters`, where it has clusters and the
    #: optimiser knows.
    shares: Shares | None = None


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
    """Go on from an optimum with another loss; iterations are counted on."""
    begun = outcome.history[-1].number

    def counted_on(iteration: Iteration) -> None:
        if iteration.number:  # where the last one ended has been told
            progress(replace(iteration, number=begun + iteration.number))

    after = method.minimize(loss, outcome.parameters, free, counted_on)
    steps = (replace(step, number=begun + step.number) for step in after.history if step.number)
    return replace(after, history=(*outcome.history, *steps))
