"""Reports on controllers: `airpuck replay -o` and `airpuck track -o`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from airpuck.control.laws import PAPERS
from airpuck.control.lqr import rotation_error
from airpuck.data.sampling import runs
from airpuck.flight.replay import Replay
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import wrapped
from airpuck.report import style
from airpuck.report.animation import Mover, animate, moving_drawing
from airpuck.report.page import Origin, PageSection, PageTable, Picture, Text, write_page
from airpuck.report.plot import path_figure
from airpuck.report.tables import agreement_table, controller_tables, outcome_table, tracking_tables
from airpuck.twin.tracking_study import Tracked


def replay_report(
    replay: Replay,
    model: Model,
    period: float,
    out: str | os.PathLike[str],
    origin: Origin | None = None,
) -> Path:
    """Write a page on a flight replayed with a control period [s]."""
    figures = replay.to_json()
    used = replay.time[replay.compared]
    commands = (
        "At each step the controller received the poses that had arrived by then, and the recorded "
        "commands instead of its own, so differences do not accumulate."
    )
    asked = Picture("replay_flight", flight_figure(replay), "Pose and set point.")
    compared = Picture("replay_commands", command_figure(replay), commands)
    spin = _fastest_spin(replay)
    neglected = (
        "The discretisation assumes that a force keeps its direction over a control period h. It "
        "turns with the craft by θ = ωh, so the velocity gained has a relative error of about θ/2: "
        f"at the fastest spin of this flight, {spin:.1f} rad/s, and h = {1e3 * period:g} ms, "
        f"{100 * float(rotation_error(np.array(spin), np.array(period))):.1f} %. The next "
        "measurement corrects this error; it affects the one-step prediction only."
    )
    sections = [
        PageSection("commands", "Commands", (agreement_table(replay), compared)),
        PageSection("flight", "Flight", (asked,)),
        PageSection("controller", "Controller", controller_tables(replay)),
        PageSection("discretisation", "What the discretisation neglects", [Text([neglected])]),
    ]
    lead = (
        f"{model.name}, {figures['steps']} commands between {used[0]:.1f} and {used[-1]:.1f} s: "
        f"median difference {figures['median_abs']:.4f}, lowest correlation "
        f"{min(m['correlation'] for m in figures['motors']):.3f}."
    )
    return write_page(out, "Replay of a recorded flight", lead, sections, origin)


def _fastest_spin(replay: Replay) -> float:
    """Return the largest spin of the flight, from differences of yaw [rad/s]."""
    known = np.isfinite(replay.pose[:, 2])
    yaw, time = np.unwrap(replay.pose[known, 2]), replay.time[known]
    # Differences over five periods, because noise in single ones would count as spin.
    turned, taken = yaw[5:] - yaw[:-5], time[5:] - time[:-5]
    return float(np.max(np.abs(turned / taken), initial=0.0)) if (taken > 0).all() else 0.0


#: Line of the set points, and of commands; the broader line is drawn first.
_SET_POINT: dict[str, Any] = {
    "color": style.BLACK,
    "linewidth": 0.9,
    "linestyle": ":",
    "drawstyle": "steps-post",
}
_RECORDED: dict[str, Any] = {"color": style.GREY, "linewidth": 2.1}
_COMPUTED: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.9, "zorder": 2.1}
_COMMANDS = {"twin": _COMPUTED, "real flight": _RECORDED}


class Curve(NamedTuple):
    """Values of each channel or motor over time, with a label and the look of their lines."""

    label: str
    time: Float[np.ndarray, " N"]
    values: Float[np.ndarray, "N k"]
    look: Mapping[str, Any]


@style.styled
def _pose_figure(curves: Sequence[Curve], span: tuple[float, float]) -> Figure:
    """Draw poses over a span of time: a panel for each channel."""
    figure = style.new_figure(style.PAGE_WIDTH, 5.0)
    panels = style.panels(figure, 3, 1, sharex=True)
    for channel, (axes, (name, unit)) in enumerate(zip(panels, style.POSE, strict=True)):
        for curve in curves:
            axes.plot(curve.time, curve.values[:, channel], **curve.look)
        axes.set_ylabel(f"{name} [{unit}]")
    panels[-1].set(xlabel="time [s]", xlim=span)
    style.top_legend(figure, [style.key(curve.label, **curve.look) for curve in curves])
    return figure


@style.styled
def _motor_figure(
    titles: Sequence[str],
    curves: Sequence[Curve],
    shaded: Sequence[Sequence[tuple[float, float]]],
    span: tuple[float, float],
    meaning: str = "",
) -> Figure:
    """Draw commands over a span of time: a panel for each motor, with shaded parts."""
    figure = style.new_figure(style.PAGE_WIDTH, 0.5 + 1.35 * ((len(titles) + 1) // 2))
    panels = style.panels(figure, len(titles), 2, sharex=True, sharey=True)
    for motor, (axes, title, parts) in enumerate(zip(panels, titles, shaded, strict=True)):
        for curve in curves:
            axes.plot(curve.time, curve.values[:, motor], drawstyle="steps-post", **curve.look)
        for start, stop in parts:
            axes.axvspan(start, stop, color=style.LIGHT, linewidth=0, zorder=1)
        axes.set_title(title, loc="left")
        axes.set(xlim=span, ylim=(-0.03, 1.05), xlabel="time [s]", ylabel="command [–]")
        axes.label_outer()
    handles: list[Artist] = [style.key(curve.label, **curve.look) for curve in curves]
    if meaning:
        handles.append(Patch(color=style.LIGHT, label=meaning))
    style.top_legend(figure, handles)
    return figure


def command_figure(replay: Replay) -> Figure:
    """Draw the recorded and computed commands of every motor over time."""
    titles = [
        f"{m['name']}: r = {m['correlation']:.3f}, median |Δ| {m['median_abs']:.4f}"
        for m in replay.to_json()["motors"]
    ]
    time = np.append(replay.time, replay.time[-1])
    outside = [time[[a, b]].tolist() for a, b in runs(~replay.compared)]
    curves = (
        Curve("sent in the flight", replay.time, replay.sent, _RECORDED),
        Curve("computed by this controller", replay.time, replay.computed, _COMPUTED),
    )
    shaded = "not compared" if outside else ""
    span = replay.time[0], replay.time[-1]
    return _motor_figure(titles, curves, [outside] * len(titles), span, shaded)


def flight_figure(replay: Replay) -> Figure:
    """Draw the pose and the set point over time."""
    pose, asked = replay.pose.copy(), replay.reference.copy()
    # The yaw is unwrapped, and each set point is drawn in the turn nearest to the craft.
    known = np.isfinite(pose[:, 2])
    pose[known, 2] = np.unwrap(pose[known, 2])
    asked[known, 2] = (pose[:, 2] - wrapped(np, pose[:, 2] - asked[:, 2]))[known]
    set_point = {"color": style.BLACK, "linewidth": 1.0, "linestyle": "--"}
    curves = (
        Curve("set point", replay.time, asked, set_point),
        Curve("pose, as the controller saw it", replay.time, pose, {"color": style.BLUE}),
    )
    return _pose_figure(curves, (replay.time[0], replay.time[-1]))


def compares_laws(flights: Sequence[Tracked]) -> bool:
    """Return whether any flight used another law than the paper's."""
    return any(flight.law not in (None, PAPERS) for flight in flights)


def flight_colors(flights: Sequence[Tracked]) -> list[str]:
    """Return a colour for each flight: by law where laws differ, otherwise by model."""
    names = [flight.label if compares_laws(flights) else flight.model for flight in flights]
    colors = style.model_colors(names)
    return [colors[name] for name in names]


def summary(flights: Sequence[Tracked]) -> PageTable:
    """Compare the flights in numbers."""
    rows = []
    for flight in flights:
        times = [result.settling_time for result in flight.results]
        done = [time for time in times if time is not None]
        x, y, yaw = np.sqrt(np.mean(flight.twin.errors**2, axis=0))
        cells = [
            f"{len(done)} of {len(times)}",
            f"{np.mean(done):.2f}" if done else "–",
            f"{1e3 * np.hypot(x, y):.0f}",
            f"{yaw:.2f}",
            f"{100 * flight.saturated.mean():.1f} %",
            f"{100 * flight.saturated.any(axis=1).mean():.0f} %",
            f"{1e3 * flight.clearance.min():.0f}",
            *(f"{ms:.2f}" for ms in flight.step_times),
        ]
        rows.append([flight.label, *cells])
    caption = (
        "Distance: root mean square of pose minus set point in force. Full command: share of "
        "commands, and of the time with at least one motor. Steps on this machine, under its "
        "other load; airpuck fly asks the operating system for priority."
    )
    groups = [("", 1), ("settled", 2), ("distance", 2), ("full command", 2), ("to a rail", 1)]
    headings = ["flight", "points", "after [s]", "[mm]", "[rad]", "of all", "any", "nearest [mm]"]
    times = ["median [ms]", "99 % [ms]", "longest [ms]"]
    return PageTable(caption, [*headings, *times], rows, [*groups, ("control step", 3)])


def law_sections(flights: Sequence[Tracked]) -> list[PageSection]:
    """Return the sections that compare control laws."""
    planned = (
        "Every tenth plan of the predictive law over its horizon, coloured by its active limit; a "
        "dot marks its end. Broad line: path flown. Outer frame: rails; dashed: limit of the "
        "craft's centre."
    )
    errors = (
        "Pose minus the set point in force, and clearance between the craft's edge and the nearest "
        "rail; zero is contact."
    )
    distances = Picture("errors", error_figure(flights), errors)
    paths = Picture("above", path_figure(flights), planned)
    outcomes = outcome_table({flight.label: flight.outcomes for flight in flights})
    return [
        PageSection("errors", "Errors and clearance", [distances]),
        PageSection("above", "Paths and plans from above", [paths, _limits_table(flights)]),
        PageSection("outcomes", "Outcomes", [outcomes]),
    ]


def _limits_table(flights: Sequence[Tracked]) -> PageTable:
    """Tabulate how often plans reached each limit."""
    kinds = ("motor", "rail", "disc", "speed", "spin")
    rows = []
    for flight in flights:
        plans = list(flight.log.predictions.values())
        if plans:
            shares = [np.mean([kind in plan.active for plan in plans]) for kind in kinds]
            rows.append([flight.label, *(f"{100 * share:.0f} %" for share in shares)])
    return PageTable(
        "Share of plans that reach a limit anywhere on their horizon.", ["flight", *kinds], rows
    )


@style.styled
def error_figure(flights: Sequence[Tracked]) -> Figure:
    """Draw pose minus set point, and the distance to the nearest rail, over time."""
    figure = style.new_figure(style.PAGE_WIDTH, 6.0)
    panels, colors = style.panels(figure, 4, 1, sharex=True), flight_colors(flights)
    channels = (*style.ERRORS, ("to a rail", "mm", 1e3))
    for k, (axes, (name, unit, factor)) in enumerate(zip(panels, channels, strict=True)):
        axes.axhline(0.0, color=style.GREY, linewidth=0.8)
        for flight, color in zip(flights, colors, strict=True):
            values = np.column_stack([flight.twin.errors, flight.clearance])[:, k]
            axes.plot(flight.twin.time - flight.origin, factor * values, color=color, linewidth=1.4)
        axes.set_ylabel(f"{name} [{unit}]")
    panels[-1].axhline(0.0, color=style.RAIL, linewidth=3.0)
    end = max(float(flight.twin.time[-1]) - flight.origin for flight in flights)
    panels[-1].set(xlabel="time [s]", xlim=(0.0, end))
    keys = [style.key(f.label, color) for f, color in zip(flights, colors, strict=True)]
    style.top_legend(figure, [*keys, style.key("rail", style.RAIL, linewidth=3.0)])
    return figure


_LINES: dict[str, Any] = {
    "twin": {"linewidth": 1.5},
    "real flight": {"linewidth": 1.2, "linestyle": style.DASHED, "alpha": 0.8},
}


def tracking_report(
    flights: Sequence[Tracked],
    truth: str,
    out: str | os.PathLike[str],
    origin: Origin | None = None,
    *,
    set_points: str = "the paper, within reach",
) -> Path:
    """Write a page on a tracking study; `set_points` names the source of the set points."""
    names = " and ".join(flight.label for flight in flights)
    lead = f"The set points of {set_points}, flown with {names} on a twin of {truth}."
    for flight in flights:
        if flight.log.predictions:
            table = flight.table.length_m, flight.table.width_m
            path = Path(out) / f"flight_{flight.file_name}.html"
            animate(flight.recording, path, vehicle=flight.vehicle, table=table, log=flight.log)
            lead += f" {path.name} beside this page shows {flight.label} in motion."
    return write_page(out, "Tracking of set points", lead, tracking_sections(flights), origin)


def tracking_sections(flights: Sequence[Tracked]) -> list[PageSection]:
    """Return the sections of a tracking study."""
    caption = (
        "An accurate model brings the craft to its set points. A poor one leaves an offset, unless "
        "the controller rejects disturbances."
    )
    if compares_laws(flights):
        caption = "All laws fly the same truth, seed and set points."
    blocks = [moving_picture(flights), Picture("tracking", tracking_figure(flights), caption)]
    blocks += tracking_tables(flights)
    inputs = [
        Picture(
            f"inputs_{flight.file_name}",
            input_figure(flight),
            f"Commands of {flight.label}. Shaded: the twin's motor is at full command.",
        )
        for flight in flights
    ]
    tracking = PageSection("tracking", "Tracking", blocks)
    commands = PageSection("inputs", "Commands", inputs)
    if not compares_laws(flights):
        return [tracking, commands]
    short = PageSection("summary", "In short", [summary(flights)])
    return [short, tracking, *law_sections(flights), commands]


def moving_picture(flights: Sequence[Tracked]) -> Picture:
    """Show the flights on the twin from above, in motion."""
    first, moving = flights[0], []
    for flight, color in zip(flights, flight_colors(flights), strict=True):
        time, radius = flight.twin.time - flight.origin, flight.vehicle.radius_m
        moving.append(Mover(flight.label, color, radius, time, flight.twin.pose))
    asked, radius = first.twin.set_points, first.vehicle.radius_m
    goal = Mover("", style.BLACK, radius, asked.times - first.origin, asked.poses)
    drawn = moving_drawing(first.table, [goal, *moving])
    caption = "The flight from above, in real time. Dashed: the set point."
    return Picture("moving", drawn, caption, moves=True)


def tracking_figure(flights: Sequence[Tracked]) -> Figure:
    """Draw pose and set points over time, for all models (fig:control_lqr).

    Real flights start at different times. Each is drawn from half a second before its first new
    set point (`Track.origin`).
    """
    track, origin = flights[0].twin, flights[0].origin
    times = np.append(track.set_points.times, track.time[-1]) - origin
    poses = np.vstack([track.set_points.poses, track.set_points.poses[-1:]])
    curves = [Curve("set point", times, poses, _SET_POINT)]
    for flight, color in zip(flights, flight_colors(flights), strict=True):
        for kind, track in flight.tracks.items():
            look = {"color": color, **_LINES[kind]}
            label = f"{flight.label}, {kind}"
            curves.append(Curve(label, track.time - flight.origin, track.pose, look))
    return _pose_figure(curves, (0.0, max(float(f.twin.time[-1]) - f.origin for f in flights)))


def input_figure(flight: Tracked) -> Figure:
    """Draw the commands of one flight."""
    curves = [
        Curve(kind, track.command_time - flight.origin, track.command, _COMMANDS[kind])
        for kind, track in flight.tracks.items()
    ]
    time = np.append(flight.log.time, flight.log.time[-1]) - flight.log.time[0] - flight.origin
    full = [[time[[a, b]].tolist() for a, b in runs(one)] for one in flight.saturated.T]
    span = 0.0, float(flight.twin.time[-1]) - flight.origin
    return _motor_figure(flight.twin.motors, curves, full, span)
