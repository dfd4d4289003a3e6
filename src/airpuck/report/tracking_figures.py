"""Flights to set points, on the twin and real (fig:control_lqr)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airpuck.flight.track import Track
from airpuck.report.style import (
    BLACK,
    GREY,
    PAGE_WIDTH,
    VERMILLION,
    new_figure,
    rung_color,
    styled,
    top_legend,
)
from airpuck.twin.tracking_study import Tracked

_POSE = (("x", "m"), ("y", "m"), ("yaw", "rad"))


@styled
def tracking_figure(flights: Sequence[Tracked]) -> Figure:
    """Draw pose and set points over time, for all models.

    Real flights begin at different times: each is drawn from half a second before its first
    set point that differs from the start (`Track.origin`).
    """
    figure = new_figure(PAGE_WIDTH, 5.0)
    panels = figure.subplots(3, 1, sharex=True)
    handles = [Line2D([], [], color=BLACK, linewidth=0.9, linestyle=":", label="set point")]
    for number, flight in enumerate(flights):
        color = rung_color(flight.model)
        origin = flight.origin
        if number == 0:
            _draw_set_points(panels, flight.twin, origin)
        _draw_pose(panels, flight.twin, origin, color=color, linewidth=1.5)
        handles.append(Line2D([], [], color=color, label=f"{flight.model}, twin"))
        if flight.real is not None:
            style = {"color": color, "linewidth": 1.2, "linestyle": (0, (4, 2)), "alpha": 0.8}
            _draw_pose(panels, flight.real, origin, **style)
            handles.append(Line2D([], [], label=f"{flight.model}, real flight", **style))
    for axes, (name, unit) in zip(panels, _POSE, strict=True):
        axes.set_ylabel(f"{name} [{unit}]")
    last = max(float(f.twin.time[-1]) - f.origin for f in flights)
    panels[-1].set_xlim(0.0, last)
    panels[-1].set_xlabel("time [s]")
    top_legend(figure, handles)
    return figure


@styled
def input_figure(flight: Tracked) -> Figure:
    """Draw the commands of one flight."""
    motors = flight.twin.motors
    rows = (len(motors) + 1) // 2
    figure = new_figure(PAGE_WIDTH, 0.5 + 1.25 * rows)
    panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
    handles = [Line2D([], [], color=VERMILLION, label="twin", linewidth=1.0)]
    if flight.real is not None:
        handles.append(Line2D([], [], color=GREY, linewidth=2.0, label="real flight"))
    origin = flight.origin
    for i, axes in enumerate(panels.ravel()):
        if i >= len(motors):
            axes.set_axis_off()
            continue
        if flight.real is not None:
            time = flight.real.command_time - origin
            axes.step(time, flight.real.command[:, i], where="post", color=GREY, linewidth=2.0)
        time = flight.twin.command_time - origin
        axes.step(time, flight.twin.command[:, i], where="post", color=VERMILLION, linewidth=0.9)
        axes.set_title(motors[i], loc="left")
        axes.set_ylim(-0.03, 1.05)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
        axes.set_xlim(0.0, float(flight.twin.time[-1]) - origin)
    for axes in panels[:, 0]:
        axes.set_ylabel("command [–]")
    top_legend(figure, handles)
    return figure


def _draw_set_points(panels: Any, track: Track, origin: float) -> None:
    """Draw the steps of the set points."""
    times = np.append(track.set_points.times, track.time[-1]) - origin
    poses = np.vstack([track.set_points.poses, track.set_points.poses[-1:]])
    for axes, values in zip(panels, poses.T, strict=True):
        axes.step(times, values, where="post", color=BLACK, linewidth=0.9, linestyle=":")


def _draw_pose(panels: Any, track: Track, origin: float, **style: object) -> None:
    """Draw a flight."""
    for axes, values in zip(panels, track.pose.T, strict=True):
        axes.plot(track.time - origin, values, **style)  # pyright: ignore[reportArgumentType]
