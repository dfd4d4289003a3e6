"""Where in time the prediction errors are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from airpuck.data.trajectory import Span
from airpuck.evaluation.evaluate import Evaluation
from airpuck.report.horizon import CHANNELS
from airpuck.report.style import (
    BLACK,
    BLUE,
    GREY,
    LIGHT,
    PAGE_WIDTH,
    VERMILLION,
    new_figure,
    styled,
    top_legend,
)

#: Share of the windows that is called the worst.
WORST = 0.08


def worst_windows(errors: Float[np.ndarray, " W"], share: float = WORST) -> Bool[np.ndarray, " W"]:
    """Mark the windows with the largest errors."""
    count = max(round(share * len(errors)), 1)
    marked = np.zeros(len(errors), dtype=bool)
    marked[np.argsort(-np.abs(errors), kind="stable")[:count]] = True
    return marked


def share_of_squares(errors: Float[np.ndarray, " W"], share: float = WORST) -> float:
    """Compute which share of the summed squared error the worst windows hold."""
    squares = errors**2
    total = float(squares.sum())
    return float(squares[worst_windows(errors, share)].sum()) / total if total > 0 else share


def touched_by(evaluation: Evaluation, spans: Sequence[Span]) -> Bool[np.ndarray, " W"]:
    """Mark the windows whose prediction touches a span."""
    stop = evaluation.start + evaluation.horizon_step * evaluation.sample_period
    touched = np.zeros(len(evaluation.start), dtype=bool)
    for span in spans:
        touched |= (evaluation.start < span.stop) & (stop > span.start)
    return touched


@styled
def error_timeline_figure(evaluation: Evaluation, faults: Sequence[Span] = ()) -> Figure:
    """Draw the error of every window along the flight.

    Shows that errors are not spread evenly: most windows lie near the median, a few far above it.
    The worst eight percent are coloured, and the share of the summed squared error that they hold
    is given; known faults of the recording are shaded.
    """
    figure = new_figure(PAGE_WIDTH, 5.4)
    panels = figure.subplots(3, 1, sharex=True)
    time = evaluation.start
    for channel, (axes, (name, unit, factor)) in enumerate(zip(panels, CHANNELS, strict=True)):
        errors = evaluation.at_horizon[channel]
        size, worst = factor * np.abs(errors), worst_windows(errors)
        for fault in faults:
            axes.axvspan(fault.start, fault.stop, color=LIGHT, lw=0)
        for chosen, color in ((~worst, BLUE), (worst, VERMILLION)):
            axes.vlines(time[chosen], 0, size[chosen], color=color, lw=0.9)
            axes.plot(time[chosen], size[chosen], ".", color=color, ms=3)
        median, rmse = factor * evaluation.median_abs[channel], factor * evaluation.rmse[channel]
        axes.axhline(median, color=BLACK, lw=0.9)
        axes.axhline(rmse, color=BLACK, lw=0.9, ls=(0, (4, 2)))
        axes.set_ylabel(f"error of {name} [{unit}]")
        axes.set_ylim(0, None)
        axes.margins(x=0.01)
        axes.set_title(
            f"median {median:.3g} {unit}, RMSE {rmse:.3g} {unit}; the worst {100 * WORST:.0f} % of "
            f"windows hold {100 * share_of_squares(errors):.0f} % of the squared error",
            loc="left",
            fontsize=8.5,
            fontweight="normal",
        )
    panels[-1].set_xlabel("start of the prediction [s]")
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=BLUE, marker=".", label="windows"),
        Line2D([], [], color=VERMILLION, marker=".", label=f"worst {100 * WORST:.0f} %"),
        Line2D([], [], color=BLACK, lw=0.9, label="median"),
        Line2D([], [], color=BLACK, lw=0.9, ls=(0, (4, 2)), label="RMSE"),
    ]
    if faults:
        handles.append(Patch(color=LIGHT, label="known faults"))
    top_legend(figure, handles)
    _name_faults(panels[0], faults)
    return figure


def _name_faults(axes: Axes, faults: Sequence[Span]) -> None:
    """Write the cause of each fault beside its shade; lower where it would meet the one before."""
    if faults:
        axes.set_ylim(0, 1.15 * axes.get_ylim()[1])
    height, free_from = 0.98, -np.inf
    for fault in faults:
        height = 0.84 if fault.stop < free_from and height > 0.9 else 0.98
        axes.annotate(
            fault.cause,
            (fault.stop, height),
            xycoords=axes.get_xaxis_transform(),
            xytext=(3, 0),
            textcoords="offset points",
            ha="left",
            va="top",
            fontsize=7,
            color=GREY,
        )
        # About how far a text of this size reaches, as a part of the time axis.
        free_from = fault.stop + 0.0085 * len(fault.cause) * np.ptp(axes.get_xlim())
