"""Standard errors that a proposed flight is expected to give, and gave on the twin."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from airpuck.boundary.outputs import replacing
from airpuck.experiment_design.design import Design
from airpuck.experiment_design.trials import CheckedFlights
from airpuck.report import style


def write_design_figure(
    found: Design, checked: CheckedFlights | None, path: str | os.PathLike[str]
) -> None:
    """Write `design_figure` as PNG."""
    with replacing(path) as temporary:
        temporary.write_bytes(style.png(design_figure(found, checked)))


@style.styled
def design_figure(found: Design, checked: CheckedFlights | None = None) -> Figure:
    """Draw the relative standard errors of every quantity: now, usual, proposed, checked."""
    figure = style.new_figure(style.PAGE_WIDTH, 1.0 + 0.24 * len(found.quantities.labels))
    axes = figure.add_subplot()
    rows = style.label_rows(axes, found.quantities.labels)
    # Flights that were flown alone are compared with predictions of what they give alone.
    usual, proposal = (
        100 * (one.relative if checked is None else one.relative_alone)
        for one in (found.usual, found.proposal)
    )
    axes.hlines(rows, usual, proposal, color=style.LIGHT, lw=2.5)
    dots: dict[str, Any] = {"ls": "", "ms": 5.5}
    handles = []
    if checked is None and np.isfinite(found.relative_before).any():
        now = 100 * found.relative_before
        handles += axes.plot(now, rows, marker="s", color=style.GREY, label="now", **dots)
    dots["marker"] = "o"
    label = "usual excitation, predicted"
    handles += axes.plot(usual, rows, color=style.GREY, mfc="white", label=label, **dots)
    handles += axes.plot(proposal, rows, color=style.BLUE, label="proposal, predicted", **dots)
    if checked is not None:
        marks: dict[str, Any] = {"ls": "", "marker": "|", "ms": 9, "mew": 1.3}
        axes.plot(100 * checked.errors.T, rows, color=style.VERMILLION, **marks)
        label = f"proposal, obtained in {len(checked.errors)} flights"
        handles.append(style.key(label, style.VERMILLION, **marks))
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
    axes.grid(visible=True, axis="x", which="minor")
    axes.set_xlabel(
        f"standard error after {found.proposal.plan.duration_s:g} s [% of what it matters against]"
    )
    style.top_legend(figure, handles)
    return figure
