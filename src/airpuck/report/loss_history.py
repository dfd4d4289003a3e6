"""The way of an optimiser."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from airpuck.identification.fit_result import Fit
from airpuck.report.style import BLACK, new_figure, rung_color, styled


@styled
def loss_history_figure(
    fits: Sequence[Fit],
    reference: Mapping[str, float] | None = None,
    *,
    reference_label: str = "published",
) -> Figure:
    """Draw the loss of each fit over the iterations of its optimiser.

    Shows how many steps each fit took, and where it ended beside the reference parameters on the
    same windows (dashed). Thin lines are losses on windows that an optimiser held out.
    """
    figure = new_figure(6.4, 3.6)
    axes = figure.add_subplot()
    reference = dict(reference or {})
    every = [iteration.loss for fit in fits for iteration in fit.history] + list(reference.values())
    narrow = max(every) < 10 * min(every)
    # Within a decade, small numbers with a common exponent; beyond, powers of ten.
    exponent = int(np.floor(np.log10(max(min(every), 1e-300)))) if narrow else 0
    scale = 10.0**-exponent
    for fit in fits:
        color = rung_color(fit.model.name)
        numbers = [iteration.number for iteration in fit.history]
        losses = [scale * iteration.loss for iteration in fit.history]
        axes.plot(numbers, losses, marker="o" if len(numbers) < 60 else None, ms=4, color=color)
        held_out = [i.test_loss for i in fit.history if i.test_loss is not None]
        if len(held_out) == len(numbers):
            axes.plot(numbers, scale * np.array(held_out), lw=0.8, color=color)
        if fit.model.name in reference:
            axes.axhline(scale * reference[fit.model.name], color=color, lw=0.9, ls=(0, (4, 2)))
    unit = f"$10^{{{exponent}}}$" if narrow else "–"
    axes.set(yscale="log", xlabel="iteration [–]", ylabel=f"loss [{unit}]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if narrow:
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
    handles = [
        Line2D([], [], marker="o", ms=4, color=rung_color(fit.model.name), label=fit.model.name)
        for fit in fits
    ]
    if reference:
        handles.append(Line2D([], [], color=BLACK, lw=0.9, ls=(0, (4, 2)), label=reference_label))
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0)
    return figure
