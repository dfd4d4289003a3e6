"""Rehearsals on the twin: how near to the rails an excitation comes, and what it would teach."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.compute.cores import usable_cores
from airpuck.control.excitation import excitation_controller
from airpuck.control.excitation_plan import ExcitationPlan
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning
from airpuck.data.trajectory import Trajectory
from airpuck.experiment_design.expected_errors import Information, information_of
from airpuck.identification.refinement import refined
from airpuck.model.model_file import Model, nominal_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import fly_excitation
from airpuck.twin.plant import Plant
from airpuck.twin.radio import as_received
from airpuck.twin.settings import TwinSettings
from airpuck.twin.twin import build_plant


@dataclass(frozen=True)
class Rehearsal:
    """A flight of an excitation on the twin."""

    #: What was flown.
    plan: ExcitationPlan
    #: Of signals, radio and noise.
    seed: int
    #: Least distance between craft and rail [m]; 0 where it met one.
    clearance: float
    #: For how long the signals paused near the rails [s].
    paused: float
    #: What it says about the model; None where it met a rail, which no model knows.
    information: Information | None


@dataclass(frozen=True, eq=False)
class World:
    """What is compiled once for all flights of a process."""

    #: The craft on the table.
    plant: Plant
    #: Of the excitation; flights copy it.
    controller: TrackingController


@dataclass(frozen=True, eq=False)
class Stage:
    """Where rehearsals are flown: the twin's truth and its settings."""

    #: The truth of the twin.
    model: Model
    #: Table, sensors, radio.
    settings: TwinSettings
    #: Of the controller.
    tuning: Tuning

    def build(self) -> World:
        """Compile what flights share."""
        return World(
            plant=build_plant(self.model, self.settings),
            controller=excitation_controller(nominal_model(self.model.vehicle), tuning=self.tuning),
        )

    def fly(self, plan: ExcitationPlan, seed: int, world: World) -> tuple[Trajectory, Rehearsal]:
        """Fly a plan."""
        flown = fly_excitation(
            self.model,
            plan.duration_s,
            seed,
            amplitude=plan.amplitude,
            hold=plan.hold_s,
            margin=plan.margin_m,
            settings=self.settings,
            tuning=self.tuning,
            plant=world.plant,
            controller=world.controller,
        )
        reach = np.array(self.settings.table.reach(self.model.vehicle.radius_m))
        free = (reach - np.abs(flown.recording["pose"].values[:, :2])).min()
        clearance = 0.0 if flown.contacts else max(float(free), 0.0)
        trajectory = preprocess(flown.recording, self.model.vehicle)
        return trajectory, Rehearsal(plan, seed, clearance, flown.paused, None)

    def rehearse(self, plan: ExcitationPlan, seed: int, world: World) -> Rehearsal:
        """Fly a plan and say what it teaches; see `fly`."""
        trajectory, flown = self.fly(plan, seed, world)
        if not flown.clearance:
            return flown
        model, delays = self.model, ()
        if model.delay_learned:
            # As `identify` will: with the mean delay of this radio, and packets where they arrived.
            model = as_received(model, self.settings, self.tuning.period_s)
            (trajectory,), delays = refined((trajectory,), model)
        information = information_of(trajectory, model, plan.duration_s, delays)
        return Rehearsal(plan, seed, flown.clearance, flown.paused, information)


Result = TypeVar("Result")
#: What is done with a plan and a seed.
Act = Callable[[Stage, ExcitationPlan, int, World], Result]

#: What the processes of a `Crew` keep between tasks.
_kept: tuple[Stage, World] | None = None


def _begin(stage: Stage) -> None:
    """Prepare a process."""
    global _kept
    _kept = stage, stage.build()


def _act(act: Act[Result], plan: ExcitationPlan, seed: int) -> Result:
    """Fly on the stage of this process."""
    assert _kept is not None
    return act(_kept[0], plan, seed, _kept[1])


class Crew:
    """Flies several plans at once, one process for each core; a context manager."""

    def __init__(self, stage: Stage, processes: int | None = None) -> None:
        if processes is not None and processes < 1:
            raise InputError("must be at least 1", field="processes")
        self._stage = stage
        self._count = processes or usable_cores()
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Crew:
        """Start the processes."""
        if self._count > 1:
            self._pool = ProcessPoolExecutor(
                self._count,
                # JAX has threads, which do not live through a fork.
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_begin,
                initargs=(self._stage,),
            )
        return self

    def __exit__(self, *_: Any) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def fly(
        self, act: Act[Result], tasks: Sequence[tuple[ExcitationPlan, int]]
    ) -> Iterator[Result]:
        """Fly plans."""
        if self._pool is not None:
            yield from self._pool.map(partial(_act, act), *zip(*tasks, strict=True))
            return
        world = self._stage.build()
        for plan, seed in tasks:
            yield act(self._stage, plan, seed, world)
