"""The interface of optimisers; continuing a fit with other data or other weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from airpuck.evaluation.evaluate import prediction_errors
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.model.parameters import Parameters

#: Degrees of freedom of the Student distribution; one is Cauchy's.
_DEGREES = 1.0
#: Weights between 0 and 2 have converged when none moves by more than this.
_SETTLED = 0.02
_MOST_PASSES = 12
#: Windows whose errors lie between these quantiles determine the derivative of the overall median
#: with respect to θ.
_AROUND = (0.4, 0.6)


@dataclass(frozen=True)
class Iteration:
    """One step of an optimiser."""

    #: 0 is the start.
    number: int
    #: Prediction loss on the training windows.
    loss: float

    def __str__(self) -> str:
        return f"iteration {self.number}: loss {self.loss:.4e}"


@dataclass(frozen=True)
class Outcome:
    """Result of an optimiser."""

    #: The best parameters found.
    parameters: Parameters
    #: Their prediction loss, without any regulariser.
    loss: float
    #: Iterations, beginning with the start.
    history: tuple[Iteration, ...]
    #: Whether the optimiser stopped by its own criterion.
    converged: bool
    #: Reason for stopping.
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
    """Continue from an optimum with another loss, and continue counting iterations."""

    def renumbered(step: Iteration) -> Iteration:
        return replace(step, number=outcome.history[-1].number + step.number)

    def report(step: Iteration) -> None:
        if step.number:  # its start is the end of the last fit, which was already reported
            progress(renumbered(step))

    after = method.minimize(loss, outcome.parameters, free, report)
    return replace(after, history=(*outcome.history, *map(renumbered, after.history[1:])))


def reweighted(
    method: Method,
    loss: PredictionLoss,
    outcome: Outcome,
    free: Bool[np.ndarray, " P"],
    progress: Callable[[Iteration], None] = lambda _: None,
) -> tuple[PredictionLoss, Outcome]:
    """Fit repeatedly, with each window weighted by how well the last fit predicts it.

    With s the mean squared weighted error of a window and σ² the median over all windows, a window
    gets the weight (ν + 1)/(ν + s/σ²), from Student's distribution with ν degrees of freedom
    (Holland and Welsch, Communications in Statistics A 6, 1977). If a window's error is ten times
    the median, its weight is a hundredth of the weight of a window without error.
    """
    weight, settled = np.ones(len(loss.windows)), False
    weighted, counted = loss, loss.multiplicity
    for _ in range(_MOST_PASSES):
        before, weight = weight, window_weights(loss, outcome.parameters)
        settled = bool(np.abs(weight - before).max() < _SETTLED)
        if settled:
            break
        weighted = replace(loss, multiplicity=weight if counted is None else counted * weight)
        outcome = minimize_on(method, weighted, outcome, free, progress)
    return weighted, replace(
        outcome,
        loss=loss.quadratic(outcome.parameters).loss,
        converged=settled and outcome.converged,
        message=outcome.message if settled else "the weights of the windows have not settled",
    )


def window_weights(loss: PredictionLoss, parameters: Parameters) -> Float[np.ndarray, " W"]:
    """Return the weight of each window, per count in the loss."""
    dynamics = replace(parameters.dynamics(np, loss.vehicle), frame=loss.frame)
    errors = prediction_errors(dynamics, loss.windows_at(parameters), loss.encoder)
    scaled = np.array(loss.weights)[:, None] * errors
    return student_weights(np.nanmean(scaled**2, axis=(0, 1)), loss.multiplicity)


def student_weights(
    square: Float[np.ndarray, " W"], times: Float[np.ndarray, " W"] | None = None
) -> Float[np.ndarray, " W"]:
    """Return the weights of windows with these mean squared errors; `times` are repetitions."""
    drawn = square if times is None else np.repeat(square, times.astype(int))
    return (_DEGREES + 1) / (_DEGREES + square / _typical(drawn))


def information_of_weights(
    square: Float[np.ndarray, " W"], gradient: Float[np.ndarray, "W P"]
) -> Float[np.ndarray, "P P"]:
    """Return the contribution of parameter-dependent weights to the information H = Σ w Hᵢ / Σ w.

    The weighted score Σ w ∇s changes with θ as Σ w ∇∇ᵀs + Σ ∇s (∂w/∂θ)ᵀ, where w = w(s/σ²) and σ²,
    the median of all s, moves with the windows around it. Windows whose predictions get worse lose
    weight: the second sum is negative.
    """
    weight, typical = student_weights(square), _typical(square)
    low, high = np.quantile(square, _AROUND)
    scale = gradient[(square >= low) & (square <= high)].mean(axis=0)
    slope = gradient / typical - np.outer(square / typical**2, scale)
    return -(gradient.T * weight**2 / (_DEGREES + 1)) @ slope / weight.sum()


def _typical(square: Float[np.ndarray, " W"]) -> float:
    """Return the scale σ² of windows' errors."""
    return max(float(np.median(square)), np.finfo(float).tiny)
