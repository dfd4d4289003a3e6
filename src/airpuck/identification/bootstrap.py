"""Intervals by resampling: blocks of time are drawn with replacement, and the model fitted again.

The block bootstrap (Künsch 1989) makes no use of the curvature at the optimum: it feels
constraints that begin to bind and curves that bend, which the sandwich estimator does not.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.errors import InputError
from airpuck.compute.process import usable_cores
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.objective import PredictionLoss
from airpuck.model.gauge import fix_gauge
from airpuck.model.parameters import Parameters
from airpuck.model.uncertainty import Bootstrap

#: Fewer blocks than this cannot be resampled: too many draws would leave parameters undetermined.
_FEWEST = 5


def bootstrap(
    loss: PredictionLoss,
    parameters: Parameters,
    free: Bool[np.ndarray, " P"],
    clusters: Int[np.ndarray, " W"],
    replicates: int,
    *,
    undetermined: Float[np.ndarray, "K P"] | None = None,
    seed: int = 0,
    method: LevenbergMarquardt | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> tuple[Bootstrap, Float[np.ndarray, "N P"]]:
    """Fit a model to resampled data, on all cores.

    Parameters
    ----------
    loss : PredictionLoss
        The loss that was minimised.
    parameters : Parameters
        Its optimum, where every fit starts.
    free : array of bool, shape (P,)
        What is estimated.
    clusters : array of int, shape (W,)
        The block that each window belongs to.
    replicates : int
        Number of fits N.
    undetermined : array, shape (K, P), optional
        Directions that the data do not determine (`Uncertainty.undetermined`): a fit stays where it
        started along them, which says nothing, so what they move gets no interval.
    seed : int, default 0
        Seed of the resampling.
    method : LevenbergMarquardt, optional
        How to fit.
    progress : callable, optional
        Called with the number of fits done.

    Returns
    -------
    intervals : Bootstrap
        From percentiles.
    estimates : array, shape (N', P)
        Of the fits that came to an end.

    Raises
    ------
    InputError
        If there are too few blocks, or fewer than two fits came to an end.
    """
    count = int(clusters.max()) + 1
    if count < _FEWEST:
        raise InputError(
            f"needs at least {_FEWEST} blocks of two seconds, this recording has {count}",
            field="bootstrap",
        )
    rng = np.random.default_rng(seed)
    draws = rng.multinomial(count, np.full(count, 1 / count), size=replicates).astype(float)
    method = method or LevenbergMarquardt(tolerance=1e-5)
    counted = np.ones(len(clusters)) if loss.multiplicity is None else loss.multiplicity

    def fit(draw: Float[np.ndarray, " G"]) -> Float[np.ndarray, " P"] | None:
        resampled = replace(loss, multiplicity=counted * draw[clusters], clusters=None)
        try:
            found = method.minimize(resampled, parameters, free).parameters
            return fix_gauge(found, loss.vehicle, free).to_vector()
        except (InputError, ArithmeticError):
            return None  # this draw does not determine the parameters

    found = []
    with ThreadPoolExecutor(usable_cores()) as pool:
        for number, vector in enumerate(pool.map(fit, draws), start=1):
            if vector is not None and np.isfinite(vector).all():
                found.append(vector)
            progress(number)
    if len(found) < 2:
        raise InputError("hardly any fit to resampled data came to an end", field="bootstrap")
    estimates = np.array(found)
    lower, upper = np.percentile(estimates, [2.5, 97.5], axis=0)
    known = free
    if undetermined is not None:
        known = free & (np.abs(undetermined) <= 1e-9).all(axis=0)
    nothing = np.where(known, 0.0, np.nan)
    return Bootstrap(len(found), seed, lower + nothing, upper + nothing), estimates
