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
    """One step of an optimiser.

    Attributes
    ----------
    number : int
        0 is the start. A step of Levenberg-Marquardt, an epoch of Adam.
    loss : float
        Prediction loss on the training windows.
    test_loss : float or None
        The same on windows held out, where the optimiser holds some out.
    """

    number: int
    loss: float
    test_loss: float | None = None


@dataclass(frozen=True)
class Outcome:
    """Result of an optimiser.

    Attributes
    ----------
    parameters : Parameters
        The best ones found.
    loss : float
        Their prediction loss, without any regulariser.
    history : tuple of Iteration
        The way there, beginning with the start.
    converged : bool
        Whether the optimiser stopped by its own criterion.
    message : str
        Why it stopped.
    shares : Shares or None
        What each cluster contributes to the loss at `parameters`, where it has clusters and the
        optimiser knows.
    """

    parameters: Parameters
    loss: float
    history: tuple[Iteration, ...]
    converged: bool
    message: str
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
        """Minimise a prediction loss.

        Parameters
        ----------
        loss : PredictionLoss
            What to minimise.
        parameters : Parameters
            Where to start.
        free : array of bool, shape (P,)
            Which entries of ``parameters.to_vector()`` may change.
        progress : callable, optional
            Called after every iteration.

        Returns
        -------
        Outcome
            The best parameters and the way there.
        """
        ...


def minimize_on(
    method: Method,
    loss: PredictionLoss,
    outcome: Outcome,
    free: Bool[np.ndarray, " P"],
    progress: Callable[[Iteration], None] = lambda _: None,
) -> Outcome:
    """Go on from an optimum with another loss; iterations are counted on.

    Parameters
    ----------
    method : Method
        The optimiser.
    loss : PredictionLoss
        What to minimise now.
    outcome : Outcome
        Where to start.
    free : array of bool, shape (P,)
        Entries that may change.
    progress : callable, optional
        Called after every iteration.

    Returns
    -------
    Outcome
        The optimum of `loss`; its history begins with that of `outcome`.
    """
    begun = outcome.history[-1].number

    def counted_on(iteration: Iteration) -> None:
        if iteration.number:  # where the last one ended has been told
            progress(replace(iteration, number=begun + iteration.number))

    after = method.minimize(loss, outcome.parameters, free, counted_on)
    steps = (replace(step, number=begun + step.number) for step in after.history if step.number)
    return replace(after, history=(*outcome.history, *steps))
