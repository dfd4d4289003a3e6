"""Whether a flight gives the standard errors that were predicted: flown on the twin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.control.excitation_plan import ExcitationPlan
from airpuck.experiment_design.design import Design
from airpuck.experiment_design.expected_errors import fit_settings
from airpuck.experiment_design.quantities_of_interest import (
    HELD,
    interests,
    relative_errors,
    scales_of,
    values_of,
)
from airpuck.experiment_design.rehearsal import Crew, Stage, World
from airpuck.experiment_design.worth import Candidate
from airpuck.identification.fit import identify
from airpuck.model.rungs import named_rung
from airpuck.twin.radio import as_received

#: Far from the seeds of rehearsals.
_SEEDS = 1_000_000


@dataclass(frozen=True, eq=False)
class Obtained:
    """What flights of a plan gave, each identified by itself."""

    #: Relative standard errors that were predicted for such a flight alone.
    predicted: Float[np.ndarray, " K"]
    #: Relative standard errors that each fit states.
    errors: Float[np.ndarray, "N K"]
    #: By how much each estimate misses the truth, in the same shares.
    misses: Float[np.ndarray, "N K"]
    #: Least distance to a rail [m].
    clearance: Float[np.ndarray, " N"]

    @property
    def typical(self) -> Float[np.ndarray, " K"]:
        """Root mean square of the standard errors that the fits state."""
        return np.sqrt((self.errors**2).mean(axis=0))

    @property
    def ratio(self) -> Float[np.ndarray, " K"]:
        """Of `typical` to `predicted`; nan where it is held or not determined."""
        judged = np.isfinite(self.predicted) & (self.predicted > HELD)
        unknown = np.full(len(judged), np.nan)
        return np.divide(self.typical, self.predicted, out=unknown, where=judged)

    def to_json(self, labels: list[str]) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        return {
            "quantities": {
                label: {
                    "predicted": float(self.predicted[k]),
                    "obtained": float(self.typical[k]),
                    "ratio": float(self.ratio[k]),
                    "misses": self.misses[:, k].tolist(),
                }
                for k, label in enumerate(labels)
            },
            "clearance_m": self.clearance.tolist(),
        }


def check_design(
    found: Design,
    flights: int = 4,
    *,
    processes: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> tuple[Obtained, Obtained]:
    """Fly the usual excitation and the proposal with other chances, identify, and compare."""
    candidates = (found.usual, found.proposal)
    tasks = [(one.plan, _SEEDS + k) for one in candidates for k in range(flights)]
    results = []
    with Crew(found.stage, processes) as crew:
        for result in crew.fly(_identified, tasks):
            results.append(result)
            progress(len(results), len(tasks))
    usual, proposal = (
        _obtained(candidate, results[first : first + flights])
        for candidate, first in zip(candidates, (0, flights), strict=True)
    )
    return usual, proposal


def _identified(
    stage: Stage, plan: ExcitationPlan, seed: int, world: World
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"], float]:
    """Fly and identify; return relative standard errors, what is missed, and the clearance."""
    truth = stage.model
    trajectory, flown = stage.fly(plan, seed, world)
    fit = identify(
        trajectory,
        named_rung(truth.name),
        vehicle=truth.vehicle,
        initial=truth.parameters,
        delay="fit" if truth.delay_learned else "fixed",
        **fit_settings(truth),
    )
    wanted = interests(truth)
    if truth.delay_learned:
        truth = as_received(truth, stage.settings, stage.tuning.period_s)
    missed = values_of(fit.model, wanted) - values_of(truth, wanted)
    return relative_errors(fit.model, wanted), missed / scales_of(wanted), flown.clearance


def _obtained(candidate: Candidate, results: list[Any]) -> Obtained:
    """Collect what the flights of a plan gave."""
    errors, misses, clearance = (np.array(one) for one in zip(*results, strict=True))
    return Obtained(candidate.alone, errors, misses, clearance)
