"""A replayed flight: commands that were sent and computed, and what the craft did."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from airpuck.control.discretization import rotation_error
from airpuck.flight.replay import Replay
from airpuck.physics.angle import wrapped
from airpuck.report.style import (
    BLACK,
    BLUE,
    GREY,
    LIGHT,
    ORANGE,
    PAGE_WIDTH,
    VERMILLION,
    new_figure,
    styled,
    top_legend,
)

#: What is drawn of the state: label, unit.
_POSE = (("x", "m"), ("y", "m"), ("yaw", "rad"))


@styled
def command_figure(replay: Replay) -> Figure:
    """Draw the recorded and the computed command of every motor over time."""
    n = len(replay.motors)
    rows = (n + 1) // 2
    figure = new_figure(PAGE_WIDTH, 0.5 + 1.35 * rows)
    panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
    medians = np.median(np.abs(replay.difference), axis=0)
    for i, axes in enumerate(panels.ravel()):
        if i >= n:
            axes.set_axis_off()
            continue
        axes.plot(replay.time, replay.sent[:, i], color=GREY, linewidth=2.2)
        axes.plot(replay.time, replay.computed[:, i], color=VERMILLION, linewidth=0.9)
        axes.set_title(
            f"{replay.motors[i]}: r = {replay.correlation[i]:.3f}, median |Δ| {medians[i]:.4f}",
            loc="left",
        )
        axes.set_ylim(-0.03, 1.05)
        for start, stop in _outside(replay):
            axes.axvspan(start, stop, color=LIGHT, linewidth=0, alpha=0.6)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
        axes.set_xlim(replay.time[0], replay.time[-1])
    for axes in panels[:, 0]:
        axes.set_ylabel("command [–]")
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=GREY, linewidth=2.2, label="sent in the flight"),
        Line2D([], [], color=VERMILLION, linewidth=0.9, label="computed by this controller"),
    ]
    if _outside(replay):
        handles.append(Patch(color=LIGHT, alpha=0.6, label="not compared"))
    top_legend(figure, handles)
    return figure


@styled
def flight_figure(replay: Replay) -> Figure:
    """Draw what the craft did beside what it was asked to do."""
    figure = new_figure(PAGE_WIDTH, 4.4)
    panels = figure.subplots(3, 1, sharex=True)
    pose = replay.pose.copy()
    # The yaw is drawn continuous, and a set point in the turn that is nearest to the craft.
    known = np.isfinite(pose[:, 2])
    pose[known, 2] = np.unwrap(pose[known, 2])
    asked = replay.reference.copy()
    near = pose[:, 2] - wrapped(np, pose[:, 2] - asked[:, 2])
    asked[:, 2] = np.where(known, near, asked[:, 2])
    for i, (axes, (name, unit)) in enumerate(zip(panels, _POSE, strict=True)):
        axes.plot(replay.time, asked[:, i], color=BLACK, linewidth=1.0, linestyle="--")
        axes.plot(replay.time, pose[:, i], color=BLUE)
        axes.set_ylabel(f"{name} [{unit}]")
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(replay.time[0], replay.time[-1])
    top_legend(
        figure,
        [
            Line2D([], [], color=BLUE, label="the craft, as the controller saw it"),
            Line2D([], [], color=BLACK, linewidth=1.0, linestyle="--", label="set point"),
        ],
    )
    return figure


@styled
def rotation_error_figure(fastest: float, period: float) -> Figure:
    """Draw what the discretisation neglects: the craft turns while a force is held."""
    figure = new_figure(0.75 * PAGE_WIDTH, 3.0)
    axes = figure.subplots()
    spin = np.geomspace(0.1, 50, 200)
    periods = sorted({0.002, 0.005, 0.01, 0.02, 0.05, period})
    shades = np.linspace(0.25, 1.0, len(periods))
    for shade, h in zip(shades, periods, strict=True):
        error = rotation_error(spin, np.full_like(spin, h))
        own = h == period
        axes.loglog(
            spin,
            100 * error,
            color=VERMILLION if own else BLUE,
            alpha=1.0 if own else float(shade),
            linewidth=2.2 if own else 1.2,
        )
        axes.annotate(
            f"{1e3 * h:g} ms",
            (spin[-1], 100 * error[-1]),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    if fastest > 0:
        at = 100 * float(rotation_error(np.array(fastest), np.array(period)))
        axes.plot([fastest], [at], "o", color=ORANGE, markeredgecolor=BLACK, zorder=5)
        axes.annotate(
            f"fastest spin flown: {fastest:.1f} rad/s, {at:.1f} %",
            (fastest, at),
            xytext=(8, -12),
            textcoords="offset points",
            ha="left",
            va="top",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5},
        )
    axes.set_xlabel("spin |ω| [rad/s]")
    axes.set_ylabel("relative error of the\nvelocity gained in a period [%]")
    axes.set_xlim(spin[0], 75)
    axes.set_title("Neglected turning within a sample time", loc="left")
    return figure


def _outside(replay: Replay) -> list[tuple[float, float]]:
    """Return the spans of time that are not compared."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], replay.compared, [True]]).astype(int)))
    last = len(replay.time) - 1
    return [
        (float(replay.time[a]), float(replay.time[min(b, last)]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
