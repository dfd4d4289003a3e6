"""How prediction errors are distributed over the windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airpuck.evaluation.evaluate import Evaluation
from airpuck.report.horizon import CHANNELS
from airpuck.report.style import BLACK, PAGE_WIDTH, new_figure, rung_color, styled, top_legend


@styled
def error_distribution_figure(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw the cumulative distribution of the absolute errors of each model.

    Shows how typical errors differ from the root mean square, which the few largest errors rule:
    dots mark the RMSE on each curve, far to the right of the median at 50 %.
    """
    figure = new_figure(PAGE_WIDTH, 3.3)
    for channel, (axes, (name, unit, factor)) in enumerate(
        zip(figure.subplots(1, 3, sharey=True), CHANNELS, strict=True)
    ):
        for evaluation in evaluations:
            size = np.sort(factor * np.abs(evaluation.at_horizon[channel]))
            share = 100 * np.arange(1, len(size) + 1) / len(size)
            color = rung_color(evaluation.model)
            axes.plot(size, share, color=color, lw=1.4)
            rmse = factor * evaluation.rmse[channel]
            axes.plot(rmse, np.interp(rmse, size, share), "o", color=color, mec="white", ms=6)
        axes.axhline(50, color=BLACK, lw=0.7, ls=":")
        axes.set(xscale="log", xlabel=f"error of {name} [{unit}]", ylim=(0, 101))
        lowest = min(
            float(np.percentile(factor * np.abs(e.at_horizon[channel]), 3)) for e in evaluations
        )
        axes.set_xlim(left=max(lowest, 1e-12))
        axes.xaxis.set_major_formatter("{x:g}")
        if channel == 0:
            axes.set_ylabel("windows with a smaller error [%]")
    names = [evaluation.model for evaluation in evaluations]
    handles = [Line2D([], [], color=rung_color(name), label=name) for name in names]
    handles.append(Line2D([], [], ls="", marker="o", color=BLACK, mec="white", label="RMSE"))
    top_legend(figure, handles)
    return figure
