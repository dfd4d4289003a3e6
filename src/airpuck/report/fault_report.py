"""Faults of a recording with their times and confidence: a page, and a section of others."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.evaluate import Evaluation, evaluate
from airpuck.faults.chain import RADIO_OUT, UNEXPLAINED
from airpuck.faults.find import CONTACT, NOT_ARMED
from airpuck.faults.strengths import (
    STRENGTH_HEADINGS,
    Strengths,
    actuator_strengths,
    strength_rows,
)
from airpuck.model.model_file import Model
from airpuck.report import style
from airpuck.report.page import Origin, PageSection, PageTable, Picture, Text, write_page
from airpuck.report.prediction_figures import squares_held, touched_by

_COLORS = {
    NOT_ARMED: style.PURPLE,
    RADIO_OUT: style.VERMILLION,
    CONTACT: style.ORANGE,
    UNEXPLAINED: style.SKY,
}
#: Opacity of a fault with zero confidence.
_FAINTEST = 0.25


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
    extent = float(trajectory.time[0]), float(trajectory.time[-1])
    figure = fault_timeline_figure(spans, evaluation, extent)
    rows = [
        [s.cause, f"{s.start:.3f}", f"{s.stop:.3f}", f"{s.stop - s.start:.3f}", confidence(s)]
        for s in spans
    ]
    headings = ["cause", "from [s]", "to [s]", "duration [s]", "confidence"]
    table = PageTable("Spans to exclude from identification.", headings, rows)
    return PageSection("faults", "Faults", (Picture("fault_timeline", figure, words), table))


def confidence(span: Span) -> str:
    """Format the confidence of a fault."""
    return "measured" if span.confidence == 1 else f"{min(span.confidence, 0.99):.2f}"


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


def fault_color(cause: str) -> str:
    """Return the colour of a cause."""
    return _COLORS.get(cause, style.BLUE if cause.endswith("stalled") else style.GREY)


@style.styled
def fault_timeline_figure(
    spans: Sequence[Span], evaluation: Evaluation, extent: tuple[float, float]
) -> Figure:
    """Draw faults over time, one row per cause, above the errors of the windows."""
    causes = list(dict.fromkeys(span.cause for span in sorted(spans, key=lambda s: s.start)))
    rows = max(len(causes), 1)
    figure = style.new_figure(style.PAGE_WIDTH, 3.6 + 0.24 * rows)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[0.24 * rows + 0.1, 1.3, 1.3])
    top = panels[0]
    for span in spans:
        row, color = causes.index(span.cause), fault_color(span.cause)
        # The edge keeps short faults visible.
        look = {"color": color, "lw": 1.5, "alpha": _FAINTEST + (1 - _FAINTEST) * span.confidence}
        top.broken_barh([(span.start, span.stop - span.start)], (row - 0.35, 0.7), **look)
        if span.confidence < 1:
            small = {"va": "center", "fontsize": 6.5, "color": style.GREY}
            style.note(top, confidence(span), (span.stop, row), (3, 0), **small)
        for panel in panels[1:]:
            panel.axvspan(span.start, span.stop, color=style.LIGHT, lw=0)
    top.set_yticks(range(len(causes)), causes)
    top.set_ylim(rows - 0.4, -0.6)
    top.grid(visible=False, axis="y")
    top.set_title("faults and the probability of each cause", loc="left")
    touched = touched_by(evaluation, spans)
    errors = evaluation.at_horizon
    sizes = (1e3 * np.hypot(errors[0], errors[1]), np.abs(errors[2]))
    for panel, size, name in zip(panels[1:], sizes, ("position [mm]", "yaw [rad]"), strict=True):
        style.draw_window_errors(panel, evaluation.start, size, touched)
        panel.set_ylabel(f"error of\n{name}")
    panels[-1].set_xlim(*extent)
    panels[-1].margins(x=0.01)
    panels[-1].set_xlabel("time [s]; windows are drawn where their prediction starts")
    meets = style.key("windows that overlap a fault", style.VERMILLION, marker=".")
    style.top_legend(figure, [style.key("windows", style.BLUE, marker="."), meets])
    return figure
