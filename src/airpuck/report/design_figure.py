"""Standard errors that a proposed flight is expected to give, and gave on the twin."""

from __future__ import annotations

import os

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airpuck.boundary.files import replacing
from airpuck.experiment_design.design import Design
from airpuck.experiment_design.trials import CheckedFlights
from airpuck.report.style import (
    BLUE,
    GREY,
    PAGE_WIDTH,
    VERMILLION,
    new_figure,
    png,
    styled,
    top_legend,
)


def write_design_figure(
    found: Design, checked: CheckedFlights | None, path: str | os.PathLike[str]
) -> None:
    """Write `design_figure` as PNG."""
    with replacing(path) as temporary:
        temporary.write_bytes(png(design_figure(found, checked)))


@styled
def design_figure(found: Design, checked: CheckedFlights | None = None) -> Figure:
    """Draw the relative standard errors of every quantity: now, usual, proposed, obtained."""
    figure = new_figure(PAGE_WIDTH, 1.0 + 0.24 * len(found.quantities.labels))
    axes = figure.add_subplot()
    rows = -np.arange(len(found.quantities.labels), dtype=float)
    alone = checked is not None
    usual, proposal = (
        one.relative_alone if alone else one.relative for one in (found.usual, found.proposal)
    )
    axes.hlines(rows, 100 * usual, 100 * proposal, color="#d9d9d9", lw=2.5)
    handles: list[Line2D] = []

    def dots(
        errors: Float[np.ndarray, " K"], marker: str, color: str, filled: bool, label: str
    ) -> None:
        shown = 100 * np.where(np.isfinite(errors), errors, np.nan)
        inside = color if filled else "white"
        (line,) = axes.plot(shown, rows, ls="", marker=marker, color=color, mfc=inside, ms=5.5)
        line.set_label(label)
        handles.append(line)

    if not alone and np.isfinite(found.relative_before).any():
        dots(found.relative_before, "s", GREY, True, "now")
    dots(usual, "o", GREY, False, "usual excitation, predicted")
    dots(proposal, "o", BLUE, True, "proposal, predicted")
    if checked is not None:
        marks = axes.plot(
            100 * checked.errors.T, rows, ls="", marker="|", color=VERMILLION, ms=9, mew=1.3
        )
        marks[0].set_label(f"proposal, obtained in {len(checked.errors)} flights")
        handles.append(marks[0])
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
    axes.grid(visible=True, axis="x", which="minor")
    axes.set_yticks(rows, found.quantities.labels)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_ylim(rows[-1] - 0.6, 0.6)
    axes.set_xlabel(
        f"standard error after {found.proposal.plan.duration_s:g} s [% of what it matters against]"
    )
    top_legend(figure, handles)
    return figure
