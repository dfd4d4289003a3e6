"""Flights of excitations on the twin, and their information about a model."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.compute.process import usable_cores
from airpuck.control.settings import ExcitationPlan
from airpuck.control.tuning import Tuning
from airpuck.data.trajectory import Trajectory
from airpuck.experiment_design.forecast import Information, information_of
from airpuck.identification.retiming import retime_packets
from airpuck.model.model_file import Model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import fly_excitation
from airpuck.twin.radio import as_received
from airpuck.twin.settings import TwinSettings

#: Called with the number done and the total.
Progress = Callable[[float, float], None]


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
    trajectory, clearance = fly(model, settings, tuning, plan, seed)
    if not clearance:
        return Trial(clearance, None)
    delays = ()
    if model.delay_learned:
        # As in `identify`: with the mean delay of this radio, and packets at their arrival times.
        model = as_received(model, settings, tuning.period_s)
        (trajectory,), delays = retime_packets((trajectory,), model)
    return Trial(clearance, information_of(trajectory, model, plan.duration_s, delays))


def fly(
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
