"""Predictions beside the measured flight, and their errors: by horizon, by window, over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Circle, Patch

from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.evaluate import Evaluation
from airpuck.faults.find import CONTACT, NOT_ARMED, RADIO_OUT, UNEXPLAINED
from airpuck.report import style

#: Colours of faults, by cause.
_COLORS = {
    NOT_ARMED: style.PURPLE,
    RADIO_OUT: style.VERMILLION,
    CONTACT: style.ORANGE,
    UNEXPLAINED: style.SKY,
}
#: Opacity of a fault with zero confidence.
_FAINTEST = 0.25
#: Share of the windows called the worst.
WORST = 0.08


def worst_windows(errors: Float[np.ndarray, "*channels W"]) -> Bool[np.ndarray, "*channels W"]:
    """Mark the windows with the largest errors of each channel."""
    count = max(round(WORST * errors.shape[-1]), 1)
    marked = np.zeros(errors.shape, dtype=bool)
    worst = np.argsort(-np.abs(errors), axis=-1, kind="stable")[..., :count]
    np.put_along_axis(marked, worst, True, axis=-1)
    return marked


def squares_held(
    errors: Float[np.ndarray, "*channels W"], marked: Bool[np.ndarray, "*channels_or_none W"]
) -> str:
    """Format the share of marked windows in each channel's squared error [%]."""
    squares = errors**2
    # Avoids 0/0 for a perfect prediction.
    total = np.maximum(squares.sum(axis=-1), 1e-300)
    shares = np.atleast_1d(100 * (squares * marked).sum(axis=-1) / total)
    return " / ".join(f"{share:.0f}" for share in shares)


def touched_by(evaluation: Evaluation, spans: Sequence[Span]) -> Bool[np.ndarray, " W"]:
    """Mark the windows whose prediction overlaps a span."""
    stop = evaluation.start + evaluation.horizon_step * evaluation.sample_period
    touched = np.zeros(len(evaluation.start), dtype=bool)
    for span in spans:
        touched |= (evaluation.start < span.stop) & (stop > span.start)
    return touched


@style.styled
def horizon_figure(
    fitted: Sequence[Evaluation], reference: Sequence[Evaluation] = (), label: str = "published"
) -> Figure:
    """Draw the RMS error over the prediction horizon.

    Broad lines show fitted models, thin dashed lines of the same colours the reference. A vertical
    line marks the horizon reported in tables.
    """
    figure = style.new_figure(style.PAGE_WIDTH, 3.5)
    handles = draw_horizon(list(figure.subplots(1, 3)), fitted, reference, label)
    style.top_legend(figure, handles)
    return figure


def draw_horizon(
    panels: Sequence[Axes],
    fitted: Sequence[Evaluation],
    reference: Sequence[Evaluation] = (),
    label: str = "published",
) -> list[Artist]:
    """Draw `horizon_figure` into axes for x, y and yaw; return the legend's entries."""
    broad: dict[str, Any] = {"lw": 3.0, "alpha": 0.45} if reference else {"lw": 1.8, "alpha": 0.8}
    dashed: dict[str, Any] = {"lw": 1.1, "ls": style.DASHED, "zorder": 3}
    colors = style.model_colors(evaluation.model for evaluation in (*fitted, *reference))
    for channel, (axes, (name, unit, factor)) in enumerate(zip(panels, style.ERRORS, strict=True)):
        for evaluations, line in ((fitted, broad), (reference, dashed)):
            for one in evaluations:
                time = one.sample_period * np.arange(1, len(one.errors) + 1)
                rmse = factor * one.rmse_over_horizon[:, channel]
                axes.plot(time, rmse, color=colors[one.model], **line)
        reported = fitted[0].horizon_step * fitted[0].sample_period
        axes.axvline(reported, color=style.GREY, lw=0.8, ls=":")
        place = {"transform": axes.get_xaxis_transform(), "ha": "right", "va": "top"}
        axes.text(reported, 0.99, f"{reported:.2g} s ", color=style.GREY, fontsize=8, **place)
        axes.set(xlabel="prediction horizon [s]", ylabel=f"RMSE of {name} [{unit}]")
        axes.set(xlim=(0, None), ylim=(0, None))
    handles: list[Artist] = [style.key(name, color, lw=3) for name, color in colors.items()]
    if reference:
        handles.append(style.key("broad: fitted here", lw=3, alpha=0.45))
        handles.append(style.key(f"dashed: {label}", lw=1.1, ls=style.DASHED))
    return handles


@style.styled
def error_distribution_figure(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw the cumulative distribution of the absolute errors of each model.

    A dot on each curve marks the RMSE, which a few large errors move far beyond the median.
    """
    figure = style.new_figure(style.PAGE_WIDTH, 3.3)
    panels = list(figure.subplots(1, 3, sharey=True))
    style.top_legend(figure, draw_error_distribution(panels, evaluations))
    return figure


def draw_error_distribution(
    panels: Sequence[Axes], evaluations: Sequence[Evaluation]
) -> list[Artist]:
    """Draw `error_distribution_figure` into three axes; return the legend's entries."""
    colors = style.model_colors(evaluation.model for evaluation in evaluations)
    for channel, (axes, (name, unit, factor)) in enumerate(zip(panels, style.ERRORS, strict=True)):
        lowest = []
        for evaluation in evaluations:
            size = np.sort(factor * np.abs(evaluation.at_horizon[channel]))
            share = 100 * np.arange(1, len(size) + 1) / len(size)
            color = colors[evaluation.model]
            axes.plot(size, share, color=color, lw=1.4)
            rmse = factor * evaluation.rmse[channel]
            axes.plot(rmse, np.interp(rmse, size, share), "o", color=color, mec="white", ms=6)
            lowest.append(float(np.percentile(size, 3)))
        axes.axhline(50, color=style.BLACK, lw=0.7, ls=":")
        axes.set(xscale="log", xlabel=f"error of {name} [{unit}]", ylim=(0, 101))
        axes.set_xlim(left=max(min(lowest), 1e-12))
        axes.xaxis.set_major_formatter("{x:g}")
    panels[0].set_ylabel("windows with a smaller error [%]")
    handles: list[Artist] = [style.key(name, color) for name, color in colors.items()]
    return [*handles, style.key("RMSE", ls="", marker="o", mec="white")]


@style.styled
def error_timeline_figure(evaluation: Evaluation, faults: Sequence[Span] = ()) -> Figure:
    """Draw the error of every window over the flight, below the faults of the recording.

    The worst windows are red; titles give their share of the squared error.
    """
    causes = list(dict.fromkeys(span.cause for span in sorted(faults, key=lambda s: s.start)))
    above = [0.24 * len(causes) + 0.1] if causes else []
    figure = style.new_figure(style.PAGE_WIDTH, 5.4 + sum(above))
    heights = [*above, 1.7, 1.7, 1.7]
    grid = list(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
    if causes:
        _draw_faults(grid[0], faults, causes)
    panels = grid[-3:]
    for channel, (axes, (name, unit, factor)) in enumerate(zip(panels, style.ERRORS, strict=True)):
        errors = evaluation.at_horizon[channel]
        for fault in faults:
            axes.axvspan(fault.start, fault.stop, color=style.LIGHT, lw=0)
        worst = worst_windows(errors)
        for chosen, color in ((~worst, style.BLUE), (worst, style.VERMILLION)):
            time, size = evaluation.start[chosen], factor * np.abs(errors[chosen])
            axes.vlines(time, 0, size, color=color, lw=0.9)
            axes.plot(time, size, ".", color=color, ms=3)
        axes.set_ylim(0, None)
        median, rmse = factor * evaluation.median_abs[channel], factor * evaluation.rmse[channel]
        axes.axhline(median, color=style.BLACK, lw=0.9)
        axes.axhline(rmse, color=style.BLACK, lw=0.9, ls=style.DASHED)
        axes.set_ylabel(f"error of {name} [{unit}]")
        axes.margins(x=0.01)
        title = (
            f"median {median:.3g} {unit}, RMSE {rmse:.3g} {unit}; the worst {100 * WORST:.0f} % of "
            f"windows account for {squares_held(errors, worst)} % of the squared error"
        )
        axes.set_title(title, loc="left", fontsize=8.5, fontweight="normal")
    panels[-1].set_xlabel("start of the prediction [s]")
    handles: list[Artist] = [
        style.key("windows", style.BLUE, marker="."),
        style.key(f"worst {100 * WORST:.0f} %", style.VERMILLION, marker="."),
        style.key("median", lw=0.9),
        style.key("RMSE", lw=0.9, ls=style.DASHED),
    ]
    if faults:
        handles.append(Patch(color=style.LIGHT, label="faults"))
    style.top_legend(figure, handles)
    return figure


def _draw_faults(axes: Axes, faults: Sequence[Span], causes: Sequence[str]) -> None:
    """Draw faults over time, one row per cause, with the probability of each cause."""
    for span in faults:
        row, color = causes.index(span.cause), fault_color(span.cause)
        # The edge keeps short faults visible.
        look = {"color": color, "lw": 1.5, "alpha": _FAINTEST + (1 - _FAINTEST) * span.confidence}
        axes.broken_barh([(span.start, span.stop - span.start)], (row - 0.35, 0.7), **look)
        if span.confidence < 1:
            place: Any = {"xytext": (3, 0), "textcoords": "offset points", "va": "center"}
            look = {"fontsize": 6.5, "color": style.GREY}
            axes.annotate(span.certainty, (span.stop, row), **place, **look)
    axes.set_yticks(range(len(causes)), causes)
    axes.set_ylim(len(causes) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


def fault_color(cause: str) -> str:
    """Return the colour of a cause."""
    return _COLORS.get(cause, style.BLUE if cause.endswith("stalled") else style.GREY)


#: Length of the stretch shown [s].
SHOWN_S = 5.0
#: Line segments of a path, for a smooth line in a small file.
_PIECES = 3000


def typical_stretch(evaluation: Evaluation) -> tuple[float, float]:
    """Return the start and end of a stretch with typical prediction errors.

    Of the stretches with the most predictions, it has the median mean squared error, with each
    channel normalised by its overall mean.
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
    """Return predictions that do not overlap."""
    chosen, free = [], -np.inf
    for number, begin in enumerate(start.tolist()):
        if begin >= free:
            chosen.append(number)
            free = begin + length
    return np.array(chosen, dtype=int)


@style.styled
def prediction_figure(trajectory: Trajectory, evaluations: Sequence[Evaluation]) -> Figure:
    """Draw measured and predicted poses over a typical stretch of a flight.

    Each prediction starts at a dot and uses no later measurements. Right: its errors.
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
        name, unit = style.POSE[channel]
        pose.set_ylabel(f"{name} [{unit}]")
        error.set_ylabel(f"error of {name} [{style.ERRORS[channel][1]}]")
    for evaluation in evaluations:
        _draw_windows(grid, trajectory, evaluation, (begin, stop), colors[evaluation.model])
    for axes in grid[-1]:
        axes.set(xlabel="time [s]", xlim=(begin, stop))
    grid[0, 0].set_title("pose", loc="left")
    grid[0, 1].set_title("predicted minus measured", loc="left")
    handles = [style.key("measured", lw=3.2, alpha=0.3)]
    handles += [style.key(f"predicted by {name}", color) for name, color in colors.items()]
    style.top_legend(figure, handles)


def _draw_windows(
    grid: Any, trajectory: Trajectory, evaluation: Evaluation, span: tuple[float, float], color: str
) -> None:
    """Draw poses and errors of one model's windows within a span, one after another."""
    steps, period = len(evaluation.errors), evaluation.sample_period
    length = steps * period
    inside = np.flatnonzero((evaluation.start >= span[0]) & (evaluation.start <= span[1] - length))
    chosen = inside[_one_after_another(evaluation.start[inside], length)]
    first = np.searchsorted(trajectory.time, evaluation.start[chosen] - period / 2)
    for number, start in zip(chosen.tolist(), first.tolist(), strict=True):
        index = start + np.arange(steps + 1)
        time = trajectory.time[index]
        for channel, (pose, error) in enumerate(grid):
            off = np.concatenate([[0.0], evaluation.errors[:, channel, number]])
            measured = trajectory.state[index, channel]
            pose.plot(time, measured + off, color=color, lw=1.3)
            pose.plot(time[0], measured[0], "o", color=color, ms=3)
            error.plot(time, style.ERRORS[channel][2] * off, color=color, lw=1.1)


@style.styled
def path_figure(trajectory: Trajectory, vehicle: Vehicle) -> Figure:
    """Draw the path of a flight from above, with the craft at its start, to scale."""
    figure = style.new_figure(6.4, 4.9)
    draw_path(figure.add_subplot(), trajectory, vehicle)
    return figure


def draw_path(axes: Axes, trajectory: Trajectory, vehicle: Vehicle) -> None:
    """Draw `path_figure` into axes, with the default table if the flight stays on it."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    step = max(len(trajectory) // _PIECES, 1)
    kept = np.flatnonzero(trajectory.usable)[::step]
    time, place = trajectory.time[kept], trajectory.state[kept, :2]
    pieces = np.stack([place[:-1], place[1:]], axis=1)
    # Excluded samples interrupt the line.
    joined = np.diff(time) < 5 * step * trajectory.sample_period
    line = LineCollection(pieces[joined].tolist(), cmap="viridis", lw=1.2)
    line.set_array(time[:-1][joined])
    axes.add_collection(line)
    figure.colorbar(line, ax=axes, label="time [s]", shrink=0.85)
    x, y, yaw = trajectory.state[0, :3].tolist()
    radius = vehicle.radius_m
    look = {"facecolor": (style.VERMILLION, 0.15), "edgecolor": style.VERMILLION, "zorder": 4}
    axes.add_patch(Circle((x, y), radius, lw=1.2, **look))
    tip = (x + 1.6 * radius * np.cos(yaw), y + 1.6 * radius * np.sin(yaw))
    style.draw_arrow(axes, (x, y), tip, color=style.VERMILLION, arrowstyle="-|>", lw=1.4)
    half = np.array(Table().reach(0.0))
    if (np.abs(place) < half).all():
        style.draw_rails(axes, Table())
    low, high = place.min(axis=0) - 1.7 * radius, place.max(axis=0) + 1.7 * radius
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
