"""What causes the prediction error: the section and the figure of an error budget."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from airpuck.evaluation.error_budget import OWNERS, UNEXPLAINED, ErrorBudget
from airpuck.report import style
from airpuck.report.page import PageSection, Picture
from airpuck.report.tables import budget_table

#: Colour of each cause.
_PALETTE = ["BLACK", "SKY", "VERMILLION", "ORANGE", "BLUE", "GREEN", "PURPLE", "LIGHT"]
_COLORS = {o: getattr(style, c) for o, c in zip((*OWNERS, UNEXPLAINED), _PALETTE, strict=True)}
#: Number of bars over a flight, and the smallest share with a label [%].
_BARS, _LABELLED = 100, 6.0


@style.styled
def budget_figure(budget: ErrorBudget) -> Figure:
    """Draw the squared error over the flight, coloured by cause, and the shares beside it."""
    figure = style.new_figure(style.PAGE_WIDTH, 6.2)
    panels = figure.subplots(3, 2, width_ratios=(5.2, 1.0), sharex="col")
    edges = np.linspace(budget.start[0], budget.start[-1], _BARS + 1)
    place = np.clip(np.searchsorted(edges, budget.start, side="right") - 1, 0, _BARS - 1)
    owned = np.concatenate([budget.drops, budget.all_known[None] ** 2])
    for channel, (left, right) in enumerate(panels):
        total = max(float(np.sum(budget.errors[channel] ** 2)), 1e-300)
        base, below, share_below = np.zeros(_BARS), np.zeros(_BARS), 0.0
        for owner, values in zip(_COLORS, owned[:, channel], strict=True):
            color = _COLORS[owner]
            height = 100 * np.bincount(place, values, _BARS) / total
            # What a cause hides from another is subtracted below the axis.
            bottom = np.where(height >= 0, base, below)
            left.bar(edges[:-1], height, np.diff(edges), bottom, align="edge", color=color, lw=0)
            base, below = base + np.maximum(height, 0), below + np.minimum(height, 0)
            share = max(100 * float(values.sum()) / total, 0.0)
            right.bar(0, share, 0.6, share_below, color=color, lw=0)
            if share >= _LABELLED:
                right.text(0.36, share_below + share / 2, f"{share:.0f} %", va="center", fontsize=8)
            share_below += share
        name, unit, factor = style.ERRORS[channel]
        rmse = factor * float(np.sqrt(np.mean(budget.errors[channel] ** 2)))
        left.set_ylabel("squared error [% of total]")
        left.set_title(f"{name}: RMSE {rmse:.3g} {unit}", loc="left")
        left.set(ylim=(1.05 * below.min(), 1.05 * base.max() + 1e-9), xlim=edges[[0, -1]])
        right.set(ylim=(0, 100.5), xlim=(-0.35, 1.0), xticks=[], yticks=[])
        right.set_axis_off()
    panels[-1, 0].set_xlabel("start of the prediction [s]")
    shown = [Patch(color=color, label=owner) for owner, color in _COLORS.items()]
    style.top_legend(figure, shown, columns=4)
    return figure


def budget_section(budget: ErrorBudget) -> PageSection:
    """Show what causes the error."""
    caption = (
        "Squared error after the prediction horizon over the flight, coloured by its cause; the "
        "sums on the right."
    )
    picture = Picture("error_budget", budget_figure(budget), caption)
    return PageSection("budget", "What causes the error", (picture, budget_table(budget)))
