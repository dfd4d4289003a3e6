"""A league: the score of each pair, and the ratings."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from airpuck.campaigns.league import LeagueResult
from airpuck.report import style

#: Goals per minute at which the colours are strongest.
_MOST = 4.0


@style.styled
def league_figure(found: LeagueResult) -> Figure:
    """Draw the matrix of scores, and the ratings with their intervals, strongest first."""
    order = np.argsort(-found.intervals[:, 0])
    height = 1.2 + 0.36 * len(order)
    figure = style.new_figure(style.PAGE_WIDTH, height)
    matrix, ratings = figure.subplots(1, 2, sharey=True, width_ratios=(1.9, 1))
    _draw_scores(matrix, found, order)
    value, low, high = found.intervals[order].T
    rows = np.arange(len(order))
    ratings.errorbar(value, rows, xerr=(value - low, high - value), fmt="o", color=style.BLUE)
    ratings.set(xlabel="rating [Elo]", title="rating, 95 % interval")
    return figure


def _draw_scores(axes: Axes, found: LeagueResult, order: np.ndarray) -> None:
    """Draw the goals of each player against each other, coloured by the difference per minute."""
    goals, seconds = (found.total(name)[np.ix_(order, order)] for name in ("goals", "duration_s"))
    lead = (goals - goals.T) / np.where(seconds > 0, seconds / 60, np.nan)
    axes.imshow(lead, cmap="RdBu", vmin=-_MOST, vmax=_MOST, aspect="auto")
    for row, column in np.argwhere(seconds > 0):
        text = f"{goals[row, column]:.0f}:{goals[column, row]:.0f}"
        color = "white" if abs(lead[row, column]) > _MOST / 2 else style.BLACK
        axes.text(column, row, text, ha="center", va="center", fontsize="small", color=color)
    names = [found.players[number] for number in order]
    axes.set_xticks(range(len(names)), names, rotation=40, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.set_title("goals for : against")
    axes.grid(visible=False)
