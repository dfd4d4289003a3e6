"""How alike flights are: distributions of their speeds and accelerations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airpuck.data.trajectory import Trajectory
from airpuck.report.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    VERMILLION,
    new_figure,
    styled,
    top_legend,
)

_COLORS = (GREY, BLUE, VERMILLION, GREEN, ORANGE, PURPLE)


def motion(trajectory: Trajectory) -> dict[str, Float[np.ndarray, " M"]]:
    """Compute what is compared: magnitudes over all usable samples."""
    state, acceleration = trajectory.state[trajectory.usable], trajectory.acceleration
    acceleration = acceleration[trajectory.usable]
    return {
        "speed [m/s]": np.hypot(state[:, 3], state[:, 4]),
        "spin |ω| [rad/s]": np.abs(state[:, 5]),
        "acceleration [m/s²]": np.hypot(acceleration[:, 0], acceleration[:, 1]),
        "angular acceleration [rad/s²]": np.abs(acceleration[:, 2]),
    }


@styled
def likeness_figure(flights: Mapping[str, Trajectory]) -> Figure:
    """Draw the share of time above each speed and acceleration, for several flights."""
    figure = new_figure(PAGE_WIDTH, 5.0)
    panels = figure.subplots(2, 2, sharey=True)
    handles = []
    for number, (name, trajectory) in enumerate(flights.items()):
        color, dashes = _COLORS[number % len(_COLORS)], "-" if number < 3 else "--"
        handles.append(Line2D([], [], label=name, color=color, linestyle=dashes))
        for axes, (label, values) in zip(panels.ravel(), motion(trajectory).items(), strict=True):
            ordered = np.sort(values)
            above = 1 - (np.arange(len(ordered)) + 0.5) / len(ordered)
            axes.semilogy(ordered, above, color=color, linestyle=dashes)
            axes.set_xlabel(label)
            axes.set_ylim(1e-3, 1.0)
            axes.set_xlim(left=0)
    for axes in panels[:, 0]:
        axes.set_ylabel("share of time above")
    top_legend(figure, handles)
    return figure
