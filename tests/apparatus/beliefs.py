"""Models whose parameters have a known uncertainty, as after a fit."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Uncertainty


def uncertainty(
    vector: np.ndarray, spread: Any, *, lost: Sequence[Any] = (), clusters=30, quantile=2.0
) -> Uncertainty:
    """Return the uncertainty of parameters from their standard errors, or their covariance.

    An error of 0 stands for a parameter that was not learned; directions in `lost` are
    undetermined.
    """
    covariance = np.diag(np.square(spread)) if np.ndim(spread) == 1 else np.asarray(spread)
    errors = np.sqrt(np.diag(covariance))
    errors = np.where(errors > 0, errors, np.nan)
    directions = np.reshape(lost, (-1, len(vector)))
    return Uncertainty(vector, covariance, errors, directions, clusters, quantile)


def believed(model: Model, spread: Any = None, **more: Any) -> Model:
    """Return a model with an uncertainty, by default of 1 % of each learned parameter."""
    vector = model.parameters.to_vector()
    if spread is None:
        spread = 0.01 * np.abs(vector) * model.free
    return replace(model, uncertainty=uncertainty(vector, spread, **more))
