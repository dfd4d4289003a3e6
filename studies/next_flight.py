"""Are the predictions of `airpuck design` right? Standard errors, and clearance from the rails.

    python studies/next_flight.py --flights 20 --duration 60

Proposes an excitation for the published M3 without prior knowledge. It flies the proposal and the
usual excitation on the twin with seeds that no trial had, and identifies each flight separately.
The stated errors of the fits are compared with the predicted ones and with the true errors.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from airpuck.experiment_design.design import CheckedFlights, check_design, design
from airpuck.model.model_file import published_model
from airpuck.report.fit_figures import design_figure
from airpuck.report.style import write_png


def show_progress(done: int, total: int) -> None:
    """Print the progress."""
    print(f"{done} of {total} flights", file=sys.stderr, flush=True)


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
    usual, proposal = check_design(
        found, options.flights, processes=options.processes, progress=show_progress
    )
    report("usual", usual)
    report("proposal", proposal)
    if options.figure is not None:
        write_png(design_figure(found, proposal), options.figure)


if __name__ == "__main__":
    from one_line import run

    run(main)
