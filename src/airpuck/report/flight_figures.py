"""A flight as it was measured, beside what models predict of it: over time, and from above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Circle, Rectangle

from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import Evaluation
from airpuck.report import style

#: How much of a flight is shown [s].
SHOWN_S = 5.0
#: Pieces that a path is drawn with: enough for a smooth line in a small file.
_PIECES = 3000


def typical_stretch(evaluation: Evaluation) -> tuple[float, float]:
    """Choose some seconds of a flight in which predictions err as they usually do.

    Among the stretches with the most predictions, that whose mean squared error, each channel
    divided by its own, is the median.
    """
    start, length = evaluation.start, evaluation.sample_period * len(evaluation.errors)
    square = evaluation.at_horizon**2
    error = (square / np.maximum(square.mean(axis=1, keepdims=True), 1e-300)).sum(axis=0)
    summed = np.concatenate([[0.0], np.cumsum(error)])
    first = np.arange(len(start))
    last = np.searchsorted(start, start + SHOWN_S - length, side="right")
    full = np.flatnonzero(last - first == (last - first).max())
    order = np.argsort(((summed[last] - summed[first]) / (last - first))[full], kind="stable")
    begin = float(start[full[order[(len(full) - 1) // 2]]])
    return begin, begin + SHOWN_S


def _one_after_another(start: Float[np.ndarray, " W"], length: float) -> Int[np.ndarray, " K"]:
    """Choose predictions that do not overlap."""
    chosen, free = [], -np.inf
    for number, begin in enumerate(start.tolist()):
        if begin >= free:
            chosen.append(number)
            free = begin + length
    return np.array(chosen, dtype=int)


@style.styled
def prediction_figure(trajectory: Trajectory, evaluations: Sequence[Evaluation]) -> Figure:
    """Draw the measured pose, and what models predict of it, over some typical seconds.

    Each prediction starts at a dot and knows nothing of what was measured after it. Right: how far
    it is off.
    """
    figure = style.new_figure(style.PAGE_WIDTH, 5.6)
    draw_predictions(figure, trajectory, evaluations)
    return figure


def draw_predictions(
    figure: Figure | SubFigure, trajectory: Trajectory, evaluations: Sequence[Evaluation]
) -> None:
    """Draw `prediction_figure` into a figure."""
    begin, stop = typical_stretch(evaluations[-1])
    colors = style.model_colors(evaluation.model for evaluation in evaluations)
    grid = figure.subplots(3, 2, sharex=True, width_ratios=(1.5, 1))
    shown = (trajectory.time >= begin) & (trajectory.time <= stop)
    for channel, (pose, error) in enumerate(grid):
        measured = trajectory.state[shown, channel]
        pose.plot(trajectory.time[shown], measured, color=style.BLACK, lw=3.2, alpha=0.3)
        error.axhline(0, color=style.BLACK, lw=0.8)
        for evaluation in evaluations:
            color = colors[evaluation.model]
            _draw_channel(pose, error, trajectory, evaluation, channel, (begin, stop), color)
        name, unit = style.POSE[channel]
        pose.set_ylabel(f"{name} [{unit}]")
        error.set_ylabel(f"error of {name} [{style.ERRORS[channel][1]}]")
    for axes in grid[-1]:
        axes.set(xlabel="time [s]", xlim=(begin, stop))
    grid[0, 0].set_title("pose", loc="left")
    grid[0, 1].set_title("predicted minus measured", loc="left")
    handles = [style.key("measured", lw=3.2, alpha=0.3)]
    handles += [style.key(f"predicted by {name}", color) for name, color in colors.items()]
    style.top_legend(figure, handles)


def _draw_channel(
    pose: Axes,
    error: Axes,
    trajectory: Trajectory,
    evaluation: Evaluation,
    channel: int,
    span: tuple[float, float],
    color: str,
) -> None:
    """Draw one channel of the predictions that lie within a span of time."""
    steps, factor = len(evaluation.errors), style.ERRORS[channel][2]
    length = steps * evaluation.sample_period
    inside = np.flatnonzero((evaluation.start >= span[0]) & (evaluation.start <= span[1] - length))
    chosen = inside[_one_after_another(evaluation.start[inside], length)]
    first = np.searchsorted(
        trajectory.time, evaluation.start[chosen] - evaluation.sample_period / 2
    )
    for number, start in zip(chosen.tolist(), first.tolist(), strict=True):
        index = start + np.arange(steps + 1)
        off = np.concatenate([[0.0], evaluation.errors[:, channel, number]])
        time, measured = trajectory.time[index], trajectory.state[index, channel]
        pose.plot(time, measured + off, color=color, lw=1.3)
        pose.plot(time[0], measured[0], "o", color=color, ms=3)
        error.plot(time, factor * off, color=color, lw=1.1)


@style.styled
def path_figure(trajectory: Trajectory, vehicle: Vehicle) -> Figure:
    """Draw the way of a flight from above, with the craft where it started, to scale."""
    figure = style.new_figure(6.4, 4.9)
    draw_path(figure.add_subplot(), trajectory, vehicle)
    return figure


def draw_path(axes: Axes, trajectory: Trajectory, vehicle: Vehicle) -> None:
    """Draw `path_figure` into axes; the rails of the usual table where the flight kept inside."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    step = max(len(trajectory) // _PIECES, 1)
    kept = np.flatnonzero(trajectory.usable)[::step]
    time, place = trajectory.time[kept], trajectory.state[kept, :2]
    pieces = np.stack([place[:-1], place[1:]], axis=1)
    # No line across what is left out.
    joined = np.diff(time) < 5 * step * trajectory.sample_period
    way = LineCollection(pieces[joined].tolist(), cmap="viridis", lw=1.2)
    way.set_array(time[:-1][joined])
    axes.add_collection(way)
    figure.colorbar(way, ax=axes, label="time [s]", shrink=0.85)
    x, y, yaw = trajectory.state[0, :3].tolist()
    radius = vehicle.radius_m
    look = {"facecolor": (style.VERMILLION, 0.15), "edgecolor": style.VERMILLION, "zorder": 4}
    axes.add_patch(Circle((x, y), radius, lw=1.2, **look))
    tip = (x + 1.6 * radius * np.cos(yaw), y + 1.6 * radius * np.sin(yaw))
    style.draw_arrow(axes, (x, y), tip, color=style.VERMILLION, arrowstyle="-|>", lw=1.4)
    half = np.array(Table().reach(0.0))
    if (np.abs(place) < half).all():
        rails = Rectangle((-half[0], -half[1]), *(2 * half), fill=False, edgecolor=style.RAIL, lw=2)
        axes.add_patch(rails)
    low, high = place.min(axis=0) - 1.7 * radius, place.max(axis=0) + 1.7 * radius
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
