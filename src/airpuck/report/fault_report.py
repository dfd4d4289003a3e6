"""What was wrong in a recording, when, and how sure that is: a page, and a part of others."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.evaluate import evaluate
from airpuck.model.model_file import Model
from airpuck.report.error_timeline import touched_by
from airpuck.report.fault_timeline import fault_timeline_figure
from airpuck.report.page import Picture, Section, Table, write_page


def fault_section(trajectory: Trajectory, faults: Sequence[Span], model: Model) -> Section:
    """Show when a recording cannot be trusted."""
    spans = sorted((*trajectory.excluded, *faults), key=lambda span: span.start)
    evaluation = evaluate(model, trajectory)
    touched = touched_by(evaluation, spans)
    squares = evaluation.at_horizon**2
    # A model that predicts without any error has no squares to share out.
    held = 100 * squares[:, touched].sum(axis=1) / np.maximum(squares.sum(axis=1), 1e-300)
    words = (
        f"Faults found with {model.name}, with the probability of their causes, and the errors of "
        f"its predictions after {evaluation.horizon_step * evaluation.sample_period:.2f} s. The "
        f"{touched.sum()} of {len(touched)} windows whose predictions meet a fault hold "
        f"{' / '.join(f'{share:.0f}' for share in held)} % of the squared error of x / y / yaw."
    )
    extent = float(trajectory.time[0]), float(trajectory.time[-1])
    figure = fault_timeline_figure(spans, evaluation, extent)
    rows = [
        [s.cause, f"{s.start:.3f}", f"{s.stop:.3f}", f"{s.stop - s.start:.3f}", confidence(s)]
        for s in spans
    ]
    headings = ["cause", "from [s]", "to [s]", "duration [s]", "confidence"]
    table = Table("What no model should be learned from.", headings, rows)
    return Section("faults", "Faults", (Picture("fault_timeline", figure, words), table))


def confidence(span: Span) -> str:
    """Write how sure a span is."""
    return "measured" if span.confidence == 1 else f"{min(span.confidence, 0.99):.2f}"


def fault_report(
    trajectory: Trajectory,
    faults: Sequence[Span],
    model: Model,
    out: str | os.PathLike[str],
) -> Path:
    """Write a page on the faults of a recording."""
    usable = trajectory.leave_out(faults).usable.mean()
    lead = (
        f"{trajectory.source}: {trajectory.duration:.1f} s, {len(trajectory)} samples, "
        f"{100 * usable:.1f} % of them without any fault."
    )
    section = fault_section(trajectory, faults, model)
    return write_page(out, "Faults of a recording", lead, [section])
