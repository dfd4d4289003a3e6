"""How prediction errors grow with the time predicted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airpuck.evaluation.evaluate import Evaluation
from airpuck.report.style import BLACK, GREY, PAGE_WIDTH, new_figure, rung_color, styled, top_legend

#: Name, unit in the figure and factor from SI, of each channel.
CHANNELS = (("x", "mm", 1e3), ("y", "mm", 1e3), ("yaw γ", "rad", 1.0))


@styled
def horizon_figure(
    fitted: Sequence[Evaluation],
    reference: Sequence[Evaluation] = (),
    *,
    reference_label: str = "published",
) -> Figure:
    """Draw the root mean square error over the horizon.

    Shows, for x, y and yaw, how fast the predictions of each model drift from the measurement:
    fitted models as broad lines, the reference as thin dashed ones in the same colours. A
    vertical line marks when tables report the error.
    """
    figure = new_figure(PAGE_WIDTH, 3.5)
    every, broad = [*fitted, *reference], 3.0 if reference else 1.8
    for channel, (axes, (name, unit, factor)) in enumerate(
        zip(figure.subplots(1, 3), CHANNELS, strict=True)
    ):
        for evaluation in every:
            of_reference = any(evaluation is other for other in reference)
            time = evaluation.sample_period * np.arange(1, len(evaluation.errors) + 1)
            axes.plot(
                time,
                factor * evaluation.rmse_over_horizon[:, channel],
                color=rung_color(evaluation.model),
                lw=1.1 if of_reference else broad,
                alpha=1.0 if of_reference else 0.45 if reference else 0.8,
                ls=(0, (4, 2)) if of_reference else "-",
                zorder=3 if of_reference else 2,
            )
        reported = every[0].horizon_step * every[0].sample_period
        axes.axvline(reported, color=GREY, lw=0.8, ls=":")
        axes.text(
            reported,
            0.99,
            f"{reported:.2g} s ",
            transform=axes.get_xaxis_transform(),
            ha="right",
            va="top",
            color=GREY,
            fontsize=8,
        )
        axes.set(
            xlabel="time predicted [s]",
            ylabel=f"RMSE of {name} [{unit}]",
            xlim=(0, None),
            ylim=(0, None),
        )
    names = dict.fromkeys(evaluation.model for evaluation in every)
    handles = [Line2D([], [], color=rung_color(name), lw=3, label=name) for name in names]
    if reference:
        handles += [
            Line2D([], [], color=BLACK, lw=3, alpha=0.45, label="broad: fitted here"),
            Line2D([], [], color=BLACK, lw=1.1, ls=(0, (4, 2)), label=f"dashed: {reference_label}"),
        ]
    top_legend(figure, handles)
    return figure
