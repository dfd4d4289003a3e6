"""A report on flights to set points: what `airpuck track -o` writes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from airpuck.data.trajectory import runs
from airpuck.flight.track import TOLERANCE, SetPointResult, Track
from airpuck.report import style
from airpuck.report.animation import animate
from airpuck.report.law_report import flight_colors, law_sections, predicts, summary
from airpuck.report.page import Origin, Picture, Section, Table, write_page
from airpuck.twin.tracking_study import Tracked

_LINES: dict[str, Any] = {
    "twin": {"linewidth": 1.5},
    "real flight": {"linewidth": 1.2, "linestyle": style.DASHED, "alpha": 0.8},
}
#: Lines of commands; the broader one is drawn below.
_COMMANDS: dict[str, Any] = {
    "twin": {"color": style.VERMILLION, "linewidth": 0.9, "zorder": 2.1},
    "real flight": {"color": style.GREY, "linewidth": 2.0},
}


def tracking_report(
    flights: Sequence[Tracked],
    truth: str,
    out: str | os.PathLike[str],
    origin: Origin | None = None,
    *,
    set_points: str = "the paper",
) -> Path:
    """Write a report on a tracking study; `set_points`: whose they are."""
    names = " and ".join(flight.label for flight in flights)
    lead = f"The set points of {set_points}, flown with {names} on a twin of {truth}."
    for flight in flights:
        if flight.log.predictions:
            table = flight.table.length_m, flight.table.width_m
            path = Path(out) / f"flight_{_file_name(flight)}.html"
            animate(flight.recording, path, vehicle=flight.vehicle, table=table, log=flight.log)
            lead += f" {path.name} beside this page shows {flight.label} in motion."
    return write_page(out, "Tracking of set points", lead, tracking_sections(flights), origin)


def tracking_sections(flights: Sequence[Tracked]) -> list[Section]:
    """Return what a page shows of a tracking study."""
    rows = [
        [f"{flight.label}, {kind}", *_row(result)]
        for flight in flights
        for kind, track in _tracks(flight).items()
        for result in track.moves()
    ]
    results = Table(
        f"What became of each set point. Settled: after so long the craft stays within "
        f"{1e3 * TOLERANCE[0]:g} mm and {TOLERANCE[2]:g} rad of it. Rests: mean distance over the "
        "last second, or the last quarter of a short dwell. "
        "Effort: mean of the sum of squared commands above the lowest.",
        ["flight", "set point", "settled after [s]", "overshoot", "rests away by", "effort"],
        rows,
    )
    caption = (
        "A model that explains the craft brings it to its set points; a poor one leaves an offset, "
        "unless disturbances are rejected."
    )
    if predicts(flights):
        caption = "Truth, seed and set points are the same for all laws."
    blocks = [Picture("tracking", tracking_figure(flights), caption), results]
    apart = [
        [f.model, *(f"{1e3 * error:.1f}" for error in f.rmse[:2]), f"{f.rmse[2]:.3f}"]
        for f in flights
        if f.rmse is not None
    ]
    if apart:
        words = "Twin against the real flight, 0.5 to 6.5 s on the figure's axis, root mean square."
        blocks.append(Table(words, ["flight", "x [mm]", "y [mm]", "yaw [rad]"], apart))
    inputs = [
        Picture(f"inputs_{_file_name(flight)}", input_figure(flight), _said(flight))
        for flight in flights
    ]
    tracking, commands = (
        Section("tracking", "Tracking", blocks),
        Section("inputs", "Commands", inputs),
    )
    if not predicts(flights):
        return [tracking, commands]
    return [summary(flights), tracking, *law_sections(flights), commands]


def _file_name(flight: Tracked) -> str:
    """Return the part of a figure's file name that tells flights apart."""
    return flight.model if flight.regulator != "mpc" else f"{flight.model}_mpc"


def _said(flight: Tracked) -> str:
    """Return what stands below the commands of a flight."""
    return f"Commands of {flight.label}. Shaded: a motor of the twin is at full command."


def _tracks(flight: Tracked) -> dict[str, Track]:
    """Name what was flown: on the twin, and in reality where it was."""
    return {"twin": flight.twin} | ({"real flight": flight.real} if flight.real is not None else {})


def _row(result: SetPointResult) -> list[str]:
    """Lay out the figures of one set point."""
    settled = "not" if result.settling_time is None else f"{result.settling_time:.2f}"
    return [
        f"{result.pose[0]:.1f}, {result.pose[1]:.1f} m, {result.pose[2]:.1f} rad",
        settled,
        _triple(result.overshoot),
        "no poses" if result.steady_state_error is None else _triple(result.steady_state_error),
        f"{result.effort:.3f}",
    ]


def _triple(values: tuple[float, ...]) -> str:
    """Write x, y and yaw."""
    x, y, yaw = values
    return f"{1e3 * x:.1f}, {1e3 * y:.1f} mm, {yaw:.3f} rad"


@style.styled
def tracking_figure(flights: Sequence[Tracked]) -> Figure:
    """Draw pose and set points over time, for all models (fig:control_lqr).

    Real flights begin at different times: each is drawn from half a second before its first
    set point that differs from the start (`Track.origin`).
    """
    figure = style.new_figure(style.PAGE_WIDTH, 5.0)
    panels = style.pose_panels(figure)
    handles = [style.key("set point", linewidth=0.9, linestyle=":")]
    track, origin = flights[0].twin, flights[0].origin
    times = np.append(track.set_points.times, track.time[-1]) - origin
    poses = np.vstack([track.set_points.poses, track.set_points.poses[-1:]])
    for axes, values in zip(panels, poses.T, strict=True):
        axes.step(times, values, where="post", color=style.BLACK, linewidth=0.9, linestyle=":")
    for flight, color in zip(flights, flight_colors(flights), strict=True):
        for kind, track in _tracks(flight).items():
            line = _LINES[kind]
            for axes, values in zip(panels, track.pose.T, strict=True):
                axes.plot(track.time - flight.origin, values, color=color, **line)
            handles.append(style.key(f"{flight.label}, {kind}", color, **line))
    panels[-1].set_xlim(0.0, max(float(f.twin.time[-1]) - f.origin for f in flights))
    style.top_legend(figure, handles)
    return figure


@style.styled
def input_figure(flight: Tracked) -> Figure:
    """Draw the commands of one flight."""
    motors = flight.twin.motors
    figure = style.new_figure(style.PAGE_WIDTH, 0.5 + 1.25 * ((len(motors) + 1) // 2))
    tracks = _tracks(flight)
    for i, axes in enumerate(style.motor_panels(figure, motors)):
        for kind, track in tracks.items():
            time = track.command_time - flight.origin
            axes.step(time, track.command[:, i], where="post", **_COMMANDS[kind])
        for first, last in runs(flight.saturated[:, i]):
            span = flight.log.time[[first, min(last, len(flight.log.time) - 1)]]
            start, stop = (span - flight.log.time[0] - flight.origin).tolist()
            axes.axvspan(start, stop, color=style.LIGHT, linewidth=0, zorder=1)
        axes.set_xlim(0.0, float(flight.twin.time[-1]) - flight.origin)
    style.top_legend(figure, [style.key(kind, **_COMMANDS[kind]) for kind in tracks])
    return figure
