"""Faults of a recording with their times and confidence: a page, and a section of others."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.evaluate import evaluate
from airpuck.faults.strengths import (
    STRENGTH_HEADINGS,
    Strengths,
    actuator_strengths,
    strength_rows,
)
from airpuck.model.model_file import Model
from airpuck.report.page import Origin, PageSection, PageTable, Picture, Text, write_page
from airpuck.report.prediction_figures import (
    error_timeline_figure,
    squares_held,
    touched_by,
)


def fault_section(trajectory: Trajectory, faults: Sequence[Span], model: Model) -> PageSection:
    """Show when and why a recording cannot be trusted."""
    spans = sorted((*trajectory.excluded, *faults), key=lambda span: span.start)
    if not spans:
        words = f"{model.name} shows no passing faults in {trajectory.duration:.1f} s."
        return PageSection("faults", "Faults", (Text([words]),))
    evaluation = evaluate(model, trajectory)
    touched = touched_by(evaluation, spans)
    words = (
        f"Faults found with {model.name}, the probability of each cause, and prediction errors "
        f"after {evaluation.horizon_step * evaluation.sample_period:.2f} s. {touched.sum()} of "
        f"{len(touched)} windows overlap a fault; they account for "
        f"{squares_held(evaluation.at_horizon, touched)} % of the squared error (x / y / yaw)."
    )
    figure = error_timeline_figure(evaluation, spans)
    rows = [
        [s.cause, f"{s.start:.3f}", f"{s.stop:.3f}", f"{s.stop - s.start:.3f}", s.certainty]
        for s in spans
    ]
    headings = ["cause", "from [s]", "to [s]", "duration [s]", "confidence"]
    table = PageTable("Spans to exclude from identification.", headings, rows)
    return PageSection("faults", "Faults", (Picture("fault_timeline", figure, words), table))


def fault_report(
    trajectory: Trajectory,
    faults: Sequence[Span],
    model: Model,
    out: str | os.PathLike[str],
    origin: Origin | None = None,
) -> Path:
    """Write a page on the faults of a recording."""
    usable = trajectory.leave_out(faults).usable.mean()
    lead = (
        f"{trajectory.source}: {trajectory.duration:.1f} s, {len(trajectory)} samples, "
        f"{100 * usable:.1f} % of them without passing faults."
    )
    sections = [
        fault_section(trajectory, faults, model),
        strength_section(actuator_strengths(model, trajectory)),
    ]
    return write_page(out, "Faults of a recording", lead, sections, origin)


def strength_section(strengths: Strengths) -> PageSection:
    """Set the strength of each actuator beside the vehicle file's."""
    caption = (
        "Thrust at the largest command, with 95 % intervals. An actuator is judged in comparison "
        "with the median of the others, each relative to its nominal strength: it is weak if it is "
        "below by more than four standard errors, and by more than sound motors differ "
        "(nominal.thrust_spread in the vehicle file)."
    )
    table = PageTable(caption, STRENGTH_HEADINGS, strength_rows(strengths))
    words = [Text(list(strengths.sentences))] if strengths.sentences else []
    return PageSection("strengths", "Strength of each actuator", (*words, table))
