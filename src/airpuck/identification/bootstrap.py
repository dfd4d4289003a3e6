"""Intervals by resampling: draw blocks of time with replacement, and fit the model again.

The block bootstrap (Künsch 1989) makes no use of the curvature at the optimum. It captures
constraints that become active and nonlinearity, which the sandwich estimator does not. Lags that a
fit holds at the vehicle file's values are drawn from their errors.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from statistics import NormalDist

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.compute.process import usable_cores
from airpuck.craft.vehicle import Vehicle
from airpuck.identification.fit_result import Fit
from airpuck.identification.method import LevenbergMarquardt, reweighted
from airpuck.identification.retiming import variance_of_mean
from airpuck.model.parameters import LAG, Parameters, fix_gauge
from airpuck.model.uncertainty import Bootstrap

#: Fewer blocks than this cannot be resampled: too many draws would leave parameters undetermined.
_FEWEST = 5


def bootstrap(
    fit: Fit, replicates: int, *, seed: int = 0, progress: Callable[[int], None] = lambda _: None
) -> Fit:
    """Add intervals from fits to resampled data to the intervals from standard errors.

    Parameters
    ----------
    fit : Fit
        By `LevenbergMarquardt`.
    replicates : int
        Number of fits; a few hundred.
    seed : int, default 0
        Seed of the resampling.
    progress : callable, optional
        Called with the number of fits done.

    Returns
    -------
    Fit
        With ``uncertainty.bootstrap``.

    Raises
    ------
    InputError
        If the fit used another method, there are too few blocks of time, or fewer than two fits
        converged.

    Examples
    --------
    >>> fit = airpuck.bootstrap(fit, 10, seed=1)  # in earnest a few hundred
    >>> fit.uncertainty.bootstrap.replicates
    10
    """
    replace(numbers.REPLICATES, low=2).check(replicates, "bootstrap")
    numbers.SEED.check(seed, "seed")
    known = fit.uncertainty
    if known is None or fit.model.fit.get("method") != LevenbergMarquardt.__name__:
        raise InputError("works with Levenberg-Marquardt only", field="bootstrap")
    estimates = resampled_estimates(fit, replicates, seed=seed, progress=progress)
    lower, upper = np.percentile(estimates, [2.5, 97.5], axis=0)
    if fit.model.delay_jitter is not None:
        # The known packets are only a sample: as for the standard errors, that adds an error.
        spread = fit.model.delay_jitter.standard_deviation_s
        reach = NormalDist().inv_cdf(0.975) * variance_of_mean(fit.packet_delays, spread) ** 0.5
        delay = fit.model.parameters.mask(frozenset({"transport_delay"}))
        delay &= np.isfinite(known.standard_errors)
        middle, half = (lower + upper) / 2, np.hypot((upper - lower) / 2, reach)
        lower, upper = np.where(delay, [middle - half, middle + half], [lower, upper])
    # Along directions that the data do not determine, every fit stays at its start.
    learned = fit.model.free | held_lag(fit)
    determined = learned & (np.abs(known.undetermined) <= 1e-9).all(axis=0)
    lower, upper = np.where(determined, [lower, upper], np.nan)
    found = Bootstrap(len(estimates), seed, lower, upper)
    return replace(fit, model=replace(fit.model, uncertainty=replace(known, bootstrap=found)))


def resampled_estimates(
    fit: Fit, replicates: int, *, seed: int = 0, progress: Callable[[int], None] = lambda _: None
) -> Float[np.ndarray, "N P"]:
    """Fit to resampled data on all cores; return the estimates of the fits that converged."""
    loss, free = fit.objective, fit.model.free
    assert loss is not None and loss.clusters is not None
    clusters = loss.clusters
    count = int(clusters.max()) + 1
    if count < _FEWEST:
        raise InputError(
            f"needs at least {_FEWEST} blocks of two seconds; this recording has {count}",
            field="bootstrap",
        )
    rng = np.random.default_rng(seed)
    draws = rng.multinomial(count, np.full(count, 1 / count), size=replicates).astype(float)
    method = LevenbergMarquardt(tolerance=1e-5)
    weights = np.ones(len(clusters)) if loss.multiplicity is None else loss.multiplicity

    lags = drawn_lags(fit, rng, replicates)

    def fitted(
        draw: Float[np.ndarray, " G"], lagging: tuple[Parameters, Vehicle]
    ) -> Float[np.ndarray, " P"] | None:
        start, vehicle = lagging
        resampled = replace(loss, vehicle=vehicle, multiplicity=draw[clusters], clusters=None)
        weighted = replace(resampled, multiplicity=weights * draw[clusters])
        try:
            found = method.minimize(weighted, start, free)
            if fit.model.fit["robust"]:
                _, found = reweighted(method, resampled, found, free)
        except (InputError, ArithmeticError):
            return None  # this draw does not determine the parameters
        return fix_gauge(found.parameters, loss.vehicle, free).to_vector()

    found = []
    with ThreadPoolExecutor(usable_cores()) as pool:
        for number, vector in enumerate(pool.map(fitted, draws, lags), start=1):
            if vector is not None and np.isfinite(vector).all():
                found.append(vector)
            progress(number)
    if len(found) < 2:
        raise InputError("fewer than two fits to resampled data converged", field="bootstrap")
    return np.array(found)


def held_lag(fit: Fit) -> Bool[np.ndarray, " P"]:
    """Mark the motor lag if the fit held it; its standard error is then the vehicle file's."""
    known, lag = fit.uncertainty, fit.model.parameters.mask(LAG)
    stated = np.isfinite(known.standard_errors) if known is not None else np.zeros_like(lag)
    return lag & ~fit.model.free & stated


def drawn_lags(fit: Fit, rng: np.random.Generator, count: int) -> list[tuple[Parameters, Vehicle]]:
    """Draw the lags that the fit held from their errors, within their bounds."""
    parameters, vehicle, held = fit.model.parameters, fit.model.vehicle, held_lag(fit)
    vector, (lower, upper) = parameters.to_vector(), parameters.bounds()
    errors = np.zeros(len(vector))
    if held.any():
        assert fit.uncertainty is not None
        errors[held] = fit.uncertainty.standard_errors[held]
    drawn = []
    for _ in range(count):
        moved = vector + errors * rng.standard_normal()
        start = parameters.with_vector(np.where(held, np.clip(moved, lower, upper), vector))
        wheels = tuple(
            wheel.slower(wheel.lag_error * rng.standard_normal()) for wheel in vehicle.wheels
        )
        other = vehicle.model_copy(update={"wheels": wheels}) if wheels else vehicle
        drawn.append((start, other))
    return drawn
