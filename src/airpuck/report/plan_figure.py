"""A plan: the path on the table, and what every motor does on it."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from airpuck.boundary.outputs import replacing
from airpuck.craft.table import Table
from airpuck.physics.thrust import thrust
from airpuck.planning.plan import Plan
from airpuck.report import style

#: Crafts that are drawn along the path.
_SHOWN = 7


def write_plan_figure(plan: Plan, path: str | os.PathLike[str], table: Table | None = None) -> None:
    """Write `plan_figure` as PNG."""
    with replacing(path) as temporary:
        temporary.write_bytes(style.png(plan_figure(plan, table)))


@style.styled
def plan_figure(plan: Plan, table: Table | None = None) -> Figure:
    """Draw the path from above, and thrusts with the commands behind them over time."""
    vehicle = plan.model.vehicle
    figure = style.new_figure(style.PAGE_WIDTH, 2.6 + 0.55 * vehicle.n_propellers)
    heights = [2.6, 0.55 * vehicle.n_propellers]
    subfigures: Any = figure.subfigures(2, 1, height_ratios=heights)
    above, below = subfigures
    _draw_path(above.add_subplot(), plan, table)
    times, states = plan.samples
    force = thrust(plan.model.dynamics.thrust, states[:, 6:].T)
    full = thrust(plan.model.dynamics.thrust, np.ones((vehicle.n_propellers, 1)))
    colors = style.propeller_colors(vehicle)
    panels = below.subplots(vehicle.n_propellers, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for number, axes in enumerate(panels):
        axes.fill_between(
            times, 100 * force[number] / full[number], color=colors[number], alpha=0.3
        )
        axes.plot(times, 100 * force[number] / full[number], color=colors[number])
        held = np.append(plan.commands[:, number], plan.commands[-1, number])
        axes.step(plan.time, 100 * held, where="post", color=style.BLACK, lw=0.8, ls=style.DASHED)
        axes.set(ylim=(-5, 109), xlim=(0, plan.duration), yticks=(0, 100))
        name = vehicle.propeller_names[number]
        axes.set_ylabel(name, rotation=0, ha="right", va="center")
        axes.label_outer()
    panels[-1].set_xlabel("time [s]")
    handles = [
        style.key("thrust [% of full]", style.GREY),
        style.key("command [%]", style.BLACK, lw=0.8, ls=style.DASHED),
    ]
    style.top_legend(below, handles)
    return figure


def draw_course(axes: Axes, plan: Plan, table: Table | None) -> None:
    """Draw the table, and what a plan must pass and must not touch."""
    if table is not None:
        length, width = table.length_m, table.width_m
        corner = (-length / 2, -width / 2)
        axes.add_patch(Rectangle(corner, length, width, fc=style.FLOOR, ec=style.RAIL, lw=2))
    for x, y, radius in plan.keep_out:
        axes.add_patch(Circle((x, y), radius, fc=style.GREY, ec=style.BLACK, alpha=0.5))
    for number, (x, y) in enumerate(plan.via, start=1):
        axes.plot(x, y, "o", color=style.VERMILLION, ms=4, zorder=3)
        axes.annotate(str(number), (x, y), (4, 4), textcoords="offset points")
    axes.set_aspect("equal")
    axes.margins(0.05)
    axes.grid(visible=False)


def _draw_path(axes: Axes, plan: Plan, table: Table | None) -> None:
    """Draw the path, the craft at some times, and the rails."""
    times, states = plan.samples
    radius = plan.model.vehicle.radius_m
    draw_course(axes, plan, table)
    axes.plot(states[:, 0], states[:, 1], color=style.BLUE)
    for time in np.linspace(0, plan.duration, _SHOWN):
        x, y, yaw = (np.interp(time, times, column) for column in states[:, :3].T)
        axes.add_patch(Circle((x, y), radius, fc="none", ec=style.GREY, lw=0.9))
        front = [x, x + radius * np.cos(yaw)], [y, y + radius * np.sin(yaw)]
        axes.plot(*front, color=style.GREY, lw=0.9)
    known = plan.lower_bound
    bound = "no lower bound" if known is None else f"no control takes less than {known:.3f} s"
    axes.set_title(f"{plan.duration:.3f} s; {bound}", loc="left")
    axes.set(xlabel="x [m]", ylabel="y [m]")
