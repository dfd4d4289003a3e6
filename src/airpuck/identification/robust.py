"""A fit that a few bad windows do not move: iteratively reweighted least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from airpuck.evaluation.evaluate import prediction_errors
from airpuck.identification.method import Iteration, Method, Outcome, minimize_on
from airpuck.identification.objective import PredictionLoss
from airpuck.model.parameters import Parameters

#: Degrees of freedom of the Student distribution; one is Cauchy's.
_DEGREES = 1.0
#: Weights between 0 and 2 are settled when none moves by more than this.
_SETTLED = 0.02
_MOST_PASSES = 12


def reweighted(
    method: Method,
    loss: PredictionLoss,
    outcome: Outcome,
    free: Bool[np.ndarray, " P"],
    progress: Callable[[Iteration], None] = lambda _: None,
) -> tuple[PredictionLoss, Outcome]:
    """Fit again and again, each window weighted by how well the last fit predicts it.

    With s the mean squared weighted error of a window and σ² the median of all, a window counts
    (ν + 1)/(ν + s/σ²): what Student's distribution of ν degrees of freedom asks for (Holland and
    Welsch, Communications in Statistics A 6, 1977). A window whose error is ten times the median's
    counts a hundredth of one without error.
    """
    if loss.multiplicity is not None:
        raise ValueError("windows that already count differently cannot be weighted")
    weight, settled = np.ones(len(loss.windows)), False
    weighted = loss
    for _ in range(_MOST_PASSES):
        before, weight = weight, window_weights(loss, outcome.parameters)
        settled = bool(np.abs(weight - before).max() < _SETTLED)
        if settled:
            break
        weighted = replace(loss, multiplicity=weight)
        outcome = minimize_on(method, weighted, outcome, free, progress)
    return weighted, replace(
        outcome,
        loss=loss.quadratic(outcome.parameters).loss,
        converged=settled and outcome.converged,
        message=outcome.message if settled else "the weights of the windows have not settled",
    )


def window_weights(loss: PredictionLoss, parameters: Parameters) -> Float[np.ndarray, " W"]:
    """Return how much each window counts."""
    dynamics = replace(parameters.dynamics(np, loss.vehicle), frame=loss.frame)
    errors = prediction_errors(dynamics, loss.windows_at(parameters), loss.encoder)
    scaled = np.array(loss.weights)[:, None] * errors
    square = np.mean(scaled**2, axis=(0, 1))
    typical = max(float(np.median(square)), np.finfo(float).tiny)
    return (_DEGREES + 1) / (_DEGREES + square / typical)
