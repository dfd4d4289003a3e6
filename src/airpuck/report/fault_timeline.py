"""When a recording cannot be trusted, and what that does to predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airpuck.data.trajectory import Span
from airpuck.evaluation.evaluate import Evaluation
from airpuck.faults.chain import RADIO_OUT, UNEXPLAINED
from airpuck.faults.find import CONTACT, NOT_ARMED
from airpuck.report.error_timeline import touched_by
from airpuck.report.style import (
    BLUE,
    GREY,
    LIGHT,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    SKY,
    VERMILLION,
    new_figure,
    styled,
    top_legend,
)

_COLORS = {NOT_ARMED: PURPLE, RADIO_OUT: VERMILLION, CONTACT: ORANGE, UNEXPLAINED: SKY}
#: What is sure fills this much of its colour; what is doubtful fills less.
_FAINTEST = 0.25


def fault_color(cause: str) -> str:
    """Return the colour of a cause."""
    return _COLORS.get(cause, BLUE if cause.endswith("stalled") else GREY)


@styled
def fault_timeline_figure(
    spans: Sequence[Span], evaluation: Evaluation, extent: tuple[float, float]
) -> Figure:
    """Draw faults along a recording, one row for each cause, above the error of each window."""
    causes = list(dict.fromkeys(span.cause for span in sorted(spans, key=lambda s: s.start)))
    rows = max(len(causes), 1)
    figure = new_figure(PAGE_WIDTH, 3.6 + 0.24 * rows)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[0.24 * rows + 0.1, 1.3, 1.3])
    top = panels[0]
    for span in spans:
        row, color = causes.index(span.cause), fault_color(span.cause)
        strength = _FAINTEST + (1 - _FAINTEST) * span.confidence
        # The edge keeps what is short visible.
        top.broken_barh(
            [(span.start, span.stop - span.start)],
            (row - 0.35, 0.7),
            facecolor=color,
            edgecolor=color,
            linewidth=1.5,
            alpha=strength,
        )
        if span.confidence < 1:
            top.annotate(
                f"{min(span.confidence, 0.99):.2f}",
                (span.stop, row),
                xytext=(3, 0),
                textcoords="offset points",
                va="center",
                fontsize=6.5,
                color=GREY,
            )
        for panel in panels[1:]:
            panel.axvspan(span.start, span.stop, color=LIGHT, lw=0)
    top.set_yticks(range(len(causes)), causes)
    top.set_ylim(rows - 0.4, -0.6)
    top.grid(visible=False, axis="y")
    top.set_title("faults, each with the probability of its cause", loc="left")
    touched = touched_by(evaluation, spans)
    errors = evaluation.at_horizon
    sizes = (1e3 * np.hypot(errors[0], errors[1]), np.abs(errors[2]))
    for panel, size, name in zip(panels[1:], sizes, ("position [mm]", "yaw [rad]"), strict=True):
        for chosen, color in ((~touched, BLUE), (touched, VERMILLION)):
            panel.vlines(evaluation.start[chosen], 0, size[chosen], color=color, lw=0.9)
            panel.plot(evaluation.start[chosen], size[chosen], ".", color=color, ms=3)
        panel.set_ylabel(f"error of\n{name}")
        panel.set_ylim(0, None)
    panels[-1].set_xlim(*extent)
    panels[-1].margins(x=0.01)
    panels[-1].set_xlabel("time [s]; of a window: the present, where its prediction starts")
    handles = [
        Line2D([], [], color=BLUE, marker=".", label="windows"),
        Line2D([], [], color=VERMILLION, marker=".", label="whose prediction meets a fault"),
    ]
    top_legend(figure, handles)
    return figure
