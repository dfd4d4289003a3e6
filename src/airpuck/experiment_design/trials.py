"""Flights of excitations on the twin: trials of candidates, and flights that check a proposal."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.compute.process import usable_cores
from airpuck.control.settings import ExcitationPlan
from airpuck.control.tuning import Tuning
from airpuck.data.trajectory import Trajectory
from airpuck.experiment_design.forecast import (
    HELD,
    ComparedQuantities,
    Information,
    information_of,
    loss_of,
)
from airpuck.identification.fit import identify
from airpuck.identification.retiming import retime_packets
from airpuck.identification.settings import Preparation
from airpuck.model.model_file import Model
from airpuck.model.rungs import named_rung
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import fly_excitation
from airpuck.twin.radio import as_received
from airpuck.twin.settings import TwinSettings

if TYPE_CHECKING:
    from airpuck.experiment_design.design import Design

#: Called with the number done and the total.
Progress = Callable[[float, float], None]

#: First seed of the flights that check a proposal; far from the seeds of the trials.
_CHECK_SEED = 1_000_000


class Trial(NamedTuple):
    """A flight of a plan on the twin."""

    #: Smallest distance to a rail [m]; 0: it touched one.
    clearance: float
    #: Its information about the model; None if it touched a rail, which no model includes.
    information: Information | None


def fly_trial(
    model: Model, settings: TwinSettings, tuning: Tuning, plan: ExcitationPlan, seed: int
) -> Trial:
    """Fly a plan on a twin of a model, and compute the flight's information about the model."""
    trajectory, clearance = _fly(model, settings, tuning, plan, seed)
    if not clearance:
        return Trial(clearance, None)
    delays = ()
    if model.delay_learned:
        # As in `identify`: with the mean delay of this radio, and packets at their arrival times.
        model = as_received(model, settings, tuning.period_s)
        (trajectory,), delays = retime_packets((trajectory,), model)
    return Trial(clearance, information_of(trajectory, model, plan.duration_s, delays))


def _fly(
    model: Model, settings: TwinSettings, tuning: Tuning, plan: ExcitationPlan, seed: int
) -> tuple[Trajectory, float]:
    """Fly a plan; return its data and the smallest distance to a rail [m], 0 if it touched one."""
    flown = fly_excitation(model, plan, seed, settings=settings, tuning=tuning)
    reach = np.array(settings.table.reach(model.vehicle.radius_m))
    free = float((reach - np.abs(flown.recording["pose"].values[:, :2])).min())
    clearance = 0.0 if flown.contacts else max(free, 0.0)
    return preprocess(flown.recording, model.vehicle), clearance


@contextmanager
def on_processes(processes: int | None) -> Iterator[Callable[..., Iterable[Any]]]:
    """Yield a function like the built-in `map` that by default uses one process per core."""
    if processes is not None and processes < 1:
        raise InputError("must be at least 1", field="processes")
    count = processes or usable_cores()
    if count == 1:
        yield map
        return
    # JAX has threads, which do not survive a fork.
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"))

    def run(*arguments: Any) -> Iterable[Any]:
        # The processes start here and inherit a blocked Ctrl-C, which a terminal sends to all.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return pool.map(*arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        yield run
    except KeyboardInterrupt:
        for process in list(pool._processes.values()):  # no public way before Python 3.14
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@dataclass(frozen=True, eq=False)
class CheckedFlights:
    """Flights of one plan, each identified separately."""

    labels: list[str]
    #: Predicted relative standard errors of such a flight alone.
    predicted: Float[np.ndarray, " K"]
    #: Relative standard errors that each fit reports.
    errors: Float[np.ndarray, "N K"]
    #: Deviation of each estimate from the truth, on the same scale.
    misses: Float[np.ndarray, "N K"]
    #: Smallest distance to a rail [m].
    clearance: Float[np.ndarray, " N"]

    @property
    def typical(self) -> Float[np.ndarray, " K"]:
        """Root mean square of the standard errors that the fits report."""
        return np.sqrt((self.errors**2).mean(axis=0))

    @property
    def ratio(self) -> Float[np.ndarray, " K"]:
        """Ratio of `typical` to `predicted`; nan where a quantity is fixed or undetermined."""
        counts = np.isfinite(self.predicted) & (self.predicted > HELD)
        unknown = np.full(len(counts), np.nan)
        return np.divide(self.typical, self.predicted, out=unknown, where=counts)

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``."""
        return {
            "quantities": {
                label: {
                    "predicted": float(self.predicted[k]),
                    "obtained": float(self.typical[k]),
                    "ratio": float(self.ratio[k]),
                    "misses": self.misses[:, k].tolist(),
                }
                for k, label in enumerate(self.labels)
            },
            "clearance_m": self.clearance.tolist(),
        }


def check_design(
    found: Design,
    flights: int = 4,
    *,
    processes: int | None = None,
    progress: Progress = lambda _done, _total: None,
) -> tuple[CheckedFlights, CheckedFlights]:
    """Fly the usual excitation and the proposal with other seeds, identify, and compare.

    Parameters
    ----------
    found : Design
        From `airpuck.design`.
    flights : int, default 4
        Number of flights of each of the two.
    processes : int, optional
        By default one per core. The result does not depend on it.
    progress : callable, optional
        Called with the number of flights done and the total.

    Returns
    -------
    usual, proposal : CheckedFlights
        Predicted standard errors, reported standard errors, and actual deviations.
    """
    numbers.CHECK_FLIGHTS.check(flights, "flights")
    candidates = (found.usual, found.proposal)
    plans = [candidate.plan for candidate in candidates for _ in range(flights)]
    seeds = [*range(_CHECK_SEED, _CHECK_SEED + flights)] * len(candidates)
    results = []
    with on_processes(processes) as run:
        act = partial(_fly_and_identify, found.model, found.settings, found.tuning)
        for result in run(act, plans, seeds):
            results.append(result)
            progress(len(results), len(plans))
    usual, proposal = (
        CheckedFlights(
            found.quantities.labels,
            candidate.relative_alone,
            *(np.array(each) for each in zip(*results[first : first + flights], strict=True)),
        )
        for candidate, first in zip(candidates, (0, flights), strict=True)
    )
    return usual, proposal


def _fly_and_identify(
    truth: Model, settings: TwinSettings, tuning: Tuning, plan: ExcitationPlan, seed: int
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"], float]:
    """Fly and identify; return relative standard errors, deviations and the clearance."""
    trajectory, clearance = _fly(truth, settings, tuning, plan, seed)
    model = identify(
        trajectory,
        named_rung(truth.name, frame=truth.frame),
        vehicle=truth.vehicle,
        initial=truth.parameters,
        loss=loss_of(truth),
        preparation=Preparation(delay="fit" if truth.delay_learned else "fixed"),
    ).model
    quantities = ComparedQuantities(truth)
    if truth.delay_learned:
        truth = as_received(truth, settings, tuning.period_s)
    missed = (quantities.values(model) - quantities.values(truth)) / quantities.scales
    return quantities.relative_errors_of(model), missed, clearance
