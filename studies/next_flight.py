"""Are the predictions of `airpuck design` right? Standard errors, and clearance from the rails.

    python studies/next_flight.py --flights 20 --duration 60

Proposes an excitation for the published M3 without prior knowledge. It flies the proposal and the
usual excitation on the twin with seeds that no trial had, and identifies each flight separately.
The stated errors of the fits are compared with the predicted ones and with the true errors.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from airpuck.control.settings import ExcitationPlan
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.experiment_design.design import Design, design
from airpuck.experiment_design.forecast import ComparedQuantities, fly, loss_of, on_processes
from airpuck.identification.fit import identify
from airpuck.identification.settings import Preparation
from airpuck.model.model_file import Model, published_model
from airpuck.report.fit_figures import design_figure
from airpuck.report.style import VERMILLION, label_rows, write_figure
from airpuck.twin.radio import as_received
from airpuck.twin.settings import TwinSettings, default_twin_settings

#: First seed of the flights that check a proposal; far from the seeds of the trials.
CHECK_SEED = 1_000_000


def show_progress(done: int, total: int) -> None:
    """Print the progress."""
    print(f"{done} of {total} flights", file=sys.stderr, flush=True)


@dataclass(frozen=True, eq=False)
class CheckedFlights:
    """Flights of one plan, each identified separately."""

    labels: list[str]
    #: Predicted relative standard errors of such a flight; nothing was known before.
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


def check_design(
    found: Design, flights: int, processes: int | None
) -> tuple[CheckedFlights, CheckedFlights]:
    """Fly the usual excitation and the proposal with other seeds, identify, and compare."""
    candidates = (found.usual, found.proposal)
    plans = [candidate.plan for candidate in candidates for _ in range(flights)]
    seeds = [*range(CHECK_SEED, CHECK_SEED + flights)] * len(candidates)
    results = []
    with on_processes(processes) as run:
        act = partial(
            _fly_and_identify, found.model, default_twin_settings(), tuning_for(found.model)
        )
        for result in run(act, plans, seeds):
            results.append(result)
            show_progress(len(results), len(plans))
    usual, proposal = (
        CheckedFlights(
            found.quantities.labels,
            candidate.relative,
            *(np.array(each) for each in zip(*results[first : first + flights], strict=True)),
        )
        for candidate, first in zip(candidates, (0, flights), strict=True)
    )
    return usual, proposal


def _fly_and_identify(
    truth: Model, settings: TwinSettings, tuning: Tuning, plan: ExcitationPlan, seed: int
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"], float]:
    """Fly and identify; return relative standard errors, deviations and the clearance."""
    trajectory, clearance = fly(truth, settings, tuning, plan, seed)
    model = identify(
        trajectory,
        truth.rung,
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


def report(name: str, one: CheckedFlights) -> None:
    """Print predicted and obtained errors [%], and true errors in stated errors (RMS)."""
    ratio = one.typical / one.predicted
    missed = np.sqrt(((one.misses / one.errors) ** 2).mean(axis=0))
    print(f"{name}: predicted %, obtained %, ratio; missed, in stated errors")
    for k, label in enumerate(one.labels):
        print(
            f"  {label:20s} {100 * one.predicted[k]:6.2f} {100 * one.typical[k]:6.2f} "
            f"{ratio[k]:5.2f}   {missed[k]:5.2f}"
        )
    print(
        f"  ratios from {ratio.min():.2f} to {ratio.max():.2f}; worst quantity "
        f"{100 * one.predicted.max():.2f} % predicted, {100 * one.typical.max():.2f} % obtained; "
        f"least distance to a rail {1e3 * one.clearance.min():.0f} mm, "
        f"contacts in {int((one.clearance == 0).sum())} of {len(one.clearance)} flights"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--criterion", choices=("worst", "mean"), default="worst")
    parser.add_argument("--processes", type=int, default=None)
    parser.add_argument("--figure", default=None)
    options = parser.parse_args()
    model = replace(published_model("M3"), frame="body", indexing="start")
    found = design(
        model,
        duration=options.duration,
        criterion=options.criterion,
        processes=options.processes,
        progress=show_progress,
    )
    print("usual:", found.usual.plan)
    print("proposal:", found.proposal.plan)
    usual, proposal = check_design(found, options.flights, options.processes)
    report("usual", usual)
    report("proposal", proposal)
    if options.figure is not None:
        figure = design_figure(found)
        rows = label_rows(figure.axes[0], proposal.labels)
        figure.axes[0].plot(100 * proposal.errors.T, rows, "|", color=VERMILLION, ms=9, mew=1.3)
        write_figure(figure, options.figure)


if __name__ == "__main__":
    from one_line import run

    run(main)
