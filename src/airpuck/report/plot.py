"""Figures of the reports in a user's axes: `airpuck.plot`.

Without axes, a function creates a pyplot figure, which a notebook displays.

Examples
--------
>>> axes = airpuck.plot.thrust(model)
>>> axes.get_ylabel()
'thrust [N]'
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from airpuck.boundary.errors import InputError
from airpuck.craft.table import Table
from airpuck.physics.thrust import thrust as thrust_of
from airpuck.planning.plan import Plan
from airpuck.report import style
from airpuck.report.fit_figures import BAND, thrust_band, thrust_curves
from airpuck.report.prediction_figures import (
    draw_error_distribution,
    draw_horizon,
    draw_path,
    draw_predictions,
)
from airpuck.twin.experiments import Race
from airpuck.twin.tracking_study import Tracked

if TYPE_CHECKING:
    from matplotlib.figure import SubFigure

    from airpuck.craft.vehicle import Vehicle
    from airpuck.data.trajectory import Trajectory
    from airpuck.evaluation.evaluate import Evaluation
    from airpuck.model.model_file import Model


def thrust(model: Model, axes: Axes | None = None) -> Axes:
    """Draw the thrust of every propeller over its speed, with 95 % bands if known.

    The second propeller of a pair is dashed.

    Parameters
    ----------
    model : Model
        The model, such as ``fit.model``.
    axes : matplotlib Axes, optional
        Where to draw; by default in a new figure.

    Returns
    -------
    matplotlib Axes
        With the drawing.
    """
    (axes,), vehicle = _axes(axes, 1), model.vehicle
    speed, colors = np.linspace(0, 1, 201), style.propeller_colors(vehicle)
    second = {group[1] for group in style.propeller_groups(vehicle) if len(group) > 1}
    curves = thrust_curves(model, speed)
    band = None if model.known is None else thrust_band(model, speed)
    for motor, (name, color) in enumerate(zip(vehicle.propeller_names, colors, strict=True)):
        line = style.DASHED if motor in second else "-"
        axes.plot(speed, curves[motor], color=color, lw=1.5, ls=line, label=name)
        if band is not None:
            axes.fill_between(speed, *band[:, motor], color=color, **BAND)
    axes.set(xlim=(0, 1), ylim=(0, 1.08 * float(curves.max())))
    axes.set(xlabel="motor speed φ [–]", ylabel="thrust [N]")
    axes.legend()
    return axes


def horizon(evaluations: Evaluation | Sequence[Evaluation], axes: Any = None) -> list[Axes]:
    """Draw the RMS error of predictions over the prediction horizon.

    Parameters
    ----------
    evaluations : Evaluation or sequence of Evaluation
        From `airpuck.evaluate` or `airpuck.compare`.
    axes : three matplotlib Axes, optional
        For x, y and yaw; by default in a new figure.

    Returns
    -------
    list of matplotlib Axes
        With the drawing.
    """
    panels = _axes(axes, 3)
    panels[-1].legend(handles=draw_horizon(panels, _several(evaluations)))
    return panels


def errors(evaluations: Evaluation | Sequence[Evaluation], axes: Any = None) -> list[Axes]:
    """Draw the distribution of the prediction errors of all windows.

    Parameters
    ----------
    evaluations : Evaluation or sequence of Evaluation
        From `airpuck.evaluate` or `airpuck.compare`.
    axes : three matplotlib Axes, optional
        For x, y and yaw; by default in a new figure.

    Returns
    -------
    list of matplotlib Axes
        With the drawing.
    """
    panels = _axes(axes, 3)
    panels[-1].legend(handles=draw_error_distribution(panels, _several(evaluations)))
    return panels


def predictions(
    trajectory: Trajectory,
    evaluations: Evaluation | Sequence[Evaluation],
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Draw measured and predicted poses over a typical stretch of a flight.

    Parameters
    ----------
    trajectory : Trajectory
        The recording that was evaluated.
    evaluations : Evaluation or sequence of Evaluation
        Its evaluations.
    figure : matplotlib Figure or SubFigure, optional
        Where to draw; by default a new figure.

    Returns
    -------
    matplotlib Figure or SubFigure
        With the drawing.
    """
    if figure is None:
        from matplotlib import pyplot

        figure = pyplot.figure(figsize=(style.PAGE_WIDTH, 5.6), layout="constrained")
    draw_predictions(figure, trajectory, _several(evaluations))
    return figure


def path(trajectory: Trajectory, vehicle: Vehicle, axes: Axes | None = None) -> Axes:
    """Draw the path of a flight from above.

    Parameters
    ----------
    trajectory : Trajectory
        The flight.
    vehicle : Vehicle
        The craft, drawn at its start.
    axes : matplotlib Axes, optional
        Where to draw; by default in a new figure.

    Returns
    -------
    matplotlib Axes
        With the drawing.
    """
    (axes,) = _axes(axes, 1)
    draw_path(axes, trajectory, vehicle)
    return axes


def _several(evaluations: Any) -> list[Evaluation]:
    """Return a list of evaluations."""
    return list(evaluations) if isinstance(evaluations, Sequence) else [evaluations]


def _axes(given: Any, count: int) -> list[Axes]:
    """Check the given axes, or create a figure with axes."""
    if given is None:
        from matplotlib import pyplot

        size = (style.PAGE_WIDTH, 3.4) if count > 1 else (6.4, 4.4)
        return style.panels(pyplot.figure(figsize=size, layout="constrained"), count, count)
    axes = np.ravel(given).tolist()
    if len(axes) != count or not all(isinstance(one, Axes) for one in axes):
        raise InputError(f"needs {count} matplotlib axes, not {len(axes)} objects", field="axes")
    return axes


#: Number of craft drawn along the path.
_SHOWN = 7


@style.styled
def plan_figure(plan: Plan, table: Table | None = None) -> Figure:
    """Draw the path from above, and thrusts and commands over time."""
    vehicle = plan.model.vehicle
    figure = style.new_figure(style.PAGE_WIDTH, 2.6 + 0.55 * vehicle.n_propellers)
    heights = [2.6, 0.55 * vehicle.n_propellers]
    subfigures: Any = figure.subfigures(2, 1, height_ratios=heights)
    above, below = subfigures
    _draw_path(above.add_subplot(), plan, table)
    times, states = plan.samples
    force = thrust_of(plan.model.dynamics.thrust, states[:, 6:].T)
    full = thrust_of(plan.model.dynamics.thrust, np.ones((vehicle.n_propellers, 1)))
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
        axes.set_ylabel(vehicle.propeller_names[number], rotation=0, ha="right", va="center")
        axes.label_outer()
    panels[-1].set_xlabel("time [s]")
    handles = [
        style.key("thrust [% of full]", style.GREY),
        style.key("command [%]", style.BLACK, lw=0.8, ls=style.DASHED),
    ]
    style.top_legend(below, handles)
    return figure


def _draw_course(axes: Axes, plan: Plan, table: Table | None) -> None:
    """Draw the table, the plan's waypoints and the discs that it must not touch."""
    if table is not None:
        style.draw_rails(axes, table, facecolor=style.FLOOR)
    for x, y, radius in plan.keep_out:
        axes.add_patch(Circle((x, y), radius, fc=style.GREY, ec=style.BLACK, alpha=0.5))
    for number, (x, y) in enumerate(plan.via, start=1):
        axes.plot(x, y, "o", color=style.VERMILLION, ms=4, zorder=3)
        axes.annotate(str(number), (x, y), (4, 4), textcoords="offset points")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.margins(0.05)
    axes.grid(visible=False)


def _draw_path(axes: Axes, plan: Plan, table: Table | None) -> None:
    """Draw the path, with the craft at some times."""
    times, states = plan.samples
    radius = plan.model.vehicle.radius_m
    _draw_course(axes, plan, table)
    axes.plot(states[:, 0], states[:, 1], color=style.BLUE)
    for time in np.linspace(0, plan.duration, _SHOWN):
        x, y, yaw = (np.interp(time, times, column) for column in states[:, :3].T)
        axes.add_patch(Circle((x, y), radius, fc="none", ec=style.GREY, lw=0.9))
        front = [x, x + radius * np.cos(yaw)], [y, y + radius * np.sin(yaw)]
        axes.plot(*front, color=style.GREY, lw=0.9)
    known = plan.lower_bound
    bound = "no lower bound" if known is None else f"lower bound {known:.3f} s"
    axes.set_title(f"{plan.duration:.3f} s; {bound}", loc="left")


@style.styled
def race_figure(race: Race, table: Table) -> Figure:
    """Draw all paths from above, and flight times with the plan's time and lower bound."""
    figure = style.new_figure(style.PAGE_WIDTH, 4.9)
    above, below = figure.subplots(2, 1, height_ratios=[3.4, 1])
    _draw_course(above, race.plan, table)
    for path in race.paths:
        above.plot(*path.T, color=style.BLUE, lw=0.8, alpha=0.6)
    states = race.plan.samples[1]
    above.plot(states[:, 0], states[:, 1], color=style.BLACK, ls=style.DASHED)
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
    keys = [
        style.key("flown", style.BLUE),
        style.key("planned", style.BLACK, ls=style.DASHED),
        style.key("lower bound", style.GREY),
    ]
    style.top_legend(figure, keys)
    return figure


@style.styled
def path_figure(flights: Sequence[Tracked]) -> Figure:
    """Draw flown paths from above, to scale, with the plans of predictive laws."""
    count = len(flights)
    figure = style.new_figure(style.PAGE_WIDTH, 0.5 + 2.4 * -(-count // 2))
    panels = style.panels(figure, count, min(count, 2), sharex=True, sharey=True)
    for axes, flight in zip(panels, flights, strict=True):
        _draw_flown(axes, flight)
        axes.label_outer()
    keys = [
        style.key("flown", style.LIGHT, lw=6.0),
        style.key("set point", style.ASKED, marker="+", lw=0),
    ]
    keys += [
        style.key(style.BOUND_WORDS[k], color, marker=".", lw=1.1)
        for k, color in style.BOUND_COLORS.items()
    ]
    style.top_legend(figure, keys)
    return figure


def _draw_flown(axes: Axes, flight: Tracked) -> None:
    """Draw one flight and its plans from above."""
    table, radius = flight.table, flight.vehicle.radius_m
    style.draw_rails(axes, table, lw=3.0)
    style.draw_rails(axes, table, radius, edgecolor=style.GREY, lw=0.8, ls=style.DASHED)
    plans = list(flight.log.predictions.values())
    lines = LineCollection(
        [plan.states[:, :2].tolist() for plan in plans],
        colors=[style.BOUND_COLORS[plan.bound_by] for plan in plans],
        lw=1.1,
        zorder=3,
    )
    axes.add_collection(lines)
    for plan in plans:
        axes.plot(
            *plan.states[-1, :2], ".", color=style.BOUND_COLORS[plan.bound_by], ms=4, zorder=3
        )
    axes.plot(*flight.twin.pose[:, :2].T, color=style.LIGHT, lw=6.0, zorder=2)
    axes.plot(*flight.twin.set_points.poses[:, :2].T, "+", color=style.ASKED, ms=9, mew=2, zorder=4)
    x, y = table.reach(-0.04)
    axes.set(xlim=(-x, x), ylim=(-y, y), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(flight.label, loc="left")
