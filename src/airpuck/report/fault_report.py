"""What was wrong in a recording, when, and how sure that is: a page, and a section of others."""

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
#: What is sure fills all of its colour; what is doubtful fills less, down to this.
_FAINTEST = 0.25


def fault_section(trajectory: Trajectory, faults: Sequence[Span], model: Model) -> PageSection:
    """Show when a recording cannot be trusted."""
    spans = sorted((*trajectory.excluded, *faults), key=lambda span: span.start)
    if not spans:
        words = f"None was found in {trajectory.duration:.1f} s with {model.name}."
        return PageSection("faults", "Faults", (Text([words]),))
    evaluation = evaluate(model, trajectory)
    touched = touched_by(evaluation, spans)
    words = (
        f"Faults found with {model.name}, with the probability of their causes, and the errors of "
        f"its predictions after {evaluation.horizon_step * evaluation.sample_period:.2f} s. The "
        f"{touched.sum()} of {len(touched)} windows whose predictions meet a fault hold "
        f"{squares_held(evaluation.at_horizon, touched)} % of the squared error of x / y / yaw."
    )
    extent = float(trajectory.time[0]), float(trajectory.time[-1])
    figure = fault_timeline_figure(spans, evaluation, extent)
    rows = [
        [s.cause, f"{s.start:.3f}", f"{s.stop:.3f}", f"{s.stop - s.start:.3f}", confidence(s)]
        for s in spans
    ]
    headings = ["cause", "from [s]", "to [s]", "duration [s]", "confidence"]
    table = PageTable("What no model should be learned from.", headings, rows)
    return PageSection("faults", "Faults", (Picture("fault_timeline", figure, words), table))


def confidence(span: Span) -> str:
    """Write how sure a span is."""
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
        f"{100 * usable:.1f} % of them without any fault."
    )
    section = fault_section(trajectory, faults, model)
    return write_page(out, "Faults of a recording", lead, [section], origin)


def fault_color(cause: str) -> str:
    """Return the colour of a cause."""
    return _COLORS.get(cause, style.BLUE if cause.endswith("stalled") else style.GREY)


@style.styled
def fault_timeline_figure(
    spans: Sequence[Span], evaluation: Evaluation, extent: tuple[float, float]
) -> Figure:
    """Draw faults along a recording, one row for each cause, above the error of each window."""
    causes = list(dict.fromkeys(span.cause for span in sorted(spans, key=lambda s: s.start)))
    rows = max(len(causes), 1)
    figure = style.new_figure(style.PAGE_WIDTH, 3.6 + 0.24 * rows)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[0.24 * rows + 0.1, 1.3, 1.3])
    top = panels[0]
    for span in spans:
        row, color = causes.index(span.cause), fault_color(span.cause)
        # The edge keeps what is short visible.
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
    top.set_title("faults, each with the probability of its cause", loc="left")
    touched = touched_by(evaluation, spans)
    errors = evaluation.at_horizon
    sizes = (1e3 * np.hypot(errors[0], errors[1]), np.abs(errors[2]))
    for panel, size, name in zip(panels[1:], sizes, ("position [mm]", "yaw [rad]"), strict=True):
        style.draw_window_errors(panel, evaluation.start, size, touched)
        panel.set_ylabel(f"error of\n{name}")
    panels[-1].set_xlim(*extent)
    panels[-1].margins(x=0.01)
    panels[-1].set_xlabel("time [s]; of a window: the present, where its prediction starts")
    meets = style.key("whose prediction meets a fault", style.VERMILLION, marker=".")
    style.top_legend(figure, [style.key("windows", style.BLUE, marker="."), meets])
    return figure
