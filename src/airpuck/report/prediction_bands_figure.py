"""Predicted against measured trajectories, with 95 % bands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from airpuck.evaluation.prediction_bands import PredictionBands
from airpuck.report.style import (
    BLACK,
    BLUE,
    ORANGE,
    PAGE_WIDTH,
    SKY,
    new_figure,
    styled,
    top_legend,
)

#: Name, unit in the figure and factor from SI, of each channel: of poses, and of small differences.
_POSES = (("x", "m", 1.0), ("y", "m", 1.0), ("γ", "rad", 1.0))
_ERRORS = (("x", "mm", 1e3), ("y", "mm", 1e3), ("γ", "rad", 1.0))
#: Opacity of the total band, and of that of the parameters on it.
_TOTAL, _PARAMETERS = 0.35, 0.55


def typical_window(bands: PredictionBands) -> int:
    """Choose the window whose error is the median one."""
    errors = (bands.predicted - bands.measured)[-1]
    scale = np.sqrt(np.mean(errors**2, axis=1, keepdims=True))
    size = np.sum((errors / np.where(scale > 0, scale, 1.0)) ** 2, axis=0)
    return int(np.argsort(size, kind="stable")[(len(size) - 1) // 2])


@styled
def prediction_bands_figure(ahead: PredictionBands, simulated: PredictionBands) -> Figure:
    """Draw predictions with their bands over some seconds of a recording.

    Shows on the left the measured pose and predictions that start anew again and again, in the
    middle what is left of it when the prediction is taken off, which the bands should hold, and on
    the right the same of one simulation over all of these seconds. Of all simulations the one with
    the median error is drawn.
    """
    figure = new_figure(PAGE_WIDTH, 6.4)
    grid = figure.subplots(3, 3, sharex=True)
    whole = typical_window(simulated)
    begin, end = simulated.start[whole], simulated.time[-1, whole]
    within = (ahead.start >= begin) & (ahead.time[-1] <= end + 1e-9)
    shown = np.flatnonzero(within).tolist()
    for channel in range(3):
        pose, left, right = grid[channel]
        _draw_poses(pose, ahead, simulated, shown, whole, channel)
        for window in shown:
            _draw_errors(left, ahead, window, channel)
        _draw_errors(right, simulated, whole, channel)
        name, unit, _ = _POSES[channel]
        pose.set_ylabel(f"{name} [{unit}]")
        name, unit, _ = _ERRORS[channel]
        for axes, bands in ((left, ahead), (right, simulated)):
            axes.set_ylabel(f"error of {name} [{unit}]")
            held = f"{bands.coverage[channel]:.0f} % of {len(bands.start)} held"
            axes.set_title(f"{bands.horizon:.1f} s: {held}", loc="left")
    grid[0, 0].set_title("poses", loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
        axes.margins(x=0.01)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=BLACK, lw=2.4, alpha=0.5, label="measured"),
        Line2D([], [], color=BLUE, label=f"predicted {ahead.horizon:.1f} s ahead"),
        Line2D([], [], color=ORANGE, label=f"simulated for {simulated.horizon:.1f} s"),
        Patch(color=SKY, alpha=_TOTAL, label="95 % band"),
    ]
    if ahead.by_parameters is not None:
        handles.append(Patch(color=BLUE, alpha=_PARAMETERS, label="of it, parameters"))
    top_legend(figure, handles)
    return figure


def _draw_poses(
    axes: Axes,
    ahead: PredictionBands,
    simulated: PredictionBands,
    shown: Sequence[int],
    whole: int,
    channel: int,
) -> None:
    """Draw what was measured, short predictions, and one long one."""
    time = simulated.time[:, whole]
    axes.plot(time, simulated.measured[:, channel, whole], color=BLACK, lw=2.4, alpha=0.5)
    middle, half = simulated.predicted[:, channel, whole], simulated.total[:, channel, whole]
    axes.fill_between(time, middle - half, middle + half, color=SKY, alpha=_TOTAL, lw=0)
    axes.plot(time, middle, color=ORANGE, lw=1.1)
    for window in shown:
        axes.plot(
            ahead.time[:, window], ahead.predicted[:, channel, window], color=BLUE, lw=1.1, zorder=3
        )


def _draw_errors(axes: Axes, bands: PredictionBands, window: int, channel: int) -> None:
    """Draw measured minus predicted of one window, and the bands about zero."""
    factor, time = _ERRORS[channel][2], bands.time[:, window]
    half = factor * bands.total[:, channel, window]
    axes.fill_between(time, -half, half, color=SKY, alpha=_TOTAL, lw=0)
    if bands.by_parameters is not None:
        half = factor * bands.by_parameters[:, channel, window]
        axes.fill_between(time, -half, half, color=BLUE, alpha=_PARAMETERS, lw=0)
    error = factor * (bands.measured - bands.predicted)[:, channel, window]
    axes.plot(time, error, color=BLACK, lw=1.0)
