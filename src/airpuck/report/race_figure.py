"""A race: paths of all flights over the planned one, and how long they took."""

from __future__ import annotations

import os

import numpy as np
from matplotlib.figure import Figure

from airpuck.boundary.outputs import replacing
from airpuck.craft.table import Table
from airpuck.report import style
from airpuck.report.plan_figure import draw_course
from airpuck.twin.race import Race


def write_race_figure(race: Race, path: str | os.PathLike[str], table: Table) -> None:
    """Write `race_figure` as PNG."""
    with replacing(path) as temporary:
        temporary.write_bytes(style.png(race_figure(race, table)))


@style.styled
def race_figure(race: Race, table: Table) -> Figure:
    """Draw paths from above, and times beside the plan, its bound and a set point."""
    figure = style.new_figure(style.PAGE_WIDTH, 4.9)
    above, below = figure.subplots(2, 1, height_ratios=[3.4, 1])
    draw_course(above, race.plan, table)
    for path in race.paths:
        above.plot(*path.T, color=style.BLUE, lw=0.8, alpha=0.6)
    states = race.plan.samples[1]
    above.plot(states[:, 0], states[:, 1], color=style.BLACK, ls=style.DASHED)
    above.set(xlabel="x [m]", ylabel="y [m]")
    rows = [("plan", race.flown, style.BLUE)]
    if race.set_point is not None:
        rows.insert(0, ("set point", race.set_point, style.VERMILLION))
    for row, (_, times, color) in enumerate(rows):
        reached = [time for time in times if time is not None]
        below.plot(reached, np.full(len(reached), row), "|", color=color, ms=12)
    below.axvline(race.plan.duration, color=style.BLACK, ls=style.DASHED)
    if race.plan.lower_bound is not None:
        below.axvline(race.plan.lower_bound, color=style.GREY)
    below.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    below.set(ylim=(-0.6, len(rows) - 0.4), xlabel="time to the goal [s]")
    below.set_xlim(0, None)
    style.top_legend(
        figure,
        [
            style.key("flown", style.BLUE),
            style.key("planned", style.BLACK, ls=style.DASHED),
            style.key("lower bound", style.GREY),
        ],
    )
    return figure
