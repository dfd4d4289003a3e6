"""Closed-loop cost against nonlinear predictive control solved to convergence."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.control.law import Moment, Step
from airpuck.control.laws import LAWS
from airpuck.control.mpc import MPC, Ongoing
from airpuck.control.predictive import PredictiveSettings
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning
from airpuck.craft.table import Table

from .converged import Converged, Problem, accelerations
from .flights import Flight, Pose, calm, craft, flown

#: No rails, which have a separate study.
_WIDE = calm().model_copy(update={"table": Table(length_m=20.0, width_m=20.0)})
#: Starts and targets, at rest: half the table's length and width, any yaw.
_AREA = np.array([0.9, 0.4, np.pi])


def flight_cost(flight: Flight, tuning: Tuning) -> float:
    """Integrate the regulator's cost over a flight."""
    weights, n = tuning.of(PredictiveSettings).weights, flight.command.shape[1]
    felt = accelerations(craft().dynamics, flight.state.T)
    sent = flight.sent.searchsorted(flight.time - craft().transport_delay, side="right") - 1
    held = np.where((sent >= 0)[:, None], flight.command[sent], 0.0)
    used = np.maximum(held - craft().vehicle.command_min, 0.0)
    rate = flight.error**2 @ weights.errors + weights.efforts @ felt**2
    rate += weights.command * (used**2 @ np.ones(n))
    return float(np.trapezoid(rate, flight.time))


@dataclass(frozen=True)
class Pair:
    """The same flight by the predictive law and by the converged solution."""

    #: Costs.
    ours: float
    converged: float
    #: Medians of the time of a step [s].
    our_step: float
    converged_step: float
    #: Share of the steps whose solver reached its tolerance.
    solved: float


class Timed(MPC):
    """Measures its steps."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.spent: list[float] = []

    def step(self, state: Ongoing, moment: Moment) -> tuple[Step, Ongoing]:
        """Find the command, and note how long that took."""
        began = time.perf_counter()
        found = super().step(state, moment)
        self.spent.append(time.perf_counter() - began)
        return found


def start_and_target(seed: int) -> tuple[Pose, Pose]:
    """Draw two poses."""
    rng = np.random.default_rng([seed, 7])
    start, target = (rng.uniform(-_AREA, _AREA).tolist() for _ in range(2))
    return tuple(start), tuple(target)


def compare(seed: int, tuning: Tuning, duration: float, problem: Problem) -> Pair:
    """Fly from one random pose to another, twice."""
    start, target = start_and_target(seed)
    ours: list[Timed] = []
    theirs: list[Converged] = []

    def by_law(reference: SetPoint, tuning: Tuning) -> TrackingController:
        LAWS["timed"] = Timed
        tuning = tuning.with_law("timed")
        controller = TrackingController(craft(), reference, tuning, table=_WIDE.table)
        assert isinstance(controller.law, Timed)
        ours.append(controller.law)
        return controller

    def by_solver(reference: SetPoint, tuning: Tuning) -> TrackingController:
        theirs.append(Converged(problem))
        LAWS["converged"] = lambda *_: theirs[0]
        return TrackingController(craft(), reference, tuning.with_law("converged"))

    costs = [
        flight_cost(flown(start, target, tuning, duration, settings=_WIDE, make=make), tuning)
        for make in (by_law, by_solver)
    ]
    steps = float(np.median(ours[0].spent)), float(np.median(theirs[0].spent))
    return Pair(*costs, *steps, float(np.mean(theirs[0].converged)))
