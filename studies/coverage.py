"""Do 95 % intervals contain the truth? Excitation flights of a known craft, identified one by one.

    python studies/coverage.py --flights 200 --duration 60 [--robust]

Prints for every parameter, and for thrust at half and full speed, the coverage of its interval and
the bias in standard errors. At the end it lists values outside their limits. The true transport
delay is the mean of the radio's delays, whose packets never overtake each other.
"""

from __future__ import annotations

import argparse
import multiprocessing
from functools import partial

import numpy as np
from recovery import true_delay, truth

from airpuck import Loss, bootstrap, identify, preprocess
from airpuck.compute.process import usable_cores
from airpuck.model.model_file import Model
from airpuck.physics.thrust import thrust
from airpuck.twin.experiments import excite

#: Speeds at which thrust is compared.
SPEEDS = np.array([0.5, 1.0])
#: Limits on the coverage of one parameter's intervals and of all together [%], and on the bias in
#: standard errors.
EACH, POOLED, BIAS = (88.5, 99.0), (93.0, 97.0), 1 / 3


def derived(model: Model) -> np.ndarray:
    """Return the thrust of every motor at `SPEEDS`, flat."""
    coefficients = np.asarray(model.parameters.thrust)
    speed = np.broadcast_to(SPEEDS, (len(coefficients), len(SPEEDS)))
    return thrust(coefficients, speed).ravel()


def labels(model: Model) -> list[str]:
    """Name what `errors_of` compares."""
    names = model.vehicle.propeller_names
    return model.parameters.labels(names) + [f"F({v:g}) {n}" for n in names for v in SPEEDS]


def errors_of(seed: int, duration: float, replicates: int, robust: bool) -> np.ndarray:
    """Fly, identify; return errors, standard errors and ends of the bootstrap's intervals."""
    model = truth()
    fit = identify(preprocess(excite(model, duration, seed)), "M3", loss=Loss(robust=robust))
    if replicates:
        fit = bootstrap(fit, replicates, seed=seed)
    known = fit.uncertainty
    assert known is not None
    true = model.with_delay(true_delay(model)).parameters.to_vector()
    error = fit.model.parameters.to_vector() - true
    error = np.concatenate([error, derived(fit.model) - derived(model)])
    spread = np.concatenate([known.standard_errors, fit.model.standard_error(derived)])
    ends = np.full((2, len(error)), np.nan)
    if known.bootstrap is not None:
        ends[0, : len(true)] = known.bootstrap.lower - true
        ends[1, : len(true)] = known.bootstrap.upper - true
    return np.stack([error, spread, np.full(len(error), known.quantile), *ends])


def covered(error: np.ndarray, spread: np.ndarray, quantile: np.ndarray) -> float:
    """Return the coverage of intervals, in percent."""
    known = np.isfinite(spread)
    return 100 * float(np.mean(np.abs(error[known]) <= (quantile * spread)[known]))


def report(results: np.ndarray) -> None:
    """Print coverage and bias, result by result and pooled."""
    error, spread, quantile, low, high = np.moveaxis(results, 1, 0)
    names, parameters = labels(truth()), len(truth().parameters.to_vector())
    outside = []
    for k, name in enumerate(names):
        known = np.isfinite(spread[:, k])
        if not known.any():
            continue
        e, s = error[known, k], spread[known, k]
        share, bias = covered(e, s, quantile[known, k]), float(np.mean(e / s))
        print(
            f"{name:28s} covered {share:5.1f} %   bias {bias:6.2f} SE   spread of errors / mean SE "
            f"{e.std(ddof=1) / s.mean():5.2f}   SE {s.mean():9.3g}   {known.sum()} flights"
        )
        if not EACH[0] <= share <= EACH[1] or abs(bias) > BIAS:
            outside.append(f"{name} ({share:.1f} %, {bias:.2f} SE)")
    for title, part in (("parameters", slice(parameters)), ("thrusts", slice(parameters, None))):
        pooled = covered(error[:, part], spread[:, part], quantile[:, part])
        print(f"pooled, {title}: {pooled:.1f} %")
        if not POOLED[0] <= pooled <= POOLED[1]:
            outside.append(f"pooled {title} ({pooled:.1f} %)")
    known = np.isfinite(low)
    if known.any():
        held = 100 * np.mean((low <= 0)[known] & (high >= 0)[known])
        print(f"pooled, parameters, bootstrap: {held:.1f} %")
    print("outside of the bounds:", ", ".join(outside) or "nothing")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=30)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--bootstrap", type=int, default=0)
    parser.add_argument("--robust", action="store_true", help="as identify --robust")
    parser.add_argument("--workers", type=int, default=usable_cores())
    options = parser.parse_args()
    task = partial(
        errors_of,
        duration=options.duration,
        replicates=options.bootstrap,
        robust=options.robust,
    )
    # JAX has threads, which do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with context.Pool(options.workers) as pool:
        results = []
        for number, result in enumerate(pool.imap(task, range(options.flights)), start=1):
            results.append(result)
            print(f"{number} of {options.flights} flights", flush=True)
    report(np.array(results))


if __name__ == "__main__":
    from one_line import run

    run(main)
