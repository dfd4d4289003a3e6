"""`+residual`: a small neural network for what the physics leaves unexplained.

It adds accelerations, as a function of the velocities in the body frame and of the thrusts. The
physics is frozen, so its parameters keep their meaning. Levenberg-Marquardt minimises the same
multi-step loss on three of four blocks of time; the weights come from the iteration that
predicts the other blocks best.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import percent
from airpuck.craft.vehicle import Vehicle
from airpuck.identification.fit_result import Fit
from airpuck.identification.objective import Quadratic
from airpuck.model.rungs import NEURAL
from airpuck.physics.effects import HIDDEN

#: Every fourth block of time is held out.
_HELD_OUT = 4
#: Fewest blocks.
_FEWEST = 8
#: First damping, relative to the mean curvature, and its factors after a better and a worse step.
_DAMPING, _LESS, _MORE = 1e-2, 0.3, 5.0
#: Most iterations, and iterations without a better prediction after which training stops.
_MOST, _PATIENCE = 40, 5
#: Standard deviation of the first weights of the hidden units, for inputs of about one.
_FIRST = 0.5


def first_weights(vehicle: Vehicle) -> Float[np.ndarray, " w"]:
    """Return random hidden units whose outputs count for nothing yet."""
    hidden = np.random.default_rng(0).normal(0, _FIRST, HIDDEN * (4 + vehicle.n_propellers))
    return np.concatenate([hidden, np.zeros(3 * HIDDEN)])


def with_residual(fit: Fit) -> Fit:
    """Train a residual on the windows of a fit, and add it to the model."""
    model, objective = fit.model, fit.objective
    assert objective is not None
    parameters = replace(model.parameters, residual=first_weights(model.vehicle))
    mine, vector = parameters.mask(frozenset({NEURAL})), parameters.to_vector()
    found = objective.quadratic(parameters)
    count = len(found.cluster_losses)
    if count < _FEWEST:
        problem = f"+{NEURAL} needs {_FEWEST} blocks of time, and there are {count}; fly longer"
        raise InputError(problem, field="model")
    held = np.arange(count) % _HELD_OUT == _HELD_OUT - 1
    before = best = float(found.cluster_losses[held].sum())
    kept, damping, waited = vector, _DAMPING, 0
    for _ in range(_MOST):
        moved = vector.copy()
        moved[mine] += _step(found, ~held, mine, damping)
        tried = objective.quadratic(parameters.with_vector(moved))
        if tried.cluster_losses[~held].sum() >= found.cluster_losses[~held].sum():
            damping *= _MORE
            waited += 1
        else:
            damping, vector, found = damping * _LESS, moved, tried
            waited += 1
            if (now := float(tried.cluster_losses[held].sum())) < best:
                best, kept, waited = now, vector, 0
        if waited >= _PATIENCE:
            break
    gain = percent(1 - best / before)
    note = f"a neural term lowers the loss of the blocks that it was not trained on by {gain}"
    return replace(fit, model=_added(model, parameters.with_vector(kept), mine, note))


def _step(
    found: Quadratic, used: Bool[np.ndarray, " G"], mine: Bool[np.ndarray, " P"], damping: float
) -> Float[np.ndarray, " w"]:
    """Return a damped Gauss-Newton step of the weights."""
    gradient = found.scores[used].sum(axis=0)[mine]
    hessian = found.informations[used].sum(axis=0)[np.ix_(mine, mine)]
    scale = float(np.trace(hessian)) / len(gradient)
    return -np.linalg.solve(hessian + damping * scale * np.eye(len(gradient)), gradient)


def _added(model: Any, parameters: Any, mine: Bool[np.ndarray, " P"], note: str) -> Any:
    """Return the model with these weights, whose errors are unknown."""
    free = mine.copy()
    free[~mine] = model.free
    known = model.uncertainty
    if known is not None:
        size, physics = len(mine), np.ix_(~mine, ~mine)
        covariance, errors = np.zeros((size, size)), np.full(size, np.nan)
        undetermined = np.zeros((len(known.undetermined), size))
        covariance[physics], errors[~mine] = known.covariance, known.standard_errors
        undetermined[:, ~mine] = known.undetermined
        known = replace(
            known,
            estimate=parameters.to_vector(),
            covariance=covariance,
            standard_errors=errors,
            undetermined=undetermined,
            notes=(*known.notes, note),
            bootstrap=None,
        )
    name = f"{model.name}+{NEURAL}"
    return replace(model, name=name, parameters=parameters, free=free, uncertainty=known)
